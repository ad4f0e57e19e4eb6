//! The surface between two neighbouring sections: both walls, with one cell per edge of the lower
//! section.
//!
//! A cell joins the lower edge a–a′ to a chain of upper vertices u₀ … uₘ. It is a quad (m = 1)
//! until the slab above inserts vertices into the upper edge. Its diagonal is a–uₘ
//! ([`Diagonal::Forward`]) or a′–u₀. The upper edges fan from the lower end of the diagonal, so a
//! cell has m + 1 triangles.
//!
//! The tests use heights 0 and 1, because scaling z does not change their results. Points are
//! exported coordinates converted to f64, so the tests hold for the exported surface.

use crate::geometry::blocks::{Blocks, Rect};
use crate::geometry::polygon::next_on_rings;
use crate::geometry::predicates::widen2;
use crate::geometry::tri_tri::Triangle;
use std::ops::Range;

/// Diagonal along which a cell is split.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Diagonal {
    /// From the lower start to the upper end of the cell.
    Forward,
    /// From the lower end to the upper start of the cell.
    Backward,
}

impl Diagonal {
    pub(super) fn other(self) -> Self {
        match self {
            Self::Forward => Self::Backward,
            Self::Backward => Self::Forward,
        }
    }
}

/// Exported points of a section (m): first the inner ring, then the outer ring.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Rim {
    pub(super) points: Vec<[f32; 2]>,
    /// Number of points of the inner ring.
    pub(super) inner: usize,
}

impl Rim {
    /// Number of points.
    pub(super) fn len(&self) -> usize {
        self.points.len()
    }

    /// Index of the point after `i` on its ring.
    #[inline]
    pub(super) fn next(&self, i: usize) -> usize {
        next_on_rings(i, self.inner, self.points.len())
    }
}

/// Surface between two sections.
#[derive(Clone, Debug)]
pub(super) struct Slab {
    pub(super) lower: Rim,
    pub(super) upper: Rim,
    /// Upper vertex above the start of each cell, and the number of upper vertices as the last
    /// entry.
    start: Vec<u32>,
    pub(super) diagonals: Vec<Diagonal>,
}

impl Slab {
    /// Joins two rims with equal numbers of points, point to point, along the shorter diagonals.
    /// Diagonals are measured in the plane, because both span the same height.
    pub(super) fn new(lower: Rim, upper: Rim) -> Self {
        debug_assert_eq!((lower.len(), lower.inner), (upper.len(), upper.inner));
        let squared = |p: [f32; 2], q: [f32; 2]| {
            let d = difference(p, q);
            d[0] * d[0] + d[1] * d[1]
        };
        let diagonals = (0..lower.len())
            .map(|i| {
                let j = lower.next(i);
                let forward = squared(lower.points[i], upper.points[j]);
                let backward = squared(lower.points[j], upper.points[i]);
                if forward <= backward { Diagonal::Forward } else { Diagonal::Backward }
            })
            .collect();
        let start = (0..=lower.len() as u32).collect();
        Self { lower, upper, start, diagonals }
    }

    /// Number of cells.
    pub(super) fn len(&self) -> usize {
        self.diagonals.len()
    }

    /// Returns the slab with its upper rim refined, and the cells that changed. `new_after[i]`
    /// vertices follow upper vertex `i`. The slab must not have been refined before.
    pub(super) fn refined(&self, upper: Rim, new_after: &[u32]) -> (Self, Vec<usize>) {
        let mut start = Vec::with_capacity(self.start.len());
        let mut sum = 0;
        for &count in new_after {
            start.push(sum);
            sum += 1 + count;
        }
        start.push(sum);
        let changed = (0..self.len()).filter(|&i| new_after[i] > 0).collect();
        let slab = Self { lower: self.lower.clone(), upper, start, diagonals: self.diagonals.clone() };
        (slab, changed)
    }

    /// Upper vertex `k` of the chain of `cell`.
    #[inline]
    fn chain(&self, cell: usize, k: usize) -> usize {
        let vertex = self.start[cell] as usize + k;
        if vertex == self.start[cell + 1] as usize { self.start[self.lower.next(cell)] as usize } else { vertex }
    }

    /// Number of upper edges of `cell`. The cell has one more triangle.
    #[inline]
    pub(super) fn edges(&self, cell: usize) -> usize {
        (self.start[cell + 1] - self.start[cell]) as usize
    }

