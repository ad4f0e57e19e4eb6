//! Cuts of triangle surfaces by planes.
//!
//! A corner above the plane along the normal counts as above, any other corner as below. Therefore
//! no triangle lies in the plane. A point of a cut depends only on the edge that contains it, so
//! the lines of neighbouring triangles join exactly. Seen from outside the surface, the side above
//! the plane is to the left of a line.

mod body;
mod half;
mod rings;

pub use body::Body;
pub use half::{Half, HalfError, HalfSpace, half};
pub use rings::nested_rings;

/// An edge as its two corners, lower index first.
pub type EdgeKey = (u32, u32);

/// Segment in which a plane cuts a triangle, directed from one edge to another.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Crossing {
    /// Edge that passes upwards through the plane.
    pub from: EdgeKey,
    /// Edge that passes downwards through the plane.
    pub to: EdgeKey,
}

impl Crossing {
    /// Computes the segment from the heights of the corners. `None` if the plane does not cut the
    /// triangle.
    #[inline]
    #[must_use]
    pub fn new(triangle: &[u32; 3], heights: [f64; 3], plane: f64) -> Option<Self> {
        let above = heights.map(|height| height > plane);
        let edge = |up: bool| {
            (0..3).find(|&k| above[k] != up && above[(k + 1) % 3] == up).map(|k| {
                let (a, b) = (triangle[k], triangle[(k + 1) % 3]);
                (a.min(b), a.max(b))
            })
        };
        Some(Self { from: edge(true)?, to: edge(false)? })
    }
}

/// Crossings joined to lines. A line is a sequence of edges.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Lines {
    /// Lines that end where they begin.
    pub closed: Vec<Vec<EdgeKey>>,
    /// Lines that end at a border of the surface.
    pub open: Vec<Vec<EdgeKey>>,
}

impl Lines {
    /// Joins crossings to lines. The result does not depend on their order if no two of them begin
    /// at the same edge.
    #[must_use]
    pub fn chain(crossings: &[Crossing]) -> Self {
        let (next, is_next) = successors(crossings);
        let starts = (0..crossings.len()).filter(|&at| !is_next[at]);
        let mut seen = vec![false; crossings.len()];
        let mut lines = Self::default();
        for start in starts.chain(0..crossings.len()) {
            let (mut at, mut line) = (Some(start), Vec::new());
            let mut last = start;
            while let Some(now) = at.filter(|&at| !seen[at]) {
                seen[now] = true;
                line.push(crossings[now].from);
                last = now;
                at = next[now];
            }
            if line.is_empty() {
                continue;
            }
            if at == Some(start) {
                lines.closed.push(line);
            } else {
                line.push(crossings[last].to);
                lines.open.push(line);
            }
        }
        for line in &mut lines.closed {
            let least = (0..line.len()).min_by_key(|&at| line[at]).unwrap_or(0);
            line.rotate_left(least);
        }
        lines.closed.sort_unstable();
        lines.open.sort_unstable();
        lines
    }
}

/// Index of the crossing that begins where each crossing ends, and whether a crossing is one of
/// these. Neighbouring triangles of a strip follow each other, so most are found beside it.
fn successors(crossings: &[Crossing]) -> (Vec<Option<usize>>, Vec<bool>) {
    let mut is_next = vec![false; crossings.len()];
    let mut beside = |at: usize| {
        let mut neighbours = [at + 1, at.wrapping_sub(1)].into_iter();
        neighbours.find(|&other| {
            crossings.get(other).is_some_and(|other| other.from == crossings[at].to)
                && !std::mem::replace(&mut is_next[other], true)
        })
    };
    let mut next: Vec<Option<usize>> = (0..crossings.len()).map(&mut beside).collect();
    let mut others: Vec<(EdgeKey, usize)> =
        (0..crossings.len()).filter(|&at| !is_next[at]).map(|at| (crossings[at].from, at)).collect();
    others.sort_unstable();
    for (at, next) in next.iter_mut().enumerate().filter(|(_, next)| next.is_none()) {
        *next = others.binary_search_by_key(&crossings[at].to, |other| other.0).ok().map(|k| others[k].1);
        next.iter().for_each(|&other| is_next[other] = true);
    }
    (next, is_next)
}

/// Point in which the edge from `p` to `q`, whose ends have these heights, intersects a plane.
#[inline]
#[must_use]
pub fn edge_intersection(p: [f64; 3], q: [f64; 3], heights: [f64; 2], plane: f64) -> [f64; 3] {
    let t = (plane - heights[0]) / (heights[1] - heights[0]);
    [0, 1, 2].map(|axis| p[axis] + t * (q[axis] - p[axis]))
}

