//! Buffers of a glTF document: the binary chunk, data within URIs, and files beside the document.

use super::error::ReadError;
use super::text::BASE64;
use super::{file, limits};
use ::gltf::Document;
use ::gltf::buffer::Source;
use base64::Engine;
use std::borrow::Cow;
use std::collections::HashMap;
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;

/// Data of each buffer of a document. Buffers that name the same file share its contents.
pub(super) struct Buffers<'a>(Vec<BufferData<'a>>);

enum BufferData<'a> {
    /// Data in the file of the document.
    Within(Cow<'a, [u8]>),
    /// Contents of a file beside the document.
    Beside(Arc<[u8]>),
}

impl<'a> Buffers<'a> {
    /// Loads the buffers. `read` is the size of the document itself in bytes, `blob` its binary
    /// chunk.
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
                blob.map(|blob| BufferData::Within(Cow::Borrowed(blob))).ok_or_else(missing)
            }
            Source::Uri(uri) => fetch(buffer.index(), uri, &mut files),
        };
        document.buffers().map(load).collect::<Result<_, _>>().map(Self)
    }

    /// Data of a buffer; `None` if there is no such buffer.
    pub(super) fn get(&self, index: usize) -> Option<&[u8]> {
        self.0.get(index).map(|data| match data {
            BufferData::Within(bytes) => &bytes[..],
            BufferData::Beside(bytes) => &bytes[..],
        })
    }
}

/// Files beside the document. Each is read once, even if several buffers name it.
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

/// Loads a buffer from its URI, which contains the data or names a file beside the document.
fn fetch(index: usize, uri: &str, files: &mut Files<'_>) -> Result<BufferData<'static>, ReadError> {
    let wrong = |detail: &str| ReadError::document(format!("buffers[{index}].uri"), detail);
    if let Some(data) = uri.strip_prefix("data:") {
        let (_, data) = data.split_once(";base64,").ok_or_else(|| wrong("its data are not in base64"))?;
        let bytes = decoded(data).ok_or_else(|| wrong("its data are not valid base64"))?;
        return Ok(BufferData::Within(Cow::Owned(bytes)));
    }
    let name = percent_decoded(uri).ok_or_else(|| wrong("it is not a valid relative reference"))?;
    let path = Path::new(&name);
    if uri.contains(':') || !path.components().all(|part| matches!(part, Component::Normal(_) | Component::CurDir)) {
        return Err(wrong("only files beside the document are read"));
    }
    let folder = files.folder.ok_or_else(|| wrong("files beside a document in memory cannot be read"))?;
    // Without `.`, so that each file has one path.
    let path = path.components().filter(|part| matches!(part, Component::Normal(_)));
    files.read(folder.join(path.collect::<PathBuf>())).map(BufferData::Beside)
}

/// Decodes base64 in the standard or the URL-safe alphabet, with any number of padding characters.
fn decoded(text: &str) -> Option<Vec<u8>> {
    let standard = |symbol| match symbol {
        b'-' => b'+',
        b'_' => b'/',
        other => other,
    };
    BASE64.decode(text.trim_end_matches('=').bytes().map(standard).collect::<Vec<u8>>()).ok()
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
        for text in ["AAAA", "AAAA="] {
            assert_eq!(decoded(text), Some(vec![0; 3]), "{text}");
        }
        for text in ["A", "AA=A", "A A", "é"] {
            assert_eq!(decoded(text), None, "{text}");
        }
    }
}
