//! Cross sections of the tube: what a simulation records and a loft connects (paper, section 3.1).

/// A closed contour: points in order, counter-clockwise, with the stable id of each.
///
/// `ids.len() == points.len()`. Ids say which vertex of one section continues which of another;
/// they are unique within a ring but in no order. New ids appear only between two old neighbours.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Ring {
    /// Stable ids, one a point.
    pub ids: Vec<u32>,
    /// Positions in micrometres.
    pub points: Vec<[f32; 2]>,
}

impl Ring {
    /// Number of points.
    #[must_use]
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Whether the ring has no points.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }
}

/// A cross section: the mucosa (`inner`) around the lumen, and the wall (`outer`) around it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Section {
    /// Time step at which it was taken; fractional where it was added to mend a slab.
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
    pub fn particles(&self) -> usize {
        self.inner.len() + self.outer.len()
    }
}
