//! Stability of the integration with time step 1.
//!
//! | integrator | condition |
//! |---|---|
//! | Runge–Kutta | highest frequency sqrt(4k + 16kb) below 2.83, its damping kf + 4c below 2.79 |
//! | Euler along the loop | 4k + 2(kf + 4c) below 4 |
//! | Euler across the loop | 16kb + 2kf below 4 |
//!
//! k is the spring, kb the bending, kf the friction and c the damping. The bounds do not depend on
//! the number of particles. The bound of semi-implicit Euler is ω² + 2γ < 4 for each mode, from the
//! roots of λ² − (2 − γ − ω²)λ + 1 − γ.
//!
//! Containment, regulation and the forces of primary folds act like springs of strength/ramp,
//! strength/softening, hold/softening and guide/reach, with the same bounds. Values within each
//! bound may still be unstable together with Runge–Kutta. Therefore the factor by which a step
//! multiplies each mode is computed, too. Forces between strands are ignored: the guard limits
//! their effect per step.

use super::check::Checks;
use super::parameters::{Integrator, Parameters};
use super::schedule::Schedule;

/// Parameters of the forces that act like springs to a fixed place.
const PULLS: [&str; 7] = [
    "/containment/strength",
    "/containment/ramp_um",
    "/regulatory/strength",
    "/regulatory/softening_um",
    "/primary/hold",
    "/primary/guide",
    "/primary/reach_um",
];

/// Number of modes that are examined, from the slowest to the fastest.
const EXAMINED_MODES: u32 = 32;

impl Checks<'_> {
    /// Records every violation of the stability bounds.
    pub(super) fn stability(&mut self, p: &Parameters) {
        let max = |s: &Schedule| s.range().1;
        let (k, c) = (max(&p.spring.stiffness), max(&p.spring.damping));
        let (kb, kf) = (max(&p.bending), max(&p.friction));
        let frequency = (4.0 * k + 16.0 * kb).sqrt();
        self.require(frequency < 2.83, "/spring/stiffness", &["/spring/stiffness", "/bending"], || {
            format!(
                "is unstable together with /bending: sqrt(4·stiffness + 16·bending) reaches {frequency:.3} 1/step \
                 (stiffness {k}, bending {kb}) and must stay below 2.83"
            )
        });
        let field = max_gradient(&p.containment.strength, &p.containment.ramp_um)
            + max_gradient(&p.regulatory.strength, &p.regulatory.softening_um)
            + max_gradient(&p.primary.hold, &p.regulatory.softening_um)
            + max(&p.primary.guide) / p.primary.reach_um;
        let pull = field.sqrt();
        self.require(pull < 2.83, "/containment/strength", &PULLS, || {
            format!(
                "is unstable together with /containment/ramp_um, /regulatory and /primary: sqrt(strength/ramp_um + \
                 (regulatory strength + hold)/softening_um + guide/reach_um) reaches {pull:.3} 1/step and must stay \
                 below 2.83"
            )
        });
        let damping = kf + 4.0 * c;
        self.require(damping < 2.79, "/spring/damping", &["/spring/damping", "/friction"], || {
            format!(
                "is unstable together with /friction: friction + 4·damping reaches {damping:.3} 1/step \
                 (friction {kf}, damping {c}) and must stay below 2.79"
            )
        });
        let euler = p.solver.integrator == Integrator::Euler;
        if !euler && self.faults.is_empty() {
            let (growth, mode) = max_growth(k, c, kb, kf, field);
            let about = [&["/spring/stiffness", "/spring/damping", "/bending", "/friction"], &PULLS[..]].concat();
            self.require(growth <= 1.0 + 1e-9, "/spring/stiffness", &about, || {
                format!(
                    "is unstable together with /spring/damping, /bending, /friction and the pull of /containment, \
                     /regulatory and /primary: each step multiplies {mode} by {growth:.3} \
                     (stiffness {k}, damping {c}, bending {kb}, friction {kf}, pull {field:.3} 1/step²)"
                )
            });
        }
        if euler {
            let at = "/solver/integrator";
            let along = 4.0 * k + field + 2.0 * damping;
            let about = [at, "/spring/stiffness", "/spring/damping", "/friction"];
            self.require(along < 4.0, at, &about, || {
                format!(
                    "\"euler\" is unstable here: 4·stiffness + 2·friction + 8·damping (with the pull \
                     of containment and regulation, {field:.3}) reaches {along:.3} and must stay \
                     below 4; \"rk4\" is stable for greater values"
                )
            });
            let across = 16.0 * kb + field + 2.0 * kf;
            self.require(across < 4.0, at, &[at, "/bending", "/friction"], || {
                format!(
                    "\"euler\" is unstable here: 16·bending + 2·friction (with the pull of containment and \
                     regulation, {field:.3}) reaches {across:.3} and must stay below 4; \
                     \"rk4\" is stable for greater values"
                )
            });
        }
    }
}

