//! The certificate: exact tests of exactly the surface that is exported, computed for every model.
//!
//! Every decision (does it intersect, is it closed, is it degenerate) is exact. Measures (areas,
//! distances, angles) are floating-point. The paper names self-intersection as the main defect of
//! such models (section 3). A model that fails its certificate is not delivered; the job fails with
//! the problem `certificate`. Results depend neither on the number of threads nor on timing.

mod batches;
mod collide;
mod components;
mod nesting;
mod regions;
mod sections;
mod shape;
mod surface;
mod topology;
mod types;

pub use regions::{BothCertificate, RegionsCertificate, certify_regions, check_regions};
pub use types::{Certificate, CheckOptions, Component, Failure, FailureKind, Place, TriangleQuality};

use crate::model::{BodyKind, LengthUnit, Mesh, Section};
use collide::Intersections;
use components::ComponentCounts;
use rayon::prelude::*;
use sections::Contours;
use shape::{TriangleMeasures, Turns};
use surface::{Coordinate, Surface};
use topology::{Connectivity, Stars, Topology};
use types::{BODIES, Failures, METRE_UM};

/// Certifies a generated model: its sections and its surface, which must be one component with the
/// Euler number of its body.
#[must_use]
#[inline(never)] // counted by scripts/counts
pub fn certify(mesh: &Mesh, sections: &[Section]) -> Certificate {
    let mut failures = Failures::default();
    let contours = Contours::of(sections);
    contours.report(&mut failures);
    let mut certificate = body(mesh, LengthUnit::Metre, failures);
    certificate.section_crossings = contours.crossings();
    certificate.min_gap_um = contours.gaps_um.iter().copied().flatten().reduce(f64::min);
    certificate.section_gaps_um = contours.gaps_um;
    certificate
}

/// Certifies the surface of one body in the coordinates that are written in `unit`.
#[must_use]
pub fn certify_body(mesh: &Mesh, unit: LengthUnit) -> Certificate {
    body(mesh, unit, Failures::default())
}

fn body(mesh: &Mesh, unit: LengthUnit, failures: Failures) -> Certificate {
    let positions = unit.of_metres(&mesh.positions);
    demanded(surface(&positions, &mesh.triangles, unit.metres() * METRE_UM, failures), mesh.body)
}

/// Adds failures unless the surface is one component with the Euler number of its body.
fn demanded(mut certificate: Certificate, body: BodyKind) -> Certificate {
    if certificate.components > 1 {
        let detail = format!("the body consists of {} parts instead of one", certificate.components);
        certificate.add_failure(FailureKind::Components, certificate.components, detail);
    }
    certificate.demand_euler(body.euler());
    certificate
}

impl Certificate {
    /// Computes area and volume again, in batches of slabs. Engine 0.3.0 added them in this order
    /// when it certified straight surfaces while they grew. The last digits of reports therefore
    /// stay the same.
    pub fn sum_in_batches(&mut self, mesh: &Mesh, unit: LengthUnit, sections: &[Section]) {
        if let [body] = &mut self.bodies[..] {
            let (positions, unit_mm) = (unit.of_metres(&mesh.positions), unit.metres() * METRE_UM / 1e3);
            let [area, volume] = batches::sums(&positions, mesh, sections);
            self.area_mm2 = area * unit_mm.powi(2);
            self.volume_mm3 = volume * unit_mm.powi(3);
            body.volume_mm3 = self.volume_mm3;
        }
    }

    fn demand_euler(&mut self, euler: i64) {
        let wrong: Vec<_> = self.bodies.iter().filter(|body| body.euler != euler).collect();
        if let Some(body) = wrong.first() {
            let detail = format!("a component has the Euler number {} instead of {euler}", body.euler);
            self.add_failure(FailureKind::Euler, wrong.len() as u64, detail);
        }
    }

    fn add_failure(&mut self, kind: FailureKind, count: u64, detail: String) {
        self.failures.push(Failure { kind, count, detail, places: Vec::new() });
        self.passed = false;
    }
}

/// Certifies any surface, given as lists of positions and triangles. Vertices at exactly the same
/// position count as one vertex. The surface may have several components.
#[must_use]
pub fn check_surface(positions: &[[f64; 3]], triangles: &[[u32; 3]], options: &CheckOptions) -> Certificate {
    let unit_um = options.unit_metres * METRE_UM;
    let welded = weld(positions, triangles);
    let mut certificate = surface(positions, welded.as_deref().unwrap_or(triangles), unit_um, Failures::default());
    if let Some(euler) = options.euler {
        certificate.demand_euler(euler);
    }
    certificate
}

