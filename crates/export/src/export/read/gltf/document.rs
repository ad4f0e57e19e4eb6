//! The parts of a glTF document that matter for geometry. All other parts are passed over unread.

use super::extensions::Extensions;
use super::json::{Array, Members, Object, shown};
use super::notes::Notes;
use crate::export::read::error::ReadError;
use crate::export::read::limits;
use std::borrow::Cow;
use std::cell::RefCell;

/// A document. Items of its lists are parsed when they are used.
pub(super) struct Document<'a> {
    pub(super) root: Object<'a>,
    pub(super) scenes: Array<'a>,
    pub(super) nodes: Array<'a>,
    pub(super) meshes: Array<'a>,
    pub(super) skins: Array<'a>,
    pub(super) materials: Array<'a>,
    pub(super) accessors: Array<'a>,
    pub(super) views: Array<'a>,
    pub(super) buffers: Array<'a>,
    pub(super) extensions: Extensions,
    notes: RefCell<Notes>,
}

/// Decodes the text of a document. A byte order mark is removed, and invalid UTF-8, which can only
/// be part of names, is replaced.
pub(super) fn text<'a>(json: &'a [u8], notes: &mut Notes) -> Result<Cow<'a, str>, ReadError> {
    let json = json.strip_prefix(b"\xef\xbb\xbf").unwrap_or(json);
    if json.trim_ascii_start().first() != Some(&b'{') {
        return Err(ReadError::UnknownFormat);
    }
    let objects = json.iter().filter(|&&byte| byte == b'{').count() as u64;
    limits::limited("document", objects, "JSON objects", limits::OBJECTS)?;
    let text = String::from_utf8_lossy(json);
    if matches!(text, Cow::Owned(_)) {
        notes.add("document", "its text is not valid UTF-8; invalid bytes were replaced");
    }
    Ok(text)
}

impl<'a> Document<'a> {
    /// Parses a document. Its text may be followed by anything.
    pub(super) fn parse(text: &'a str, mut notes: Notes) -> Result<Self, ReadError> {
        let mut values = serde_json::Deserializer::from_str(text).into_iter::<Members<'_>>();
        let members = match values.next() {
            Some(Ok(members)) => members,
            Some(Err(error)) => return Err(ReadError::document("document", error.to_string())),
            None => return Err(ReadError::UnknownFormat),
        };
        let rest = text.get(values.byte_offset()..).unwrap_or_default();
        if !rest.trim_matches(|c: char| c.is_whitespace() || c == '\0').is_empty() {
            notes.add("document", format!("{} bytes after its end were passed over", rest.len()));
        }
        let root = Object::new("", members);
        check_version(&root)?;
        if !root.has("asset") {
            notes.add("asset", "it is missing; glTF 2.0 is assumed");
        }
        Ok(Self {
            scenes: root.array("scenes")?,
            nodes: root.array("nodes")?,
            meshes: root.array("meshes")?,
            skins: root.lazy_array("skins"),
            materials: root.lazy_array("materials"),
            accessors: root.lazy_array("accessors"),
            views: root.lazy_array("bufferViews"),
            buffers: root.lazy_array("buffers"),
            extensions: Extensions::new(&root),
            notes: RefCell::new(notes),
            root,
        })
    }

    /// Adds a note.
    pub(super) fn note(&self, place: &str, text: impl Into<Cow<'static, str>>) {
        self.notes.borrow_mut().add(place, text);
    }

    /// Checks the extensions of a part that is in use, as [`Extensions::check`].
    pub(super) fn check(&self, part: &Object<'_>, read: &[&str]) -> Result<(), ReadError> {
        self.extensions.check(part, read, &mut self.notes.borrow_mut())
    }

    /// True if the document declares that it uses the extension.
    pub(super) fn declares(&self, extension: &str) -> bool {
        self.extensions.requires(extension) || self.root.texts("extensionsUsed").iter().any(|name| name == extension)
    }

    /// All notes, when everything was read.
    pub(super) fn into_notes(self) -> Vec<String> {
        let mut notes = self.notes.into_inner();
        self.extensions.note_required(&mut notes);
        notes.into_texts()
    }
}

/// Refuses documents that need another version, and those of glTF 1.0, which look alike and mean
/// something else.
fn check_version(root: &Object<'_>) -> Result<(), ReadError> {
    if let Some(asset) = root.object("asset").ok().flatten() {
        let is_other = |version: &String| version.split('.').next().is_some_and(|major| major.trim() != "2");
        if let Some(version) = asset.text("version").filter(is_other) {
            let detail = format!("this is glTF {}, and only glTF 2.0 is read", shown(&version));
            return Err(asset.wrong("version", detail));
        }
        if let Some(version) = asset.text("minVersion").filter(|version| is_above(version)) {
            let detail = format!("the document requires glTF {}, and only glTF 2.0 is read", shown(&version));
            return Err(asset.wrong("minVersion", detail));
        }
    }
    if ["meshes", "nodes"].iter().any(|name| matches!(root.object(name), Ok(Some(_)))) {
        return Err(root.wrong("meshes", "this is an object, as in glTF 1.0, and only glTF 2.0 is read"));
    }
    Ok(())
}

/// True if a version such as `2.1` is above 2.0.
fn is_above(version: &str) -> bool {
    let (major, minor) = version.split_once('.').unwrap_or((version, "0"));
    let number = |part: &str| part.trim().parse::<u64>().ok();
    match (number(major), number(minor)) {
        (Some(2), Some(minor)) => minor > 0,
        (Some(major), _) => major > 2,
        (None, _) => false,
    }
}
