//! Bodies turned inside out: a component of negative volume is a cavity where it lies within another body, else a fault.
//! Only surfaces that are closed and oriented enclose anything.

use super::topology::Topology;
use super::types::{FailureKind, Failures};
use super::{Coordinate, Surface, few};

pub(super) fn examine<C: Coordinate>(
    surface: &Surface<'_, C>,
    topology: &Topology,
    volumes: &[f64],
    failures: &mut Failures,
) {
    if topology.open_edges + topology.bad_edges + topology.disoriented_edges > 0 {
        return;
    }
    let inverted = volumes.iter().enumerate().filter(|(_, volume)| **volume <= 0.0).map(|(body, _)| body);
    let solid = volumes.iter().any(|volume| *volume > 0.0);
    let wrong: Vec<usize> = inverted.filter(|&body| !solid || !is_cavity(surface, topology, body)).collect();
    let places = few(&wrong, |&body| surface.place_of_vertex(topology.bodies[body].vertex));
    let count = wrong.len() as u64;
    failures.add(FailureKind::Volume, count, format!("{count} components enclose no volume or are inside out"), places);
}

/// Whether a component lies within the others: the winding number of these around one of its vertices, from the solid
/// angles of their triangles (van Oosterom and Strackee, 1983).
fn is_cavity<C: Coordinate>(surface: &Surface<'_, C>, topology: &Topology, body: usize) -> bool {
    let eye = surface.point(topology.bodies[body].vertex);
    let mut angle = 0.0;
    for t in surface.triangles.iter().filter(|t| topology.body_of(**t) != body) {
        let [a, b, c] = t.map(|v| {
            let p = surface.point(v);
            [p[0] - eye[0], p[1] - eye[1], p[2] - eye[2]]
        });
        let dot = |p: [f64; 3], q: [f64; 3]| p[0] * q[0] + p[1] * q[1] + p[2] * q[2];
        let volume = a[0] * (b[1] * c[2] - b[2] * c[1])
            + a[1] * (b[2] * c[0] - b[0] * c[2])
            + a[2] * (b[0] * c[1] - b[1] * c[0]);
        let (la, lb, lc) = (dot(a, a).sqrt(), dot(b, b).sqrt(), dot(c, c).sqrt());
        angle += 2.0 * f64::atan2(volume, la * lb * lc + dot(a, b) * lc + dot(b, c) * la + dot(c, a) * lb);
    }
    angle > 2.0 * std::f64::consts::PI
}
