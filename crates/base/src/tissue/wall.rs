//! The muscular wall: how deep it reaches from the outside of the tube.
//!
//! The border between muscle and mucosa does not follow the folds. At a place of the outside its depth is that of the nearest
//! lumen, less epithelium and lamina propria: the least over a sixteenth of the circumference to both sides, then averaged
//! over as much. It therefore never exceeds the depth of the lumen at any place, and varies slowly.

use super::{Contour, Layers};

/// Places around the tube at which the depth is kept.
const PLACES: usize = 512;
/// Places to either side over which the least is taken, and then the mean: a sixteenth of the circumference.
const REACH: usize = PLACES / 16;

/// The wall of a section.
#[derive(Clone, Debug)]
pub(super) struct Wall {
    pub(super) outside: Contour,
    /// Depth of the inner border of the muscle, µm from the outside, by place.
    depths: Vec<f64>,
    serosa_um: f64,
    longitudinal_share: f64,
}

/// A layer of the wall, from the outside.
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
        let window = |k: usize| (k + PLACES - REACH..=k + PLACES + REACH).map(|at| at % PLACES);
        let least: Vec<f64> = (0..PLACES).map(|k| window(k).map(|at| raw[at]).fold(f64::INFINITY, f64::min)).collect();
        let mean = |k: usize| window(k).map(|at| least[at]).sum::<f64>() / (2 * REACH + 1) as f64;
        let depths = (0..PLACES).map(mean).collect();
        Self { outside, depths, serosa_um: layers.serosa_um, longitudinal_share: layers.longitudinal_share }
    }

    /// The layer at a depth below the place of the outside with the arc length `around`.
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
