//! The certificate of tissue and lumen together. Each body has its own certificate; this one proves
//! that the two fit.

use super::collide;
use super::surface::{Coordinate, Surface};
use super::topology;
use super::types::{Certificate, Failure, FailureKind, Failures, METRE_UM};
use crate::model::{BodyKind, LengthUnit, Mesh, Patch, PatchKind};
use serde::Serialize;

/// Maximum relative difference of volumes that sum the same terms in a different order.
const VOLUME_ROUNDING: f64 = 1e-9;

/// Certificate of both bodies together.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct RegionsCertificate {
    /// True if there are no failures.
    pub passed: bool,
    /// Number of vertices of both bodies.
    pub vertices: u64,
    /// Number of triangles of both bodies. Triangles of the common wall count once.
    pub triangles: u64,
    /// Number of triangles of the common wall.
    pub shared_triangles: u64,
    /// Number of pairs of triangles, of one or both bodies, that intersect outside their shared
    /// vertices and edges.
    pub triangle_intersections: u64,
    /// Number of edges that belong to three triangles: one of a wall, one of a cap and one of a
    /// lid.
    pub rim_edges: u64,
    /// Volume enclosed by the outer wall, the caps and the lids.
    pub volume_mm3: f64,
    /// Relative difference between `volume_mm3` and the sum of the volumes of both bodies.
    pub volume_error: f64,
    /// The failures, at most one entry per kind.
    pub failures: Vec<Failure>,
}

impl RegionsCertificate {
    /// Returns the first failure in one line, with its place.
    #[must_use]
    pub fn first_failure(&self) -> Option<String> {
        self.failures.first().map(|failure| format!("tissue and lumen together: {failure}"))
    }
}

/// Certifies that tissue and lumen fit together, in the coordinates that are written in `unit`:
///
/// - Triangles of both bodies intersect only in shared vertices and edges.
/// - The inner wall of `regions` is the wall of `lumen`, vertex for vertex.
/// - The outside is one closed body whose volume is the sum of both volumes. `bodies` are the
///   volumes of tissue and lumen, mm³.
#[must_use]
pub fn certify_regions(regions: &Mesh, lumen: &Mesh, bodies: [f64; 2], unit: LengthUnit) -> RegionsCertificate {
    let positions = unit.of_metres(&regions.positions);
    let unit_um = unit.metres() * METRE_UM;
    let surface = Surface { positions: &positions, triangles: &regions.triangles, unit_um };
    let mut failures = Failures::default();
    if !shares_wall(regions, lumen) {
        let detail = "the lumen's wall is not the tissue's inner wall".to_owned();
        failures.add(FailureKind::Conformity, 1, detail, Vec::new());
    }
    together(&surface, &regions.patches, bodies, failures)
}

/// Certificates of a file with both bodies, which contains their common wall once.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BothCertificate {
    /// Certificate of the tissue alone.
    pub tissue: Certificate,
    /// Certificate of the lumen alone.
    pub lumen: Certificate,
    /// Certificate of both bodies together.
    pub regions: RegionsCertificate,
}

impl BothCertificate {
    /// True if there are no failures.
    #[must_use]
    pub fn passed(&self) -> bool {
        self.tissue.passed && self.lumen.passed && self.regions.passed
    }
}

/// Certifies a file that has the patches of both bodies. `unit_metres` has the meaning of
/// [`super::CheckOptions::unit_metres`].
#[must_use]
pub fn check_regions(
    positions: &[[f64; 3]],
    triangles: &[[u32; 3]],
    patches: &[Patch],
    unit_metres: f64,
) -> BothCertificate {
    let welded = super::weld(positions, triangles);
    let triangles = welded.as_deref().unwrap_or(triangles);
    let of = |kinds: &[PatchKind]| patches_of(triangles, patches, kinds);
    let judged = |triangles: &[[u32; 3]], body: BodyKind| {
        super::demanded(super::surface(positions, triangles, unit_metres * METRE_UM, Failures::default()), body)
    };
    let tissue = judged(&of(BodyKind::Tissue.patches()), BodyKind::Tissue);
    let wall = of(&[PatchKind::InnerWall]).into_iter().map(|[a, b, c]| [a, c, b]);
    let lumen: Vec<[u32; 3]> = wall.chain(of(&[PatchKind::Inlet, PatchKind::Outlet])).collect();
    let lumen = judged(&lumen, BodyKind::Lumen);
    let surface = Surface { positions, triangles, unit_um: unit_metres * METRE_UM };
    let regions = together(&surface, patches, [tissue.volume_mm3, lumen.volume_mm3], Failures::default());
    BothCertificate { tissue, lumen, regions }
}

