//! What is to be grown: every parameter of the model in real units, valid by construction.
//!
//! A [`ModelSpec`] can only be made by resolving a merge patch on a preset, which checks everything
//! and reports every fault at once; whoever holds one need not check again.

mod schedule;

pub use schedule::{Ease, Fluctuation, Schedule};

/// A resolved, checked specification. Dereferences to its [`Parameters`].
#[derive(Clone, Debug, PartialEq)]
pub struct ModelSpec(Parameters);

impl std::ops::Deref for ModelSpec {
    type Target = Parameters;

    fn deref(&self) -> &Parameters {
        &self.0
    }
}

/// All parameters of a model. Lengths in micrometres unless the name says otherwise; time in steps;
/// mass 1. A step is also a place along the tube, see [`Parameters::z`].
#[derive(Clone, Debug, PartialEq)]
pub struct Parameters {
    /// Length of the tube in millimetres.
    pub length_mm: f64,
    /// Time steps from the isthmus end to the ampulla end.
    pub steps: u32,
    /// Steps run with the parameters of step 0 before it is recorded.
    pub burn_in: u32,
    /// Place along the tube as a fraction of its length, over the fraction of steps; strictly increasing from 0 to 1.
    pub z: Schedule,
    /// How many particles, and where new ones are made.
    pub particles: Particles,
    /// Spring between neighbours.
    pub spring: Spring,
    /// Friction strength, 1/step.
    pub friction: Schedule,
    /// Bending stiffness (second difference, normal part).
    pub bending: Schedule,
    /// Containment region.
    pub containment: Containment,
    /// Regulatory force toward the anchor.
    pub regulatory: Regulatory,
    /// Contortion of single particles.
    pub contortion: Contortion,
    /// Self-intersection force, barrier and guard.
    pub collision: Collision,
    /// Variation of tissue thickness and lumen gap.
    pub variation: Variation,
    /// Slow lobes of the outer wall.
    pub wall: Wall,
    /// Integrator, neighbour search, recording.
    pub solver: Solver,
    /// Options of the surface.
    pub mesh: MeshOptions,
}

/// Particle counts and growth.
#[derive(Clone, Debug, PartialEq)]
pub struct Particles {
    /// Particles of both loops; not decreasing.
    pub total: Schedule,
    /// Particles of the outer loop among them; not decreasing.
    pub outer: Schedule,
    /// Steps between growth events.
    pub every: u32,
    /// Rest length that edges relax to.
    pub edge_um: Schedule,
    /// Weight of fold-tip curvature in the choice of the edge to split.
    pub tip_weight: Schedule,
    /// Random candidates of each tournament.
    pub candidates: u32,
}

/// Spring force of the paper.
#[derive(Clone, Debug, PartialEq)]
pub struct Spring {
    /// k.
    pub stiffness: Schedule,
    /// c.
    pub damping: Schedule,
    /// Fraction of its distance to `edge_um` by which a rest length relaxes each step.
    pub relaxation: Schedule,
}

/// Containment force of the paper.
#[derive(Clone, Debug, PartialEq)]
pub struct Containment {
    /// Strength.
    pub strength: Schedule,
    /// Distance over which the force sets in.
    pub ramp_um: Schedule,
    /// Ratio of the y radius to the x radius of the ellipse.
    pub squash: Schedule,
    /// Spacing s of fold strands: `R_in` = sqrt(n·edge·s / (π·squash)).
    pub spacing_um: Schedule,
    /// Thickness of the wall: `R_wall` − `R_in`.
    pub wall_um: Schedule,
}

/// Regulatory force of the paper.
#[derive(Clone, Debug, PartialEq)]
pub struct Regulatory {
    /// Strength.
    pub strength: Schedule,
    /// Distance to the anchor under which the force fades.
    pub softening_um: Schedule,
}

/// Contortion force of the paper.
#[derive(Clone, Debug, PartialEq)]
pub struct Contortion {
    /// Fraction of the particles that are contorted.
    pub fraction: f64,
    /// Magnitude m.
    pub magnitude: Schedule,
    /// Period of the global modifier c, steps.
    pub period: f64,
}

/// Self-intersection force of the paper, with the barrier and the guard that keep walls from crossing.
#[derive(Clone, Debug, PartialEq)]
pub struct Collision {
    /// Strength kr.
    pub strength: Schedule,
    /// Range Dt across tissue.
    pub tissue_um: Schedule,
    /// Range Dg across the lumen gap.
    pub gap_um: Schedule,
    /// Reference range: the force is scaled by `reference_um`/D.
    pub reference_um: f64,
    /// Strength fb of the barrier.
    pub barrier: Schedule,
    /// Distance under which the barrier acts.
    pub barrier_um: Schedule,
    /// Least clearance `g_min` that the guard keeps.
    pub clearance_um: f64,
}

/// A smooth random field that varies thickness and gap.
#[derive(Clone, Debug, PartialEq)]
pub struct Variation {
    /// Amplitude a: ranges are scaled by exp(a·z). 0 switches the field off.
    pub amplitude: Schedule,
    /// Wavelength.
    pub wavelength_um: f64,
    /// Phase drift along the tube, radians a step.
    pub drift: f64,
}

/// Slow lobed noise of the outer wall.
#[derive(Clone, Debug, PartialEq)]
pub struct Wall {
    /// Amplitude as a fraction of the radius.
    pub lobing: Schedule,
    /// Highest number of lobes.
    pub lobes: u32,
    /// Phase drift along the tube, radians a step.
    pub drift: f64,
}

/// How the model is computed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Solver {
    /// Time integration.
    pub integrator: Integrator,
    /// Neighbour search; it changes speed, never results.
    pub search: Search,
    /// Steps between recorded sections.
    pub record_every: u32,
}

/// Time integration scheme.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Integrator {
    /// Runge–Kutta of fourth order.
    Rk4,
    /// Semi-implicit Euler.
    Euler,
}

/// Neighbour search.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Search {
    /// Lists of blocks of consecutive segments, kept while displacements stay bounded.
    Lists,
    /// Uniform grid rebuilt for each evaluation.
    Grid,
    /// Every pair, as in the paper.
    AllPairs,
}

/// Options of the exported surface.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct MeshOptions {
    /// Write the walls as triangle strips, as in the paper.
    pub strips: bool,
}
