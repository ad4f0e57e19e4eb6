//! The window: the vertices and triangles that later ones may still concern. Within it vertices are numbered from its first.

use super::super::shape::Turns;
use super::super::surface::Surface;
use super::chunk::Chunk;
use std::ops::Range;

/// Some triangles with their numbers in the stream, and how they turn.
#[derive(Default)]
struct Batch {
    triangles: Vec<[u32; 3]>,
    numbers: Vec<u32>,
    turns: Vec<Turns>,
}

impl Batch {
    fn push(&mut self, triangle: [u32; 3], number: u32, turns: Turns) {
        self.triangles.push(triangle);
        self.numbers.push(number);
        self.turns.push(turns);
    }

    fn append(&mut self, other: &mut Self) {
        self.triangles.append(&mut other.triangles);
        self.numbers.append(&mut other.numbers);
        self.turns.append(&mut other.turns);
    }

    /// Keeps some triangles, in their order, and calls `other` with the others.
    fn keep(&mut self, is_kept: impl Fn([u32; 3]) -> bool, mut other: impl FnMut([u32; 3], u32, Turns)) {
        let mut kept = 0;
        for i in 0..self.triangles.len() {
            let (triangle, number, turns) = (self.triangles[i], self.numbers[i], self.turns[i]);
            if is_kept(triangle) {
                self.triangles[kept] = triangle;
                self.numbers[kept] = number;
                self.turns[kept] = turns;
                kept += 1;
            } else {
                other(triangle, number, turns);
            }
        }
        self.triangles.truncate(kept);
        self.numbers.truncate(kept);
        self.turns.truncate(kept);
    }

    fn lower(&mut self, by: u32) {
        self.triangles.iter_mut().flatten().for_each(|v| *v -= by);
    }
}

fn surface<'a>(
    positions: &'a [[f32; 3]],
    triangles: &'a [[u32; 3]],
    numbers: &'a [u32],
    unit_um: f64,
) -> Surface<'a, f32> {
    Surface { positions, triangles, unit_um, numbers: Some(numbers) }
}

/// Whether all positions lie at `z` or above.
pub(super) fn are_above(positions: &[[f32; 3]], z: f32) -> bool {
    positions.iter().fold(f32::INFINITY, |least, p| least.min(p[2])) >= z
}

/// See the module.
pub(super) struct Window {
    /// Number of the first vertex in the stream.
    first: u32,
    positions: Vec<[f32; 3]>,
    /// Triangles with no retired vertex, in their order.
    waiting: Batch,
    /// Triangles with a retired vertex, those that were settled last first.
    settled: Batch,
    /// Empty: buffers for the next triangles that settle.
    spare: Batch,
    /// Vertices that have retired.
    retired: u32,
    /// No later triangle lies below.
    floor: f32,
}

impl Default for Window {
    fn default() -> Self {
        let (waiting, settled, spare) = Default::default();
        Self { first: 0, positions: Vec::new(), waiting, settled, spare, retired: 0, floor: f32::NEG_INFINITY }
    }
}

impl Window {
    /// Number of its first vertex in the stream.
    pub(super) fn first_vertex(&self) -> u32 {
        self.first
    }

    /// Adds a chunk whose triangles are numbered from `first` on; returns where they begin among those that wait.
    pub(super) fn add(&mut self, chunk: &Chunk<'_>, first: u32) -> usize {
        let new = self.waiting.triangles.len();
        self.positions.extend(chunk.positions);
        for triangles in &chunk.triangles {
            self.waiting.triangles.extend(triangles.iter().map(|t| t.map(|v| v - self.first)));
        }
        self.waiting.numbers.extend(first..first + chunk.count() as u32);
        self.waiting.turns.resize(self.waiting.triangles.len(), Turns::ANY);
        new
    }

    /// The triangles that wait, from one on, and how they turn.
    pub(super) fn waiting(&mut self, from: usize, unit_um: f64) -> (Surface<'_, f32>, &mut [Turns]) {
        let Batch { triangles, numbers, turns } = &mut self.waiting;
        (surface(&self.positions, &triangles[from..], &numbers[from..], unit_um), &mut turns[from..])
    }

    pub(super) fn settled(&self, unit_um: f64) -> Surface<'_, f32> {
        surface(&self.positions, &self.settled.triangles, &self.settled.numbers, unit_um)
    }

    /// How those that are settled turn.
    pub(super) fn settled_turns(&self) -> &[Turns] {
        &self.settled.turns
    }

    /// The numbers of all triangles, sorted.
    pub(super) fn numbers(&self) -> Vec<u32> {
        let mut numbers = [&self.settled.numbers[..], &self.waiting.numbers].concat();
        numbers.sort_unstable();
        numbers
    }

    /// The z of a vertex, given by its number in the stream.
    pub(super) fn z(&self, vertex: u32) -> f32 {
        self.positions[(vertex - self.first) as usize][2]
    }

    /// Whether all vertices that have not retired lie at `z` or above.
    pub(super) fn is_above(&self, z: f32) -> bool {
        are_above(&self.positions[(self.retired - self.first) as usize..], z)
    }

    /// Below which number vertices, and below which z places have retired.
    pub(super) fn retired(&self) -> (u32, f32) {
        (self.retired, self.floor)
    }

    /// Retires the vertices below one, and all places below `z`; returns which vertices of the window are newly retired.
    pub(super) fn retire(&mut self, vertices: u32, z: f32) -> Range<u32> {
        let before = self.retired;
        self.retired = vertices.clamp(before, self.first + self.positions.len() as u32);
        self.floor = self.floor.max(z);
        before - self.first..self.retired - self.first
    }

    /// Settles the triangles whose least vertex is retired; they are then the first of those settled. Returns their number.
    pub(super) fn settle(&mut self) -> usize {
        let retired = self.retired - self.first;
        let Self { waiting, settled, spare, .. } = self;
        waiting.keep(|t| t.iter().all(|&v| v >= retired), |t, number, turns| spare.push(t, number, turns));
        let count = spare.triangles.len();
        spare.append(settled);
        std::mem::swap(settled, spare);
        count
    }

    /// Forgets what no later triangle can reach; returns how many vertices.
    pub(super) fn forget(&mut self) -> usize {
        let Self { positions, waiting, settled, .. } = self;
        let z = |v: u32| positions[v as usize][2];
        let floor = waiting.triangles.iter().flatten().fold(self.floor, |least, &v| least.min(z(v)));
        let retired = self.retired - self.first;
        settled.keep(|t| t.iter().any(|&v| v >= retired || z(v) >= floor), |_, _, _| {});
        let gone = settled.triangles.iter().flatten().fold(retired, |least, &v| least.min(v));
        positions.drain(..gone as usize);
        waiting.lower(gone);
        settled.lower(gone);
        self.first += gone;
        gone as usize
    }
}
