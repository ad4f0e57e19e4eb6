//! Integrates a curve from its curvature in rotation-minimising frames.

use glam::{DQuat, DVec2, DVec3};

/// Start of a curve: a point, the direction, and the first vector of the frame.
#[derive(Clone, Copy, Debug)]
pub(super) struct Heading {
    pub(super) at: DVec3,
    pub(super) tangent: DVec3,
    pub(super) u: DVec3,
}

/// Points of the curve with these curvatures at equal arc lengths. Each step is an arc of a circle.
pub(super) fn integrate(from: Heading, bends: impl IntoIterator<Item = DVec2>, step: f64) -> Vec<DVec3> {
    let Heading { mut at, mut tangent, mut u } = from;
    let mut points = vec![at];
    for bend in bends {
        let v = tangent.cross(u);
        let angle = bend.length() * step;
        if angle > 0.0 {
            let axis = tangent.cross(u * bend.x + v * bend.y).normalize();
            // Chord of the arc.
            at += DQuat::from_axis_angle(axis, 0.5 * angle) * tangent * (step * libm::sin(0.5 * angle) / (0.5 * angle));
            let turn = DQuat::from_axis_angle(axis, angle);
            (tangent, u) = ((turn * tangent).normalize(), turn * u);
            u = (u - tangent * u.dot(tangent)).normalize();
        } else {
            at += tangent * step;
        }
        points.push(at);
    }
    points
}
