//! Vectors in the plane.

pub(super) type Point = [f64; 2];

/// The angle by which one direction turns to another.
pub(super) fn angle(u: Point, v: Point) -> f64 {
    libm::atan2(cross(u, v), u[0] * v[0] + u[1] * v[1])
}

pub(super) fn cross(u: Point, v: Point) -> f64 {
    u[0] * v[1] - u[1] * v[0]
}

pub(super) fn minus(a: Point, b: Point) -> Point {
    [a[0] - b[0], a[1] - b[1]]
}

pub(super) fn length(v: Point) -> f64 {
    (v[0] * v[0] + v[1] * v[1]).sqrt()
}

pub(super) fn along(a: Point, b: Point, t: f64) -> Point {
    [a[0] + (b[0] - a[0]) * t, a[1] + (b[1] - a[1]) * t]
}
