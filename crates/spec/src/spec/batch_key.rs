//! Key of the models that a GPU may grow together.
//!
//! The members of a GPU batch are stepped together, so their steps must agree. All of them wait for
//! the member with the most particles.

use super::Parameters;

/// Ratio of the ends of each range of particle counts.
const RATIO: f64 = 1.25;

/// Key of the models that a GPU may grow together. Models with equal keys have equal steps and
/// integrators, and particle counts of the inner loop that differ by less than a factor of 1.25.
/// Similar models may still have different keys, on either side of a boundary between ranges.
#[must_use]
pub fn batch_key(p: &Parameters) -> String {
    let inner = |u: f64| (p.particles.total.at(u).round() - p.particles.outer.at(u).round()).max(1.0);
    let particles = inner(0.0).max(inner(1.0));
    let range = (libm::log(particles) / libm::log(RATIO)).floor();
    format!(
        "{}/{}/{}/{}/{}/{range}",
        p.recorded().end(),
        p.burn_in,
        p.particles.every,
        p.interval(),
        p.solver.integrator.name()
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::spec::{ModelSpec, preset};
    use serde_json::{Value, json};

    fn key(patch: &Value) -> String {
        batch_key(&ModelSpec::resolve(preset("paper").unwrap(), patch).unwrap())
    }

    #[test]
    fn a_key_depends_on_steps_integrator_and_size_alone() {
        let paper = key(&json!({}));
        assert_eq!(key(&json!({ "friction": 0.31, "containment": { "squash": 1.1 } })), paper);
        for other in [
            json!({ "steps": 1000 }),
            json!({ "burn_in": 10 }),
            json!({ "particles": { "every": 7 } }),
            json!({ "solver": { "record_every": 5 } }),
            json!({ "solver": { "integrator": "euler" } }),
            json!({ "mesh": { "resolution_um": 40 } }),
            json!({ "piece": { "to": 0.5 } }),
            json!({ "particles": { "total": { "keys": [[0, 710], [1, 4000]] } } }),
        ] {
            assert_ne!(key(&other), paper, "{other}");
        }
    }

    #[test]
    fn models_of_one_key_differ_by_less_than_a_quarter() {
        let mut ranges = std::collections::BTreeMap::<String, Vec<u32>>::new();
        for total in (800..4000).step_by(40) {
            let patch = json!({ "particles": { "total": { "keys": [[0, 300], [1, total]] } } });
            let spec = ModelSpec::resolve(preset("paper").unwrap(), &patch).unwrap();
            let inner = spec.particles.total.at(1.0) - spec.particles.outer.at(1.0);
            ranges.entry(batch_key(&spec)).or_default().push(inner.round() as u32);
        }
        assert!((9..=11).contains(&ranges.len()), "{ranges:?}");
        for inner in ranges.values() {
            let (least, most) = (inner.iter().min().unwrap(), inner.iter().max().unwrap());
            assert!(f64::from(*most) < 1.25 * f64::from(*least), "{inner:?}");
        }
    }
}
