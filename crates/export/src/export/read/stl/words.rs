//! Words of a text file, with the numbers of their lines.

use super::super::error::ReadError;
use super::super::text::{coordinate, first_line, line_ends, quoted, wrong};
use std::borrow::Cow;

/// Splits a text into words. Keywords may have any case.
pub(super) struct Words<'a> {
    rest: &'a [u8],
    /// Line of the last word, from 1.
    line: usize,
}

impl<'a> Words<'a> {
    pub(super) fn new(bytes: &'a [u8]) -> Self {
        Self { rest: bytes, line: 1 }
    }

    pub(super) fn line(&self) -> usize {
        self.line
    }

    /// Returns the next word. A word that is not UTF-8 is replaced by one that no rule accepts.
    pub(super) fn next(&mut self) -> Option<&'a str> {
        let (word, rest, line) = self.split()?;
        (self.rest, self.line) = (rest, line);
        Some(word)
    }

    /// The next word, what follows it, and its line.
    fn split(&self) -> Option<(&'a str, &'a [u8], usize)> {
        let begin = self.rest.iter().position(|b| !b.is_ascii_whitespace())?;
        let (space, rest) = self.rest.split_at(begin);
        let line = self.line + line_ends(space);
        let (word, rest) = rest.split_at(rest.iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len()));
        Some((std::str::from_utf8(word).unwrap_or("\u{fffd}"), rest, line))
    }

    /// Takes the next word if it is `keyword`.
    pub(super) fn next_is(&mut self, keyword: &str) -> bool {
        self.next_is_any(&[keyword])
    }

    /// Takes the next word if it is one of the keywords.
    pub(super) fn next_is_any(&mut self, keywords: &[&str]) -> bool {
        match self.split() {
            Some((word, rest, line)) if keywords.iter().any(|keyword| word.eq_ignore_ascii_case(keyword)) => {
                (self.rest, self.line) = (rest, line);
                true
            }
            _ => false,
        }
    }

    pub(super) fn expect(&mut self, keyword: &str) -> Result<(), ReadError> {
        if self.next_is(keyword) {
            return Ok(());
        }
        match self.next() {
            Some(word) => Err(wrong(self.line, format!("{} instead of {keyword:?}", quoted(word)))),
            None => Err(self.ended(&format!("the file stops before {keyword:?}"))),
        }
    }

    /// Takes `end` with the keyword, in one word or two.
    pub(super) fn expect_end(&mut self, keyword: &str) -> Result<(), ReadError> {
        if self.next_is("end") {
            return self.expect(keyword);
        }
        self.expect(&format!("end{keyword}"))
    }

    /// Reads three coordinates, as f32 if they are `single`.
    pub(super) fn point(&mut self, single: bool) -> Result<[f64; 3], ReadError> {
        let mut point = [0.0; 3];
        for x in &mut point {
            let word = self.next();
            if word.is_none() {
                return Err(self.ended("the file stops within a vertex"));
            }
            *x = if single { coordinate::<f32>(self.line, word)? } else { coordinate::<f64>(self.line, word)? };
        }
        Ok(point)
    }

    pub(super) fn ended(&self, detail: &str) -> ReadError {
        wrong(self.line, format!("the end is missing: {detail}"))
    }

    /// Takes the rest of the line.
    pub(super) fn pass_line(&mut self) {
        let (line, _) = first_line(self.rest);
        self.rest = &self.rest[line.len()..];
    }

    /// Takes a name: the rest of the line, or what precedes `facet normal` if a facet begins in it.
    pub(super) fn name(&mut self) -> Cow<'a, str> {
        let (name, rest) = self.rest.split_at(name_end(self.rest));
        self.rest = rest;
        String::from_utf8_lossy(name)
    }

    /// True if the rest of the file has the word `facet`.
    pub(super) fn has_facets(&self) -> bool {
        self.rest.split(u8::is_ascii_whitespace).any(|word| word.eq_ignore_ascii_case(b"facet"))
    }
}

/// Offset of the line end or of the words `facet normal`, whichever comes first. A file may be one
/// line of many solids, so nothing beyond this offset is scanned.
fn name_end(text: &[u8]) -> usize {
    let (mut at, mut facet) = (0, None);
    loop {
        let space = text[at..].iter().position(|b| !b.is_ascii_whitespace() || matches!(b, b'\n' | b'\r'));
        let Some(start) = space.map(|space| at + space) else { return text.len() };
        let word = text[start..].split(u8::is_ascii_whitespace).next().unwrap_or_default();
        match facet {
            _ if word.is_empty() => return start,
            Some(facet) if word.eq_ignore_ascii_case(b"normal") => return facet,
            _ => facet = word.eq_ignore_ascii_case(b"facet").then_some(start),
        }
        at = start + word.len();
    }
}