/// A surface prepared for many cuts by planes of constant z.
pub struct Slicer<'a> {
    positions: &'a [[f32; 3]],
    /// Sorted by `min_z`.
    triangles: Vec<[u32; 3]>,
    min_z: Vec<f32>,
    max_height: f32,
}

impl<'a> Slicer<'a> {
    /// Prepares triangles whose corners are indices into `positions`.
    #[must_use]
    pub fn new(positions: &'a [[f32; 3]], triangles: &[[u32; 3]]) -> Self {
        let range = |triangle: &[u32; 3]| {
            let z = triangle.map(|corner| positions[corner as usize][2]);
            (z[0].min(z[1]).min(z[2]), z[0].max(z[1]).max(z[2]))
        };
        let mut triangles = triangles.to_vec();
        triangles.sort_by(|a, b| range(a).0.total_cmp(&range(b).0));
        let min_z = triangles.iter().map(|triangle| range(triangle).0).collect();
        let max_height = triangles.iter().map(range).map(|(low, high)| high - low).fold(0.0, f32::max);
        Self { positions, triangles, min_z, max_height }
    }

    /// Maximum extent of a triangle along z.
    #[must_use]
    pub fn height(&self) -> f32 {
        self.max_height
    }

    /// Closed lines of the cut at `z`: x and y in the unit of the positions times `scale`. Open
    /// lines are dropped.
    #[must_use]
    pub fn cut(&self, z: f64, scale: f64) -> Vec<Vec<[f32; 2]>> {
        let z_single = z as f32;
        let first = self.min_z.partition_point(|&low| low < z_single - 1.001 * self.max_height);
        let end = self.min_z.partition_point(|&low| low <= z_single);
        let place = |corner: u32| self.positions[corner as usize].map(f64::from);
        let crossings = (self.triangles[first..end].iter())
            .filter_map(|triangle| Crossing::new(triangle, triangle.map(|corner| place(corner)[2]), z));
        let point = |&(a, b): &EdgeKey| {
            let (p, q) = (place(a), place(b));
            let [x, y, _] = edge_intersection(p, q, [p[2], q[2]], z);
            [x, y].map(|c| (c * scale) as f32)
        };
        let lines = Lines::chain(&crossings.collect::<Vec<_>>()).closed;
        lines.iter().map(|line| line.iter().map(point).collect()).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::PatchKind;
    use crate::model::sample::tube;

    fn area(line: &[[f32; 2]]) -> f64 {
        let next = line.iter().cycle().skip(1);
        line.iter()
            .zip(next)
            .map(|(a, b)| f64::from(a[0]) * f64::from(b[1]) - f64::from(a[1]) * f64::from(b[0]))
            .sum::<f64>()
            .abs()
            / 2.0
    }

    #[test]
    fn a_tube_is_cut_into_one_line_at_any_height() {
        let mesh = tube(24, 4, 0.2);
        let wall = mesh.patches.iter().find(|patch| patch.kind == PatchKind::OuterWall).unwrap();
        let slicer = Slicer::new(&mesh.positions, &mesh.triangles[wall.triangles.clone()]);
        // A regular polygon of radius 1 mm, in µm², even in a plane through corners.
        let expected = 0.5 * 24.0 * (std::f64::consts::TAU / 24.0).sin() * 1e6;
        for z in [1e-6, 0.3e-3, 1e-3, 2.5e-3, 3.999e-3] {
            let lines = slicer.cut(z, 1e6);
            assert_eq!(lines.len(), 1, "{z}");
            assert!((area(&lines[0]) / expected - 1.0).abs() < 1e-3, "{z}: {}", area(&lines[0]));
        }
        assert!(slicer.cut(-1e-3, 1e6).is_empty() && slicer.cut(5e-3, 1e6).is_empty());
    }

    #[test]
    fn a_line_that_does_not_close_is_left_out() {
        let positions = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 1.0], [5.0, 1.0, 1.0]];
        assert!(Slicer::new(&positions, &[[0, 1, 2], [1, 3, 2]]).cut(0.5, 1.0).is_empty());
    }

    #[test]
    fn lines_are_chained_in_any_order_and_open_ones_keep_their_ends() {
        let edge = |k: u32| (k, 100 + k);
        let step = |from: u32, to: u32| Crossing { from: edge(from), to: edge(to) };
        let forward = vec![step(1, 2), step(2, 3), step(3, 1), step(7, 5), step(5, 6)];
        let backward: Vec<Crossing> = forward.iter().rev().copied().collect();
        let lines = Lines::chain(&forward);
        assert_eq!(lines.closed, [[1, 2, 3].map(edge)]);
        assert_eq!(lines.open, [[7, 5, 6].map(edge)]);
        assert_eq!(Lines::chain(&backward), lines);
        assert_eq!(Lines::chain(&[]), Lines::default());
    }
}
