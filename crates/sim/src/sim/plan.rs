//! Plan of a simulation: a specification and a seed, sampled into one [`StepRow`] per step, the
//! thickness field and the lobes of the wall.
//!
//! The backends use only these tables, never the schedules, so CPU and GPU compute with the same
//! numbers.

use super::layout::StepRow;
use super::maths::fraction;
use super::region::{Region, Spoke, spokes};
use crate::random::{self, Stream};
use crate::spec::{Folds, Integrator, Parameters, Schedule, Search, Variety};
use std::f64::consts::{PI, TAU};

/// One cosine of the thickness field: `cos(2π(x·kx + y·ky + phase + drift·t))`, all in turns.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wave {
    /// Wave vector, turns per µm.
    pub k: [f32; 2],
    /// Phase, turns.
    pub phase: f64,
    /// Drift, turns per step.
    pub drift: f64,
}

/// One cosine of the sway: `direction·cos(2π(x·kx + y·ky + phase + frequency·t))`, a flow across
/// its wave vector.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Flow {
    /// Wave vector, turns per µm.
    pub k: [f32; 2],
    /// Unit vector across the wave vector.
    pub direction: [f32; 2],
    /// Phase, turns.
    pub phase: f64,
    /// Frequency, turns per step.
    pub frequency: f64,
}

/// One term of the variety around the wall: `cos(order·θ + 2π(phase + drift·t))` for heights,
/// thickness and shift. The order is the number of maxima around the tube.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mode {
    /// Phases, turns.
    pub phases: [f64; 3],
    /// Drift, turns per step.
    pub drift: f64,
}

/// One lobe of the outer wall: `weight·cos(order·θ + 2π(phase + drift·t))`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lobe {
    /// Number of maxima around the tube.
    pub order: u32,
    /// Weight. The weights of all lobes have a root-sum-square of 1.
    pub weight: f32,
    /// Phase, turns.
    pub phase: f64,
    /// Drift, turns per step.
    pub drift: f64,
}

/// Maximum 4k + 2(kf + 4c) of the outer loop. The outer loop is always integrated by semi-implicit
/// Euler, which is stable below 4; the difference is left for the pull toward the target.
const WALL_STABLE: f64 = 3.6;

/// Minimum thickness of the wall, µm.
const MARGIN: f32 = 20.0;

/// Number of cosines of the thickness field, and of the sway.
const WAVES: u32 = 24;

/// All inputs of a backend.
#[derive(Clone, Debug)]
pub struct Plan {
    /// Seed.
    pub seed: u64,
    /// Number of steps from the isthmus end to the last section of the model.
    pub steps: u32,
    /// Number of steps before step 0.
    pub burn_in: u32,
    /// Steps between growth events.
    pub grow_every: u32,
    /// Steps between recorded sections.
    pub record_every: u32,
    /// Number of candidates in a growth tournament.
    pub candidates: u32,
    /// Fraction of contorted particles.
    pub contorted: f32,
    /// Minimum clearance, µm.
    pub clearance: f32,
    /// Integrator.
    pub integrator: Integrator,
    /// Neighbour search.
    pub search: Search,
    /// Number of particles at step 0: inner loop, outer loop.
    pub start: [u32; 2],
    /// One row per step. Step t is row `burn_in + t`.
    pub rows: Vec<StepRow>,
    /// Place along the tube at each step from 0 to `steps`, µm.
    pub z_um: Vec<f64>,
    /// The thickness field.
    pub waves: Vec<Wave>,
    /// Lobes of the outer wall.
    pub lobes: Vec<Lobe>,
    /// The variety around the wall, beginning with the mode that has one maximum; empty without
    /// variety.
    pub modes: Vec<Mode>,
    /// The sway; empty if the sway never acts.
    pub flows: Vec<Flow>,
    /// Directions of the region that contains the folds; empty if the region is the ellipse at
    /// every step.
    pub spokes: Vec<Spoke>,
    /// Directions of the clefts between primary folds in the flattened plane, in the order of their
    /// appearance; empty without clefts.
    pub clefts: Vec<[f32; 2]>,
    /// Size of the organ divided by the size of the simulated organ.
    pub scale: f32,
}

