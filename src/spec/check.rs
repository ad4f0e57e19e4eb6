//! What must hold between parameters: stability of the integration, monotone growth, room for the walls.
//!
//! Stability with time step 1 (project notes on the physics): the highest mode of a chain with spring k and
//! bending kb has the frequency sqrt(4k + 16kb), its damping is kf + 4c; classical Runge–Kutta needs
//! the first below 2.83 and the second below 2.79, whatever the number of particles. Semi-implicit Euler needs
//! ω² + 2γ < 4 of each mode (from the roots of λ² − (2 − γ − ω²)λ + 1 − γ): 4k + 2(kf + 4c) along the loop and
//! 16kb + 2kf across it. Containment and regulation pull like springs of strength/ramp and strength/softening,
//! which are held to the same bound. What acts between strands is left to the guard, which bounds each step.

use super::canonical::number;
use super::fault::Fault;
use super::parameters::{Integrator, Parameters};
use super::schedule::Schedule;
use std::f64::consts::PI;

/// Fewest particles of the inner loop.
pub(super) const MIN_INNER: f64 = 16.0;
/// Least distance of recorded sections along the tube, µm: positions are exported in single precision.
const MIN_SECTION_DISTANCE_UM: f64 = 0.05;
/// A split is refused under this many clearances; an edge is halved by it.
const EDGE_CLEARANCES: f64 = 80.0;
/// Places at which slow schedules are compared.
const PLACES: u32 = 512;

/// Every fault between parameters. Those that involve a pointer of `bad`, which stands for a value of the
/// preset in place of one that could not be read, are left out.
pub(super) fn faults(p: &Parameters, bad: &[String]) -> Vec<Fault> {
    let mut checks = Checks { bad, faults: Vec::new() };
    checks.stability(p);
    checks.place(p);
    checks.growth(p);
    checks.solver(p);
    checks.room(p);
    checks.faults
}

struct Checks<'a> {
    bad: &'a [String],
    faults: Vec<Fault>,
}