/// Certifies both bodies in one surface.
fn together<C: Coordinate>(
    surface: &Surface<'_, C>,
    patches: &[Patch],
    bodies: [f64; 2],
    mut failures: Failures,
) -> RegionsCertificate {
    let of = |kinds: &[PatchKind]| patches_of(surface.triangles, patches, kinds);
    let outside: Vec<PatchKind> =
        BodyKind::Regions.patches().iter().copied().filter(|kind| *kind != PatchKind::InnerWall).collect();
    let outer = super::surface(surface.positions, &of(&outside), surface.unit_um, Failures::default());
    if let Some(detail) = outer.first_failure() {
        let detail = format!("the outside of both bodies: {detail}");
        failures.add(FailureKind::Conformity, 1, detail, Vec::new());
    }
    // Three triangles at an edge are a fault of a surface but not of two bodies.
    let complex = topology::examine_alone(surface, &mut Failures::default());
    let (open_edges, bad_edges) = (complex.faults.open_edges.count, complex.faults.bad_edges.count);
    let intersections = collide::examine(surface, &[], &complex, &mut failures);
    let lids = of(&[PatchKind::Inlet, PatchKind::Outlet]);
    let lids = Surface { triangles: &lids, ..*surface };
    let rim_edges = topology::examine_alone(&lids, &mut Failures::default()).faults.open_edges.count;
    let volume_error = ((bodies[0] + bodies[1]) / outer.volume_mm3 - 1.0).abs();
    let faults = [
        (open_edges > 0, format!("{open_edges} edges belong to one triangle only")),
        (
            bad_edges != rim_edges,
            format!("{bad_edges} edges belong to more than two triangles, {rim_edges} of the rims"),
        ),
        (outer.components != 1 || outer.euler != 2, "the outside is not one closed body".to_owned()),
        (
            volume_error.is_nan() || volume_error > VOLUME_ROUNDING,
            format!("the volumes of both bodies differ from that of the outside by {volume_error:e}"),
        ),
    ];
    for (_, detail) in faults.into_iter().filter(|(is_fault, _)| *is_fault) {
        failures.add(FailureKind::Conformity, 1, detail, Vec::new());
    }
    RegionsCertificate {
        passed: failures.0.is_empty(),
        vertices: complex.connectivity.bodies.iter().map(|body| body.vertices).sum(),
        triangles: surface.triangles.len() as u64,
        shared_triangles: of(&[PatchKind::InnerWall]).len() as u64,
        triangle_intersections: intersections.crossing.count,
        rim_edges,
        volume_mm3: outer.volume_mm3,
        volume_error,
        failures: failures.0,
    }
}

/// Triangles of the patches of these kinds, in order.
fn patches_of(triangles: &[[u32; 3]], patches: &[Patch], kinds: &[PatchKind]) -> Vec<[u32; 3]> {
    let wanted = patches.iter().filter(|patch| kinds.contains(&patch.kind));
    wanted.flat_map(|patch| &triangles[patch.triangles.clone()]).copied().collect()
}

/// True if the wall of the lumen has the triangles of the inner wall, reversed, at the same
/// coordinates.
fn shares_wall(regions: &Mesh, lumen: &Mesh) -> bool {
    let sorted = |mesh: &Mesh, kind, turned: bool| {
        let corners = mesh.patch(kind).iter().map(|t| {
            let [a, b, c] = t.map(|v| mesh.positions[v as usize].map(f32::to_bits));
            let [a, b, c] = if turned { [a, c, b] } else { [a, b, c] };
            // Rotates the corners so that the smallest comes first.
            [[a, b, c], [b, c, a], [c, a, b]].into_iter().min().unwrap_or([a, b, c])
        });
        let mut corners: Vec<[[u32; 3]; 3]> = corners.collect();
        corners.sort_unstable();
        corners
    };
    sorted(regions, PatchKind::InnerWall, false) == sorted(lumen, PatchKind::Wall, true)
}

#[cfg(test)]
mod tests {
    use super::super::certify_body;
    use super::*;
    use crate::model::sample;

