//! Cuts of a body, and the borders of its walls.

use super::rings::nested_rings;
use super::{Crossing, EdgeKey, Lines, edge_intersection};
use crate::geometry::distance::Triangles;
use crate::model::{Border, Cut, Line, Mesh, PatchKind, Plane};
use rayon::prelude::*;
use std::borrow::Cow;
use std::collections::HashMap;
use std::ops::Range;

/// Number of consecutive triangles with a common bounding box.
const TRIANGLES_PER_BOX: usize = 1 << 10;
const BOXES_PER_TASK: usize = 16;

/// A closed surface that bounds tissue or lumen, ready to be cut.
#[derive(Clone, Debug)]
pub struct Body<'a> {
    positions: Cow<'a, [[f32; 3]]>,
    triangles: Cow<'a, [[u32; 3]]>,
    um_per_unit: f64,
    /// Bounding box of every [`TRIANGLES_PER_BOX`] triangles, µm.
    boxes: Vec<Extent>,
    is_lumen: bool,
    walls: Option<Walls>,
}

/// Minimum and maximum corner of a box, µm.
#[derive(Clone, Copy, Debug)]
struct Extent {
    low: [f64; 3],
    high: [f64; 3],
}

/// Walls of a body of tissue, each with the fans of triangles that would close its ends.
#[derive(Clone, Debug)]
struct Walls {
    /// Triangles of the inner and of the outer wall.
    triangles: [Range<usize>; 2],
    /// For each wall, the edges along its ends, each with the centre of that end, µm.
    fans: [Vec<([u32; 2], [f64; 3])>; 2],
}

impl<'a> Body<'a> {
    /// Creates a body from a surface with named patches. `um_per_unit` is the unit of `positions`
    /// in micrometres.
    #[must_use]
    pub fn new(
        positions: impl Into<Cow<'a, [[f32; 3]]>>,
        triangles: impl Into<Cow<'a, [[u32; 3]]>>,
        patches: &[(PatchKind, Range<usize>)],
        um_per_unit: f64,
    ) -> Self {
        let (positions, triangles) = (positions.into(), triangles.into());
        let range = |kind| patches.iter().find(|(patch, _)| *patch == kind).map(|(_, triangles)| triangles.clone());
        let caps = [PatchKind::CapIsthmus, PatchKind::CapAmpulla].map(range);
        let walls = match (range(PatchKind::InnerWall), range(PatchKind::OuterWall), caps) {
            (Some(inner), Some(outer), [Some(first), Some(last)]) => {
                let caps = [&triangles[first], &triangles[last]];
                Some(Walls { triangles: [inner, outer], fans: fans(&positions, caps, um_per_unit) })
            }
            _ => None,
        };
        let boxes = triangles
            .par_chunks(TRIANGLES_PER_BOX)
            .with_min_len(BOXES_PER_TASK)
            .map(|triangles| Extent::of(triangles, &positions, um_per_unit))
            .collect();
        Self { is_lumen: range(PatchKind::Wall).is_some(), positions, triangles, um_per_unit, boxes, walls }
    }

    /// Approximate memory of the surface, bytes.
    #[must_use]
    pub fn bytes(&self) -> usize {
        12 * (self.positions.len() + self.triangles.len())
    }

    /// Number of triangles.
    #[must_use]
    pub fn triangle_count(&self) -> usize {
        self.triangles.len()
    }

    /// Corners of a triangle, µm.
    #[must_use]
    pub fn corners_um(&self, triangle: usize) -> [[f64; 3]; 3] {
        self.triangles[triangle].map(|v| self.position_um(v))
    }

    /// The triangles, for distances from them in micrometres.
    #[must_use]
    pub fn triangles(&self) -> Triangles<impl Fn(usize) -> [[f64; 3]; 3] + Sync> {
        Triangles::new(self.triangles.len(), |k| self.corners_um(k))
    }

    /// Cuts the body with a plane.
    #[must_use]
    pub fn cut(&self, plane: &Plane) -> Cut {
        let crossings = self.crossings(0..self.triangles.len(), plane);
        let lines = self
            .lines(plane, &crossings)
            .closed
            .into_iter()
            .map(|line| line.iter().map(|p| plane.coordinates(*p)).collect());
        nested_rings(*plane, lines.collect(), self.is_lumen)
    }

