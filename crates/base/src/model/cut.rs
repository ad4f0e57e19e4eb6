//! A planar cut through a surface, and the border of one wall in a plane, as plain data.
//! `geometry::cut` computes them.

use super::Plane;
use serde::Serialize;

/// Area that a ring of a cut bounds: `tissue` that nothing surrounds, the `lumen` (the largest hole
/// in it), an `island` of tissue that lumen surrounds, or a `pocket` (any other hole in tissue).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "lowercase")]
pub enum RingKind {
    /// Tissue that nothing in the plane surrounds.
    Tissue,
    /// The largest hole in it.
    Lumen,
    /// Tissue that is surrounded by lumen: in this plane it is not connected to the wall.
    Island,
    /// Any other hole in tissue: a part of the lumen that is not connected to the rest in this
    /// plane.
    Pocket,
}

impl RingKind {
    /// True if the ring is the outer boundary of tissue.
    #[must_use]
    pub fn is_tissue(self) -> bool {
        matches!(self, Self::Tissue | Self::Island)
    }
}

/// A closed polygon of a cut.
#[derive(Clone, Debug, PartialEq)]
pub struct CutRing {
    /// Kind of the area that the ring bounds.
    pub kind: RingKind,
    /// Index of the ring that directly surrounds this one; always lower than the ring's own index.
    pub parent: Option<usize>,
    /// Area inside the ring, including all rings that it surrounds.
    pub area_um2: f64,
    /// Coordinates u and v of the points: counter-clockwise around tissue, clockwise around lumen.
    pub points: Vec<[f64; 2]>,
}

impl CutRing {
    /// Length of the ring.
    #[must_use]
    pub fn perimeter_um(&self) -> f64 {
        let ends = self.points.iter().cycle().skip(1);
        self.points.iter().zip(ends).map(|(a, b)| (b[0] - a[0]).hypot(b[1] - a[1])).sum()
    }
}

/// Rings in which a plane cuts a body.
///
/// A ring follows the ring that surrounds it. Rings with the same parent are sorted by area,
/// largest first.
#[derive(Clone, Debug, PartialEq)]
pub struct Cut {
    /// The cutting plane.
    pub plane: Plane,
    /// Rings of the cut.
    pub rings: Vec<CutRing>,
}

impl Cut {
    /// Rings of one kind.
    pub fn of(&self, kind: RingKind) -> impl Iterator<Item = &CutRing> {
        self.rings.iter().filter(move |ring| ring.kind == kind)
    }

    /// Borders of the inner and the outer wall. `None` unless the cut is one piece of tissue with
    /// at least one hole.
    #[must_use]
    pub fn borders(&self) -> Option<[Border; 2]> {
        let [outside, mucosa @ ..] = &self.rings[..] else { return None };
        let line = |ring: &CutRing| ring.points.iter().map(|p| p.map(|x| x as f32)).collect();
        let is_tube = outside.kind == RingKind::Tissue && mucosa.iter().all(|ring| ring.parent.is_some());
        (is_tube && !mucosa.is_empty())
            .then(|| [Border::closed(mucosa.iter().map(line).collect()), Border::closed(vec![line(outside)])])
    }

    /// Area of lumen and pockets, without islands.
    #[must_use]
    pub fn lumen_um2(&self) -> f64 {
        let enclosed = |ring: &CutRing| ring.parent.is_some() || !ring.kind.is_tissue();
        let signed = |ring: &CutRing| if ring.kind.is_tissue() { -ring.area_um2 } else { ring.area_um2 };
        // The sum of no numbers is −0; adding 0 makes it 0.
        self.rings.iter().filter(|ring| enclosed(ring)).map(signed).sum::<f64>() + 0.0
    }

    /// Area of all tissue, islands included.
    #[must_use]
    pub fn tissue_um2(&self) -> f64 {
        self.rings.iter().map(|ring| if ring.kind.is_tissue() { ring.area_um2 } else { -ring.area_um2 }).sum()
    }
}

/// Intersection of one wall with a plane.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Border {
    /// Polylines of the border, µm.
    pub lines: Vec<Line>,
    /// Edges in the planes of the caps. Together with the lines they enclose an area.
    pub closing: Vec<[[f32; 2]; 2]>,
}

/// A polyline in the coordinates u and v of a plane.
#[derive(Clone, Debug, PartialEq)]
pub struct Line {
    /// Points in order.
    pub points: Vec<[f32; 2]>,
    /// True if the last point is connected to the first.
    pub is_closed: bool,
}

impl Border {
    /// Creates a border of closed lines.
    #[must_use]
    pub fn closed(lines: Vec<Vec<[f32; 2]>>) -> Self {
        let line = |points| Line { points, is_closed: true };
        Self { lines: lines.into_iter().map(line).collect(), closing: Vec::new() }
    }

    /// Points of all lines and closing edges.
    pub fn points(&self) -> impl Iterator<Item = [f32; 2]> + '_ {
        self.lines.iter().flat_map(|line| line.points.iter().copied()).chain(self.closing.iter().flatten().copied())
    }
}