impl Checks<'_> {
    /// Notes a fault at `at` where `ok` is false, unless one of the values it is `about` is not the caller's.
    fn require(&mut self, ok: bool, at: &str, about: &[&str], detail: impl FnOnce() -> String) {
        if !ok && !self.bad.iter().any(|bad| about.contains(&bad.as_str())) {
            self.faults.push(Fault::new(at, detail()));
        }
    }

    fn stability(&mut self, p: &Parameters) {
        let most = |s: &Schedule| s.range().1;
        let (k, c) = (most(&p.spring.stiffness), most(&p.spring.damping));
        let (kb, kf) = (most(&p.bending), most(&p.friction));
        let frequency = (4.0 * k + 16.0 * kb).sqrt();
        self.require(frequency < 2.83, "/spring/stiffness", &["/spring/stiffness", "/bending"], || {
            format!(
                "is unstable together with /bending: sqrt(4·stiffness + 16·bending) reaches {frequency:.3} 1/step \
                 (stiffness {k}, bending {kb}) and must stay below 2.83"
            )
        });
        let field = stiffness(&p.containment.strength, &p.containment.ramp_um)
            + stiffness(&p.regulatory.strength, &p.regulatory.softening_um);
        let pull = field.sqrt();
        let about =
            ["/containment/strength", "/containment/ramp_um", "/regulatory/strength", "/regulatory/softening_um"];
        self.require(pull < 2.83, "/containment/strength", &about, || {
            format!(
                "is unstable together with /containment/ramp_um and /regulatory: sqrt(strength/ramp_um + regulatory \
                 strength/softening_um) reaches {pull:.3} 1/step and must stay below 2.83"
            )
        });
        let damping = kf + 4.0 * c;
        self.require(damping < 2.79, "/spring/damping", &["/spring/damping", "/friction"], || {
            format!(
                "is unstable together with /friction: friction + 4·damping reaches {damping:.3} 1/step \
                 (friction {kf}, damping {c}) and must stay below 2.79"
            )
        });
        if p.solver.integrator == Integrator::Euler {
            let at = "/solver/integrator";
            let along = 4.0 * k + field + 2.0 * damping;
            let about = [at, "/spring/stiffness", "/spring/damping", "/friction"];
            self.require(along < 4.0, at, &about, || {
                format!(
                    "\"euler\" is unstable here: 4·stiffness + 2·friction + 8·damping (with the pull \
                     of containment and regulation, {field:.3}) reaches {along:.3} and must stay \
                     below 4; \"rk4\" bears more"
                )
            });
            let across = 16.0 * kb + field + 2.0 * kf;
            self.require(across < 4.0, at, &[at, "/bending", "/friction"], || {
                format!(
                    "\"euler\" is unstable here: 16·bending + 2·friction (with the pull of containment and \
                     regulation, {field:.3}) reaches {across:.3} and must stay below 4; \
                     \"rk4\" bears more"
                )
            });
        }
    }

    fn place(&mut self, p: &Parameters) {
        let before = self.faults.len();
        for (at, u, due) in [("/z/keys/0/1", 0.0, 0.0), ("/z", 1.0, 1.0)] {
            self.require(p.z.at(u) == due, at, &["/z"], || {
                format!(
                    "is {} at {u} of the steps, where it must be {due}: the sections span the whole length",
                    p.z.at(u)
                )
            });
        }
        for (i, pair) in p.z.keys.windows(2).enumerate() {
            let (a, b) = (pair[0][1], pair[1][1]);
            self.require(b > a, &format!("/z/keys/{}/1", i + 1), &["/z"], || {
                format!("is {b}, not above {a} of the key before it; the place along the tube must increase strictly")
            });
        }
        if self.faults.len() > before {
            return;
        }
        let place = |step: u32| p.z.at(f64::from(step) / f64::from(p.steps)) * p.length_mm * 1000.0;
        let stations: Vec<u32> = p.stations().collect();
        let thinnest =
            stations.windows(2).map(|s| (place(s[1]) - place(s[0]), s[0])).min_by(|a, b| a.0.total_cmp(&b.0));
        if let Some((distance, step)) = thinnest {
            let about = ["/z", "/length_mm", "/steps", "/solver/record_every"];
            self.require(distance >= MIN_SECTION_DISTANCE_UM, "/z", &about, || {
                format!(
                    "puts the sections after step {step} only {distance:.2e} µm apart; at least {MIN_SECTION_DISTANCE_UM} µm \
                     are needed (longer tube, fewer recorded sections, or a steeper schedule)"
                )
            });
        }
    }

    fn growth(&mut self, p: &Parameters) {
        let (total, outer) = (&p.particles.total, &p.particles.outer);
        let (at_total, at_outer) = ("/particles/total", "/particles/outer");
        let before = self.faults.len();
        for (at, schedule) in [(at_total, total), (at_outer, outer)] {
            for (i, pair) in schedule.keys.windows(2).enumerate() {
                let (a, b) = (pair[0][1], pair[1][1]);
                self.require(b >= a, &format!("{at}/keys/{}/1", i + 1), &[at], || {
                    format!("is {b}, below {a} of the key before it; particles are never taken away")
                });
            }
        }
        let both = [at_total, at_outer];
        let inner = |u: f64| total.at(u) - outer.at(u);
        let first = inner(0.0);
        self.require(first >= MIN_INNER, at_total, &both, || {
            format!("leaves {} particles to the inner loop at the start; it needs at least {MIN_INNER}", number(first))
        });
        if self.faults.len() > before {
            return;
        }
        // A particle of tolerance, since counts are rounded.
        let shrinks =
            places(&[total, outer]).windows(2).map(|u| (u[0], inner(u[0]), inner(u[1]))).find(|(_, a, b)| *b < a - 1.0);
        if let Some((u, a, b)) = shrinks {
            self.require(false, at_outer, &both, || {
                format!(
                    "grows faster than /particles/total near {u:.3} of the steps, so that the inner loop would shrink \
                     from {a:.0} to {b:.0} particles"
                )
            });
        }
    }

    fn solver(&mut self, p: &Parameters) {
        let at = "/solver/record_every";
        self.require(p.solver.record_every <= p.steps, at, &[at, "/steps"], || {
            format!("is {}, more than the {} steps of the run", p.solver.record_every, p.steps)
        });
        let (at, clearance, edge) =
            ("/collision/clearance_um", p.collision.clearance_um, p.particles.edge_um.range().0);
        self.require(clearance * EDGE_CLEARANCES <= edge, at, &[at, "/particles/edge_um"], || {
            format!(
                "is {clearance} µm, above {:.4} µm, a {EDGE_CLEARANCES:.0}th of the least edge length {edge} µm: \
                 every split would be refused",
                edge / EDGE_CLEARANCES
            )
        });
    }

    fn room(&mut self, p: &Parameters) {
        let c = &p.containment;
        let schedules =
            [&p.particles.total, &p.particles.outer, &p.particles.edge_um, &c.squash, &c.spacing_um, &c.wall_um];
        let swing = p.wall.lobing.fluctuation.map_or(0.0, |f| f.amplitude);
        let tight = places(&schedules).into_iter().find_map(|u| {
            let inner = (p.particles.total.at(u) - p.particles.outer.at(u)).max(0.0);
            let r_in = (inner * p.particles.edge_um.at(u) * c.spacing_um.at(u) / (PI * c.squash.at(u))).sqrt();
            let wall = c.wall_um.at(u);
            let lobe = (p.wall.lobing.at(u) + swing) * (r_in + wall);
            (lobe > 0.5 * wall).then_some((u, lobe, wall))
        });
        if let Some((u, lobe, wall)) = tight {
            let about = [
                "/wall/lobing",
                "/containment/wall_um",
                "/containment/squash",
                "/containment/spacing_um",
                "/particles/total",
                "/particles/outer",
                "/particles/edge_um",
            ];
            self.require(false, "/wall/lobing", &about, || {
                format!(
                    "makes lobes of {lobe:.0} µm at {u:.3} of the steps, more than half of the wall's {wall:.0} µm \
                     (/containment/wall_um): the outer wall would meet the inner one"
                )
            });
        }
    }
}

/// Greatest stiffness of a force of this strength that sets in over this distance, 1/step².
fn stiffness(strength: &Schedule, over: &Schedule) -> f64 {
    strength.range().1 / over.range().0
}

/// Fractions of the steps, in order, at which to compare schedules: an even spread and all their keys.
fn places(schedules: &[&Schedule]) -> Vec<f64> {
    let even = (0..=PLACES).map(|i| f64::from(i) / f64::from(PLACES));
    let mut places: Vec<f64> = even.chain(schedules.iter().flat_map(|s| s.fractions())).collect();
    places.sort_by(f64::total_cmp);
    places.dedup();
    places
}
