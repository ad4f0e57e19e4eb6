//! Pieces in which the writers hand on what they write, and text that must stay on one line.

use std::io::{self, Write};

/// Size of a piece.
pub(super) const CHUNK: usize = 1 << 16;

/// Writes `items` of `N` bytes each, in pieces.
pub(super) fn write_items<T, const N: usize>(
    items: impl IntoIterator<Item = T>,
    out: &mut (impl Write + ?Sized),
    bytes: impl Fn(T) -> [u8; N],
) -> io::Result<()> {
    let mut piece = Vec::with_capacity(CHUNK);
    for item in items {
        if piece.len() + N > CHUNK {
            out.write_all(&piece)?;
            piece.clear();
        }
        piece.extend_from_slice(&bytes(item));
    }
    out.write_all(&piece)
}

/// The three numbers in little-endian order.
pub(super) fn vec3([x, y, z]: [f32; 3]) -> [u8; 12] {
    join([x.to_le_bytes(), y.to_le_bytes(), z.to_le_bytes()])
}

/// `parts` one after another. `N` is their length together.
///
/// # Panics
/// If `N` is less.
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

/// Free text without line ends and zeros, which would end it in the file.
pub(super) fn one_line(text: &str) -> String {
    text.replace(['\n', '\r', '\0'], " ")
}