    /// Borders of the inner and of the outer wall in a plane. `None` if the body lacks the patches
    /// of a tissue.
    #[must_use]
    pub fn borders(&self, plane: &Plane) -> Option<[Border; 2]> {
        let walls = self.walls.as_ref()?;
        let single = |p: [f64; 3]| plane.coordinates(p).map(|x| x as f32);
        let border = |k: usize| {
            let PointLines { closed, open } = self.lines(plane, &self.crossings(walls.triangles[k].clone(), plane));
            let line = |is_closed| {
                move |line: Vec<[f64; 3]>| Line { points: line.into_iter().map(single).collect(), is_closed }
            };
            let lines = closed.into_iter().map(line(true)).chain(open.into_iter().map(line(false))).collect();
            let closing = walls.fans[k].iter().filter_map(|(edge, middle)| {
                let corners = [self.position_um(edge[0]), self.position_um(edge[1]), *middle];
                let ends = triangle_segment(corners, plane)?;
                ends.iter().all(|p| plane.reaches(*p)).then(|| ends.map(single))
            });
            Border { lines, closing: closing.collect() }
        };
        Some([border(0), border(1)])
    }

    /// Minimum and maximum height of the body above the origin, along the normal of `plane`, µm.
    #[must_use]
    pub fn extent_um(&self, plane: &Plane) -> [f64; 2] {
        let heights = (0..self.positions.len() as u32).map(|v| plane.height_of(self.position_um(v)));
        heights.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], h| [low.min(h), high.max(h)])
    }

    fn position_um(&self, v: u32) -> [f64; 3] {
        self.positions[v as usize].map(|x| f64::from(x) * self.um_per_unit)
    }

    /// Crossings of a range of triangles, in their order.
    fn crossings(&self, triangles: Range<usize>, plane: &Plane) -> Vec<Crossing> {
        let height = plane.height_um();
        let boxes = triangles.start / TRIANGLES_PER_BOX..triangles.end.div_ceil(TRIANGLES_PER_BOX);
        let of_box = |k: usize| {
            let own = k * TRIANGLES_PER_BOX..(k + 1) * TRIANGLES_PER_BOX;
            let own = own.start.max(triangles.start)..own.end.min(triangles.end);
            (self.triangles[own].iter())
                .filter_map(|t| Crossing::new(t, t.map(|v| plane.height_of(self.position_um(v))), height))
        };
        boxes
            .into_par_iter()
            .with_min_len(BOXES_PER_TASK)
            .filter(|&k| self.boxes[k].meets(plane, height))
            .flat_map_iter(of_box)
            .filter(|crossing| plane.reaches(self.intersection(plane, crossing.from)))
            .collect()
    }

    fn intersection(&self, plane: &Plane, (a, b): EdgeKey) -> [f64; 3] {
        let [p, q] = [a, b].map(|v| self.position_um(v));
        edge_intersection(p, q, [p, q].map(|p| plane.height_of(p)), plane.height_um())
    }

    fn lines(&self, plane: &Plane, crossings: &[Crossing]) -> PointLines {
        let point = |&edge: &EdgeKey| self.intersection(plane, edge);
        let points = |lines: Vec<Vec<EdgeKey>>| lines.iter().map(|line| line.iter().map(point).collect()).collect();
        let Lines { closed, open } = Lines::chain(crossings);
        PointLines { closed: points(closed), open: points(open) }
    }
}

impl Extent {
    fn of(triangles: &[[u32; 3]], positions: &[[f32; 3]], um_per_unit: f64) -> Self {
        let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
        for &v in triangles.as_flattened() {
            for (axis, x) in positions[v as usize].into_iter().enumerate() {
                low[axis] = low[axis].min(x);
                high[axis] = high[axis].max(x);
            }
        }
        let um = |x: f32| f64::from(x) * um_per_unit;
        Self { low: low.map(um), high: high.map(um) }
    }

    /// True if a triangle within the box may cross the plane. Rounding is monotone, so no rounded
    /// height of a point is beyond the rounded heights of the corners.
    fn meets(&self, plane: &Plane, height_um: f64) -> bool {
        let rises = plane.normal.map(|x| x >= 0.0);
        let corner = |ahead: bool| [0, 1, 2].map(|k| if rises[k] == ahead { self.high[k] } else { self.low[k] });
        plane.height_of(corner(false)) <= height_um && plane.height_of(corner(true)) > height_um
    }
}

impl<'a> From<&'a Mesh> for Body<'a> {
    fn from(mesh: &'a Mesh) -> Self {
        let patches: Vec<_> = mesh.patches.iter().map(|patch| (patch.kind, patch.triangles.clone())).collect();
        Self::new(&mesh.positions[..], &mesh.triangles[..], &patches, 1e6)
    }
}

