//! Nesting of the closed lines of a cut.

use crate::geometry::polygon::{Containment, edges, locate_wide};
use crate::model::{Cut, CutRing, Plane, RingKind};

/// Nests closed lines that do not cross each other. The outermost lines bound tissue, or lumen if
/// `is_lumen` is true.
#[must_use]
pub fn nested_rings(plane: Plane, lines: Vec<Vec<[f64; 2]>>, is_lumen: bool) -> Cut {
    let mut unnested: Vec<UnnestedRing> = lines.into_iter().map(UnnestedRing::new).collect();
    unnested.sort_by(|a, b| b.area.total_cmp(&a.area));
    // Of the larger rings around a ring, the smallest is its parent.
    for i in 1..unnested.len() {
        let (before, rest) = unnested.split_at_mut(i);
        rest[0].parent = (0..i).rev().find(|&k| before[k].surrounds(&rest[0]));
    }
    let mut cut = Cut { plane, rings: Vec::with_capacity(unnested.len()) };
    let roots: Vec<usize> = (0..unnested.len()).filter(|&i| unnested[i].parent.is_none()).collect();
    for (rank, &root) in roots.iter().enumerate() {
        let kind = match (is_lumen, rank) {
            (false, _) => RingKind::Tissue,
            (true, 0) => RingKind::Lumen,
            (true, _) => RingKind::Pocket,
        };
        add(&mut cut.rings, &mut unnested, root, kind, None);
    }
    cut
}

fn add(rings: &mut Vec<CutRing>, unnested: &mut [UnnestedRing], at: usize, kind: RingKind, parent: Option<usize>) {
    let own = rings.len();
    let UnnestedRing { area, mut points, is_clockwise, .. } = std::mem::take(&mut unnested[at]);
    if is_clockwise == kind.is_tissue() {
        points.reverse();
    }
    rings.push(CutRing { kind, parent, area_um2: area, points });
    let children: Vec<usize> = (0..unnested.len()).filter(|&i| unnested[i].parent == Some(at)).collect();
    for (rank, &i) in children.iter().enumerate() {
        let kind = match kind {
            RingKind::Tissue if rank == 0 => RingKind::Lumen,
            RingKind::Tissue | RingKind::Island => RingKind::Pocket,
            RingKind::Lumen | RingKind::Pocket => RingKind::Island,
        };
        add(rings, unnested, i, kind, Some(own));
    }
}

#[derive(Default)]
struct UnnestedRing {
    points: Vec<[f64; 2]>,
    area: f64,
    is_clockwise: bool,
    low: [f64; 2],
    high: [f64; 2],
    parent: Option<usize>,
}

impl UnnestedRing {
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

    /// True if `other` lies inside this ring. The rings do not cross, but they may share points
    /// where the plane touches the surface, so the first point of `other` off this ring decides.
    fn surrounds(&self, other: &Self) -> bool {
        let exceeds = (0..2).any(|axis| other.low[axis] < self.low[axis] || other.high[axis] > self.high[axis]);
        let first_off_boundary =
            || other.points.iter().map(|&p| locate_wide(&self.points, p)).find(|at| *at != Containment::Boundary);
        !exceeds && first_off_boundary() == Some(Containment::Inside)
    }
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
        let cut = nested_rings(Plane::across(5.0), lines.clone(), false);
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
            assert_eq!(UnnestedRing::new(ring.points.clone()).is_clockwise, !ring.kind.is_tissue());
        }
        let lumen = nested_rings(Plane::across(5.0), lines, true);
        assert_eq!(kinds(&lumen)[..3], [(Lumen, None), (Island, Some(0)), (Pocket, Some(1))]);
        assert_eq!(lumen.of(Pocket).count(), 3);
        assert_eq!(nested_rings(Plane::across(0.0), Vec::new(), false).rings, []);
    }

    #[test]
    fn rings_that_share_a_point_are_nested_by_the_others() {
        let corner = vec![[10.0, 10.0], [8.0, 10.0], [8.0, 8.0]];
        let cut = nested_rings(Plane::across(0.0), vec![square(10.0, [0.0; 2]), corner], false);
        assert_eq!(cut.rings[1].parent, Some(0));
    }
}