impl Plan {
    /// Samples all schedules of `p`.
    #[must_use]
    pub fn new(p: &Parameters, seed: u64) -> Self {
        let steps = f64::from(p.steps);
        let last = *p.recorded().end();
        let row = |t: i64| Self::row(p, seed, t);
        let mut rows: Vec<StepRow> = (-i64::from(p.burn_in)..=i64::from(last)).map(row).collect();
        let spokes = spokes(p, |row| fold_shift(&p.folds, seed, row));
        rows.iter_mut().for_each(|row| row.margin *= Region::wall(&spokes, row).slope());
        let z_um = (0..=last).map(|t| p.length_mm * 1000.0 * p.z.at(f64::from(t) / steps)).collect();
        Self {
            seed,
            steps: last,
            burn_in: p.burn_in,
            grow_every: p.particles.every,
            record_every: p.interval(),
            candidates: p.particles.candidates,
            contorted: p.contortion.fraction as f32,
            clearance: p.collision.clearance_um as f32,
            integrator: p.solver.integrator,
            search: p.solver.search,
            start: counts(p, 0.0),
            rows,
            z_um,
            waves: waves(p, seed),
            lobes: lobes(p, seed),
            modes: modes(p, seed),
            flows: if p.sway.strength.range().1 > 0.0 { flows(p, seed) } else { Vec::new() },
            spokes,
            clefts: clefts(p, seed),
            scale: p.scale as f32,
        }
    }

    /// The row of step `t` (negative in burn-in).
    #[must_use]
    pub fn at(&self, t: i64) -> &StepRow {
        let last = self.rows.len() as i64 - 1;
        &self.rows[(t + i64::from(self.burn_in)).clamp(0, last) as usize]
    }

    /// The region that contains the folds at step `t`.
    #[must_use]
    pub fn region(&self, t: i64) -> Region {
        Region::inner(&self.spokes, self.at(t))
    }

    /// The region that the wall encloses at step `t`, without the folds that the wall does not
    /// follow.
    #[must_use]
    pub fn wall_region(&self, t: i64) -> Region {
        Region::wall(&self.spokes, self.at(t))
    }

    /// True if step `t` begins with a growth event.
    #[must_use]
    pub fn grows_at(&self, t: i64) -> bool {
        t >= 0 && t % i64::from(self.grow_every) == 0
    }

    /// True if the section at step `t` is recorded.
    #[must_use]
    pub fn records_at(&self, t: i64) -> bool {
        t >= 0 && (t % i64::from(self.record_every) == 0 || t == i64::from(self.steps))
    }

    /// Number of particles that both loops lack at the end if they have `particles`.
    pub(super) fn missing_splits(&self, particles: u32) -> u64 {
        let last = self.at(i64::from(self.steps));
        u64::from((last.inner_target + last.outer_target).saturating_sub(particles))
    }

    fn row(p: &Parameters, seed: u64, t: i64) -> StepRow {
        let steps = f64::from(p.steps);
        let mut ordinal = 0;
        // The order of the calls numbers the phases, so a new parameter must be sampled last.
        let mut value = |s: &Schedule| {
            let phase = f64::from(random::unit(random::word(seed, Stream::SchedulePhase, ordinal, 0)));
            ordinal += 1;
            s.sample(t as f64, steps, phase)
        };
        let edge = value(&p.particles.edge_um);
        let spacing = value(&p.containment.spacing_um);
        let squash = value(&p.containment.squash);
        let wall = value(&p.containment.wall_um);
        let tissue = value(&p.collision.tissue_um);
        let gap = value(&p.collision.gap_um);
        let magnitude = value(&p.contortion.magnitude);
        let c = |at: f64| (magnitude * libm::sin(TAU * at / p.contortion.period)) as f32;
        let t0 = t as f64;
        let [inner, _] = counts(p, t0.max(0.0));
        let r_in = (f64::from(inner) * edge * spacing / (PI * squash)).sqrt();
        let ahead = if t < 0 { 0.0 } else { (t0 + f64::from(p.particles.every)).min(steps) };
        let [inner_target, outer_target] = counts(p, ahead);
        let (stiffness, damping) = (value(&p.spring.stiffness), value(&p.spring.damping));
        let relaxation = value(&p.spring.relaxation) as f32;
        let friction = value(&p.friction);
        let wall_share = (WALL_STABLE / (4.0 * stiffness + 2.0 * (friction + 4.0 * damping))).min(1.0);
        StepRow {
            stiffness: stiffness as f32,
            damping: damping as f32,
            relaxation,
            edge: edge as f32,
            friction: friction as f32,
            bending: value(&p.bending) as f32,
            containment: value(&p.containment.strength) as f32,
            ramp: value(&p.containment.ramp_um) as f32,
            squash: squash as f32,
            r_in: r_in as f32,
            r_wall: (r_in + wall) as f32,
            regulatory: value(&p.regulatory.strength) as f32,
            softening: value(&p.regulatory.softening_um) as f32,
            contortion: [c(t0), c(t0 + 0.5), c(t0 + 1.0)],
            repulsion: (value(&p.collision.strength) * p.collision.reference_um) as f32,
            range_mean: (0.5 * (gap + tissue)) as f32,
            range_half: (0.5 * (gap - tissue)) as f32,
            barrier: value(&p.collision.barrier) as f32,
            barrier_distance: value(&p.collision.barrier_um) as f32,
            variation: value(&p.variation.amplitude) as f32,
            tip_weight: value(&p.particles.tip_weight) as f32,
            lobing: value(&p.wall.lobing) as f32,
            wall_stiffness: (stiffness * wall_share) as f32,
            wall_damping: (damping * wall_share) as f32,
            wall_friction: (friction * wall_share) as f32,
            sway: (friction * value(&p.sway.strength)) as f32,
            asymmetry: value(&p.variety.asymmetry) as f32,
            height: value(&p.variety.height) as f32,
            thickness: value(&p.variety.thickness) as f32,
            shift: shift(p, t0, value(&p.variety.shift)),
            outline: value(&p.outline.strength) as f32,
            fold: value(&p.folds.depth) as f32,
            fold_of_wall: p.folds.wall as f32,
            fold_phase: fold_phase(p, seed, t0),
            margin: MARGIN,
            clefts: value(&p.primary.clefts) as f32,
            hold: value(&p.primary.hold) as f32,
            cleft_width: (p.primary.width_um / r_in) as f32,
            spare: if p.primary.clefts.range().1 > 0.0 { p.primary.spare as f32 } else { 0.0 },
            guide: value(&p.primary.guide) as f32,
            reach: p.primary.reach_um as f32,
            room: value(&p.particles.room_weight) as f32,
            inner_target,
            outer_target,
        }
    }
}

