//! Vessels of the wall: in the layer between circular and longitudinal muscle, and in the
//! subserosa, most of these at the mesosalpinx.

use super::{Layers, random, wander};
use std::f64::consts::TAU;

/// Golden section: directions of successive vessels are spread evenly, and never in a pattern.
const GOLDEN: f64 = 0.618_033_988_749_895;
/// Fraction of a turn by which a vessel wanders to either side.
const SHIFT: f64 = 0.03;
/// Half of the height of a vessel as a fraction of the muscle, and of the subserosa; chosen.
const OF_MUSCLE: f64 = 0.055;
const OF_SUBSEROSA: f64 = 0.3;
/// Vessels with a smaller half height are not drawn, µm.
const MIN_UM: f64 = 1.0;

/// The wall in a direction from the middle of the tube.
pub(super) struct Side {
    /// Point of the outer contour.
    pub(super) edge: [f64; 2],
    /// Unit vector from the middle towards it.
    pub(super) out: [f64; 2],
    /// Thickness of the muscle and of the subserosa, µm.
    pub(super) muscle_um: f64,
    pub(super) subserosa_um: f64,
}

/// A vessel: an uneven ellipse.
#[derive(Clone, Copy, Debug)]
pub(super) struct Vessel {
    middle: [f64; 2],
    /// Unit vector towards the outside.
    out: [f64; 2],
    /// Half of the extent around the tube and across the wall, µm.
    half: [f64; 2],
    /// Angles of the unevenness, radians.
    uneven: [f64; 2],
}

impl Vessel {
    /// Distance of a point inside the vessel from its border, µm. `None` outside.
    pub(super) fn within(&self, p: [f64; 2]) -> Option<f64> {
        let d = [p[0] - self.middle[0], p[1] - self.middle[1]];
        let reach = 1.3 * self.half[0].max(self.half[1]);
        if d[0].abs() > reach || d[1].abs() > reach {
            return None;
        }
        let across = (d[0] * self.out[0] + d[1] * self.out[1]) / self.half[1];
        let around = (d[1] * self.out[0] - d[0] * self.out[1]) / self.half[0];
        let angle = libm::atan2(across, around);
        let radius =
            1.0 + 0.13 * libm::cos(2.0 * angle + self.uneven[0]) + 0.1 * libm::cos(3.0 * angle + self.uneven[1]);
        let within = radius - across.hypot(around);
        (within > 0.0).then(|| within * self.half[0].min(self.half[1]))
    }
}

/// Vessels of a section. `side` returns the wall in a direction, in turns. The vessel `k` continues
/// from section to section; it is thinner where the number of vessels falls from `k + 1` to `k`,
/// and ends there.
pub(super) fn vessels(layers: &Layers, side: &dyn Fn(f64) -> Option<Side>) -> Vec<Vessel> {
    (0..layers.vessels.max(0.0).ceil() as u32).filter_map(|k| vessel(layers, side, k)).collect()
}

fn vessel(layers: &Layers, side: &dyn Fn(f64) -> Option<Side>, k: u32) -> Option<Vessel> {
    let [size, flat, a, b] = random(layers.seed, k);
    let spread = (f64::from(k / 2) * GOLDEN + random(layers.seed, k % 2 + 500)[0]).rem_euclid(1.0);
    let is_subserosal = k % 2 == 1;
    let from_side = 2.0 * spread - 1.0;
    // Most vessels of the subserosa lie within an eighth of a turn of the mesosalpinx.
    let turn = if is_subserosal { -0.25 + 0.5 * from_side * from_side.abs().powi(2) } else { spread };
    let Side { edge, out, muscle_um, subserosa_um } = side(turn + SHIFT * wander(layers, k))?;
    let at = |depth: f64| [edge[0] - depth * out[0], edge[1] - depth * out[1]];
    let serosa = layers.serosa_um;
    let (height, depth) = if is_subserosal {
        (OF_SUBSEROSA * subserosa_um, serosa + subserosa_um * (0.45 + 0.1 * a))
    } else {
        (OF_MUSCLE * muscle_um, serosa + subserosa_um + layers.longitudinal_share * muscle_um)
    };
    let height = height * (0.6 + 0.6 * size) * (layers.vessels - f64::from(k)).clamp(0.0, 1.0).sqrt();
    let half = [height * (1.2 + flat), height];
    let uneven = [TAU * a + 0.8 * wander(layers, k + 200), TAU * b + 0.8 * wander(layers, k + 300)];
    (height >= MIN_UM).then(|| Vessel { middle: at(depth), out, half, uneven })
}
