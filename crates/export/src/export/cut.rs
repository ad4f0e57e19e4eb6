//! JSON document of a cut.

use crate::model::{Cut, CutRing, Plane, RingKind};
use serde::Serialize;

/// A planar cut of a surface. Lengths are in micrometres.
#[derive(Clone, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct CutDocument {
    /// Unit of lengths: `um`.
    pub units: &'static str,
    /// Plane of the cut.
    pub plane: Plane,
    /// Area of the tissue, including islands.
    pub tissue_area_um2: f64,
    /// Area of the lumen and of pockets, without islands.
    pub lumen_area_um2: f64,
    /// Number of islands.
    #[cfg_attr(feature = "schema", schema(minimum = 0))]
    pub islands: usize,
    /// Number of pockets.
    #[cfg_attr(feature = "schema", schema(minimum = 0))]
    pub pockets: usize,
    /// Closed rings that do not cross. A ring follows the ring that surrounds it. Rings inside the
    /// same ring are sorted by area, largest first.
    pub rings: Vec<RingDocument>,
}

/// A ring of a cut.
#[derive(Clone, Debug, Serialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[cfg_attr(feature = "schema", schema(as = CutRingAnswer))]
pub struct RingDocument {
    /// Area that the ring bounds.
    pub kind: RingKind,
    /// Index of the ring that directly surrounds this one; null if there is none.
    #[cfg_attr(feature = "schema", schema(required = true, minimum = 0))]
    pub parent: Option<usize>,
    /// Area inside the ring, including all rings that it surrounds.
    pub area_um2: f64,
    /// Length of the ring.
    pub perimeter_um: f64,
    /// Coordinates u and v of the points, micrometres: counter-clockwise around tissue and islands,
    /// clockwise around lumen and pockets.
    pub points: Vec<[f64; 2]>,
}

impl From<CutRing> for RingDocument {
    fn from(ring: CutRing) -> Self {
        let perimeter_um = ring.perimeter_um();
        let CutRing { kind, parent, area_um2, points } = ring;
        Self { kind, parent, area_um2, perimeter_um, points }
    }
}

impl From<Cut> for CutDocument {
    fn from(cut: Cut) -> Self {
        Self {
            units: "um",
            plane: cut.plane,
            tissue_area_um2: cut.tissue_um2(),
            lumen_area_um2: cut.lumen_um2(),
            islands: cut.of(RingKind::Island).count(),
            pockets: cut.of(RingKind::Pocket).count(),
            rings: cut.rings.into_iter().map(Into::into).collect(),
        }
    }
}
