//! Thickness of walls and width of gaps of any closed surface, sampled along rays: what a printer
//! must resolve.
//!
//! From places spread evenly over the area, one ray follows the normal inwards and one outwards.
//! Its length to the surface that it meets first is the thickness of the wall or the width of the
//! gap, provided that this surface faces the place: its normal is within 60° of the opposite
//! direction. The places do not depend on chance or on the number of threads. A thinner place may
//! lie between them.

use crate::geometry::bvh::{Bounds, Bvh, Ray, WIDTH};
use crate::geometry::curve::sort_along_curve;
use crate::geometry::vector::{cross, dot, norm, sub};
use rayon::prelude::*;

/// Number of places.
const PLACES: usize = 20_000;
/// Minimum cosine of the angle between a ray and the normal of the surface that it meets.
const FACING: f64 = 0.5;

/// Walls and gaps of a surface, in the unit of its positions.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Printable {
    /// Thickness of walls; `None` if no wall was found.
    pub wall: Option<Least>,
    /// Distance between facing surfaces outside the body; `None` if no gap was found.
    pub gap: Option<Least>,
    /// Number of places.
    pub places: usize,
}

/// Small values of a sampled length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Least {
    /// Minimum.
    pub least: f64,
    /// Value that 5 % of the values do not reach.
    pub fifth_percentile: f64,
}

impl Least {
    fn of(mut values: Vec<f64>) -> Option<Self> {
        values.sort_unstable_by(f64::total_cmp);
        Some(Self { least: *values.first()?, fifth_percentile: *values.get(values.len() / 20)? })
    }
}

/// Measures the walls and gaps of a surface. Triangles without area are ignored.
///
/// # Panics
/// If a triangle names a vertex that does not exist.
#[must_use]
pub fn printable(positions: &[[f32; 3]], triangles: &[[u32; 3]]) -> Printable {
    let surface = Triangles::new(positions, triangles);
    let places = surface.places();
    let found: Vec<[Option<f64>; 2]> = (places.par_iter())
        .map(|&(triangle, place)| {
            let inwards = surface.normal(triangle).map(|x| -x);
            [inwards, inwards.map(|x| -x)].map(|direction| surface.facing(triangle, Ray { origin: place, direction }))
        })
        .collect();
    let lengths = |side: usize| found.iter().filter_map(|both| both[side]).collect();
    Printable { wall: Least::of(lengths(0)), gap: Least::of(lengths(1)), places: places.len() }
}

/// Triangles in the order of a curve, with a hierarchy.
struct Triangles<'a> {
    positions: &'a [[f32; 3]],
    triangles: &'a [[u32; 3]],
    order: Vec<u32>,
    /// Hierarchy of blocks of eight triangles, which takes an eighth of the memory of one of
    /// single triangles.
    blocks: Bvh,
}

impl<'a> Triangles<'a> {
    fn new(positions: &'a [[f32; 3]], triangles: &'a [[u32; 3]]) -> Self {
        let mut surface = Self { positions, triangles, order: Vec::new(), blocks: Bvh::default() };
        let mut order: Vec<u32> = (0..triangles.len() as u32).collect();
        sort_along_curve(&mut order, |t| {
            let [a, b, c] = surface.corners(t);
            [0, 1, 2].map(|axis| (a[axis] + b[axis] + c[axis]) / 3.0)
        });
        let of_block = |block: usize| {
            let own = &order[block * WIDTH..order.len().min((block + 1) * WIDTH)];
            own.iter().fold(Bounds::EMPTY, |all, &t| all.with(&Bounds::of(surface.corners(t))))
        };
        surface.blocks = Bvh::build(order.len().div_ceil(WIDTH), of_block);
        surface.order = order;
        surface
    }

    fn corners(&self, triangle: u32) -> [[f64; 3]; 3] {
        self.triangles[triangle as usize].map(|v| self.positions[v as usize].map(f64::from))
    }

    /// Unit normal of a triangle with an area.
    fn normal(&self, triangle: u32) -> [f64; 3] {
        let [a, b, c] = self.corners(triangle);
        let normal = cross(sub(b, a), sub(c, a));
        let length = norm(normal);
        normal.map(|x| x / length)
    }

    /// Triangles and points on them, evenly spread over the area.
    fn places(&self) -> Vec<(u32, [f64; 3])> {
        let area = |&t: &u32| {
            let [a, b, c] = self.corners(t);
            norm(cross(sub(b, a), sub(c, a)))
        };
        let total: f64 = self.order.iter().map(area).sum();
        let (mut places, mut sum) = (Vec::with_capacity(PLACES), 0.0);
        for t in &self.order {
            sum += area(t);
            while places.len() < PLACES && (places.len() as f64 + 0.5) / (PLACES as f64) * total < sum {
                places.push((*t, self.point(*t, places.len())));
            }
        }
        places
    }

