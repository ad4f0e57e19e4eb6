//! The simulation as the paper describes it: one function per force, all pairs, plain `f64`.
//!
//! A reader of the paper starts here: section 3 of Burkitt, Romano, Walker and Fazeli, *3D
//! Modelling of Complex Biological Structures: The Oviduct*. The paper does not number its
//! equations; the numbers here count those of section 3. Lengths are in µm. The time step and the
//! mass of a particle are 1, so velocities are in µm/step and forces in µm/step².
//!
//! The backends [`cpu`](super::cpu) and [`gpu`](super::gpu) compute the same motion in `f32`; tests
//! compare both with this module. No model is grown with it, because the time of a step is
//! proportional to the square of the number of particles.
//!
//! Departures from the paper. The backends have them too, so the comparison needs them:
//!
//! - [`containment`] rises over a ramp: a force that jumps cannot be integrated accurately. It has
//!   no outer limit: a particle beyond the limit would never return.
//! - [`regulatory`] falls to 0 close to the anchor, where its direction is undefined.
//! - An anchor keeps its direction when the ellipse changes with the number of particles.
//! - [`self_intersection`] has a formula; the paper describes the effect only.
//! - [`bending`] is added: springs alone do not resist a change of direction.
//! - [`guidance`] and the hold of clefts in [`Loop::force`] are added.
//! - Rest lengths relax to the length of a whole edge, because a split halves them.
//!
//! The backends also have what this module leaves out, since it can be inactive in a comparison:
//! the limit of moves that keeps walls apart, the outer loop (it never acts on the inner loop),
//! sway, outlines other than the ellipse, the fields that vary [`Particle::scale`], and the choice
//! of the edges to split. `docs/physics.md` describes all of them.
//!
//! # Example
//!
//! ```
//! use oviduct_sim::sim::reference::{Coefficients, Loop};
//! use oviduct_sim::sim::{InnerLoop, Plan};
//! use oviduct_spec::spec::{Integrator, ModelSpec, preset};
//!
//! let spec = ModelSpec::resolve(preset("paper").unwrap(), &serde_json::json!({})).unwrap();
//! let plan = Plan::new(&spec, 7);
//! let mut mucosa = Loop::from(&InnerLoop::start(&plan));
//! for t in -300..-295 {
//!     mucosa.step(&Coefficients::from(plan.at(t)), Integrator::Rk4);
//! }
//! assert_eq!(mucosa.particles.len(), 600);
//! assert!(mucosa.particles.iter().all(|particle| particle.v.length() < 5.0));
//! ```

use super::layout::StepRow;
use super::state::InnerLoop;
use crate::spec::Integrator;
use glam::DVec2;
use std::f64::consts::TAU;

/// A particle of the inner loop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Particle {
    /// Position, µm.
    pub p: DVec2,
    /// Velocity v, µm/step.
    pub v: DVec2,
    /// Rest length r of the spring to the next particle, µm.
    pub r: f64,
    /// Direction of the anchor in the flattened plane, a unit vector: see [`Ellipse::point`].
    pub anchor: DVec2,
    /// Direction of the contortion: 1 toward the lumen, −1 away from it, 0 for a particle without
    /// contortion.
    pub sign: f64,
    /// Factor of the self-intersection ranges; 1 in the paper.
    pub scale: f64,
    /// Share of a cleft between primary folds, from 0 to 1; 0 in the paper.
    pub cleft: f64,
}

/// The closed loop of particles (the paper's inner thread), counter-clockwise around the lumen.
#[derive(Clone, Debug, PartialEq)]
pub struct Loop {
    /// Particles in order; the last one is connected to the first one.
    pub particles: Vec<Particle>,
}

/// The inner ellipse of the containment region.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Ellipse {
    /// Radius along the x axis `R_in`, µm.
    pub radius: f64,
    /// Radius along the y axis over radius along the x axis: the paper's squash amount.
    pub squash: f64,
}

