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

/// Points of a polyline, whose lines are divided into parts of at most this length.
pub(super) fn divided(way: &[P3], most_um: f64) -> Vec<P3> {
    let mut points = vec![way[0]];
    for pair in way.windows(2) {
        let along = minus(pair[1], pair[0]);
        let count = (length(along) / most_um).ceil().max(1.0);
        let part = |k: usize| [0, 1, 2].map(|axis| pair[0][axis] + along[axis] * k as f64 / count);
        points.extend((1..=count as usize).map(part));
    }
    points
}
