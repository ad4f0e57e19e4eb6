//! Helpers of the writers: writing in large chunks, joining bytes, text that must stay on one line.

use std::io::{self, Write};

/// Size of a chunk, bytes.
pub(super) const CHUNK: usize = 1 << 16;

/// Writes `items` of `N` bytes each, in chunks.
pub(super) fn write_items<T, const N: usize>(
    items: impl IntoIterator<Item = T>,
    out: &mut (impl Write + ?Sized),
    bytes: impl Fn(T) -> [u8; N],
) -> io::Result<()> {
    let mut chunk = Vec::with_capacity(CHUNK);
    for item in items {
        if chunk.len() + N > CHUNK {
            out.write_all(&chunk)?;
            chunk.clear();
        }
        chunk.extend_from_slice(&bytes(item));
    }
    out.write_all(&chunk)
}

/// Writes `text` and clears it, once it is as long as a chunk.
pub(super) fn write_if_full(text: &mut Vec<u8>, out: &mut impl Write) -> io::Result<()> {
    if text.len() >= CHUNK {
        out.write_all(text)?;
        text.clear();
    }
    Ok(())
}

/// Appends decimal digits, several times faster than `write!`. Most of a text file consists of
/// faces.
pub(super) fn push_number(text: &mut Vec<u8>, mut number: u64) {
    let mut digits = [0; 20];
    let mut start = digits.len();
    loop {
        start -= 1;
        digits[start] = b'0' + (number % 10) as u8;
        number /= 10;
        if number == 0 {
            break;
        }
    }
    text.extend_from_slice(&digits[start..]);
}

/// Three numbers in little-endian order.
pub(super) fn vec3([x, y, z]: [f32; 3]) -> [u8; 12] {
    join([x.to_le_bytes(), y.to_le_bytes(), z.to_le_bytes()])
}

/// Joins `parts` and pads them with zeros to `N` bytes.
///
/// # Panics
/// If the parts have more than `N` bytes.
pub(super) fn join<const N: usize>(parts: impl IntoIterator<Item = impl AsRef<[u8]>>) -> [u8; N] {
    let mut all = [0; N];
    let mut at = 0;
    for part in parts {
        let part = part.as_ref();
        all[at..at + part.len()].copy_from_slice(part);
        at += part.len();
    }
    all
}

/// Replaces line ends and zeros, which would end the text in a file, by spaces.
pub(super) fn one_line(text: &str) -> String {
    text.replace(['\n', '\r', '\0'], " ")
}