/// Strengths, lengths and distances of all forces during one step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Coefficients {
    /// Spring strength k, 1/step².
    pub stiffness: f64,
    /// Spring damping strength c, 1/step.
    pub damping: f64,
    /// Containment strength k, µm/step².
    pub containment: f64,
    /// Distance over which the containment force rises to its full strength, µm.
    pub ramp: f64,
    /// Inner ellipse of the containment region.
    pub ellipse: Ellipse,
    /// Regulatory strength k, µm/step².
    pub regulatory: f64,
    /// Distance from the anchor within which the regulatory force falls to 0, µm.
    pub softening: f64,
    /// Regulatory strength that is added at the bottom of a cleft, µm/step².
    pub hold: f64,
    /// Strength of the guidance, µm/step².
    pub guide: f64,
    /// Distance from the ray within which the guidance falls to 0, µm.
    pub reach: f64,
    /// m·c of the contortion at the start, the middle and the end of the step, µm/step².
    pub contortion: [f64; 3],
    /// Friction strength k, 1/step.
    pub friction: f64,
    /// Self-intersection strength times its reference range, µm²/step².
    pub repulsion: f64,
    /// Range Dg of the self-intersection force across the lumen, µm.
    pub gap: f64,
    /// Range Dt of the self-intersection force across tissue, µm.
    pub tissue: f64,
    /// Strength of the barrier, µm/step².
    pub barrier: f64,
    /// Range b of the barrier, µm.
    pub barrier_distance: f64,
    /// Bending strength, 1/step².
    pub bending: f64,
    /// Rest length that all edges relax to, µm.
    pub edge: f64,
    /// Fraction by which rest lengths relax in the step.
    pub relaxation: f64,
}

/// Spring force `F_s = −((k × (x − r)) + (c × v))` on `own` by the spring to its neighbour `other`
/// (equation 1, figure 6a).
///
/// k is the spring strength, c the damping strength, x the distance between the two particles, r
/// the rest length, v the velocity at which they move apart. The force acts along the direction
/// from `other` to `own`.
#[must_use]
pub fn spring(own: &Particle, other: &Particle, r: f64, k: f64, c: f64) -> DVec2 {
    let x = (own.p - other.p).length();
    let away = (own.p - other.p).normalize_or_zero();
    let v = (own.v - other.v).dot(away);
    -((k * (x - r)) + (c * v)) * away
}

/// Containment force `F_n = d × k` on a particle at `p` outside the inner ellipse (equation 2,
/// figures 5 and 6c).
///
/// d is the direction of the centre, k the strength. Departures: the force rises to its full
/// strength over the distance `ramp` (µm), and acts beyond the paper's outer radius too.
#[must_use]
pub fn containment(p: DVec2, ellipse: &Ellipse, k: f64, ramp: f64) -> DVec2 {
    let d = -p.normalize_or_zero();
    let share = ((ellipse.elliptic_radius(p) - ellipse.radius) / ramp).clamp(0.0, 1.0);
    d * k * share
}

/// Regulatory force `F_g = d × k` on a particle at `p` (equation 3, figure 6d).
///
/// d is the direction of the `anchor`, the nearest point on the inner radius ellipse when the
/// particle was created; k is the strength. Departure: within the distance `softening` (µm), the
/// force is proportional to the distance.
#[must_use]
pub fn regulatory(p: DVec2, anchor: DVec2, k: f64, softening: f64) -> DVec2 {
    let d = (anchor - p) / (anchor - p).length().max(softening);
    d * k
}

/// Guidance on a particle at `p` along the ray from the axis to its `anchor`: a departure, which
/// keeps folds upright on the wall.
///
/// The force is k toward the nearest point of the ray. Within the distance `reach` (µm), it is
/// proportional to the distance.
#[must_use]
pub fn guidance(p: DVec2, anchor: DVec2, k: f64, reach: f64) -> DVec2 {
    let along = p.dot(anchor).max(0.0) / anchor.length_squared();
    let d = along * anchor - p;
    k * d / d.length().max(reach)
}

/// Contortion force `F_c = d × θ/180 × m × c` on a particle at `p` between its two neighbours
/// (equation 4, figure 6b).
///
/// d is the normal of the line between the neighbours, toward the lumen or away from it by `sign`;
/// θ the angle between the directions of the neighbours, in degrees; m the magnitude; c the global
/// modifier, which oscillates between −1 and 1. `m_c` is the product of m and c.
#[must_use]
pub fn contortion([before, p, after]: [DVec2; 3], sign: f64, m_c: f64) -> DVec2 {
    let d = sign * normal(before, after);
    let cosine = (before - p).normalize_or_zero().dot((after - p).normalize_or_zero());
    let theta = libm::acos(cosine.clamp(-1.0, 1.0)).to_degrees();
    d * (theta / 180.0) * m_c
}

/// Frictional force `F_r = −v × k` on a particle with the velocity `v` (equation 5).
#[must_use]
pub fn friction(v: DVec2, k: f64) -> DVec2 {
    -v * k
}

