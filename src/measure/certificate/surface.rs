//! The surface under test, and the locations of faults on it.

use super::types::{PLACES, Place};

/// A coordinate of a surface: f32 or f64.
pub(super) trait Coordinate: Copy + Send + Sync + Into<f64> {}
impl<T: Copy + Send + Sync + Into<f64>> Coordinate for T {}

/// A surface under test; all triangle indices are in range and all coordinates within the bounds of the predicates.
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

    pub(super) fn place_of_vertex(&self, vertex: u32) -> Place {
        Place::at(self.point(vertex).map(|x| x * self.unit_um))
    }

    pub(super) fn place_of_triangles(&self, triangles: &[u32]) -> Place {
        let corners = self.corners(triangles[0] as usize);
        let centre = std::array::from_fn(|axis| corners.iter().map(|p| p[axis]).sum::<f64>() / 3.0 * self.unit_um);
        Place { triangles: triangles.to_vec(), ..Place::at(centre) }
    }
}

/// The places of the first [`PLACES`] items.
pub(super) fn few<T>(items: impl IntoIterator<Item = T>, place: impl FnMut(T) -> Place) -> Vec<Place> {
    items.into_iter().take(PLACES).map(place).collect()
}
