//! Points in space.

/// A point, µm.
pub(super) type P3 = [f64; 3];

/// Maps a point of the straight tube to its image in the bent one, µm.
pub type Bend<'a> = &'a (dyn Fn([f64; 3]) -> [f64; 3] + Sync);

pub(super) fn minus(a: P3, b: P3) -> P3 {
    [0, 1, 2].map(|k| a[k] - b[k])
}

pub(super) fn length(a: P3) -> f64 {
    a.iter().map(|x| x * x).sum::<f64>().sqrt()
}
