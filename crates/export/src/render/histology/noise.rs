//! Smooth random fields in the plane, interpolated between values on a lattice.

use crate::random::{Stream, words};

/// Number of lattice points per side, after which the field repeats.
const SIDE: usize = 256;

/// A field of values from 0 to 1 with mean 0.5.
pub(super) struct Noise(Vec<f32>);

impl Noise {
    /// Creates the field of a section.
    pub(super) fn new(seed: u64, index: u32) -> Self {
        let word = |i: usize| words(seed, Stream::Histology, index, i as u32);
        let values = (0..SIDE * SIDE / 16).flat_map(|i| word(i).into_iter().flat_map(u32::to_le_bytes));
        Self(values.map(|byte| f32::from(byte) / 255.0).collect())
    }

    /// Value at a point, in units of the lattice.
    pub(super) fn at(&self, u: f32, v: f32) -> f32 {
        self.around(u, v, SIDE as i32)
    }

    /// Value at a point of the field that repeats in the first direction after `period` lattice
    /// points.
    pub(super) fn around(&self, u: f32, v: f32, period: i32) -> f32 {
        let (u0, v0) = (u.floor(), v.floor());
        let (s, t) = (smooth(u - u0), smooth(v - v0));
        let column = |i: i32| i.rem_euclid(period.max(1)).rem_euclid(SIDE as i32) as usize;
        let row = |j: i32| j.rem_euclid(SIDE as i32) as usize * SIDE;
        let (i, j) = (u0 as i32, v0 as i32);
        let (i0, i1, j0, j1) = (column(i), column(i + 1), row(j), row(j + 1));
        let low = self.0[j0 + i0] + (self.0[j0 + i1] - self.0[j0 + i0]) * s;
        let high = self.0[j1 + i0] + (self.0[j1 + i1] - self.0[j1 + i0]) * s;
        low + (high - low) * t
    }

    /// Cells around random points, one per unit square. Returns the distance to the second nearest
    /// point minus the distance to the nearest point, and a random value of the cell.
    pub(super) fn bundle(&self, u: f32, v: f32) -> (f32, f32) {
        let value = |i: i32, j: i32, k: i32| {
            let side = SIDE as i32;
            self.0[((j + 61 * k).rem_euclid(side) * side + (i + 17 * k).rem_euclid(side)) as usize]
        };
        let (i0, j0) = (u.floor() as i32, v.floor() as i32);
        let (mut first, mut second, mut own) = (f32::INFINITY, f32::INFINITY, 0.0);
        for j in j0 - 1..=j0 + 1 {
            for i in i0 - 1..=i0 + 1 {
                let (du, dv) = (i as f32 + value(i, j, 1) - u, j as f32 + value(i, j, 2) - v);
                let distance = (du * du + dv * dv).sqrt();
                if distance < first {
                    (second, first, own) = (first, distance, value(i, j, 3));
                } else {
                    second = second.min(distance);
                }
            }
        }
        (second - first, own)
    }
}

fn smooth(t: f32) -> f32 {
    t * t * (3.0 - 2.0 * t)
}

/// Smooth step from 0 below `from` to 1 above `to`.
pub(super) fn ramp(from: f32, to: f32, value: f32) -> f32 {
    smooth(((value - from) / (to - from)).clamp(0.0, 1.0))
}
