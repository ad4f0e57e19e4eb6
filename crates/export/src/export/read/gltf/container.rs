//! Container of binary glTF: finds the document and the binary chunk among all chunks.

use super::notes::Notes;
use crate::export::read::error::ReadError;

/// Bytes of the header, and of the head of a chunk.
const HEADER: usize = 12;
const HEAD: usize = 8;

/// Splits a file into its document and its binary chunk. A text file is all document.
pub(super) fn chunks<'a>(bytes: &'a [u8], notes: &mut Notes) -> Result<(&'a [u8], Option<&'a [u8]>), ReadError> {
    if !bytes.starts_with(b"glTF") {
        return Ok((bytes, None));
    }
    let wrong = |byte: usize, detail: String| ReadError::Byte { byte, detail };
    let header = |byte| word(bytes, byte).ok_or_else(|| wrong(byte, "the file ends within its header".to_owned()));
    let version = header(4)?;
    if version != 2 {
        return Err(wrong(4, format!("this is glTF {version}.0, and only glTF 2.0 is read; convert the file first")));
    }
    let (stated, length) = (header(8)? as usize, bytes.len());
    if stated > length {
        return Err(wrong(
            8,
            format!("the file has {length} bytes, and its header states {stated}: its end is missing"),
        ));
    }
    if stated < length {
        let detail = format!("the header states {stated} bytes, and the file has {length}; all chunks were read");
        notes.add("", detail);
    }
    let (mut json, mut blob, mut at) = (None, None, HEADER);
    while let (None, Some(length), Some(kind)) = (blob, word(bytes, at), bytes.get(at + 4..at + HEAD)) {
        let (begin, end) = (at + HEAD, (at + HEAD).saturating_add(length as usize));
        let whole = |what: &str| {
            let detail = || format!("the {what} chunk has {length} bytes and is longer than the rest of the file");
            bytes.get(begin..end).ok_or_else(|| wrong(at, detail()))
        };
        match kind {
            b"JSON" if json.is_none() => json = Some(whole("JSON")?),
            b"BIN\0" => blob = Some(whole("binary")?),
            _ if at < stated => notes.add(&format!("byte {at}"), "a chunk of unknown type was passed over"),
            _ => {}
        }
        at = next(bytes, end);
    }
    let json = json.ok_or_else(|| wrong(HEADER, "there is no JSON chunk".to_owned()))?;
    Ok((json, blob))
}

/// Start of the chunk after one that ends at `end`. A chunk whose length is no multiple of four is
/// padded in some files and not in others.
fn next(bytes: &[u8], end: usize) -> usize {
    let padded = end.checked_next_multiple_of(4).unwrap_or(end);
    let is_known = |at: &usize| matches!(bytes.get(at + 4..at + HEAD), Some(b"JSON" | b"BIN\0"));
    [padded, end].into_iter().find(is_known).unwrap_or(padded)
}

fn word(bytes: &[u8], at: usize) -> Option<u32> {
    bytes.get(at..)?.first_chunk().map(|word| u32::from_le_bytes(*word))
}