    /// A point of a triangle, from a sequence that fills it evenly (Roberts' R2).
    fn point(&self, triangle: u32, number: usize) -> [f64; 3] {
        let [a, b, c] = self.corners(triangle);
        let part = |step: f64| (0.5 + number as f64 * step).fract();
        let (u, v) = (part(0.754_877_666_246_692_7), part(0.569_840_290_998_053_3));
        let (u, v) = if u + v > 1.0 { (1.0 - u, 1.0 - v) } else { (u, v) };
        [0, 1, 2].map(|axis| a[axis] + u * (b[axis] - a[axis]) + v * (c[axis] - a[axis]))
    }

    /// Distance from a place on a triangle to the surface along a ray of unit direction, if the
    /// surface there faces the triangle.
    fn facing(&self, from: u32, ray: Ray) -> Option<f64> {
        let block = |block: usize| &self.order[block * WIDTH..self.order.len().min((block + 1) * WIDTH)];
        let nearest = |at: usize| {
            let hits = block(at).iter().filter(|&&t| t != from);
            hits.filter_map(|&t| Some((intersection(&ray, self.corners(t))?, t))).min_by(|a, b| a.0.total_cmp(&b.0))
        };
        let (at, distance) = self.blocks.first_along(&ray, |at| nearest(at).map(|(distance, _)| distance))?;
        let (_, hit) = nearest(at)?;
        // Inside a wall, the surface that the ray meets faces along the ray; across a gap, it faces
        // against the ray.
        let is_inwards = dot(ray.direction, self.normal(from)) < 0.0;
        let cosine = dot(ray.direction, self.normal(hit)) * if is_inwards { 1.0 } else { -1.0 };
        (cosine >= FACING).then_some(distance)
    }
}

/// Distance along a ray at which it meets a triangle, if it does (Möller and Trumbore).
fn intersection(ray: &Ray, [a, b, c]: [[f64; 3]; 3]) -> Option<f64> {
    let (ab, ac, from) = (sub(b, a), sub(c, a), sub(ray.origin, a));
    let across = cross(ray.direction, ac);
    let determinant = dot(ab, across);
    if determinant == 0.0 {
        return None;
    }
    let u = dot(from, across) / determinant;
    let around = cross(from, ab);
    let v = dot(ray.direction, around) / determinant;
    let distance = dot(ac, around) / determinant;
    (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && distance > 0.0).then_some(distance)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::sample::tube;

    /// A closed box.
    fn cuboid(low: [f32; 3], high: [f32; 3], positions: &mut Vec<[f32; 3]>, triangles: &mut Vec<[u32; 3]>) {
        let first = positions.len() as u32;
        positions.extend((0..8).map(|k| [0, 1, 2].map(|axis| if k >> axis & 1 == 0 { low[axis] } else { high[axis] })));
        for [a, b, c, d] in [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]] {
            triangles.extend([[a, b, c], [a, c, d]].map(|t: [u32; 3]| t.map(|v| first + v)));
        }
    }

    #[test]
    fn plates_have_their_thickness_and_the_gap_between_them() {
        let (mut positions, mut triangles) = (Vec::new(), Vec::new());
        cuboid([0.0; 3], [10.0, 10.0, 0.5], &mut positions, &mut triangles);
        cuboid([0.0, 0.0, 0.75], [10.0, 10.0, 3.75], &mut positions, &mut triangles);
        let found = printable(&positions, &triangles);
        assert_eq!(found.places, PLACES);
        let (wall, gap) = (found.wall.unwrap(), found.gap.unwrap());
        assert_eq!((wall.least, wall.fifth_percentile, gap.least, gap.fifth_percentile), (0.5, 0.5, 0.25, 0.25));
    }

    #[test]
    fn a_tube_has_the_thickness_of_its_wall_and_the_width_of_its_lumen() {
        // Radii 0.5 and 1 mm; polygons of 48 corners are thinner than circles by 0.2 %.
        let mesh = tube(48, 4, 0.0);
        let found = printable(&mesh.positions, &mesh.triangles);
        let (wall, gap) = (found.wall.unwrap(), found.gap.unwrap());
        for (value, expected) in [(wall.least, 5e-4), (wall.fifth_percentile, 5e-4), (gap.least, 1e-3)] {
            assert!((value / expected - 1.0).abs() < 0.02, "{value} {expected}");
        }
    }

    #[test]
    fn a_surface_without_area_has_neither() {
        let none = printable(&[[0.0; 3]; 3], &[[0, 1, 2]]);
        assert_eq!(none, Printable::default());
        assert_eq!(printable(&[], &[]), Printable::default());
        let (mut positions, mut triangles) = (Vec::new(), Vec::new());
        cuboid([0.0; 3], [1.0; 3], &mut positions, &mut triangles);
        assert_eq!(printable(&positions, &triangles).gap, None);
    }
}
