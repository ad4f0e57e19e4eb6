//! Smooth random fields in space with their gradients, and cells around random points.
//!
//! Fields are interpolated between values on a lattice, and cells have one point per lattice cube.
//! Both repeat after a whole number of cubes in each direction.

use crate::random::{Stream, words};
use glam::{IVec3, Vec3};
use std::sync::LazyLock;

/// Number of lattice points per direction, after which every field repeats.
pub(super) const SIDE: i32 = 256;
/// First counter of the random numbers of the lattice. Those of the wall and of cells are lower.
const LATTICE: u32 = 3 << 30;

/// Random permutation of 0 to 255, and a random value from 0 to 1 for each number.
struct Table {
    order: [u8; SIDE as usize],
    values: [f32; SIDE as usize],
}

/// The table is the same for all models, so textures of walls do not depend on the seed.
static TABLE: LazyLock<Table> = LazyLock::new(|| {
    let random = |k: usize| words(0, Stream::Histology, u32::MAX, LATTICE + k as u32);
    let mut order: [u8; SIDE as usize] = std::array::from_fn(|k| k as u8);
    for k in (1..order.len()).rev() {
        order.swap(k, random(k)[0] as usize % (k + 1));
    }
    // Values are evenly spread, so the mean of a field is exactly one half.
    let values = std::array::from_fn(|k| (k as f32 + 0.5) / SIDE as f32);
    Table { order, values }
});

/// Number from 0 to 255 of a lattice point. `period` is the number of points after which the
/// lattice repeats, at most [`SIDE`] in each direction.
#[inline]
fn number(table: &Table, at: IVec3, period: IVec3) -> u8 {
    let wrapped = |i: i32, period: i32| i.rem_euclid(period) as usize;
    let x = table.order[wrapped(at.x, period.x)];
    let xy = table.order[(usize::from(x) + wrapped(at.y, period.y)) & 255];
    table.order[(usize::from(xy) + wrapped(at.z, period.z)) & 255]
}

/// Value from 0 to 1 of a smooth field, and its gradient, at a point in units of the lattice.
pub(super) fn noise(p: Vec3, period: IVec3) -> (f32, Vec3) {
    let table = &*TABLE;
    let cube = p.floor();
    let t = p - cube;
    let (s, slope) = (t * t * (3.0 - 2.0 * t), 6.0 * t * (1.0 - t));
    let first = cube.as_ivec3();
    let value = |x: i32, y: i32, z: i32| table.values[usize::from(number(table, first + IVec3::new(x, y, z), period))];
    let mut along = [[0.0; 2]; 2];
    let mut across = [[0.0; 2]; 2];
    for (y, z) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
        let (a, b) = (value(0, y, z), value(1, y, z));
        along[z as usize][y as usize] = a + (b - a) * s.x;
        across[z as usize][y as usize] = b - a;
    }
    let mix = |of: [f32; 2], share: f32| of[0] + (of[1] - of[0]) * share;
    let rows = along.map(|row| mix(row, s.y));
    let gradient = Vec3::new(
        mix(across.map(|row| mix(row, s.y)), s.z),
        mix(along.map(|row| row[1] - row[0]), s.z),
        rows[1] - rows[0],
    );
    (mix(rows, s.z), gradient * slope)
}

/// The cell that contains a point.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cell {
    /// Vector from the point of the cell.
    pub(super) offset: Vec3,
    /// Distance to the point of the next cell minus the distance to that of this cell.
    pub(super) border: f32,
    /// Random value of the cell, from 0 to 1.
    pub(super) own: f32,
}

/// Finds the cell of a point in units of the lattice.
pub(super) fn cell(p: Vec3, period: IVec3) -> Cell {
    let table = &*TABLE;
    let cube = p.floor();
    let (first, t) = (cube.as_ivec3(), p - cube);
    let mut best = (f32::INFINITY, Vec3::ZERO, 0.0);
    let mut second = f32::INFINITY;
    for z in -1..=1 {
        for y in -1..=1 {
            for x in -1..=1 {
                let k = number(table, first + IVec3::new(x, y, z), period);
                let value = |turn: u8| table.values[usize::from(table.order[usize::from(k.wrapping_add(turn))])];
                // Points stay away from the sides of their cubes, so cells have similar sizes.
                let place = Vec3::new(value(0), value(85), value(170)) * 0.7 + 0.15;
                let offset = t - Vec3::new(x as f32, y as f32, z as f32) - place;
                let square = offset.length_squared();
                if square < best.0 {
                    second = best.0;
                    best = (square, offset, value(43));
                } else {
                    second = second.min(square);
                }
            }
        }
    }
    Cell { offset: best.1, border: second.sqrt() - best.0.sqrt(), own: best.2 }
}

#[cfg(test)]
mod tests {
    use super::*;

    const WHOLE: IVec3 = IVec3::splat(SIDE);

    #[test]
    fn the_gradient_is_that_of_the_value() {
        for k in 0..200 {
            let p = Vec3::new(0.37, 0.91, 0.13) * k as f32 + Vec3::new(0.21, 0.43, 0.77);
            let (_, gradient) = noise(p, WHOLE);
            let step = 1.0 / 256.0;
            for axis in [Vec3::X, Vec3::Y, Vec3::Z] {
                let found = (noise(p + axis * step, WHOLE).0 - noise(p - axis * step, WHOLE).0) / (2.0 * step);
                assert!((found - gradient.dot(axis)).abs() < 0.02, "{p}: {found} and {gradient}");
            }
        }
    }

    #[test]
    fn fields_and_cells_repeat_after_their_period() {
        let period = IVec3::new(7, SIDE, 5);
        for k in 0..50 {
            let p = Vec3::new(0.61, 0.27, 0.83) * k as f32;
            let moved = p + Vec3::new(7.0, 0.0, -5.0);
            assert!((noise(p, period).0 - noise(moved, period).0).abs() < 1e-4);
            assert!((cell(p, period).border - cell(moved, period).border).abs() < 1e-4);
        }
        assert!((0..50).any(|k| (noise(Vec3::splat(0.3 + k as f32), WHOLE).0 - 0.5).abs() > 0.2));
    }
}