/// Maximum gradient of a force that rises to `strength` over the distance `over`, 1/step².
fn max_gradient(strength: &Schedule, over: &Schedule) -> f64 {
    strength.range().1 / over.range().0
}

/// Maximum factor by which a step of classical Runge–Kutta multiplies a mode of the chain, and the
/// name of that mode.
///
/// A mode with the frequency ω and the damping γ obeys x″ = −ω²x − γx′. A step multiplies each of
/// its two parts by R(λ) = 1 + λ + λ²/2 + λ³/6 + λ⁴/24, where λ is a root of λ² + γλ + ω². Let s
/// run from 0 (particles move together) to 1 (neighbours move against each other). Stretching has
/// ω² = 4ks + field and γ = kf + 4cs, bending has ω² = 16kb·s² + field and γ = kf. In a sharply
/// folded loop the two mix.
fn max_growth(k: f64, c: f64, kb: f64, kf: f64, field: f64) -> (f64, &'static str) {
    let mode = |i: u32| {
        let s = f64::from(i) / f64::from(EXAMINED_MODES);
        let (stretch, bend, damping) = (4.0 * k * s, 16.0 * kb * s * s, 4.0 * c * s);
        [
            (runge_kutta_growth(stretch + field, kf + damping), "stretching"),
            (runge_kutta_growth(bend + field, kf), "bending"),
            (runge_kutta_growth(stretch + bend + field, kf + damping), "stretching with bending"),
        ]
    };
    (0..=EXAMINED_MODES).flat_map(mode).max_by(|a, b| a.0.total_cmp(&b.0)).unwrap_or((1.0, "nothing"))
}

/// Maximum of |R(λ)| over the roots λ of λ² + γλ + ω².
fn runge_kutta_growth(frequency_squared: f64, damping: f64) -> f64 {
    let discriminant = 0.25 * damping * damping - frequency_squared;
    let root = discriminant.abs().sqrt();
    let roots = if discriminant < 0.0 {
        [[-0.5 * damping, root], [-0.5 * damping, -root]]
    } else {
        [[-0.5 * damping + root, 0.0], [-0.5 * damping - root, 0.0]]
    };
    let growth = |[x, y]: [f64; 2]| {
        let factor = [4.0, 3.0, 2.0, 1.0]
            .into_iter()
            .fold([1.0, 0.0], |[a, b]: [f64; 2], order| [1.0 + (x * a - y * b) / order, (x * b + y * a) / order]);
        f64::hypot(factor[0], factor[1])
    };
    growth(roots[0]).max(growth(roots[1]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_bounds_of_runge_kutta_are_those_of_the_textbook() {
        let undamped = |frequency: f64| runge_kutta_growth(frequency * frequency, 0.0);
        assert!(undamped(2.82) < 1.0 && undamped(2.84) > 1.0);
        let heavy = |damping: f64| runge_kutta_growth(0.0, damping);
        assert!(heavy(2.78) <= 1.0 && heavy(2.79) > 1.0);
    }

    /// The factor, measured in a run of the oscillator.
    fn shown(frequency_squared: f64, damping: f64) -> f64 {
        let slope = |[x, v]: [f64; 2]| [v, -frequency_squared * x - damping * v];
        let along = |a: [f64; 2], h: f64, b: [f64; 2]| [a[0] + h * b[0], a[1] + h * b[1]];
        let (mut state, steps) = ([1.0, 0.3], 400);
        let mut size = 0.0;
        for _ in 0..steps {
            let k1 = slope(state);
            let k2 = slope(along(state, 0.5, k1));
            let k3 = slope(along(state, 0.5, k2));
            let k4 = slope(along(state, 1.0, k3));
            for (axis, value) in state.iter_mut().enumerate() {
                *value += (k1[axis] + 2.0 * k2[axis] + 2.0 * k3[axis] + k4[axis]) / 6.0;
            }
            let norm = f64::hypot(state[0], state[1]);
            size += norm.ln();
            state = state.map(|value| value / norm);
        }
        (size / f64::from(steps)).exp()
    }

    #[test]
    fn the_growth_of_a_mode_is_what_a_run_of_it_shows() {
        for (frequency_squared, damping) in [(8.0, 1.9), (8.0, 2.3), (8.0, 2.7), (9.2, 0.3), (2.0, 0.7), (5.3, 0.7)] {
            let (told, seen) = (runge_kutta_growth(frequency_squared, damping), shown(frequency_squared, damping));
            assert!((told - seen).abs() < 0.01, "{frequency_squared}, {damping}: {told} {seen}");
        }
    }

    #[test]
    fn values_that_are_stable_alone_may_not_be_so_together() {
        let growth = |k: f64, c: f64| max_growth(k, c, 0.0, 0.3, 0.0).0;
        assert!(growth(2.0, 0.1) <= 1.0 && growth(0.5, 0.6) <= 1.0);
        assert!(growth(2.0, 0.5) > 1.15, "{}", growth(2.0, 0.5));
    }
}
