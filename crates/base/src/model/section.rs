//! Cross sections of the tube. The simulation records them, the loft connects them (paper, section
//! 3.1).

use super::Border;

/// A closed contour: points in counter-clockwise order, each with a stable id.
///
/// Both vectors have the same length. A vertex continues the vertices with the same id in
/// other sections. Ids are unique within a ring but not ordered. A new id appears only between
/// two old neighbours.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Ring {
    /// Stable id of each point.
    pub ids: Vec<u32>,
    /// Positions, µm.
    pub points: Vec<[f32; 2]>,
}

impl Ring {
    /// Number of points.
    #[must_use]
    #[inline]
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// True if the ring has no points.
    #[must_use]
    #[inline]
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }
}

/// A cross section of the tube: the contours of its inner and outer wall.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Section {
    /// Time step of the section; fractional if mending added the section.
    pub step: f64,
    /// Place along the tube, µm from the isthmus end.
    pub z_um: f64,
    /// True if mending added the section, false if the simulation recorded it.
    pub added: bool,
    /// Boundary of the lumen.
    pub inner: Ring,
    /// Boundary of the tissue.
    pub outer: Ring,
}

impl Section {
    /// Number of particles of both loops.
    #[must_use]
    #[inline]
    pub fn particles(&self) -> usize {
        self.inner.len() + self.outer.len()
    }

    /// Borders of the inner and the outer wall.
    #[must_use]
    #[inline]
    pub fn borders(&self) -> [Border; 2] {
        [&self.inner, &self.outer].map(|ring| Border::closed(vec![ring.points.clone()]))
    }
}
