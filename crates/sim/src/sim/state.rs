//! The state of both loops, as structures of arrays.

use super::plan::Plan;
use crate::model::{Ring, Section};
use crate::random::{self, Stream};

/// The mucosa: particles in counter-clockwise order. All vectors have the same length.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct InnerLoop {
    /// Stable ids.
    pub id: Vec<u32>,
    /// Positions, µm.
    pub x: Vec<f32>,
    /// Positions, µm.
    pub y: Vec<f32>,
    /// Velocities, µm a step.
    pub vx: Vec<f32>,
    /// Velocities, µm a step.
    pub vy: Vec<f32>,
    /// Rest length of the edge to the successor, µm.
    pub rest: Vec<f32>,
    /// Direction of the anchor in the flattened plane, its cosine; the anchor is where it meets the boundary of the region.
    pub anchor_x: Vec<f32>,
    /// Its sine.
    pub anchor_y: Vec<f32>,
    /// Contortion sign: −1, 0 or 1.
    pub sign: Vec<f32>,
    /// Scale exp(a·z) of the force ranges by the thickness field.
    pub scale: Vec<f32>,
    /// The next id.
    pub next_id: u32,
}

impl InnerLoop {
    /// The loop at the start of burn-in: at equal angles on the boundary of the region, with a small random displacement.
    #[must_use]
    pub fn start(plan: &Plan) -> Self {
        let time = -i64::from(plan.burn_in);
        let (row, region) = (plan.at(time), plan.region(time));
        let n = plan.start[0] as usize;
        let mut s = Self { next_id: n as u32, ..Self::default() };
        for i in 0..n {
            let angle = std::f64::consts::TAU * i as f64 / n as f64;
            let wobble = random::unit(random::word(plan.seed, Stream::Start, i as u32, 0)) - 0.5;
            let unit = [libm::cos(angle) as f32, libm::sin(angle) as f32];
            let r = (row.r_in + wobble) * region.boundary(unit);
            let p = [r * unit[0], r * row.squash * unit[1]];
            let anchor = region.nearest(p, row);
            s.id.push(i as u32);
            s.x.push(p[0]);
            s.y.push(p[1]);
            s.vx.push(0.0);
            s.vy.push(0.0);
            s.anchor_x.push(anchor[0]);
            s.anchor_y.push(anchor[1]);
            s.sign.push(contortion_sign(plan, i as u32));
            s.scale.push(1.0);
        }
        for i in 0..n {
            let j = if i + 1 == n { 0 } else { i + 1 };
            let (dx, dy) = (s.x[j] - s.x[i], s.y[j] - s.y[i]);
            s.rest.push((dx * dx + dy * dy).sqrt());
        }
        s
    }

    /// Number of particles.
    #[must_use]
    pub fn len(&self) -> usize {
        self.id.len()
    }

    /// Whether the loop has no particles.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.id.is_empty()
    }

    /// The contour, enlarged by `scale`.
    #[must_use]
    pub fn ring(&self, scale: f32) -> Ring {
        let points = self.x.iter().zip(&self.y).map(|(&x, &y)| [scale * x, scale * y]).collect();
        Ring { ids: self.id.clone(), points }
    }
}

/// The contortion sign of the particle with this id: −1, 1, or 0 if it is not contorted.
pub(crate) fn contortion_sign(plan: &Plan, id: u32) -> f32 {
    let w = random::words(plan.seed, Stream::Contortion, id, 0);
    match (random::unit(w[0]) < plan.contorted, w[1] & 1) {
        (false, _) => 0.0,
        (true, 0) => -1.0,
        (true, _) => 1.0,
    }
}

/// The wall: a simplified version of the inner loop.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct OuterLoop {
    /// Stable ids.
    pub id: Vec<u32>,
    /// Positions, µm.
    pub p: Vec<[f32; 2]>,
    /// Velocities, µm a step.
    pub v: Vec<[f32; 2]>,
}

impl OuterLoop {
    /// Number of particles.
    #[must_use]
    pub fn len(&self) -> usize {
        self.id.len()
    }

    /// Whether the loop has no particles.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.id.is_empty()
    }

    /// The contour, enlarged by `scale`.
    #[must_use]
    pub fn ring(&self, scale: f32) -> Ring {
        Ring { ids: self.id.clone(), points: self.p.iter().map(|p| p.map(|c| scale * c)).collect() }
    }
}

/// The whole state of a simulation between two steps, from which a backend can continue.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Checkpoint {
    /// The step reached; negative during burn-in.
    pub time: i64,
    /// The mucosa.
    pub inner: InnerLoop,
    /// The wall.
    pub outer: OuterLoop,
    /// Clearance of each inner particle at the start of the last step, µm; empty before the first one.
    pub clearance: Vec<f32>,
}

impl Checkpoint {
    /// The cross section of this state.
    #[must_use]
    pub fn section(&self, plan: &Plan) -> Section {
        let at = self.time.clamp(0, i64::from(plan.steps)) as usize;
        Section {
            step: at as f64,
            z_um: plan.z_um[at],
            added: false,
            inner: self.inner.ring(plan.scale),
            outer: self.outer.ring(plan.scale),
        }
    }
}
