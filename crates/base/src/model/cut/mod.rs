//! A planar cut of a surface: closed rings, nested and told apart.

mod body;
mod border;
mod plane;

pub use body::Body;
pub use border::{Border, Line};
pub use plane::Plane;

use crate::geometry::polygon::{Place, locate_wide};
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
        edges(&self.points).map(|(a, b)| (b[0] - a[0]).hypot(b[1] - a[1])).sum()
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
    /// Nests closed lines, of which no two cross. The outermost bound tissue; with `lumen`, they bound the lumen.
    #[must_use]
    pub fn new(plane: Plane, lines: Vec<Vec<[f64; 2]>>, lumen: bool) -> Self {
        let mut found: Vec<Found> = lines.into_iter().map(Found::new).collect();
        found.sort_by(|a, b| b.area.total_cmp(&a.area));
        // The smallest of the larger ones around it.
        for i in 1..found.len() {
            let (before, rest) = found.split_at_mut(i);
            rest[0].parent = (0..i).rev().find(|&k| before[k].surrounds(&rest[0]));
        }
        let mut cut = Self { plane, rings: Vec::with_capacity(found.len()) };
        let roots: Vec<usize> = (0..found.len()).filter(|&i| found[i].parent.is_none()).collect();
        for (rank, &root) in roots.iter().enumerate() {
            let kind = match (lumen, rank) {
                (false, _) => RingKind::Tissue,
                (true, 0) => RingKind::Lumen,
                (true, _) => RingKind::Pocket,
            };
            cut.add(&mut found, root, kind, None);
        }
        cut
    }

    fn add(&mut self, found: &mut [Found], at: usize, kind: RingKind, parent: Option<usize>) {
        let own = self.rings.len();
        let Found { area, mut points, is_clockwise, .. } = std::mem::take(&mut found[at]);
        if is_clockwise == kind.is_tissue() {
            points.reverse();
        }
        self.rings.push(CutRing { kind, parent, area_um2: area, points });
        let within: Vec<usize> = (0..found.len()).filter(|&i| found[i].parent == Some(at)).collect();
        for (rank, &i) in within.iter().enumerate() {
            let kind = match kind {
                RingKind::Tissue if rank == 0 => RingKind::Lumen,
                RingKind::Tissue | RingKind::Island => RingKind::Pocket,
                RingKind::Lumen | RingKind::Pocket => RingKind::Island,
            };
            self.add(found, i, kind, Some(own));
        }
    }

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

/// A ring that is not nested yet.
#[derive(Default)]
struct Found {
    points: Vec<[f64; 2]>,
    area: f64,
    is_clockwise: bool,
    low: [f64; 2],
    high: [f64; 2],
    parent: Option<usize>,
}

impl Found {
    fn new(points: Vec<[f64; 2]>) -> Self {
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for p in &points {
            for axis in 0..2 {
                low[axis] = low[axis].min(p[axis]);
                high[axis] = high[axis].max(p[axis]);
            }
        }
        let o = points.first().copied().unwrap_or_default();
        let twice: f64 =
            edges(&points).map(|(a, b)| (a[0] - o[0]) * (b[1] - o[1]) - (a[1] - o[1]) * (b[0] - o[0])).sum();
        Self { points, area: twice.abs() / 2.0, is_clockwise: twice < 0.0, low, high, parent: None }
    }

    /// Whether `other`, which does not cross this, lies within it. Where the plane touches the surface, rings may share points.
    fn surrounds(&self, other: &Self) -> bool {
        let apart = (0..2).any(|axis| other.low[axis] < self.low[axis] || other.high[axis] > self.high[axis]);
        let place = || other.points.iter().map(|&p| locate_wide(&self.points, p)).find(|at| *at != Place::Boundary);
        !apart && place() == Some(Place::Inside)
    }
}

fn edges(points: &[[f64; 2]]) -> impl Iterator<Item = ([f64; 2], [f64; 2])> {
    points.iter().zip(points.iter().cycle().skip(1)).map(|(&a, &b)| (a, b))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square(half: f64, [x, y]: [f64; 2]) -> Vec<[f64; 2]> {
        [[1.0, -1.0], [1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0]].map(|[u, v]| [x + half * u, y + half * v]).to_vec()
    }

    fn kinds(cut: &Cut) -> Vec<(RingKind, Option<usize>)> {
        cut.rings.iter().map(|ring| (ring.kind, ring.parent)).collect()
    }

    #[test]
    fn rings_are_nested_and_told_apart() {
        use RingKind::{Island, Lumen, Pocket, Tissue};
        let mut clockwise = square(10.0, [0.0; 2]);
        clockwise.reverse();
        let lines = vec![
            square(1.0, [2.0, 0.0]),
            square(0.5, [2.0, 0.0]),
            clockwise,
            square(0.2, [-9.0, 0.0]),
            square(6.0, [0.0; 2]),
            square(2.0, [30.0, 0.0]),
            square(1.0, [-2.0, 0.0]),
        ];
        let cut = Cut::new(Plane::across(5.0), lines.clone(), false);
        assert_eq!(
            kinds(&cut),
            [
                (Tissue, None),
                (Lumen, Some(0)),
                (Island, Some(1)),
                (Pocket, Some(2)),
                (Island, Some(1)),
                (Pocket, Some(0)),
                (Tissue, None)
            ]
        );
        assert_eq!(cut.rings[0].area_um2, 400.0);
        assert_eq!(cut.rings[0].perimeter_um(), 80.0);
        assert!((cut.tissue_um2() - (400.0 - 144.0 + 4.0 - 1.0 + 4.0 - 0.16 + 16.0)).abs() < 1e-9);
        assert!((cut.lumen_um2() - (144.0 - 4.0 + 1.0 - 4.0 + 0.16)).abs() < 1e-9);
        for ring in &cut.rings {
            assert_eq!(Found::new(ring.points.clone()).is_clockwise, !ring.kind.is_tissue());
        }
        let lumen = Cut::new(Plane::across(5.0), lines, true);
        assert_eq!(kinds(&lumen)[..3], [(Lumen, None), (Island, Some(0)), (Pocket, Some(1))]);
        assert_eq!(lumen.of(Pocket).count(), 3);
        assert_eq!(Cut::new(Plane::across(0.0), Vec::new(), false).rings, []);
    }

    #[test]
    fn rings_that_share_a_point_are_nested_by_the_others() {
        let corner = vec![[10.0, 10.0], [8.0, 10.0], [8.0, 8.0]];
        let cut = Cut::new(Plane::across(0.0), vec![square(10.0, [0.0; 2]), corner], false);
        assert_eq!(cut.rings[1].parent, Some(0));
    }
}
