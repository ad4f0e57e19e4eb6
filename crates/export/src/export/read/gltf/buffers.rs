//! Buffers of a glTF document: the binary chunk, data within URIs, and files beside the document.

use super::document::Document;
use super::extensions::MESHOPT;
use super::json::Object;
use crate::export::read::error::ReadError;
use crate::export::read::text::BASE64;
use crate::export::read::{file, limits};
use base64::Engine;
use std::cell::{OnceCell, RefCell};
use std::collections::HashMap;
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;

/// Data of the buffers of a document, loaded when they are used: the file of a texture may be
/// missing. Buffers that name the same file share its contents.
pub(super) struct Buffers<'a> {
    document: &'a Document<'a>,
    blob: Option<&'a [u8]>,
    loaded: Vec<OnceCell<Arc<Vec<u8>>>>,
    files: RefCell<Files<'a>>,
}

impl<'a> Buffers<'a> {
    /// Buffers none of which is loaded. `read` is the size of the document itself in bytes, `blob`
    /// its binary chunk.
    pub(super) fn new(document: &'a Document<'a>, read: u64, blob: Option<&'a [u8]>, folder: Option<&'a Path>) -> Self {
        let files = Files { room: limits::BYTES.saturating_sub(read), folder, known: HashMap::new() };
        let loaded = (0..document.buffers.len()).map(|_| OnceCell::new()).collect();
        Self { document, blob, loaded, files: RefCell::new(files) }
    }

    /// Data of a buffer.
    pub(super) fn get(&self, index: usize) -> Result<&[u8], ReadError> {
        if let Some(data) = self.loaded.get(index).and_then(OnceCell::get) {
            return Ok(data);
        }
        let buffer = self.document.buffers.get(index)?;
        self.document.check(&buffer, &MESHOPT)?;
        let uri = buffer.text("uri");
        if uri.is_none() && buffer.has("uri") {
            return Err(buffer.wrong("uri", "it is not a text"));
        }
        // An empty one names nothing.
        match (uri.filter(|uri| !uri.is_empty()), self.blob) {
            (Some(uri), _) => {
                let data = fetch(&buffer, &uri, &mut self.files.borrow_mut())?;
                Ok(self.loaded[index].get_or_init(|| data))
            }
            (None, Some(blob)) if index == 0 => Ok(blob),
            (None, _) => Err(buffer.fault("it has no data: no uri, and it is not the binary chunk of the file")),
        }
    }
}

/// Files beside the document. Each is read once, even if several buffers name it.
struct Files<'f> {
    /// Bytes that may still be read.
    room: u64,
    folder: Option<&'f Path>,
    known: HashMap<PathBuf, Arc<Vec<u8>>>,
}

impl Files<'_> {
    fn read(&mut self, path: PathBuf) -> Result<Arc<Vec<u8>>, ReadError> {
        if let Some(known) = self.known.get(&path) {
            return Ok(Arc::clone(known));
        }
        let bytes = Arc::new(file::read(&path, self.room)?);
        self.room -= bytes.len() as u64;
        self.known.insert(path, Arc::clone(&bytes));
        Ok(bytes)
    }
}

/// Loads a buffer from its URI, which contains the data or names a file beside the document.
fn fetch(buffer: &Object<'_>, uri: &str, files: &mut Files<'_>) -> Result<Arc<Vec<u8>>, ReadError> {
    let wrong = |detail: &str| buffer.wrong("uri", detail);
    if let Some(data) = uri.strip_prefix("data:") {
        let (_, data) = data.split_once(";base64,").ok_or_else(|| wrong("its data are not in base64"))?;
        let bytes = decoded(data).ok_or_else(|| wrong("its data are not valid base64"))?;
        return Ok(Arc::new(bytes));
    }
    let name = percent_decoded(uri).ok_or_else(|| wrong("it is not a valid relative reference"))?;
    let path = Path::new(&name);
    if uri.contains(':') || !path.components().all(|part| matches!(part, Component::Normal(_) | Component::CurDir)) {
        return Err(wrong("only files beside the document are read"));
    }
    let folder = files.folder.ok_or_else(|| wrong("files beside a document in memory cannot be read"))?;
    // Without `.`, so that each file has one path.
    let path = path.components().filter(|part| matches!(part, Component::Normal(_)));
    files.read(folder.join(path.collect::<PathBuf>()))
}

/// Decodes base64 in the standard or the URL-safe alphabet, with any number of padding characters
/// and with line breaks.
fn decoded(text: &str) -> Option<Vec<u8>> {
    let standard = |symbol| match symbol {
        b'-' => b'+',
        b'_' => b'/',
        other => other,
    };
    let symbols = text.bytes().filter(|symbol| !symbol.is_ascii_whitespace()).map(standard);
    let mut symbols: Vec<u8> = symbols.collect();
    let padding = symbols.iter().rev().take_while(|&&symbol| symbol == b'=').count();
    symbols.truncate(symbols.len() - padding);
    BASE64.decode(symbols).ok()
}

fn percent_decoded(uri: &str) -> Option<String> {
    let (mut bytes, mut rest) = (Vec::new(), uri.as_bytes());
    while let Some((&first, after)) = rest.split_first() {
        if first == b'%' {
            let digits = std::str::from_utf8(after.get(..2)?).ok()?;
            bytes.push(u8::from_str_radix(digits, 16).ok()?);
            rest = &after[2..];
        } else {
            bytes.push(first);
            rest = after;
        }
    }
    String::from_utf8(bytes).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn alphabets_and_padding_of_base64_do_not_matter() {
        for text in ["-_8=", "+/8=", "-_8", "+/8=="] {
            assert_eq!(decoded(text), Some(vec![251, 255]), "{text}");
        }
        for text in ["AAAA", "AAAA=", "AA\r\nAA\n"] {
            assert_eq!(decoded(text), Some(vec![0; 3]), "{text}");
        }
        for text in ["A", "AA=A", "é"] {
            assert_eq!(decoded(text), None, "{text}");
        }
    }
}
