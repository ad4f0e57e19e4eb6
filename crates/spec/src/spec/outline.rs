//! The outline of the containment region, and the motion of the transverse folds.

use super::canonical::number;
use super::check::Checks;
use super::fault::Fault;
use super::parameters::{Outline, OutlineKind, Parameters};
use crate::geometry::star::{self, NotStar, radii};
use std::f64::consts::TAU;

/// Minimum and maximum distance of the outline from the axis, in units of `R_in`.
const RADIUS_BOUNDS: [f64; 2] = [0.3, 3.0];
/// Maximum displacement of the boundary per step: that of a particle.
const MAX_BOUNDARY_SPEED_UM: f64 = 5.0;
/// Maximum slope of the fold profile cos⁸(φ/2) per radian of the phase φ.
const MAX_FOLD_SLOPE: f64 = 0.886;
/// Relative increase of the maximum fold speed per unit of `folds.irregularity`.
const SPEEDUP_PER_IRREGULARITY: f64 = 0.92;
/// Number of places at which the motion of the folds is checked.
const PLACES: u32 = 512;

impl Outline {
    /// Gauge of the outline ([`star`]). `None` if the outline is the ellipse.
    ///
    /// # Errors
    /// Returns a fault if the outline is not star-shaped about the axis or leaves its bounds.
    pub fn gauge(&self) -> Result<Option<Vec<f64>>, Fault> {
        let (at, gauge) = match self.kind {
            _ if self.strength.range().1 <= 0.0 => return Ok(None),
            OutlineKind::Ellipse => return Ok(None),
            OutlineKind::Superellipse => ("/outline/exponent", Ok(star::superellipse(self.exponent))),
            OutlineKind::Polygon if self.points.len() < 3 => {
                let detail = format!("has {} corners; a polygon needs at least 3", self.points.len());
                return Err(Fault::new("/outline/points", detail));
            }
            OutlineKind::Polygon => ("/outline/points", star::polygon(&self.points)),
            OutlineKind::Grid if self.grid.is_empty() => {
                return Err(Fault::new("/outline/grid", "is empty; a grid needs at least 2 rows"));
            }
            OutlineKind::Grid => ("/outline/grid", star::level(&self.grid, self.grid_half)),
        };
        let gauge = gauge.map_err(|why| Fault::new(pointer(at, why), reason(why)))?;
        let beyond = radii(&gauge).find(|radius| !(RADIUS_BOUNDS[0]..=RADIUS_BOUNDS[1]).contains(radius));
        match beyond {
            Some(radius) => {
                let [least, most] = RADIUS_BOUNDS;
                let detail =
                    format!("is {radius:.3} R_in from the axis somewhere; it must be between {least} and {most}");
                Err(Fault::new(at, detail))
            }
            None => Ok(Some(gauge)),
        }
    }
}

fn pointer(at: &str, why: NotStar) -> String {
    match why {
        NotStar::TurnsBack { corner } => format!("{at}/{corner}"),
        _ => at.to_owned(),
    }
}

fn reason(why: NotStar) -> String {
    match why {
        NotStar::TurnsBack { .. } => {
            "begins an edge that runs back, or toward the axis: seen from the axis, the corners must follow each other in one sense \
             and go once around it"
                .to_owned()
        }
        NotStar::WindsRepeatedly => "goes around the axis more than once".to_owned(),
        NotStar::Crossings { angle_deg, count } => format!(
            "changes its sign {count} times along the ray at {angle_deg:.0}° from the axis; it must do so once in every direction"
        ),
        NotStar::Outside => "is not negative at the axis, which must be inside".to_owned(),
    }
}

impl Parameters {
    /// True if the containment region is an ellipse at every step.
    #[must_use]
    pub fn is_elliptic(&self) -> bool {
        let outlined = self.outline.kind != OutlineKind::Ellipse && self.outline.strength.range().1 > 0.0;
        !outlined && self.folds.depth.range().1 <= 0.0
    }

    /// Maximum distance of the region's boundary from the axis in the flattened plane, in units of
    /// `R_in`.
    pub(super) fn widest(&self) -> f64 {
        let gauge = self.outline.gauge().ok().flatten().unwrap_or_default();
        radii(&gauge).fold(1.0, f64::max)
    }
}

impl Checks<'_> {
    pub(super) fn outline(&mut self, p: &Parameters) {
        if let Err(fault) = p.outline.gauge() {
            let about =
                ["/outline/kind", "/outline/exponent", "/outline/points", "/outline/grid", "/outline/grid_half"];
            self.require(false, &fault.pointer, &about, || fault.detail.clone());
        }
    }

    /// Records a fault if transverse folds move the boundary faster than particles can follow.
    pub(super) fn folds(&mut self, p: &Parameters) {
        let (folds, swing) = (&p.folds, p.folds.depth.fluctuation.map_or(0.0, |f| f.amplitude));
        let speed = |i: u32| {
            let u = [i, i + 1].map(|i| f64::from(i) / f64::from(PLACES));
            let advance = p.length_mm * (p.z.at(u[1]) - p.z.at(u[0])) * f64::from(PLACES) / f64::from(p.steps);
            let radius = p.inner_radius_um(u[0]).max(p.inner_radius_um(u[1]));
            let depth = folds.depth.at(u[0]).max(folds.depth.at(u[1])) + swing;
            depth * radius * MAX_FOLD_SLOPE * TAU * (1.0 + SPEEDUP_PER_IRREGULARITY * folds.irregularity) * advance
                / folds.period_mm
        };
        let fastest = (0..PLACES).map(|i| (speed(i), i)).max_by(|a, b| a.0.total_cmp(&b.0));
        if let Some((speed, i)) = fastest.filter(|(speed, _)| *speed > MAX_BOUNDARY_SPEED_UM) {
            let at = "/folds/period_mm";
            let about = [
                at,
                "/folds/depth",
                "/length_mm",
                "/steps",
                "/z",
                "/particles/total",
                "/particles/edge_um",
                "/containment/spacing_um",
            ];
            self.require(false, at, &about, || {
                format!(
                    "is {}: at {:.3} of the steps the folds move the boundary by {speed:.1} µm a step, and particles follow up to {MAX_BOUNDARY_SPEED_UM} \
                     (use more /steps, a greater distance, a smaller /folds/depth, or a smaller simulation with a greater /scale)",
                    number(folds.period_mm),
                    f64::from(i) / f64::from(PLACES)
                )
            });
        }
    }
}