/// Distance by which a row of transverse folds is ahead of the first row, turns.
fn fold_shift(folds: &Folds, seed: u64, row: u32) -> f64 {
    let random = 2.0 * f64::from(random::unit(random::word(seed, Stream::Folds, row, 1))) - 1.0;
    folds.stagger * f64::from(row) + 0.5 * folds.irregularity * random
}

/// Phase of the transverse folds at step `t`, turns. The phase follows the place along the tube,
/// with slow random shifts.
fn fold_phase(p: &Parameters, seed: u64, t: f64) -> f32 {
    // Wavelengths of the shifts, in distances of folds.
    const SLOW: [f64; 3] = [2.3, 3.7, 6.1];
    let steps = f64::from(p.steps);
    let along = p.length_mm * p.z.at((t / steps).clamp(0.0, 1.0)) / p.folds.period_mm;
    let unit = |index: u32| f64::from(random::unit(random::word(seed, Stream::Folds, index, 0)));
    let shifts = (1..).zip(SLOW).map(|(i, slow)| libm::sin(TAU * (along / slow + unit(i))));
    fraction(along + unit(0) + 0.5 * p.folds.irregularity * shifts.sum::<f64>() / SLOW.len() as f64)
}

/// Number of particles of the inner and of the outer loop at time `t`, rounded.
fn counts(p: &Parameters, t: f64) -> [u32; 2] {
    let u = t / f64::from(p.steps);
    let total = p.particles.total.at(u).round() as u32;
    let outer = p.particles.outer.at(u).round() as u32;
    [total.saturating_sub(outer), outer]
}

/// Half of the change of the logarithms of growth rate and force ranges between two times: the
/// fraction `share` of the steps before `t`, and as many steps after `t`.
fn shift(p: &Parameters, t: f64, share: f64) -> [f32; 2] {
    // Minimum growth rate as a fraction of its mean.
    const LEAST_RATE: f64 = 0.1;
    if share <= 0.0 {
        return [0.0; 2];
    }
    let steps = f64::from(p.steps);
    let inner = |t: f64| p.particles.total.at(t / steps) - p.particles.outer.at(t / steps);
    let rate = |t: f64| {
        let from = t.min(steps - 1.0);
        (inner(from + 1.0) - inner(from)).max(LEAST_RATE * (inner(steps) - inner(0.0)) / steps)
    };
    let ranges = |t: f64| p.collision.tissue_um.at(t / steps) + p.collision.gap_um.at(t / steps);
    let [before, after] = [t - share * steps, t + share * steps].map(|t| t.clamp(0.0, steps));
    let half = |before: f64, after: f64| if before > 0.0 { 0.5 * libm::log(after / before) } else { 0.0 };
    [half(rate(before), rate(after)) as f32, half(ranges(before), ranges(after)) as f32]
}