/// Self-intersection force on `own` by the edge from `a` to `b`; `normal` is the normal of `own`
/// toward the lumen (figure 6e).
///
/// The paper states that a particle too close to another particle or to the line between two of
/// them is moved in the opposite direction. Departure, since it gives no formula: with q the vector
/// from the nearest point of the edge, d its length and α the angle between the normal and −q,
///
/// - the range is D = scale·((Dg + Dt)/2 + (Dg − Dt)/2 · cos α): Dg across the lumen, Dt across
///   tissue;
/// - the force is (repulsion/D)·(1 − d/D) along q for d < D;
/// - a barrier adds barrier·(b/d − 1) along q for d < b.
#[must_use]
pub fn self_intersection(own: &Particle, normal: DVec2, a: DVec2, b: DVec2, with: &Coefficients) -> DVec2 {
    let q = own.p - nearest_on_edge(own.p, a, b);
    // The direction is undefined where a particle lies on an edge.
    let d = q.length().max(1e-6);
    let cos_alpha = -normal.dot(q) / d;
    let range = own.scale * ((with.gap + with.tissue) / 2.0 + (with.gap - with.tissue) / 2.0 * cos_alpha);
    let soft = (with.repulsion / range * (1.0 - d / range)).max(0.0);
    let hard = (with.barrier * (with.barrier_distance / d - 1.0)).max(0.0);
    (soft + hard) * q / d
}

/// Point of the edge from `a` to `b` nearest to `p`.
fn nearest_on_edge(p: DVec2, a: DVec2, b: DVec2) -> DVec2 {
    // An edge without length is a point.
    let along = (p - a).dot(b - a) / (b - a).length_squared().max(1e-12);
    a + along.clamp(0.0, 1.0) * (b - a)
}

/// Bending force on a particle at `p` between its two neighbours: a departure, which straightens
/// the loop.
///
/// It is k times the part of before − 2p + after that is normal to the line between the neighbours.
#[must_use]
pub fn bending([before, p, after]: [DVec2; 3], k: f64) -> DVec2 {
    let n = normal(before, after);
    k * (before - 2.0 * p + after).dot(n) * n
}

/// Unit normal of the line from `before` to `after`, toward the lumen.
fn normal(before: DVec2, after: DVec2) -> DVec2 {
    (after - before).perp().normalize_or_zero()
}

impl Ellipse {
    /// Radius along the x axis of the ellipse of the same squash through `p`, µm.
    #[must_use]
    pub fn elliptic_radius(&self, p: DVec2) -> f64 {
        DVec2::new(p.x, p.y / self.squash).length()
    }

    /// Point of the ellipse in a direction of the flattened plane (x, y/squash), in which the
    /// ellipse is a circle.
    #[must_use]
    pub fn point(&self, direction: DVec2) -> DVec2 {
        self.radius * DVec2::new(direction.x, self.squash * direction.y)
    }

    /// Direction, in the flattened plane, of the point of the ellipse nearest to `p`.
    #[must_use]
    pub fn nearest(&self, p: DVec2) -> DVec2 {
        let direction = |angle: f64| DVec2::new(libm::cos(angle), libm::sin(angle));
        let distance = |angle: &f64| self.point(direction(*angle)).distance_squared(p);
        let nearest = |a: f64, b: f64| if distance(&a) <= distance(&b) { a } else { b };
        let mut step = TAU / 64.0;
        let mut angle = (1..64).map(|i| f64::from(i) * step).fold(0.0, nearest);
        while step > 1e-12 {
            step /= 2.0;
            angle = [angle - step, angle + step].into_iter().fold(angle, nearest);
        }
        direction(angle)
    }
}

impl Loop {
    /// Total force on particle `i`, with `m_c` the product m·c of the contortion.
    #[must_use]
    pub fn force(&self, i: usize, with: &Coefficients, m_c: f64) -> DVec2 {
        let (all, n) = (&self.particles, self.particles.len());
        let (previous, next) = ((i + n - 1) % n, (i + 1) % n);
        let (before, own, after) = (&all[previous], &all[i], &all[next]);
        let corner = [before.p, own.p, after.p];
        let anchor = with.ellipse.point(own.anchor);
        let mut total = spring(own, before, before.r, with.stiffness, with.damping)
            + spring(own, after, own.r, with.stiffness, with.damping)
            + containment(own.p, &with.ellipse, with.containment, with.ramp)
            + regulatory(own.p, anchor, with.regulatory + with.hold * own.cleft, with.softening)
            + guidance(own.p, anchor, with.guide, with.reach)
            + contortion(corner, own.sign, m_c)
            + friction(own.v, with.friction)
            + bending(corner, with.bending);
        // Every edge except the two that end at the particle.
        for j in (0..n).filter(|&j| j != i && j != previous) {
            total += self_intersection(own, normal(before.p, after.p), all[j].p, all[(j + 1) % n].p, with);
        }
        total
    }

    /// Advances the loop by one step. Departure: rest lengths relax after it.
    pub fn step(&mut self, with: &Coefficients, integrator: Integrator) {
        match integrator {
            Integrator::Euler => self.euler(with),
            Integrator::Rk4 => self.runge_kutta(with),
        }
        for particle in &mut self.particles {
            particle.r += with.relaxation * (with.edge - particle.r);
        }
    }

