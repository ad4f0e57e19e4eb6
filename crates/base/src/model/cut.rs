//! A planar cut of a surface: closed rings, nested and told apart.

use super::Plane;
use serde::Serialize;

/// What a ring of a cut bounds.
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
    /// Any other hole in tissue: a part of the lumen that is not connected to the rest in this plane.
    Pocket,
}

impl RingKind {
    /// Whether it bounds tissue from outside.
    #[must_use]
    pub fn is_tissue(self) -> bool {
        matches!(self, Self::Tissue | Self::Island)
    }
}

/// A closed ring of a cut.
#[derive(Clone, Debug, PartialEq)]
pub struct CutRing {
    /// What it bounds.
    pub kind: RingKind,
    /// The ring that directly surrounds it, which comes before it.
    pub parent: Option<usize>,
    /// Area within it, with all that it surrounds.
    pub area_um2: f64,
    /// u and v of its points: counter-clockwise around tissue, clockwise around holes.
    pub points: Vec<[f64; 2]>,
}

impl CutRing {
    /// Its length.
    #[must_use]
    pub fn perimeter_um(&self) -> f64 {
        let ends = self.points.iter().cycle().skip(1);
        self.points.iter().zip(ends).map(|(a, b)| (b[0] - a[0]).hypot(b[1] - a[1])).sum()
    }
}

/// A cut. A ring comes after the one that surrounds it; of rings with the same one, the largest comes first.
#[derive(Clone, Debug, PartialEq)]
pub struct Cut {
    /// Where.
    pub plane: Plane,
    /// Its rings.
    pub rings: Vec<CutRing>,
}

impl Cut {
    /// The rings of a kind.
    pub fn of(&self, kind: RingKind) -> impl Iterator<Item = &CutRing> {
        self.rings.iter().filter(move |ring| ring.kind == kind)
    }

    /// The surface of the mucosa and the outside of the wall, if the cut is that of a tube: of tissue around one lumen.
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
        self.rings.iter().filter(|ring| enclosed(ring)).map(signed).sum()
    }

    /// Area of all tissue.
    #[must_use]
    pub fn tissue_um2(&self) -> f64 {
        self.rings.iter().map(|ring| if ring.kind.is_tissue() { ring.area_um2 } else { -ring.area_um2 }).sum()
    }
}

/// Where one of the walls meets a plane.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Border {
    /// Its lines; u and v of their points in micrometres.
    pub lines: Vec<Line>,
    /// Edges in the ends of the tube: with the lines, they enclose an area.
    pub closing: Vec<[[f32; 2]; 2]>,
}

/// A line.
#[derive(Clone, Debug, PartialEq)]
pub struct Line {
    /// Its points.
    pub points: Vec<[f32; 2]>,
    /// Whether the last point is connected to the first.
    pub is_closed: bool,
}

impl Border {
    /// A border of closed lines only.
    #[must_use]
    pub fn closed(lines: Vec<Vec<[f32; 2]>>) -> Self {
        let line = |points| Line { points, is_closed: true };
        Self { lines: lines.into_iter().map(line).collect(), closing: Vec::new() }
    }

    /// All points.
    pub fn points(&self) -> impl Iterator<Item = [f32; 2]> + '_ {
        self.lines.iter().flat_map(|line| line.points.iter().copied()).chain(self.closing.iter().flatten().copied())
    }
}