    /// Vertices of triangle `k` of `cell`. Upper vertices are numbered after the lower ones. The
    /// triangle is counter-clockwise seen from outside the ring. Neighbouring triangles of a cell,
    /// and of cells with equal diagonals, share an edge.
    #[inline]
    pub(super) fn triangle(&self, cell: usize, k: usize) -> [usize; 3] {
        let n = self.lower.len();
        let (a, b) = (cell, self.lower.next(cell));
        let upper = |k: usize| n + self.chain(cell, k);
        let m = self.edges(cell);
        match self.diagonals[cell] {
            Diagonal::Forward if k < m => [a, upper(k + 1), upper(k)],
            Diagonal::Forward => [a, b, upper(m)],
            Diagonal::Backward if k == 0 => [a, b, upper(0)],
            Diagonal::Backward => [b, upper(k), upper(k - 1)],
        }
    }

    /// Visits the triangles of `cell` in their order; see [`Self::triangle`].
    #[inline]
    pub(super) fn for_triangles(&self, cell: usize, mut each: impl FnMut([usize; 3])) {
        let m = self.edges(cell);
        if m > 1 {
            (0..=m).for_each(|k| each(self.triangle(cell, k)));
            return;
        }
        let (a, b) = (cell, self.lower.next(cell));
        let [u, v] = [a, b].map(|start| self.lower.len() + self.start[start] as usize);
        let triangles = match self.diagonals[cell] {
            Diagonal::Forward => [[a, v, u], [a, b, v]],
            Diagonal::Backward => [[a, b, u], [b, v, u]],
        };
        triangles.into_iter().for_each(each);
    }

    /// Number of triangles of a range of cells.
    pub(super) fn triangle_count(&self, cells: &Range<usize>) -> usize {
        (self.start[cells.end] - self.start[cells.start]) as usize + cells.len()
    }

    /// Triangle `k` of `cell` in space, and the numbers of its corners. The triangle must have an
    /// area.
    #[inline]
    pub(super) fn triangle_in_space(&self, cell: usize, k: usize) -> (Triangle, [u32; 3]) {
        let corners = self.triangle(cell, k);
        (Triangle::new(corners.map(|corner| self.corner(corner))), corners.map(|corner| corner as u32))
    }

    #[inline]
    fn corner(&self, id: usize) -> [f64; 3] {
        let n = self.lower.len();
        let (p, z) = if id < n { (self.lower.points[id], 0.0) } else { (self.upper.points[id - n], 1.0) };
        [f64::from(p[0]), f64::from(p[1]), z]
    }

    #[inline]
    fn for_points(&self, cell: usize, mut each: impl FnMut([f32; 2])) {
        each(self.lower.points[cell]);
        each(self.lower.points[self.lower.next(cell)]);
        for k in 0..=self.edges(cell) {
            each(self.upper.points[self.chain(cell, k)]);
        }
    }

    /// Bounding boxes of the cells, seen along the tube. Refining the upper rim does not change the
    /// boxes, because a rounded point of an edge stays in the box of the edge's ends.
    pub(super) fn blocks(&self) -> Blocks {
        let rect = |cell| {
            let mut rect = Rect::EMPTY;
            self.for_points(cell, |p| rect = rect.joined(&Rect { min: p, max: p }));
            rect
        };
        Blocks::new(&(0..self.len()).map(rect).collect::<Vec<_>>())
    }

    /// True if an edge of `cell` has no length.
    pub(super) fn degenerate(&self, cell: usize) -> bool {
        let upper = |k: usize| self.upper.points[self.chain(cell, k)];
        self.lower.points[cell] == self.lower.points[self.lower.next(cell)]
            || (0..self.edges(cell)).any(|k| upper(k) == upper(k + 1))
    }

    /// For each cell of an unrefined slab, true if a plane through the edge that it shares with the
    /// next cell separates the two. The cells then intersect only in that edge, and neither
    /// overlaps itself.
    ///
    /// A plane through that edge whose trace in both rims has the normal d separates the cells if d
    /// has a positive component along the lower and the upper edges of both. The sum of these edges
    /// is used as d.
    pub(super) fn parted_from_next(&self) -> Vec<bool> {
        let edges: Vec<[[f64; 2]; 2]> = (0..self.len())
            .map(|cell| {
                let next = self.lower.next(cell);
                [&self.lower, &self.upper].map(|rim| difference(rim.points[cell], rim.points[next]))
            })
            .collect();
        (0..self.len())
            .map(|cell| {
                let (here, next) = (edges[cell], edges[self.lower.next(cell)]);
                let d = sum([sum(here), sum(next)]);
                is_along(d, here[0]) & is_along(d, here[1]) & is_along(d, next[0]) & is_along(d, next[1])
            })
            .collect()
    }

