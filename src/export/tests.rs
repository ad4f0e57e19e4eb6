//! Helpers for the tests of several formats.

use super::Metadata;

pub(crate) fn meta() -> Metadata {
    Metadata {
        preset: "pig".into(),
        seed: 7,
        digest: "0f3a".repeat(16),
        engine: "0.1.0".into(),
        length_mm: 4.0,
        sections: 2,
    }
}

/// The triangle rotated to start at its least corner, with the same orientation.
pub(crate) fn turned<T: Ord + Copy>(t: [T; 3]) -> [T; 3] {
    let least = (0..3).min_by_key(|&k| t[k]).unwrap();
    [t[least], t[(least + 1) % 3], t[(least + 2) % 3]]
}
