//! The lean of a section of a frame: the displacement along the tube, by the same field as at rest.
//!
//! The field is an injective map of space at rest. It is evaluated at the moved points of the
//! contour, without the factor on the contour, so the map of a frame stays injective except for
//! that factor, which changes little along the tube. If the lean stayed with the points, the walls
//! of a gap that move towards each other would be sheared apart.

use super::level::{Level, Point};
use crate::mesh::lean::{Centre, LeanField};

/// Minimum full displacement from which the remaining fraction at rest can be computed, µm.
const LEAST_UM: f64 = 1.0;

/// Displacements of the inner contour of a section.
pub(super) struct Shift {
    z_um: f64,
    /// Displacement at rest, µm.
    rest: Vec<f64>,
    /// Full displacement by the field at rest, µm, and the fraction of it that remained.
    full: Vec<f64>,
    share: Vec<f64>,
    /// Fraction of the displacement that remains in frames.
    left: Vec<f64>,
}

impl Shift {
    /// Creates the displacements of a section at `z_um`. `leaned` returns the z of a vertex after
    /// the lean, µm.
    pub(super) fn new(level: &Level, z_um: f64, field: &LeanField<'_>, leaned: impl Fn(u32) -> f64) -> Self {
        let rest: Vec<f64> = level.inner.iter().map(|&v| leaned(v) - z_um).collect();
        let full: Vec<f64> = level.points.iter().map(|&[x, y]| field.at([x, y, z_um])).collect();
        let share =
            |(rest, full): (&f64, &f64)| if full.abs() > LEAST_UM { (rest / full).clamp(0.0, 1.0) } else { 1.0 };
        let share = rest.iter().zip(&full).map(share).collect();
        let left = vec![1.0; rest.len()];
        Self { z_um, rest, full, share, left }
    }

    /// Displacement of a point of the contour that has moved to a place.
    pub(super) fn at(&self, i: usize, [x, y]: Point, field: &LeanField<'_>) -> f64 {
        self.left[i] * (self.rest[i] + self.share[i] * (field.at([x, y, self.z_um]) - self.full[i]))
    }

    /// Removes a fraction of the displacement around the centres.
    pub(super) fn damp(&mut self, points: &[Point], centres: &[Centre], share: f64) {
        self.change(points, centres, |left, centre, p| {
            if let Some(remainder) = centre.remainder(p, share) {
                *left *= remainder;
            }
        });
    }

    /// Restores a fraction of the removed displacement around the centres.
    pub(super) fn restore(&mut self, points: &[Point], centres: &[Centre], share: f64) {
        self.change(points, centres, |left, centre, p| {
            if let Some(remainder) = centre.remainder(p, share) {
                *left = 1.0 - remainder * (1.0 - *left);
            }
        });
    }

    /// Restores all displacement.
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
