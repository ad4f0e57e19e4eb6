//! Cuts of a surface by planes of constant z, as closed lines.
//!
//! A corner with a z above the plane is above it, any other below, so that no triangle lies in the plane. A point of a cut
//! depends only on the edge that it lies on, so that the lines of neighbouring triangles meet exactly.

/// A surface, prepared for many cuts.
pub struct Slicer<'a> {
    positions: &'a [[f32; 3]],
    /// The triangles, those that begin lowest first.
    triangles: Vec<[u32; 3]>,
    /// Least z of each.
    lows: Vec<f32>,
    /// Greatest height of a triangle.
    height: f32,
}

/// Where a triangle leads: from the edge on which its line begins to the one on which it ends.
struct Crossing {
    from: (u32, u32),
    to: (u32, u32),
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

    /// The closed lines in the plane, as x and y in the unit of the positions times `scale`. A line is left out if the surface is
    /// open where it would close.
    #[must_use]
    pub fn cut(&self, z: f64, scale: f64) -> Vec<Vec<[f32; 2]>> {
        let z_single = z as f32;
        let first = self.lows.partition_point(|&low| low < z_single - 1.001 * self.height);
        let end = self.lows.partition_point(|&low| low <= z_single);
        let mut crossings: Vec<Crossing> =
            self.triangles[first..end].iter().filter_map(|triangle| self.crossing(triangle, z)).collect();
        crossings.sort_unstable_by_key(|crossing| crossing.from);
        let mut seen = vec![false; crossings.len()];
        let mut lines = Vec::new();
        for start in 0..crossings.len() {
            let (mut at, mut line) = (start, Vec::new());
            while !seen[at] {
                seen[at] = true;
                line.push(self.point(crossings[at].from, z).map(|c| (c * scale) as f32));
                let next = crossings[at].to;
                match crossings.binary_search_by_key(&next, |crossing| crossing.from) {
                    Ok(found) => at = found,
                    Err(_) => line.clear(),
                }
            }
            if at == start && line.len() > 2 {
                lines.push(line);
            }
        }
        lines
    }

    fn crossing(&self, triangle: &[u32; 3], z: f64) -> Option<Crossing> {
        let above = triangle.map(|corner| self.z(corner) > z);
        let edge = |up: bool| {
            (0..3).find(|&k| above[k] != up && above[(k + 1) % 3] == up).map(|k| {
                let (a, b) = (triangle[k], triangle[(k + 1) % 3]);
                (a.min(b), a.max(b))
            })
        };
        Some(Crossing { from: edge(true)?, to: edge(false)? })
    }

    fn z(&self, corner: u32) -> f64 {
        f64::from(self.positions[corner as usize][2])
    }

    fn point(&self, (a, b): (u32, u32), z: f64) -> [f64; 2] {
        let t = (z - self.z(a)) / (self.z(b) - self.z(a));
        let (p, q) = (self.positions[a as usize], self.positions[b as usize]);
        [0, 1].map(|axis| f64::from(p[axis]) + t * (f64::from(q[axis]) - f64::from(p[axis])))
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
}