    /// Like [`Self::parted_from_next`] for one cell of a slab that may be refined, with all its
    /// upper edges.
    pub(super) fn is_parted_from_next(&self, cell: usize) -> bool {
        let next = self.lower.next(cell);
        let lower = |cell: usize| difference(self.lower.points[cell], self.lower.points[self.lower.next(cell)]);
        let upper = |cell: usize, from: usize, to: usize| {
            difference(self.upper.points[self.chain(cell, from)], self.upper.points[self.chain(cell, to)])
        };
        let across = |cell: usize| sum([lower(cell), upper(cell, 0, self.edges(cell))]);
        let d = sum([across(cell), across(next)]);
        [cell, next]
            .into_iter()
            .all(|cell| is_along(d, lower(cell)) && (0..self.edges(cell)).all(|k| is_along(d, upper(cell, k, k + 1))))
    }

    /// True if a line separates the projections of two cells, which then do not intersect. May be
    /// false although another projection or line would separate the cells.
    ///
    /// The projection is along the mean motion of both cells, so a common shift does not widen it.
    /// The lines run along and across the cells.
    pub(super) fn apart(&self, i: usize, j: usize) -> bool {
        let (s, t) = (self.ends(i), self.ends(j));
        let motion = [0, 1].map(|axis| {
            let of = |[a, b, c, d]: [[f64; 2]; 4]| c[axis] - a[axis] + d[axis] - b[axis];
            0.25 * (of(s) + of(t))
        });
        let course = |[a, b, c, d]: [[f64; 2]; 4]| [b[0] - a[0] + d[0] - c[0], b[1] - a[1] + d[1] - c[1]];
        let ([x, y], [u, v]) = (course(s), course(t));
        let parted = |axis| self.parted_along(axis, motion, i, j);
        // Cells with near indices follow each other on one wall; others lie side by side.
        if i.abs_diff(j) < 16 {
            parted([x + u, y + v]) || parted([-y, x]) || parted([-v, u])
        } else {
            parted([-y, x]) || parted([-v, u]) || parted([x + u, y + v])
        }
    }

    /// Ends of the lower and of the upper side of a cell.
    #[inline]
    fn ends(&self, cell: usize) -> [[f64; 2]; 4] {
        [
            self.lower.points[cell],
            self.lower.points[self.lower.next(cell)],
            self.upper.points[self.chain(cell, 0)],
            self.upper.points[self.chain(cell, self.edges(cell))],
        ]
        .map(widen2)
    }

    /// True if the projections of two cells along `motion` are disjoint on the direction `axis`.
    /// The margin is far above the rounding error of a difference and a sum of two products.
    #[inline]
    fn parted_along(&self, axis: [f64; 2], motion: [f64; 2], i: usize, j: usize) -> bool {
        let mut size = 0.0f64;
        let mut projection = |cell: usize| {
            let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
            let mut project = |[x, y]: [f64; 2]| {
                let (x, y) = (axis[0] * x, axis[1] * y);
                size = size.max(x.abs() + y.abs());
                low = low.min(x + y);
                high = high.max(x + y);
            };
            project(widen2(self.lower.points[cell]));
            project(widen2(self.lower.points[self.lower.next(cell)]));
            for k in 0..=self.edges(cell) {
                let p = widen2(self.upper.points[self.chain(cell, k)]);
                project([p[0] - motion[0], p[1] - motion[1]]);
            }
            (low, high)
        };
        let ((low_i, high_i), (low_j, high_j)) = (projection(i), projection(j));
        let margin = 1e-14 * size;
        low_i - high_j > margin || low_j - high_i > margin
    }
}

#[inline]
fn sum([e, f]: [[f64; 2]; 2]) -> [f64; 2] {
    [e[0] + f[0], e[1] + f[1]]
}

/// True if an edge has a positive component along `d`. The margin exceeds the rounding error of the
/// differences and of the sum of two products.
#[inline]
fn is_along(d: [f64; 2], edge: [f64; 2]) -> bool {
    let (x, y) = (d[0] * edge[0], d[1] * edge[1]);
    x + y > 1e-14 * (x.abs() + y.abs())
}

#[inline]
fn difference(a: [f32; 2], b: [f32; 2]) -> [f64; 2] {
    [f64::from(b[0]) - f64::from(a[0]), f64::from(b[1]) - f64::from(a[1])]
}
