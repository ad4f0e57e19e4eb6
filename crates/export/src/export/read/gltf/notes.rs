//! Notes about what was passed over, one for all places of the same kind.

use std::borrow::Cow;

/// Upper bound for kinds of notes; a file can name any number of extensions.
const KINDS: usize = 40;

/// Notes by kind.
#[derive(Default)]
pub(super) struct Notes(Vec<Note>);

struct Note {
    text: Cow<'static, str>,
    /// First and last place; empty for the whole file.
    place: String,
    last: String,
    /// Number of places. Parts that are used in turn several times count again.
    count: usize,
}

impl Notes {
    /// Adds a note about a place such as `nodes[3]`, or about the whole file if `place` is empty.
    pub(super) fn add(&mut self, place: &str, text: impl Into<Cow<'static, str>>) {
        let text = text.into();
        if let Some(known) = self.0.iter_mut().find(|note| note.text == text) {
            if known.last != place {
                known.count += 1;
                place.clone_into(&mut known.last);
            }
        } else if self.0.len() < KINDS {
            self.0.push(Note { text, place: place.to_owned(), last: place.to_owned(), count: 1 });
        }
    }

    /// The notes as text.
    pub(super) fn into_texts(self) -> Vec<String> {
        let text = |Note { text, place, count, .. }| match count {
            _ if place.is_empty() => text.into_owned(),
            1 => format!("{place}: {text}"),
            _ => format!("{place} and {} more: {text}", count - 1),
        };
        self.0.into_iter().map(text).collect()
    }
}