fn waves(p: &Parameters, seed: u64) -> Vec<Wave> {
    let wave = |i: u32| {
        let w = random::words(seed, Stream::Thickness, i, 0);
        let unit = |j: usize| f64::from(random::unit(w[j]));
        // Directions are stratified over the half circle; wave numbers vary by ±30 %.
        let direction = PI * (f64::from(i) + unit(0)) / f64::from(WAVES);
        let k = (0.7 + 0.6 * unit(1)) / p.variation.wavelength_um;
        Wave {
            k: [(k * libm::cos(direction)) as f32, (k * libm::sin(direction)) as f32],
            phase: unit(2),
            drift: p.variation.drift / TAU * (2.0 * unit(3) - 1.0),
        }
    };
    (0..WAVES).map(wave).collect()
}

fn flows(p: &Parameters, seed: u64) -> Vec<Flow> {
    let flow = |i: u32| {
        let [w, v] = [0, 1].map(|part| random::words(seed, Stream::Sway, i, part));
        let unit = |word: u32| f64::from(random::unit(word));
        // Directions are stratified over the half circle, wave numbers vary by ±30 %, frequencies
        // by ±40 % in both directions.
        let direction = PI * (f64::from(i) + unit(w[0])) / f64::from(WAVES);
        let (sin, cos) = (libm::sin(direction), libm::cos(direction));
        let k = (0.7 + 0.6 * unit(w[1])) / p.sway.wavelength_um;
        let sign = if v[0] & 1 == 0 { 1.0 } else { -1.0 };
        Flow {
            k: [(k * cos) as f32, (k * sin) as f32],
            direction: [(-sin) as f32, cos as f32],
            phase: unit(w[2]),
            frequency: sign * (0.6 + 0.8 * unit(w[3])) / p.sway.period,
        }
    };
    (0..WAVES).map(flow).collect()
}

fn modes(p: &Parameters, seed: u64) -> Vec<Mode> {
    let Variety { asymmetry, height, thickness, shift, waves, drift } = &p.variety;
    if [asymmetry, height, thickness, shift].iter().all(|strength| strength.range().1 <= 0.0) {
        return Vec::new();
    }
    let mode = |order: u32| {
        let unit = random::words(seed, Stream::Variety, order, 0).map(|word| f64::from(random::unit(word)));
        Mode { phases: [unit[0], unit[1], unit[2]], drift: drift / TAU * (2.0 * unit[3] - 1.0) }
    };
    (1..=*waves).map(mode).collect()
}

/// Directions of clefts. Each is the one, of several candidates, that is farthest from all earlier
/// clefts, so the clefts are far from each other at any number.
fn clefts(p: &Parameters, seed: u64) -> Vec<[f32; 2]> {
    const CANDIDATES: u32 = 10;
    let mut turns: Vec<f64> = Vec::new();
    for k in 0..p.primary.clefts.range().1.ceil() as u32 {
        let apart = |turn: f64| {
            let gaps = turns.iter().map(|other| (turn - other).abs());
            gaps.map(|gap| gap.min(1.0 - gap)).fold(1.0, f64::min)
        };
        let candidates = (0..CANDIDATES).map(|c| f64::from(random::unit(random::word(seed, Stream::Clefts, k, c))));
        let farthest = candidates.reduce(|best, turn| if apart(turn) > apart(best) { turn } else { best });
        turns.extend(farthest);
    }
    turns.into_iter().map(|turn| [libm::cos(TAU * turn) as f32, libm::sin(TAU * turn) as f32]).collect()
}

fn lobes(p: &Parameters, seed: u64) -> Vec<Lobe> {
    let raw = |order: u32| {
        let w = random::words(seed, Stream::Lobes, order, 0);
        let unit = |j: usize| f64::from(random::unit(w[j]));
        let weight = (0.4 + 0.6 * unit(0)) / f64::from(order).sqrt();
        (order, weight, unit(1), p.wall.drift / TAU * (2.0 * unit(2) - 1.0))
    };
    // Order 1 would only shift the tube.
    let lobes: Vec<_> = (2..=p.wall.lobes).map(raw).collect();
    let norm = lobes.iter().map(|l| l.1 * l.1).sum::<f64>().sqrt().max(1e-12);
    lobes
        .into_iter()
        .map(|(order, weight, phase, drift)| Lobe { order, weight: (weight / norm) as f32, phase, drift })
        .collect()
}
