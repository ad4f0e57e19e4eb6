//! The loop as a chain of segments at one evaluation of the forces: segments in blocks, normals, tensions.

use crate::sim::layout::{LANES, StepRow};

/// Coordinates of the segments that pad the last block: far away, of zero length.
const FAR: f32 = 1e9;

/// A block of consecutive segments: start, direction, and 1/length² of each.
#[derive(Clone, Copy, Debug)]
pub(super) struct Block {
    pub(super) x: [f32; LANES],
    pub(super) y: [f32; LANES],
    pub(super) dx: [f32; LANES],
    pub(super) dy: [f32; LANES],
    pub(super) inverse: [f32; LANES],
}

impl Block {
    const EMPTY: Self =
        Self { x: [FAR; LANES], y: [FAR; LANES], dx: [0.0; LANES], dy: [0.0; LANES], inverse: [0.0; LANES] };
}

/// Positions and velocities of an evaluation, and the quantities derived from them.
///
/// `x, y, vx, vy` begin with a copy of the last particle and end with a copy of the first one: the predecessor of
/// particle i is at index i, the particle itself at i + 1, its successor at i + 2.
#[derive(Clone, Debug, Default)]
pub(super) struct Chain {
    pub(super) x: Vec<f32>,
    pub(super) y: Vec<f32>,
    pub(super) vx: Vec<f32>,
    pub(super) vy: Vec<f32>,
    /// Normals toward the lumen, one per particle.
    pub(super) nx: Vec<f32>,
    pub(super) ny: Vec<f32>,
    /// Pull of each edge on its first particle; entry 0 belongs to the edge before particle 0.
    pub(super) tx: Vec<f32>,
    pub(super) ty: Vec<f32>,
    pub(super) blocks: Vec<Block>,
}

impl Chain {
    pub(super) fn resize(&mut self, n: usize) {
        for v in [&mut self.x, &mut self.y, &mut self.vx, &mut self.vy] {
            v.resize(n + 2, 0.0);
        }
        self.nx.resize(n, 0.0);
        self.ny.resize(n, 0.0);
        self.tx.resize(n + 1, 0.0);
        self.ty.resize(n + 1, 0.0);
        self.blocks.resize(n.div_ceil(LANES), Block::EMPTY);
        if let Some(last) = self.blocks.last_mut() {
            *last = Block::EMPTY;
        }
    }

    /// Number of particles.
    pub(super) fn len(&self) -> usize {
        self.nx.len()
    }

    /// Copies the end particles to the opposite ends.
    #[inline(always)]
    pub(super) fn close(&mut self) {
        let n = self.len();
        for v in [&mut self.x, &mut self.y, &mut self.vx, &mut self.vy] {
            v[0] = v[n];
            v[n + 1] = v[1];
        }
    }

    /// Computes segments, normals and tensions from positions and velocities.
    #[inline(always)]
    pub(super) fn derive(&mut self, rest: &[f32], row: &StepRow) {
        let n = self.len();
        for (b, block) in self.blocks.iter_mut().enumerate() {
            let first = b * LANES;
            let count = LANES.min(n - first);
            if count == LANES {
                let (x, y) = (&self.x[first + 1..first + LANES + 2], &self.y[first + 1..first + LANES + 2]);
                for l in 0..LANES {
                    fill(block, l, [x[l], y[l]], [x[l + 1], y[l + 1]]);
                }
            } else {
                for l in 0..count {
                    let j = first + l + 1;
                    fill(block, l, [self.x[j], self.y[j]], [self.x[j + 1], self.y[j + 1]]);
                }
            }
        }
        let (x, y) = (&self.x[..n + 2], &self.y[..n + 2]);
        let (vx, vy) = (&self.vx[..n + 2], &self.vy[..n + 2]);
        let (nx, ny) = (&mut self.nx[..n], &mut self.ny[..n]);
        for j in 0..n {
            let (tx, ty) = (x[j + 2] - x[j], y[j + 2] - y[j]);
            let inverse = 1.0 / (tx * tx + ty * ty + 1e-12).sqrt();
            nx[j] = -ty * inverse;
            ny[j] = tx * inverse;
        }
        let rest = &rest[..n];
        let (fx, fy) = (&mut self.tx[1..=n], &mut self.ty[1..=n]);
        for j in 0..n {
            let (dx, dy) = (x[j + 2] - x[j + 1], y[j + 2] - y[j + 1]);
            let length = (dx * dx + dy * dy + 1e-12).sqrt();
            let inverse = 1.0 / length;
            let (ux, uy) = (dx * inverse, dy * inverse);
            let closing = (vx[j + 2] - vx[j + 1]) * ux + (vy[j + 2] - vy[j + 1]) * uy;
            let pull = row.stiffness * (length - rest[j]) + row.damping * closing;
            fx[j] = pull * ux;
            fy[j] = pull * uy;
        }
        self.tx[0] = self.tx[n];
        self.ty[0] = self.ty[n];
    }
}

#[inline(always)]
fn fill(block: &mut Block, l: usize, a: [f32; 2], b: [f32; 2]) {
    let (dx, dy) = (b[0] - a[0], b[1] - a[1]);
    block.x[l] = a[0];
    block.y[l] = a[1];
    block.dx[l] = dx;
    block.dy[l] = dy;
    block.inverse[l] = 1.0 / (dx * dx + dy * dy + 1e-12);
}