    /// Both bodies of a round tube with fans as lids, and the lumen.
    fn pair(n: u32) -> (Mesh, Mesh) {
        let slabs = 3;
        let mut regions = Mesh { body: BodyKind::Regions, ..sample::tube(n, slabs, 0.0) };
        let mut lumen = Mesh { body: BodyKind::Lumen, triangles: Vec::new(), patches: Vec::new(), ..regions.clone() };
        let wall = regions.patch(PatchKind::InnerWall).iter().map(|&[a, b, c]| [a, c, b]);
        let mut parts = vec![(PatchKind::Wall, wall.collect::<Vec<_>>())];
        for (ring, kind) in [(0, PatchKind::Inlet), (slabs, PatchKind::Outlet)] {
            let first = ring * n;
            let lid: Vec<[u32; 3]> = (first + 1..first + n - 1)
                .map(|v| if ring == 0 { [first, v + 1, v] } else { [first, v, v + 1] })
                .collect();
            let start = regions.triangles.len();
            regions.triangles.extend(&lid);
            regions.patches.push(Patch { kind, triangles: start..regions.triangles.len() });
            parts.push((kind, lid));
        }
        for (kind, triangles) in parts {
            let start = lumen.triangles.len();
            lumen.triangles.extend(triangles);
            lumen.patches.push(Patch { kind, triangles: start..lumen.triangles.len() });
        }
        (regions, lumen)
    }

    fn judge(regions: &Mesh, lumen: &Mesh) -> RegionsCertificate {
        let tissue = regions.patches[3].triangles.end;
        let tissue =
            Mesh { body: BodyKind::Tissue, triangles: regions.triangles[..tissue].to_vec(), ..regions.clone() };
        let volumes = [&tissue, lumen].map(|body| certify_body(body, LengthUnit::Metre).volume_mm3);
        certify_regions(regions, lumen, volumes, LengthUnit::Metre)
    }

    #[test]
    fn bodies_that_fit_pass() {
        let (regions, lumen) = pair(24);
        let found = judge(&regions, &lumen);
        assert!(found.passed, "{found:?}");
        assert_eq!((found.rim_edges, found.shared_triangles), (48, 144));
        assert_eq!((found.vertices, found.triangles), (192, 384 + 44));
        let lumen = certify_body(&lumen, LengthUnit::Metre);
        assert!(lumen.passed, "{:?}", lumen.failures);
        // A prism over a regular polygon of radius 0.5 mm, 4 mm long.
        let area = 0.5 * 24.0 * 0.25 * (std::f64::consts::TAU / 24.0).sin();
        assert!((lumen.volume_mm3 / (4.0 * area) - 1.0).abs() < 5e-3, "{}", lumen.volume_mm3);
    }

    #[test]
    fn what_does_not_fit_fails() {
        let faults = |change: &dyn Fn(&mut Mesh, &mut Mesh)| {
            let (mut regions, mut lumen) = pair(24);
            change(&mut regions, &mut lumen);
            let found = judge(&regions, &lumen);
            assert!(!found.passed);
            found.failures.into_iter().map(|failure| failure.kind).collect::<Vec<_>>()
        };
        let conformity = |found: Vec<FailureKind>| assert!(found.contains(&FailureKind::Conformity), "{found:?}");
        conformity(faults(&|_, lumen| lumen.positions[5][0] = f32::from_bits(lumen.positions[5][0].to_bits() + 1)));
        conformity(faults(&|_, lumen| lumen.triangles.swap(0, 180)));
        conformity(faults(&|regions, _| {
            let last = regions.triangles.len() - 1;
            regions.triangles[last].swap(0, 1);
        }));
        conformity(faults(&|regions, _| {
            regions.triangles.pop();
            if let Some(outlet) = regions.patches.last_mut() {
                outlet.triangles.end -= 1;
            }
        }));
        let (regions, _) = pair(24);
        let positions: Vec<[f64; 3]> = regions.positions.iter().map(|p| p.map(f64::from)).collect();
        let both = check_regions(&positions, &regions.triangles, &regions.patches, 1.0);
        assert!(both.passed(), "{both:?}");
        let both = check_regions(&positions, &regions.triangles, &regions.patches[..5], 1.0);
        assert!(!both.passed() && both.tissue.passed && !both.lumen.passed);
        // A lid that bulges into the tube would be valid, but here its vertex lies beyond the outer
        // wall.
        let through = faults(&|regions, lumen| {
            for mesh in [regions, lumen] {
                mesh.positions[30] = [2e-3, 2e-3, 2e-3];
            }
        });
        assert!(through.contains(&FailureKind::TriangleIntersections), "{through:?}");
    }
}
