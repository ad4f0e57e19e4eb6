//! The lean of a section of a frame: the displacement along the tube, by the same field as at rest.
//!
//! The field is a map of space, one to one at rest. It is looked up where a point of the contour has moved, without the factor
//! on the contour, so that in a frame it remains one to one but for that factor, which changes little along the tube. A lean that stayed with the
//! points would shear the two walls of a gap apart wherever they move toward each other.

use super::level::{Level, Point};
use crate::mesh::lean::{Centre, Field};

/// Full displacement below which nothing can be said about the part of it that was left at rest, µm.
const LEAST_UM: f64 = 1.0;

/// Displacements of the inner contour of a section.
pub(super) struct Shift {
    z_um: f64,
    /// Displacement at rest, µm.
    rest: Vec<f64>,
    /// That of the field there, and the part of it that was left.
    full: Vec<f64>,
    share: Vec<f64>,
    /// Part of all displacement that is left in frames.
    left: Vec<f64>,
}

impl Shift {
    /// Of a section at a place, whose points lean to `leaned`, µm.
    pub(super) fn new(level: &Level, z_um: f64, field: &Field<'_>, leaned: impl Fn(u32) -> f64) -> Self {
        let rest: Vec<f64> = level.inner.iter().map(|&v| leaned(v) - z_um).collect();
        let full: Vec<f64> = level.points.iter().map(|&[x, y]| field.at([x, y, z_um])).collect();
        let share =
            |(rest, full): (&f64, &f64)| if full.abs() > LEAST_UM { (rest / full).clamp(0.0, 1.0) } else { 1.0 };
        let share = rest.iter().zip(&full).map(share).collect();
        let left = vec![1.0; rest.len()];
        Self { z_um, rest, full, share, left }
    }

    /// The displacement of a point of the contour that has moved.
    pub(super) fn at(&self, i: usize, [x, y]: Point, field: &Field<'_>) -> f64 {
        self.left[i] * (self.rest[i] + self.share[i] * (field.at([x, y, self.z_um]) - self.full[i]))
    }

    /// Takes a share of the displacement away around places.
    pub(super) fn damp(&mut self, points: &[Point], centres: &[Centre], share: f64) {
        self.change(points, centres, |left, centre, p| {
            if let Some(remains) = centre.left(p, share) {
                *left *= remains;
            }
        });
    }

    /// Gives a share of what was taken away back around places.
    pub(super) fn restore(&mut self, points: &[Point], centres: &[Centre], share: f64) {
        self.change(points, centres, |left, centre, p| {
            if let Some(remains) = centre.left(p, share) {
                *left = 1.0 - remains * (1.0 - *left);
            }
        });
    }

    /// Gives all back.
    pub(super) fn restore_all(&mut self) {
        self.left.fill(1.0);
    }

    fn change(&mut self, points: &[Point], centres: &[Centre], by: impl Fn(&mut f64, &Centre, [f64; 3])) {
        for centre in centres.iter().filter(|centre| centre.is_near(self.z_um)) {
            for ([x, y], left) in points.iter().zip(&mut self.left) {
                by(left, centre, [*x, *y, self.z_um]);
            }
        }
    }
}
