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
    /// Velocities, µm/step.
    pub vx: Vec<f32>,
    /// Velocities, µm/step.
    pub vy: Vec<f32>,
    /// Rest length of the edge to the successor, µm.
    pub rest: Vec<f32>,
    /// Cosine of the direction of the anchor in the flattened plane. The anchor is the point of the
    /// region's boundary in this direction.
    pub anchor_x: Vec<f32>,
    /// Sine of the direction of the anchor.
    pub anchor_y: Vec<f32>,
    /// Contortion sign: −1, 0 or 1.
    pub sign: Vec<f32>,
    /// Scale exp(a·z) of the force ranges by the thickness field.
    pub scale: Vec<f32>,
    /// Share of a cleft between primary folds: 1 at its bottom, 0 far from all clefts.
    pub cleft: Vec<f32>,
    /// The next id.
    pub next_id: u32,
}

impl InnerLoop {
    /// The loop at the start of burn-in: at equal angles on the boundary of the region, with small
    /// random displacements.
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
            let sign = contortion_sign(plan, i as u32);
            s.push(i as u32, [p[0], p[1], 0.0, 0.0, 0.0, anchor[0], anchor[1], sign, 1.0, 0.0]);
        }
        for i in 0..n {
            let j = if i + 1 == n { 0 } else { i + 1 };
            let (dx, dy) = (s.x[j] - s.x[i], s.y[j] - s.y[i]);
            s.rest[i] = (dx * dx + dy * dy).sqrt();
        }
        s
    }

    /// All vectors except the ids, in the order of their declaration.
    pub(super) fn fields(&self) -> [&Vec<f32>; 10] {
        let Self { x, y, vx, vy, rest, anchor_x, anchor_y, sign, scale, cleft, .. } = self;
        [x, y, vx, vy, rest, anchor_x, anchor_y, sign, scale, cleft]
    }

    /// The vectors of [`InnerLoop::fields`].
    pub(super) fn fields_mut(&mut self) -> [&mut Vec<f32>; 10] {
        let Self { x, y, vx, vy, rest, anchor_x, anchor_y, sign, scale, cleft, .. } = self;
        [x, y, vx, vy, rest, anchor_x, anchor_y, sign, scale, cleft]
    }

    /// Appends a particle with these values of [`InnerLoop::fields`].
    pub(super) fn push(&mut self, id: u32, values: [f32; 10]) {
        self.id.push(id);
        self.fields_mut().into_iter().zip(values).for_each(|(field, value)| field.push(value));
    }

    /// Number of particles.
    #[must_use]
    pub fn len(&self) -> usize {
        self.id.len()
    }

    /// True if the loop has no particles.
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

/// The contortion sign of the particle with this id: −1 or 1 for a small percentage of the
/// particles, 0 for the others.
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
    /// Velocities, µm/step.
    pub v: Vec<[f32; 2]>,
}

impl OuterLoop {
    /// Number of particles.
    #[must_use]
    pub fn len(&self) -> usize {
        self.id.len()
    }

    /// True if the loop has no particles.
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
    /// Current step; negative during burn-in.
    pub time: i64,
    /// The mucosa.
    pub inner: InnerLoop,
    /// The wall.
    pub outer: OuterLoop,
    /// Clearance of each inner particle at the start of the last step, µm; empty before the first
    /// step.
    pub clearance: Vec<f32>,
}

impl Checkpoint {
    /// The cross section of this state.
    #[must_use]
    pub fn section(&self, plan: &Plan) -> Section {
        section(plan, self.time, &self.inner, &self.outer)
    }
}

/// The cross section of loops at step `time`.
pub(super) fn section(plan: &Plan, time: i64, inner: &InnerLoop, outer: &OuterLoop) -> Section {
    let at = time.clamp(0, i64::from(plan.steps)) as usize;
    Section {
        step: at as f64,
        z_um: plan.z_um[at],
        added: false,
        inner: inner.ring(plan.scale),
        outer: outer.ring(plan.scale),
    }
}
