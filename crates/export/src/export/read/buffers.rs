//! The buffers of a glTF document: the binary chunk, data within URIs, and files beside the document.

use super::error::ReadError;
use super::{file, limits};
use ::gltf::Document;
use ::gltf::buffer::Source;
use std::borrow::Cow;
use std::collections::HashMap;
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;

/// The data of each buffer of a document. Buffers of the same file share its contents.
pub(super) struct Buffers<'a>(Vec<Data<'a>>);

enum Data<'a> {
    Within(Cow<'a, [u8]>),
    Beside(Arc<[u8]>),
}

impl<'a> Buffers<'a> {
    /// Loads the buffers. `read` is the number of bytes that the document itself has, `blob` its binary chunk.
    pub(super) fn load(
        document: &Document,
        read: u64,
        blob: Option<&'a [u8]>,
        folder: Option<&Path>,
    ) -> Result<Self, ReadError> {
        let mut files = Files { room: limits::BYTES.saturating_sub(read), folder, known: HashMap::new() };
        let load = |buffer: ::gltf::Buffer<'_>| match buffer.source() {
            Source::Bin => {
                let missing = || ReadError::document(format!("buffers[{}]", buffer.index()), "it has no data");
                blob.map(|blob| Data::Within(Cow::Borrowed(blob))).ok_or_else(missing)
            }
            Source::Uri(uri) => fetch(buffer.index(), uri, &mut files),
        };
        document.buffers().map(load).collect::<Result<_, _>>().map(Self)
    }

    /// The data of a buffer.
    pub(super) fn get(&self, index: usize) -> Option<&[u8]> {
        self.0.get(index).map(|data| match data {
            Data::Within(bytes) => &bytes[..],
            Data::Beside(bytes) => &bytes[..],
        })
    }
}

/// Files beside the document; each is read once, however many buffers name it.
struct Files<'f> {
    /// Bytes that may still be read.
    room: u64,
    folder: Option<&'f Path>,
    known: HashMap<PathBuf, Arc<[u8]>>,
}

impl Files<'_> {
    fn read(&mut self, path: PathBuf) -> Result<Arc<[u8]>, ReadError> {
        if let Some(known) = self.known.get(&path) {
            return Ok(Arc::clone(known));
        }
        let bytes: Arc<[u8]> = file::read(&path, self.room)?.into();
        self.room -= bytes.len() as u64;
        self.known.insert(path, Arc::clone(&bytes));
        Ok(bytes)
    }
}

/// Loads a buffer that is named by a URI: data within it, or a file beside the document.
fn fetch(index: usize, uri: &str, files: &mut Files<'_>) -> Result<Data<'static>, ReadError> {
    let wrong = |detail: &str| ReadError::document(format!("buffers[{index}].uri"), detail);
    if let Some(data) = uri.strip_prefix("data:") {
        let (_, data) = data.split_once(";base64,").ok_or_else(|| wrong("its data are not in base64"))?;
        let bytes = base64(data.as_bytes()).ok_or_else(|| wrong("its data are not valid base64"))?;
        return Ok(Data::Within(Cow::Owned(bytes)));
    }
    let name = percent_decoded(uri).ok_or_else(|| wrong("it is not a valid relative reference"))?;
    let path = Path::new(&name);
    if uri.contains(':') || !path.components().all(|part| matches!(part, Component::Normal(_) | Component::CurDir)) {
        return Err(wrong("only files beside the document are read"));
    }
    let folder = files.folder.ok_or_else(|| wrong("files beside a document in memory cannot be read"))?;
    // Without `.`, so that one file has one path.
    let path = path.components().filter(|part| matches!(part, Component::Normal(_)));
    files.read(folder.join(path.collect::<PathBuf>())).map(Data::Beside)
}

fn base64(text: &[u8]) -> Option<Vec<u8>> {
    let text = text.strip_suffix(b"==").or_else(|| text.strip_suffix(b"=")).unwrap_or(text);
    let mut bytes = Vec::with_capacity(text.len() / 4 * 3 + 3);
    for group in text.chunks(4) {
        let mut word = 0u32;
        for &symbol in group {
            let value = match symbol {
                b'A'..=b'Z' => symbol - b'A',
                b'a'..=b'z' => symbol - b'a' + 26,
                b'0'..=b'9' => symbol - b'0' + 52,
                b'+' | b'-' => 62,
                b'/' | b'_' => 63,
                _ => return None,
            };
            word = (word << 6) | u32::from(value);
        }
        word <<= 6 * (4 - group.len());
        let whole = match group.len() {
            4 => 3,
            3 => 2,
            2 => 1,
            _ => return None,
        };
        bytes.extend(&word.to_be_bytes()[1..=whole]);
    }
    Some(bytes)
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
