//! The loop as a chain of segments at one evaluation of the forces.

use crate::sim::state::InnerLoop;
use std::ops::Range;

/// Number of segments in a block.
pub(super) const BLOCK: usize = 8;

/// Consecutive segments, each from a particle to its successor, as the pair forces read them.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Block {
    /// Start points.
    pub(super) x: [f32; BLOCK],
    pub(super) y: [f32; BLOCK],
    /// Vectors from start to end.
    pub(super) dx: [f32; BLOCK],
    pub(super) dy: [f32; BLOCK],
    /// Vectors from start to end, divided by the square of their length.
    pub(super) over_x: [f32; BLOCK],
    pub(super) over_y: [f32; BLOCK],
}

impl Block {
    #[inline(always)]
    fn set(&mut self, l: usize, a: [f32; 2], b: [f32; 2]) {
        let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
        let inverse = 1.0 / (dx * dx + dy * dy + 1e-12);
        (self.x[l], self.y[l], self.dx[l], self.dy[l]) = (a[0], a[1], dx, dy);
        (self.over_x[l], self.over_y[l]) = (dx * inverse, dy * inverse);
    }
}

/// Positions and velocities of an evaluation, and quantities derived from the positions.
///
/// `x, y, vx, vy` begin with a copy of the last particle and end with a copy of the first one: the
/// predecessor of particle i is at index i, the particle itself at i + 1, its successor at i + 2.
#[derive(Clone, Debug, Default)]
pub(super) struct Chain {
    pub(super) x: Vec<f32>,
    pub(super) y: Vec<f32>,
    pub(super) vx: Vec<f32>,
    pub(super) vy: Vec<f32>,
    /// Normals toward the lumen, one per particle.
    pub(super) nx: Vec<f32>,
    pub(super) ny: Vec<f32>,
    pub(super) blocks: Vec<Block>,
}

/// Entries of consecutive particles, without the copies at the ends.
pub(super) struct Stretch<'a> {
    pub(super) x: &'a mut [f32],
    pub(super) y: &'a mut [f32],
    pub(super) vx: &'a mut [f32],
    pub(super) vy: &'a mut [f32],
    pub(super) nx: &'a mut [f32],
    pub(super) ny: &'a mut [f32],
    blocks: &'a mut [Block],
}

impl Chain {
    /// Loads the positions and velocities of a state.
    pub(super) fn load(&mut self, s: &InnerLoop) {
        let n = s.len();
        self.resize(n);
        for (v, from) in [(&mut self.x, &s.x), (&mut self.y, &s.y), (&mut self.vx, &s.vx), (&mut self.vy, &s.vy)] {
            v[1..=n].copy_from_slice(from);
        }
        self.whole().derive();
        self.join(std::iter::once(0..n));
    }

    pub(super) fn resize(&mut self, n: usize) {
        for v in [&mut self.x, &mut self.y, &mut self.vx, &mut self.vy] {
            v.resize(n + 2, 0.0);
        }
        self.nx.resize(n, 0.0);
        self.ny.resize(n, 0.0);
        self.blocks.resize(n.div_ceil(BLOCK), Block::default());
    }

    /// Number of particles.
    #[inline(always)]
    pub(super) fn len(&self) -> usize {
        self.nx.len()
    }

    fn whole(&mut self) -> Stretch<'_> {
        let n = self.len();
        Stretch {
            x: &mut self.x[1..=n],
            y: &mut self.y[1..=n],
            vx: &mut self.vx[1..=n],
            vy: &mut self.vy[1..=n],
            nx: &mut self.nx,
            ny: &mut self.ny,
            blocks: &mut self.blocks,
        }
    }

    /// Splits the chain into stretches. The parts must cover the loop in order and consist of whole
    /// blocks.
    pub(super) fn stretches(&mut self, parts: impl Iterator<Item = Range<usize>>) -> impl Iterator<Item = Stretch<'_>> {
        let mut rest = self.whole();
        parts.map(move |part| Stretch {
            x: take(&mut rest.x, part.len()),
            y: take(&mut rest.y, part.len()),
            vx: take(&mut rest.vx, part.len()),
            vy: take(&mut rest.vy, part.len()),
            nx: take(&mut rest.nx, part.len()),
            ny: take(&mut rest.ny, part.len()),
            blocks: take(&mut rest.blocks, part.len().div_ceil(BLOCK)),
        })
    }

    /// Completes the entries that [`Stretch::derive`] leaves open: at the borders of parts, and
    /// where the loop closes.
    pub(super) fn join(&mut self, parts: impl IntoIterator<Item = Range<usize>>) {
        let n = self.len();
        for v in [&mut self.x, &mut self.y, &mut self.vx, &mut self.vy] {
            v[0] = v[n];
            v[n + 1] = v[1];
        }
        let point = |i: usize| [self.x[i], self.y[i]];
        for part in parts {
            let last = part.end - 1;
            self.blocks[last / BLOCK].set(last % BLOCK, point(last + 1), point(last + 2));
            for i in [part.start, last] {
                [self.nx[i], self.ny[i]] = normal(point(i), point(i + 2));
            }
        }
    }
}

/// Splits the first `count` entries off a slice.
pub(super) fn take<'a, T>(slice: &mut &'a mut [T], count: usize) -> &'a mut [T] {
    let (first, rest) = std::mem::take(slice).split_at_mut(count);
    *slice = rest;
    first
}

impl Stretch<'_> {
    /// Computes blocks and normals, except for particles whose neighbours are in other stretches;
    /// see [`Chain::join`].
    #[inline(always)]
    pub(super) fn derive(&mut self) {
        let n = self.x.len();
        let (x, y) = (&self.x[..n], &self.y[..n]);
        for (b, block) in self.blocks.iter_mut().enumerate() {
            let first = b * BLOCK;
            if first + BLOCK < n {
                let (x, y) = (&x[first..first + BLOCK + 1], &y[first..first + BLOCK + 1]);
                for l in 0..BLOCK {
                    block.set(l, [x[l], y[l]], [x[l + 1], y[l + 1]]);
                }
            } else {
                for i in first + 1..n {
                    block.set(i - 1 - first, [x[i - 1], y[i - 1]], [x[i], y[i]]);
                }
            }
        }
        let (nx, ny) = (&mut self.nx[..n], &mut self.ny[..n]);
        for i in 2..n {
            [nx[i - 1], ny[i - 1]] = normal([x[i - 2], y[i - 2]], [x[i], y[i]]);
        }
    }
}

/// Normal toward the lumen of a particle between two others.
#[inline(always)]
fn normal(before: [f32; 2], after: [f32; 2]) -> [f32; 2] {
    let (tx, ty) = (after[0] - before[0], after[1] - before[1]);
    let inverse = 1.0 / (tx * tx + ty * ty + 1e-12).sqrt();
    [-ty * inverse, tx * inverse]
}
