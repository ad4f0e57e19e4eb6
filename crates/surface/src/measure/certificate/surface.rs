//! The surface under test, and places of faults on it.

use super::types::{FailureKind, Failures, PLACES, Place};
use crate::geometry::bvh::{Points, WIDTH, points};

/// Coordinate type of a surface: f32 or f64.
pub(super) trait Coordinate: Copy + Send + Sync + Into<f64> {}
impl<T: Copy + Send + Sync + Into<f64>> Coordinate for T {}

/// Number of triangles that are measured together, one per vector lane.
pub(super) const LANES: usize = WIDTH;
/// Corners of these triangles: `[corner][axis][lane]`.
pub(super) type Corners = Points<3>;

/// Surface under test. All indices are in range, and all coordinates are in the range of the
/// predicates.
pub(super) struct Surface<'a, C> {
    pub(super) positions: &'a [[C; 3]],
    pub(super) triangles: &'a [[u32; 3]],
    /// Micrometres per unit of the positions.
    pub(super) unit_um: f64,
}

impl<C: Coordinate> Surface<'_, C> {
    #[inline]
    pub(super) fn point(&self, vertex: u32) -> [f64; 3] {
        self.positions[vertex as usize].map(Into::into)
    }

    #[inline]
    pub(super) fn corners(&self, triangle: usize) -> [[f64; 3]; 3] {
        self.triangles[triangle].map(|v| self.point(v))
    }

    /// Stores the corners of up to eight triangles, one per lane. Unused lanes are NaN.
    #[inline(always)]
    pub(super) fn lanes(&self, triangles: impl Iterator<Item = usize>, corners: &mut Corners) {
        points(triangles.map(|triangle| self.corners(triangle)), corners);
    }

    pub(super) fn place_of_vertex(&self, vertex: u32) -> Place {
        Place::at(self.point(vertex).map(|x| x * self.unit_um))
    }

    /// Place of some triangles: the centre of the first.
    pub(super) fn place_of_triangles(&self, triangles: &[u32]) -> Place {
        let corners = self.corners(triangles[0] as usize);
        let centre = std::array::from_fn(|axis| corners.iter().map(|p| p[axis]).sum::<f64>() / 3.0 * self.unit_um);
        Place { triangles: triangles.to_vec(), ..Place::at(centre) }
    }
}

/// Number of vertices whose coordinates are outside the range of the predicates, and the first of
/// them.
pub(super) fn beyond_range<C: Coordinate>(positions: &[[C; 3]]) -> (u64, usize) {
    let is_within = |&x: &C| {
        let x: f64 = x.into();
        (x == 0.0) | ((x.abs() >= 1e-60) & (x.abs() <= 1e60))
    };
    // Usually all are in range. The test has no branches, so the compiler can vectorize it.
    if positions.as_flattened().iter().fold(true, |all, x| all & is_within(x)) {
        return (0, 0);
    }
    let is_beyond = |p: &&[C; 3]| !p.iter().all(is_within);
    let first = positions.iter().position(|p| is_beyond(&p)).unwrap_or(0);
    (positions.iter().filter(is_beyond).count() as u64, first)
}

/// Places of the first [`PLACES`] items.
pub(super) fn few<T>(items: impl IntoIterator<Item = T>, place: impl FnMut(T) -> Place) -> Vec<Place> {
    items.into_iter().take(PLACES).map(place).collect()
}

/// Faults of one kind: their number, and the first places.
#[derive(Default)]
pub(super) struct Tally {
    pub(super) count: u64,
    pub(super) places: Vec<Place>,
}

impl Tally {
    /// Adds faults. Keeps the first places in the order of their triangles; places without
    /// triangles keep the order in which they are added.
    pub(super) fn add(&mut self, count: u64, places: Vec<Place>) {
        self.count += count;
        self.places.extend(places);
        self.places.sort_by(|a, b| a.triangles.cmp(&b.triangles));
        self.places.truncate(PLACES);
    }

    /// Adds a failure if there are faults. Its detail is their number followed by `what`.
    pub(super) fn report(&self, kind: FailureKind, what: &str, failures: &mut Failures) {
        failures.add(kind, self.count, format!("{} {what}", self.count), self.places.clone());
    }
}