struct PointLines {
    closed: Vec<Vec<[f64; 3]>>,
    open: Vec<Vec<[f64; 3]>>,
}

/// Segment in which a plane cuts a triangle.
fn triangle_segment(corners: [[f64; 3]; 3], plane: &Plane) -> Option<[[f64; 3]; 2]> {
    let heights = corners.map(|p| plane.height_of(p));
    let Crossing { from, to } = Crossing::new(&[0, 1, 2], heights, plane.height_um())?;
    let point = |(a, b): EdgeKey| {
        let (a, b) = (a as usize, b as usize);
        edge_intersection(corners[a], corners[b], [heights[a], heights[b]], plane.height_um())
    };
    Some([point(from), point(to)])
}

/// Edges at the ends of the inner and of the outer wall, each with the centre of its end. A cap has
/// two rims; the rim with the larger bounding box (sum of its sides) belongs to the outer wall.
fn fans(positions: &[[f32; 3]], caps: [&[[u32; 3]]; 2], um_per_unit: f64) -> [Vec<([u32; 2], [f64; 3])>; 2] {
    let mut fans = [Vec::new(), Vec::new()];
    for cap in caps {
        let mut rims = rims(cap);
        let extent_sum = |rim: &Vec<[u32; 2]>| {
            let mut extent = [[f32::INFINITY, f32::NEG_INFINITY]; 3];
            for p in rim.iter().map(|edge| positions[edge[0] as usize]) {
                (0..3).for_each(|axis| extent[axis] = [extent[axis][0].min(p[axis]), extent[axis][1].max(p[axis])]);
            }
            extent.iter().map(|[low, high]| high - low).sum::<f32>()
        };
        rims.sort_by(|a, b| extent_sum(a).total_cmp(&extent_sum(b)));
        let outer = rims.len().saturating_sub(1);
        for (k, rim) in rims.into_iter().enumerate() {
            let mut middle = [0.0; 3];
            for edge in &rim {
                let p = positions[edge[0] as usize];
                (0..3).for_each(|axis| middle[axis] += f64::from(p[axis]) * um_per_unit / rim.len() as f64);
            }
            fans[usize::from(k == outer)].extend(rim.into_iter().map(|edge| (edge, middle)));
        }
    }
    fans
}