/// Replaces each vertex by the smallest vertex at exactly the same position. `None` if no vertex is
/// replaced or an index is out of range.
fn weld(positions: &[[f64; 3]], triangles: &[[u32; 3]]) -> Option<Vec<[u32; 3]>> {
    // Adding zero turns −0 into 0.
    let key = |v: u32| positions[v as usize].map(|x| (x + 0.0).to_bits());
    let mut order: Vec<u32> = (0..u32::try_from(positions.len()).ok()?).collect();
    order.par_sort_unstable_by_key(|&v| (key(v), v));
    let mut first: Vec<u32> = (0..order.len() as u32).collect();
    let mut welded = false;
    for same in order.chunk_by(|&a, &b| key(a) == key(b)) {
        for &v in &same[1..] {
            first[v as usize] = same[0];
            welded = true;
        }
    }
    if !welded || triangles.iter().flatten().any(|&v| v as usize >= first.len()) {
        return None;
    }
    Some(triangles.iter().map(|t| t.map(|v| first[v as usize])).collect())
}

fn surface<C: Coordinate>(
    positions: &[[C; 3]],
    triangles: &[[u32; 3]],
    unit_um: f64,
    mut failures: Failures,
) -> Certificate {
    if !is_admissible(positions, triangles, &mut failures) {
        return Certificate::default().conclude(failures);
    }
    let surface = Surface { positions, triangles, unit_um };
    let stars = Stars::of(&surface);
    let connectivity = Connectivity::of(&surface, &stars);
    let mut turns = vec![Turns::ANY; surface.triangles.len()];
    let shape = TriangleMeasures::of(&surface, surface.corners(0)[0], |t| connectivity.body_of(t), &mut turns);
    let topology = topology::examine(&surface, stars, connectivity, &turns, &mut failures);
    shape.report(&surface, &mut failures);
    let intersections = collide::examine(&surface, &shape.degenerate, &topology, &mut failures);
    nesting::examine(&surface, &topology, &shape.volumes, intersections.crossing.count == 0, &mut failures);
    of_findings(unit_um, &topology, shape, &intersections).conclude(failures)
}

/// Certificate of these findings, without failures yet.
fn of_findings(
    unit_um: f64,
    topology: &Topology,
    shape: TriangleMeasures,
    intersections: &Intersections,
) -> Certificate {
    let (bodies, faults) = (&topology.connectivity.bodies, &topology.faults);
    let unit_mm = unit_um / 1e3;
    let each = bodies.iter().zip(&shape.volumes);
    let volume = shape.volumes.iter().fold(0.0, |sum, volume| sum + volume);
    Certificate {
        passed: false,
        closed: faults.open_edges.count == 0,
        manifold: faults.open_edges.count == 0 && faults.bad_edges.count == 0 && faults.bad_vertices.count == 0,
        oriented: faults.disoriented_edges.count == 0,
        euler: bodies.iter().map(ComponentCounts::euler).sum(),
        components: bodies.len() as u64,
        bodies: each.take(BODIES).map(|(body, volume)| body.report(volume * unit_mm.powi(3))).collect(),
        vertices: bodies.iter().map(|body| body.vertices).sum(),
        triangles: bodies.iter().map(|body| body.triangles).sum(),
        open_edges: faults.open_edges.count,
        non_manifold_edges: faults.bad_edges.count,
        non_manifold_vertices: faults.bad_vertices.count,
        disoriented_edges: faults.disoriented_edges.count,
        degenerate_triangles: shape.degenerate.len() as u64,
        duplicate_triangles: intersections.duplicates.count,
        section_crossings: 0,
        triangle_intersections: intersections.crossing.count,
        min_gap_um: None,
        section_gaps_um: Vec::new(),
        min_edge_um: shape.min_edge * unit_um,
        min_angle_deg: shape.min_angle_deg,
        quality: shape.quality.shared(),
        volume_mm3: volume * unit_mm.powi(3),
        area_mm2: shape.area * unit_mm.powi(2),
        bounds_um: shape.bounds.map(|corner| corner.map(|x| x * unit_um)),
        failures: Vec::new(),
    }
}

/// True if the other tests can be applied to a surface; otherwise adds a failure.
fn is_admissible<C: Coordinate>(positions: &[[C; 3]], triangles: &[[u32; 3]], failures: &mut Failures) -> bool {
    let (kind, count, detail) = if triangles.is_empty() {
        (FailureKind::Empty, 1, "there are no triangles".to_owned())
    } else {
        let is_outside = |t: &&[u32; 3]| t.iter().any(|&v| v as usize >= positions.len());
        match (triangles.iter().filter(is_outside).count() as u64, surface::beyond_range(positions)) {
            (0, (count, first)) => {
                let what = "have coordinates that are not finite or beyond 1e±60";
                (FailureKind::Coordinates, count, format!("{count} vertices (first: {first}) {what}"))
            }
            (count, _) => {
                let detail = format!("{count} triangles name vertices beyond the {} there are", positions.len());
                (FailureKind::Indices, count, detail)
            }
        }
    };
    failures.add(kind, count, detail, Vec::new());
    count == 0
}

#[cfg(test)]
mod samples;
#[cfg(test)]
mod tests;
