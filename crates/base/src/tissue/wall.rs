//! Depth of the muscular wall, measured from the outer wall of the tube.
//!
//! The border between muscle and mucosa does not follow the folds. At a place of the outer wall,
//! its depth is the distance of the nearest lumen minus epithelium and lamina propria. The depth is
//! then replaced by the minimum, and after that by the mean, over a sixteenth of the circumference
//! to both sides. The border therefore never lies deeper than the lumen permits, and varies slowly.

use super::{Contour, Layers};

/// Number of places around the tube at which the depth is stored.
const PLACES: usize = 512;
/// Places to either side in the window of minimum and mean: a sixteenth of the circumference.
const WINDOW: usize = PLACES / 16;

/// The muscular wall of a section.
#[derive(Clone, Debug)]
pub(super) struct Wall {
    pub(super) outside: Contour,
    /// Distance of the inner border of the muscle from the outer wall at each place, µm.
    depths: Vec<f64>,
    serosa_um: f64,
    longitudinal_share: f64,
}

/// A layer of the wall, ordered from the outside.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum WallLayer {
    Serosa,
    Longitudinal,
    Circular,
    Mucosa,
}

impl Wall {
    pub(super) fn new(outside: Contour, lumen: &Contour, layers: &Layers) -> Self {
        let place = |k: usize| outside.at(outside.length() * k as f64 / PLACES as f64);
        let mucosa = layers.epithelium_um + layers.lamina_um;
        let raw: Vec<f64> = (0..PLACES).map(|k| (lumen.distance(place(k)) - mucosa).max(0.0)).collect();
        let window = |k: usize| (k + PLACES - WINDOW..=k + PLACES + WINDOW).map(|at| at % PLACES);
        let minima: Vec<f64> = (0..PLACES).map(|k| window(k).map(|at| raw[at]).fold(f64::INFINITY, f64::min)).collect();
        let mean = |k: usize| window(k).map(|at| minima[at]).sum::<f64>() / (2 * WINDOW + 1) as f64;
        let depths = (0..PLACES).map(mean).collect();
        Self { outside, depths, serosa_um: layers.serosa_um, longitudinal_share: layers.longitudinal_share }
    }

    /// Layer at `depth` below the point of the outer wall with the arc length `around`.
    pub(super) fn layer(&self, depth: f64, around: f64) -> WallLayer {
        if depth <= self.serosa_um {
            return WallLayer::Serosa;
        }
        let at = around / self.outside.length() * PLACES as f64;
        let (k, t) = (at.floor(), at - at.floor());
        let k = k as usize % PLACES;
        let border = self.depths[k] * (1.0 - t) + self.depths[(k + 1) % PLACES] * t;
        if depth > border {
            WallLayer::Mucosa
        } else if depth <= self.serosa_um + self.longitudinal_share * (border - self.serosa_um) {
            WallLayer::Longitudinal
        } else {
            WallLayer::Circular
        }
    }
}
