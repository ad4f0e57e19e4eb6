//! Container of binary glTF, and parsing of the document without validation.

use super::error::ReadError;
use super::limits;
use ::gltf::json::{Root, deserialize};

/// Splits a binary file into its document and its binary chunk.
pub(super) fn chunks(bytes: &[u8]) -> Result<(&[u8], Option<&[u8]>), ReadError> {
    let wrong = |byte: usize, detail: &str| ReadError::Byte { byte, detail: detail.to_owned() };
    let word = |byte: usize| {
        let word = bytes.get(byte..).and_then(|rest| rest.first_chunk::<4>());
        word.map(|b| u32::from_le_bytes(*b)).ok_or_else(|| wrong(byte, "the file ends within a header"))
    };
    if word(4)? != 2 {
        return Err(wrong(4, "the version is not 2"));
    }
    if word(8)? as usize > bytes.len() {
        return Err(wrong(8, "the file is shorter than it says"));
    }
    let chunk = |begin: usize, kind: &[u8; 4], what: &str| {
        let length = word(begin)? as usize;
        if bytes.get(begin + 4..begin + 8) != Some(kind) {
            return Err(wrong(begin + 4, &format!("this is not the {what} chunk")));
        }
        let rest = &bytes[begin + 8..];
        rest.get(..length).ok_or_else(|| wrong(begin, &format!("the {what} chunk is longer than the file")))
    };
    let json = chunk(12, b"JSON", "JSON")?;
    let next = 20 + json.len().next_multiple_of(4);
    let blob = if next + 8 <= bytes.len() { Some(chunk(next, b"BIN\0", "binary")?) } else { None };
    Ok((json, blob))
}

/// Parses a document without validating it.
pub(super) fn root(json: &[u8]) -> Result<Root, ReadError> {
    if json.trim_ascii_start().first() != Some(&b'{') {
        return Err(ReadError::UnknownFormat);
    }
    let objects = json.iter().filter(|&&byte| byte == b'{').count() as u64;
    limits::limited("document", objects, "JSON objects", limits::OBJECTS)?;
    deserialize::from_slice(json).map_err(|error| refused(error.into()))
}

/// Converts an error of the `gltf` crate, of which only the first validation error is reported.
pub(super) fn refused(error: ::gltf::Error) -> ReadError {
    match error {
        ::gltf::Error::Validation(faults) => match faults.first() {
            Some((path, error)) => {
                ReadError::document(path.as_str(), format!("{error} ({} such faults in all)", faults.len()))
            }
            None => ReadError::document("document", "it is not valid"),
        },
        other => ReadError::document("document", other.to_string()),
    }
}
