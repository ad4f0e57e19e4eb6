//! The grid to which the positions of a level are rounded, with 65,536 steps per axis.
//!
//! Each axis has its own step, because a tube is many times longer than wide. With the step of the
//! length on all axes, the step would be wider than folds (15 µm for a tube of 1 m). All patches
//! use the same grid, so their borders coincide exactly.

use rayon::prelude::*;
use std::collections::HashSet;

/// Position of a vertex on the grid, in steps.
pub(super) type Cell = [u16; 3];

/// The grid: cell `c` lies at `origin + c * step`, in metres. Both are f32, as in the file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Grid {
    pub(super) origin: [f32; 3],
    pub(super) step: [f32; 3],
}

impl Grid {
    /// Grid that spans the positions.
    pub(super) fn spanning(positions: &[[f32; 3]]) -> Self {
        let mut grid = Self { origin: [0.0; 3], step: [0.0; 3] };
        for axis in 0..3 {
            let values = || positions.iter().map(|p| p[axis]);
            let (low, high) = (values().fold(f32::INFINITY, f32::min), values().fold(f32::NEG_INFINITY, f32::max));
            grid.origin[axis] = low;
            grid.step[axis] = ((f64::from(high) - f64::from(low)) / f64::from(u16::MAX)) as f32;
            // Normals are divided by the step, so it must not be zero.
            grid.step[axis] = grid.step[axis].max(1e-12);
        }
        grid
    }

    /// Position of a cell in metres.
    pub(super) fn position(&self, cell: Cell) -> [f32; 3] {
        let along = |a: usize| (f64::from(self.origin[a]) + f64::from(cell[a]) * f64::from(self.step[a])) as f32;
        [along(0), along(1), along(2)]
    }

    pub(super) fn nearest(&self, position: [f32; 3]) -> Cell {
        std::array::from_fn(|a| {
            let steps = (f64::from(position[a]) - f64::from(self.origin[a])) / f64::from(self.step[a]);
            steps.round() as u16
        })
    }

    /// Nearest cells of positions, except that each position has its own cell. Otherwise a reader
    /// that merges equal positions would merge two vertices.
    pub(super) fn cells(&self, positions: &[[f32; 3]]) -> Vec<Cell> {
        let mut cells: Vec<Cell> = positions.par_iter().map(|p| self.nearest(*p)).collect();
        let mut keys: Vec<u64> = cells.par_iter().map(|&[x, y, z]| key(x, y, z)).collect();
        keys.par_sort_unstable();
        if keys.par_windows(2).any(|pair| pair[0] == pair[1]) {
            separate(&mut cells);
        }
        cells
    }

    /// Normal in the space of the grid, in steps of 1/32,767. A viewer divides it by the step of
    /// each axis. With 8 bits, slanted normals of a long thin tube would have almost no x and y.
    pub(super) fn normal(&self, normal: [f32; 3]) -> [i16; 3] {
        let scaled: [f64; 3] = std::array::from_fn(|a| f64::from(normal[a]) * f64::from(self.step[a]));
        let length = scaled.iter().map(|x| x * x).sum::<f64>().sqrt();
        scaled.map(|x| (x / length * 32_767.0).round() as i16)
    }
}

fn key(x: u16, y: u16, z: u16) -> u64 {
    u64::from(z) << 32 | u64::from(y) << 16 | u64::from(x)
}

/// Moves each cell that an earlier vertex occupies to the nearest free cell.
fn separate(cells: &mut [Cell]) {
    let mut taken: HashSet<Cell> = cells.iter().copied().collect();
    let mut seen = HashSet::with_capacity(taken.len());
    for cell in cells {
        if !seen.insert(*cell) {
            let free = (1..=i32::from(u16::MAX)).find_map(|reach| shell(*cell, reach).find(|c| !taken.contains(c)));
            *cell = free.expect("a grid has more cells than a mesh vertices");
            taken.insert(*cell);
        }
    }
}

/// Cells whose maximum distance from `centre` along an axis is `reach` steps.
fn shell(centre: Cell, reach: i32) -> impl Iterator<Item = Cell> {
    let side = -reach..=reach;
    let offsets = side.clone().flat_map(move |z| side.clone().map(move |y| (z, y)));
    let offsets = offsets.flat_map(move |(z, y)| (-reach..=reach).map(move |x| [x, y, z]));
    offsets.filter(move |o| o.iter().any(|d| d.abs() == reach)).filter_map(move |offset| {
        let mut cell = centre;
        for axis in 0..3 {
            cell[axis] = u16::try_from(i32::from(centre[axis]) + offset[axis]).ok()?;
        }
        Some(cell)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn positions_are_rounded_to_half_a_step(
            positions in prop::collection::vec((-1e-3f32..1e-3, -2e-3f32..1e-3, 0f32..1.0).prop_map(|(x, y, z)| [x, y, z]), 2..60),
        ) {
            let grid = Grid::spanning(&positions);
            let cells = grid.cells(&positions);
            prop_assert_eq!(cells.iter().collect::<HashSet<_>>().len(), positions.len());
            for (p, cell) in positions.iter().zip(cells) {
                let q = grid.position(cell);
                for axis in 0..3 {
                    let off = (f64::from(p[axis]) - f64::from(q[axis])).abs();
                    // Half a step, and the rounding of the position to f32.
                    let most = f64::from(grid.step[axis]) * 0.5 + f64::from(p[axis].abs()) * 6.1e-8;
                    prop_assert!(off <= most, "axis {}: {} of {}", axis, off, most);
                }
            }
        }

        #[test]
        fn a_viewer_finds_the_direction_of_a_normal(
            x in -1f32..1.0, y in -1f32..1.0, z in -1f32..1.0, length in 1e-3f32..1.0,
        ) {
            let grid = Grid { origin: [0.0; 3], step: [4e-8, 5e-8, length / 65535.0] };
            let normal = glam::Vec3::new(x, y, z).normalize();
            let stored = grid.normal(normal.into()).map(|n| f32::from(n) / 32_767.0);
            let seen = (glam::Vec3::from(stored) / glam::Vec3::from(grid.step)).normalize();
            prop_assert!(seen.dot(normal) > 0.999, "{seen} for {normal}: {}", seen.dot(normal));
        }
    }

    #[test]
    fn equal_positions_get_cells_of_their_own() {
        let corner = [1e-3, 1e-3, 0.06];
        let mut positions = vec![[0.0; 3]];
        positions.extend([corner; 30]);
        let grid = Grid::spanning(&positions);
        let cells = grid.cells(&positions);
        assert_eq!(cells.iter().collect::<HashSet<_>>().len(), 31);
        assert_eq!(cells[1], [u16::MAX; 3]);
        assert!(cells[2..].iter().flatten().all(|&c| c >= u16::MAX - 3));
    }
}
