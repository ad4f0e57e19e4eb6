//! Cross sections of the tube, recorded by a simulation and connected by a loft (paper, section 3.1).

use super::Border;

/// A closed contour: points in order, counter-clockwise, with the stable id of each.
///
/// `ids.len() == points.len()`. A vertex of one section continues the vertex with the same id in another. Ids
/// are unique within a ring but not ordered. New ids appear only between two old neighbours.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Ring {
    /// Stable ids, one per point.
    pub ids: Vec<u32>,
    /// Positions in micrometres.
    pub points: Vec<[f32; 2]>,
}

impl Ring {
    /// Number of points.
    #[must_use]
    #[inline]
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Whether the ring has no points.
    #[must_use]
    #[inline]
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }
}

/// A cross section: the mucosa (`inner`) around the lumen, and the wall (`outer`) around it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Section {
    /// Time step of the section; fractional if it was added to mend a slab.
    pub step: f64,
    /// Place along the tube, micrometres from the isthmus end.
    pub z_um: f64,
    /// Whether it was added to mend a slab rather than recorded by the schedule.
    pub added: bool,
    /// Boundary of the lumen.
    pub inner: Ring,
    /// Boundary of the tissue.
    pub outer: Ring,
}

impl Section {
    /// Particles of both loops.
    #[must_use]
    #[inline]
    pub fn particles(&self) -> usize {
        self.inner.len() + self.outer.len()
    }

    /// The contours as borders: the surface of the mucosa, and the outside of the wall.
    #[must_use]
    #[inline]
    pub fn borders(&self) -> [Border; 2] {
        [&self.inner, &self.outer].map(|ring| Border::closed(vec![ring.points.clone()]))
    }
}