/// Closed chains of the edges that belong to only one triangle.
fn rims(triangles: &[[u32; 3]]) -> Vec<Vec<[u32; 2]>> {
    let mut next: HashMap<u32, u32> = HashMap::new();
    let edges = || triangles.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]);
    let all: std::collections::HashSet<[u32; 2]> = edges().collect();
    let open: Vec<[u32; 2]> = edges().filter(|&[a, b]| !all.contains(&[b, a])).collect();
    next.extend(open.iter().map(|&[a, b]| (a, b)));
    let mut rims = Vec::new();
    for [start, _] in open {
        let (mut at, mut rim) = (start, Vec::new());
        while let Some(to) = next.remove(&at) {
            rim.push([at, to]);
            at = to;
        }
        if !rim.is_empty() {
            rims.push(rim);
        }
    }
    rims
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::course::Course;
    use crate::model::RingKind;
    use crate::model::sample::tube;

    #[test]
    fn other_parts_than_the_one_around_the_plane_are_left_out() {
        let mut mesh = tube(24, 4, 0.0);
        let count = mesh.positions.len() as u32;
        let beside: Vec<[f32; 3]> = mesh.positions.iter().map(|[x, y, z]| [x + 5e-3, *y, *z]).collect();
        // A patch is one range of triangles, so the second tube is appended to the last patch.
        let more: Vec<[u32; 3]> = mesh.triangles.iter().map(|t| t.map(|v| v + count)).collect();
        mesh.positions.extend(beside);
        mesh.triangles.extend(more);
        let last = mesh.patches.len() - 1;
        mesh.patches[last].triangles.end = mesh.triangles.len();
        let course = Course::straight(4000.0);
        let body = Body::from(&mesh);
        let plane = course.plane_across(1700.0, [0.0, 4000.0], 1200.0).unwrap();
        assert_eq!((plane.u, plane.v, plane.reach_um), ([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], Some(1200.0)));
        assert_eq!(body.cut(&Plane::across(1700.0)).of(RingKind::Tissue).count(), 2);
        assert_eq!(body.cut(&plane).of(RingKind::Tissue).count(), 1);
        assert_ne!(plane.digest(), Plane::across(1700.0).digest());
        // The caps are planar only up to rounding.
        for end in [0.0, 4000.0] {
            let plane = course.plane_across(end, [0.0, 4000.0], 1200.0).unwrap();
            assert_eq!(body.cut(&plane).rings.len(), 2);
        }
        assert_eq!(course.plane_across(4000.1, [0.0, 4000.0], 1200.0), None);
    }

    #[test]
    fn a_tube_is_cut_across_along_and_at_an_angle() {
        let mesh = tube(24, 4, 0.0);
        let body = Body::from(&mesh);
        // Regular polygons of 24 corners, radii 500 and 1000 µm.
        let polygon = 12.0 * (std::f64::consts::TAU / 24.0).sin() * 1e6;
        let across = Plane::across(1700.0);
        let tilted = Plane::through([0.0, 0.0, 2000.0], [0.0, 1.0, 1.0]).unwrap();
        for (plane, stretch) in [(across, 1.0), (tilted, 2.0_f64.sqrt())] {
            let cut = body.cut(&plane);
            let found: Vec<(RingKind, f64)> = cut.rings.iter().map(|ring| (ring.kind, ring.area_um2)).collect();
            let expected = [(RingKind::Tissue, polygon * stretch), (RingKind::Lumen, polygon * stretch / 4.0)];
            assert_eq!(found.len(), 2);
            for (found, expected) in found.iter().zip(expected) {
                assert!(found.0 == expected.0 && (found.1 / expected.1 - 1.0).abs() < 1e-3, "{found:?} {expected:?}");
            }
        }
        assert_eq!([-1.0, 1700.0, 4000.1].map(|z_um| body.cut(&Plane::across(z_um)).rings.len()), [0, 2, 0]);
        // Along the axis the tissue is two strips of 4 mm, and no ring encloses the lumen.
        let along = body.cut(&Plane::through([0.0, 1.0, 0.0], [0.0, 1.0, 0.0]).unwrap());
        assert!(along.rings.iter().all(|ring| ring.kind == RingKind::Tissue) && along.rings.len() == 2);
        assert!((along.tissue_um2() / (4000.0 * 1000.0) - 1.0).abs() < 0.01, "{}", along.tissue_um2());
    }

    #[test]
    fn boxes_leave_out_no_triangle_that_a_plane_crosses() {
        let mesh = tube(1500, 5, 0.2);
        let body = Body::from(&mesh);
        assert!(body.boxes.len() > 20);
        for k in 0..200 {
            let [a, b, c] = [k as f64, (k * k) as f64, (3 * k) as f64].map(|x| libm::sin(x + 0.5));
            // Every other plane passes through a vertex.
            let origin =
                if k % 2 == 0 { [600.0 * a, 700.0 * b, 2000.0 + 2100.0 * c] } else { body.position_um(17 * k) };
            let plane = Plane::through(origin, [b, c, a]).unwrap();
            let crossed = |t: &&[u32; 3]| {
                let heights = t.map(|v| plane.height_of(body.position_um(v)));
                Crossing::new(t, heights, plane.height_um()).is_some()
            };
            let expected = mesh.triangles.iter().filter(crossed).count();
            assert_eq!(body.crossings(0..mesh.triangles.len(), &plane).len(), expected, "{plane:?}");
        }
    }

    #[test]
    fn the_walls_of_a_plane_along_the_tube_are_open_lines_that_fans_close() {
        let mesh = tube(24, 4, 0.0);
        let body = Body::from(&mesh);
        let plane = Plane::through([0.0, 1.0, 0.0], [0.0, 1.0, 0.0]).unwrap();
        let [mucosa, outside] = body.borders(&plane).unwrap();
        for (border, radius) in [(mucosa, 500.0), (outside, 1000.0)] {
            assert_eq!(border.lines.iter().map(|line| line.is_closed).collect::<Vec<_>>(), [false, false]);
            let length: f32 = border.closing.iter().map(|[a, b]| (b[0] - a[0]).hypot(b[1] - a[1])).sum();
            // Twice the width of the tube at y = 1 µm.
            assert!((f64::from(length) / (4.0 * radius) - 1.0).abs() < 0.01, "{length}");
        }
        let [mucosa, outside] = body.borders(&Plane::across(2500.0)).unwrap();
        for border in [mucosa, outside] {
            assert!(border.closing.is_empty() && border.lines.len() == 1 && border.lines[0].is_closed);
        }
    }
}
