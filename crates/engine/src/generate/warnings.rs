//! Warnings about a model that passes its certificate but differs from its request, mostly because
//! it grew poorly.

use crate::model::LengthUnit;
use serde::{Deserialize, Serialize};

/// Minimum gap between walls without a warning, µm.
const SMALL_GAP_UM: f64 = 0.1;

/// Minimum factor on the lean without a warning.
const MUCH_LEAN: f64 = 0.9;

/// Minimum factor on the wave of contraction without a warning.
const MUCH_WAVE: f64 = 0.5;

/// Measures of the growth of a model.
pub(super) struct Growth {
    /// Number of splits that were deferred for lack of room and never made.
    pub(super) splits_missing: u64,
    /// Minimum distance between two parts of a contour in any section, µm; `None` if it was not
    /// measured.
    pub(super) min_gap_um: Option<f64>,
    /// Number of particles of both loops in the last section.
    pub(super) particles: u64,
    /// Number of particles of both loops that the specification requests at the end.
    pub(super) target: u64,
    /// Factor on the lean that keeps walls apart; `None` if the surface does not lean.
    pub(super) lean_scale: Option<f64>,
    /// True if a lean is requested for an even surface.
    pub(super) lean_left_out: bool,
    /// Requested unit that no file has.
    pub(super) units_unused: Option<LengthUnit>,
    /// Minimum factor on the wave of contraction, and its place, mm; `None` if the tube does not
    /// contract.
    pub(super) wave: Option<[f64; 2]>,
}

/// Warning about a finished model that differs from its request.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema), schema(as = ModelWarning))]
pub struct Warning {
    /// `splits-missing`, `small-gap`, `particles-short`, `lean-reduced`, `lean-left-out`,
    /// `contraction-reduced` or `units-unused`. Later versions may add codes.
    pub code: String,
    /// A sentence with the measured values.
    pub detail: String,
}

/// All warnings, in the order of the codes; empty for a model as requested.
pub(super) fn warnings(growth: &Growth) -> Vec<Warning> {
    let mut warnings = Vec::new();
    let mut warn = |code: &str, detail| warnings.push(Warning { code: code.to_owned(), detail });
    let Growth { splits_missing, min_gap_um, particles, target, lean_scale, lean_left_out, units_unused, wave } =
        *growth;
    if splits_missing > 0 {
        let are = if splits_missing == 1 { "split was" } else { "splits were" };
        warn(
            "splits-missing",
            format!(
                "{splits_missing} {are} never made, because the walls left no room (/containment/spacing_um, /collision/clearance_um)."
            ),
        );
    }
    if let Some(gap) = min_gap_um.filter(|gap| *gap < SMALL_GAP_UM) {
        warn(
            "small-gap",
            format!(
                "The least gap between walls is {gap:.3} µm, below {SMALL_GAP_UM} µm: folds have collapsed onto each other."
            ),
        );
    }
    if particles < target {
        warn(
            "particles-short",
            format!("The model ends with {particles} particles; its specification asks for {target}."),
        );
    }
    if let Some(scale) = lean_scale.filter(|scale| *scale < MUCH_LEAN) {
        warn(
            "lean-reduced",
            format!(
                "The lean was reduced to {scale:.2} of its strength everywhere to keep walls apart (/lean/strength_um, /lean/ends_mm): \
                 cuts have fewer islands."
            ),
        );
    }
    if lean_left_out {
        warn(
            "lean-left-out",
            "An even surface (/mesh/resolution_um) does not lean: its cuts have no islands (/lean/strength_um 0 asks for that).".into(),
        );
    }
    if let Some([factor, place]) = wave.filter(|wave| wave[0] < MUCH_WAVE) {
        warn(
            "contraction-reduced",
            format!(
                "The wave of contraction was reduced to {factor:.2} of its height at {place:.1} mm to keep walls apart \
                 (/contraction/closure, /contraction/shortening)."
            ),
        );
    }
    if let Some(unit) = units_unused {
        warn(
            "units-unused",
            format!(
                "The unit {} (/units) has no effect, because every requested format has a fixed unit. A unit can be \
                 chosen for obj, stl, stl-ascii, ply, vtp, 3mf and centreline.",
                unit.name()
            ),
        );
    }
    warnings
}

#[cfg(test)]
mod tests {
    use super::*;

    fn codes(growth: &Growth) -> Vec<String> {
        warnings(growth).into_iter().map(|w| w.code).collect()
    }

    #[test]
    fn each_shortcoming_has_its_own_warning() {
        let good = || Growth {
            splits_missing: 0,
            min_gap_um: Some(0.1),
            particles: 600,
            target: 600,
            lean_scale: Some(0.95),
            lean_left_out: false,
            units_unused: None,
            wave: Some([0.6, 3.0]),
        };
        assert_eq!(codes(&good()), [""; 0]);
        assert_eq!(codes(&Growth { min_gap_um: None, ..good() }), [""; 0]);
        assert_eq!(codes(&Growth { splits_missing: 1, ..good() }), ["splits-missing"]);
        assert_eq!(codes(&Growth { min_gap_um: Some(0.0999), ..good() }), ["small-gap"]);
        assert_eq!(codes(&Growth { lean_scale: Some(0.7), ..good() }), ["lean-reduced"]);
        assert_eq!(codes(&Growth { lean_scale: None, lean_left_out: true, ..good() }), ["lean-left-out"]);
        assert_eq!(codes(&Growth { wave: Some([0.4, 3.0]), ..good() }), ["contraction-reduced"]);
        let unused = warnings(&Growth { units_unused: Some(LengthUnit::Millimetre), ..good() });
        assert_eq!(unused[0].code, "units-unused");
        assert!(unused[0].detail.starts_with("The unit mm (/units) has no effect"), "{unused:?}");
        let short = warnings(&Growth { particles: 588, ..good() });
        assert_eq!(short[0].code, "particles-short");
        assert!(short[0].detail.contains("588") && short[0].detail.contains("600"), "{short:?}");
    }
}
