//! Cuts of triangles by planes, as lines.
//!
//! A corner that is higher along the normal than the plane is above it, any other below, so that no triangle lies in the plane.
//! A point of a cut depends only on the edge that it lies on, so that the lines of neighbouring triangles meet exactly. Lines
//! have what is above on their left, seen from outside of the surface.

mod body;
mod rings;

pub use body::Body;
pub use rings::nested_rings;

/// An edge by its corners, the lower index first.
pub type EdgeKey = (u32, u32);

/// Where a triangle leads: from the edge on which its line begins to the one on which it ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Crossing {
    /// The edge that goes up through the plane.
    pub from: EdgeKey,
    /// The edge that goes down through the plane.
    pub to: EdgeKey,
}

impl Crossing {
    /// The crossing of a triangle whose corners have these heights; none if the plane does not cut it.
    #[inline]
    #[must_use]
    pub fn of(triangle: &[u32; 3], heights: [f64; 3], plane: f64) -> Option<Self> {
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

/// Crossings in order, as edges.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Lines {
    /// Closed lines.
    pub closed: Vec<Vec<EdgeKey>>,
    /// Lines that end where the surface is open.
    pub open: Vec<Vec<EdgeKey>>,
}

impl Lines {
    /// Chains crossings. The result does not depend on their order.
    #[must_use]
    pub fn chain(mut crossings: Vec<Crossing>) -> Self {
        crossings.sort_unstable_by_key(|crossing| (crossing.from, crossing.to));
        let next = |at: usize| crossings.binary_search_by_key(&crossings[at].to, |crossing| crossing.from).ok();
        let mut follows = vec![false; crossings.len()];
        (0..crossings.len()).filter_map(next).for_each(|at| follows[at] = true);
        let starts = (0..crossings.len()).filter(|&at| !follows[at]);
        let mut seen = vec![false; crossings.len()];
        let mut lines = Self::default();
        for start in starts.chain(0..crossings.len()) {
            let (mut at, mut line) = (Some(start), Vec::new());
            let mut last = start;
            while let Some(now) = at.filter(|&at| !seen[at]) {
                seen[now] = true;
                line.push(crossings[now].from);
                last = now;
                at = next(now);
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
        lines
    }
}

/// The point at which an edge with ends `p` and `q` at these heights meets a plane.
#[inline]
#[must_use]
pub fn meeting_point(p: [f64; 3], q: [f64; 3], heights: [f64; 2], plane: f64) -> [f64; 3] {
    let t = (plane - heights[0]) / (heights[1] - heights[0]);
    [0, 1, 2].map(|axis| p[axis] + t * (q[axis] - p[axis]))
}

/// A surface, prepared for many cuts by planes of constant z.
pub struct Slicer<'a> {
    positions: &'a [[f32; 3]],
    /// The triangles, those that begin lowest first.
    triangles: Vec<[u32; 3]>,
    /// Least z of each.
    lows: Vec<f32>,
    /// Greatest extent of a triangle along z.
    height: f32,
}

impl<'a> Slicer<'a> {
    /// Prepares triangles with corners among `positions`.
    #[must_use]
    pub fn new(positions: &'a [[f32; 3]], triangles: &[[u32; 3]]) -> Self {
        let range = |triangle: &[u32; 3]| {
            let z = triangle.map(|corner| positions[corner as usize][2]);
            (z[0].min(z[1]).min(z[2]), z[0].max(z[1]).max(z[2]))
        };
        let mut triangles = triangles.to_vec();
        triangles.sort_by(|a, b| range(a).0.total_cmp(&range(b).0));
        let lows = triangles.iter().map(|triangle| range(triangle).0).collect();
        let height = triangles.iter().map(range).map(|(low, high)| high - low).fold(0.0, f32::max);
        Self { positions, triangles, lows, height }
    }

    /// Greatest extent of a triangle along z.
    #[must_use]
    pub fn height(&self) -> f32 {
        self.height
    }

    /// The closed lines in the plane, as x and y in the unit of the positions times `scale`. Lines that do not close are left out.
    #[must_use]
    pub fn cut(&self, z: f64, scale: f64) -> Vec<Vec<[f32; 2]>> {
        let z_single = z as f32;
        let first = self.lows.partition_point(|&low| low < z_single - 1.001 * self.height);
        let end = self.lows.partition_point(|&low| low <= z_single);
        let place = |corner: u32| self.positions[corner as usize].map(f64::from);
        let crossings = (self.triangles[first..end].iter())
            .filter_map(|triangle| Crossing::of(triangle, triangle.map(|corner| place(corner)[2]), z));
        let point = |&(a, b): &EdgeKey| {
            let (p, q) = (place(a), place(b));
            let [x, y, _] = meeting_point(p, q, [p[2], q[2]], z);
            [x, y].map(|c| (c * scale) as f32)
        };
        let lines = Lines::chain(crossings.collect()).closed;
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
        // A regular polygon of radius 1 mm, in µm², also in the plane of corners.
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
        let lines = Lines::chain(forward);
        assert_eq!(lines.closed, [[1, 2, 3].map(edge)]);
        assert_eq!(lines.open, [[7, 5, 6].map(edge)]);
        assert_eq!(Lines::chain(backward), lines);
        assert_eq!(Lines::chain(Vec::new()), Lines::default());
    }
}