    /// Euler method: the total force updates the velocity, "which in turn determines the new
    /// position".
    fn euler(&mut self, with: &Coefficients) {
        let rates = self.rates(with, with.contortion[0]);
        for (particle, [_, acceleration]) in self.particles.iter_mut().zip(rates) {
            particle.v += acceleration;
            particle.p += particle.v;
        }
    }

    /// Runge–Kutta method of fourth order, which the paper chose.
    fn runge_kutta(&mut self, with: &Coefficients) {
        let [start, middle, end] = with.contortion;
        let k1 = self.rates(with, start);
        let k2 = self.ahead(0.5, &k1).rates(with, middle);
        let k3 = self.ahead(0.5, &k2).rates(with, middle);
        let k4 = self.ahead(1.0, &k3).rates(with, end);
        let mean = |i: usize| [0, 1].map(|j| (k1[i][j] + 2.0 * k2[i][j] + 2.0 * k3[i][j] + k4[i][j]) / 6.0);
        *self = self.ahead(1.0, &(0..k1.len()).map(mean).collect::<Vec<_>>());
    }

    /// Rates of change of the position and of the velocity of every particle.
    fn rates(&self, with: &Coefficients, m_c: f64) -> Vec<[DVec2; 2]> {
        self.particles.iter().enumerate().map(|(i, particle)| [particle.v, self.force(i, with, m_c)]).collect()
    }

    /// The loop after the time `h` at constant `rates`.
    fn ahead(&self, h: f64, rates: &[[DVec2; 2]]) -> Self {
        let moved = |(particle, [velocity, acceleration]): (&Particle, &[DVec2; 2])| Particle {
            p: particle.p + h * velocity,
            v: particle.v + h * acceleration,
            ..*particle
        };
        Self { particles: self.particles.iter().zip(rates).map(moved).collect() }
    }

    /// Growth: inserts a particle in the middle of the edge from particle `edge` to the next one.
    ///
    /// The contour is unchanged; both halves have half the rest length. `sign` is the new
    /// particle's contortion. The paper states that the number of particles increases, but not
    /// where.
    pub fn split(&mut self, edge: usize, ellipse: &Ellipse, sign: f64) {
        let (a, b) = (self.particles[edge], self.particles[(edge + 1) % self.particles.len()]);
        let p = a.p.midpoint(b.p);
        let middle = Particle {
            p,
            v: a.v.midpoint(b.v),
            r: a.r / 2.0,
            anchor: ellipse.nearest(p),
            sign,
            scale: f64::midpoint(a.scale, b.scale),
            cleft: f64::midpoint(a.cleft, b.cleft),
        };
        self.particles[edge].r /= 2.0;
        self.particles.insert(edge + 1, middle);
    }
}

/// The numbers of a backend's step.
impl From<&StepRow> for Coefficients {
    fn from(row: &StepRow) -> Self {
        let [mean, half] = [row.range_mean, row.range_half].map(f64::from);
        Self {
            stiffness: row.stiffness.into(),
            damping: row.damping.into(),
            containment: row.containment.into(),
            ramp: row.ramp.into(),
            ellipse: Ellipse { radius: row.r_in.into(), squash: row.squash.into() },
            regulatory: row.regulatory.into(),
            softening: row.softening.into(),
            hold: row.hold.into(),
            guide: row.guide.into(),
            reach: row.reach.into(),
            contortion: row.contortion.map(f64::from),
            friction: row.friction.into(),
            repulsion: row.repulsion.into(),
            gap: mean + half,
            tissue: mean - half,
            barrier: row.barrier.into(),
            barrier_distance: row.barrier_distance.into(),
            bending: row.bending.into(),
            edge: row.edge.into(),
            relaxation: row.relaxation.into(),
        }
    }
}

/// The state of a backend's inner loop.
impl From<&InnerLoop> for Loop {
    fn from(s: &InnerLoop) -> Self {
        let vector = |x: &[f32], y: &[f32], i: usize| DVec2::new(x[i].into(), y[i].into());
        let particle = |i: usize| Particle {
            p: vector(&s.x, &s.y, i),
            v: vector(&s.vx, &s.vy, i),
            r: s.rest[i].into(),
            anchor: vector(&s.anchor_x, &s.anchor_y, i),
            sign: s.sign[i].into(),
            scale: s.scale[i].into(),
            cleft: s.cleft[i].into(),
        };
        Self { particles: (0..s.len()).map(particle).collect() }
    }
}

#[cfg(test)]
mod tests;
