//! The certificate of a model: made for every model, from exactly the surface that is exported.
//!
//! Every decision (does it cross, is it closed, is it degenerate) is exact; measures (areas, distances, angles) are
//! floating-point. The paper names self-intersection as the main defect of such models (section 3); a model that fails
//! here is not delivered as good. Results depend neither on the number of threads nor on timing.

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
use collide::Meetings;
use components::Body;
use rayon::prelude::*;
use sections::Contours;
use shape::{Shape, Turns};
use surface::{Coordinate, Surface};
use topology::{Connectivity, Stars, Topology};
use types::{BODIES, Failures, METRE_UM};

/// Proves that a generated model is sound, or lists its faults: those of the sections it was made from, and of its surface,
/// which must be one component with the Euler number of its body.
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

/// Proves that the surface of one body is sound as it is written in `unit`, or lists its faults.
#[must_use]
pub fn certify_body(mesh: &Mesh, unit: LengthUnit) -> Certificate {
    body(mesh, unit, Failures::default())
}

fn body(mesh: &Mesh, unit: LengthUnit, failures: Failures) -> Certificate {
    let positions = unit.of_metres(&mesh.positions);
    demanded(surface(&positions, &mesh.triangles, unit.metres() * METRE_UM, failures), mesh.body)
}

/// Adds the failures of a surface that is not one component with the Euler number of its body.
fn demanded(mut certificate: Certificate, body: BodyKind) -> Certificate {
    let mut failures = Failures(std::mem::take(&mut certificate.failures));
    if certificate.components > 1 {
        let detail = format!("the body consists of {} parts instead of one", certificate.components);
        failures.add(FailureKind::Components, certificate.components, detail, Vec::new());
    }
    demand_euler(&certificate, body.euler(), &mut failures);
    certificate.conclude(failures)
}

impl Certificate {
    /// Sums area and volume again, in batches of slabs: the order in which engine 0.3.0 added them when it
    /// certified straight surfaces while they grew, so that the last digits of reports stay the same.
    pub fn sum_in_batches(&mut self, mesh: &Mesh, unit: LengthUnit, sections: &[Section]) {
        if let [body] = &mut self.bodies[..] {
            let (positions, unit_mm) = (unit.of_metres(&mesh.positions), unit.metres() * METRE_UM / 1e3);
            let [area, volume] = batches::sums(&positions, mesh, sections);
            self.area_mm2 = area * unit_mm.powi(2);
            self.volume_mm3 = volume * unit_mm.powi(3);
            body.volume_mm3 = self.volume_mm3;
        }
    }
}

/// The certificate of any surface, given as lists of positions (metres) and triangles. Vertices at exactly the
/// same position count as one. The surface may have several components.
#[must_use]
pub fn certify_soup(positions: &[[f64; 3]], triangles: &[[u32; 3]]) -> Certificate {
    check_surface(positions, triangles, &CheckOptions::default())
}

/// The certificate of a file by `oviduct check`: as [`certify_soup`], with the additional requirements of the options.
#[must_use]
pub fn check_surface(positions: &[[f64; 3]], triangles: &[[u32; 3]], options: &CheckOptions) -> Certificate {
    let unit_um = options.unit_metres * METRE_UM;
    let welded = weld(positions, triangles);
    let mut certificate = surface(positions, welded.as_deref().unwrap_or(triangles), unit_um, Failures::default());
    let mut failures = Failures(std::mem::take(&mut certificate.failures));
    if let Some(euler) = options.euler {
        demand_euler(&certificate, euler, &mut failures);
    }
    certificate.conclude(failures)
}

fn demand_euler(certificate: &Certificate, euler: i64, failures: &mut Failures) {
    let wrong: Vec<_> = certificate.bodies.iter().filter(|body| body.euler != euler).collect();
    if let Some(body) = wrong.first() {
        let detail = format!("a component has the Euler number {} instead of {euler}", body.euler);
        failures.add(FailureKind::Euler, wrong.len() as u64, detail, Vec::new());
    }
}

/// The triangles with each vertex replaced by the least one at exactly the same position; none if no vertex is replaced or
/// an index is out of range.
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
    if let Err(failure) = admissible(positions, triangles) {
        failures.0.push(failure);
        return Certificate::default().conclude(failures);
    }
    let surface = Surface { positions, triangles, unit_um };
    let stars = Stars::of(&surface);
    let connectivity = Connectivity::of(&surface, &stars);
    let mut turns = vec![Turns::ANY; surface.triangles.len()];
    let shape = Shape::of(&surface, surface.corners(0)[0], |t| connectivity.body_of(t), &mut turns);
    let topology = topology::examine(&surface, stars, connectivity, &turns, &mut failures);
    shape.report(&surface, &mut failures);
    let meetings = collide::examine(&surface, &shape.degenerate, &topology, &mut failures);
    nesting::examine(&surface, &topology, &shape.volumes, meetings.count() == 0, &mut failures);
    of_findings(unit_um, &topology, shape, &meetings).conclude(failures)
}

/// The certificate of these findings, as yet without failures.
fn of_findings(unit_um: f64, topology: &Topology, shape: Shape, meetings: &Meetings) -> Certificate {
    let (bodies, faults) = (&topology.connectivity.bodies, &topology.faults);
    let unit_mm = unit_um / 1e3;
    let each = bodies.iter().zip(&shape.volumes);
    let volume = shape.volumes.iter().fold(0.0, |sum, volume| sum + volume);
    Certificate {
        passed: false,
        closed: faults.open_edges.count == 0,
        manifold: faults.open_edges.count == 0 && faults.bad_edges.count == 0 && faults.bad_vertices.count == 0,
        oriented: faults.disoriented_edges.count == 0,
        euler: bodies.iter().map(Body::euler).sum(),
        components: bodies.len() as u64,
        bodies: each.take(BODIES).map(|(body, volume)| body.report(volume * unit_mm.powi(3))).collect(),
        vertices: bodies.iter().map(|body| body.vertices).sum(),
        triangles: bodies.iter().map(|body| body.triangles).sum(),
        open_edges: faults.open_edges.count,
        non_manifold_edges: faults.bad_edges.count,
        non_manifold_vertices: faults.bad_vertices.count,
        disoriented_edges: faults.disoriented_edges.count,
        degenerate_triangles: shape.degenerate.len() as u64,
        duplicate_triangles: meetings.duplicates(),
        section_crossings: 0,
        triangle_intersections: meetings.count(),
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

/// Refuses surfaces to which the other tests cannot be applied.
fn admissible<C: Coordinate>(positions: &[[C; 3]], triangles: &[[u32; 3]]) -> Result<(), Failure> {
    if triangles.is_empty() {
        let detail = "there are no triangles".to_owned();
        return Err(Failure { kind: FailureKind::Empty, count: 1, detail, places: Vec::new() });
    }
    let outside = |t: &&[u32; 3]| t.iter().any(|&v| v as usize >= positions.len());
    let count = triangles.iter().filter(outside).count();
    if count > 0 {
        let detail = format!("{count} triangles name vertices beyond the {} there are", positions.len());
        return Err(Failure { kind: FailureKind::Indices, count: count as u64, detail, places: Vec::new() });
    }
    match surface::beyond_range(positions) {
        (0, _) => Ok(()),
        (count, first) => {
            let detail =
                format!("{count} vertices (first: {first}) have coordinates that are not finite or beyond 1e±60");
            Err(Failure { kind: FailureKind::Coordinates, count, detail, places: Vec::new() })
        }
    }
}

#[cfg(test)]
mod samples;
#[cfg(test)]
mod tests;
