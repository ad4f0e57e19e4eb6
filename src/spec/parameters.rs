//! The table of all parameters: the one place where their names, units, bounds and meaning are written down.
//!
//! Structs, readers, canonical JSON and JSON Schema come from it (see [`super::table`]); defaults come from
//! the presets; what concerns several parameters at once is in [`super::check`]. The forces are those of the
//! paper's section 3, with bending, barrier and guard added. The time step is 1, the mass of a particle 1.

use super::schedule::Schedule;
use super::table::{Count, Range, choice, group};

/// Most particles of both loops that a specification may ask for.
pub const MAX_PARTICLES: u32 = 200_000;
/// Most time steps.
pub const MAX_STEPS: u32 = 100_000;
/// Most steps between two recorded sections; all of them are kept until the slab between is sound.
const MAX_INTERVAL: u32 = 1000;

/// Strength of a force between particles, µm/step².
const FORCE: Range = Range::of(0.0, 20.0).because("stronger forces only run into the guard on each step");
/// Phase drift along the tube, radians a step.
const DRIFT: Range = Range::of(0.0, 0.5).because("sections would no longer resemble the ones before them");

group! {
    /// All parameters of a model. Lengths in micrometres unless the name says otherwise; time in steps;
    /// mass 1. A step is also a place along the tube, see [`Parameters::z`].
    #[derive(Clone, Debug, PartialEq)]
    pub struct Parameters {
        /// Length of the tube in millimetres.
        pub length_mm: f64 = "Length" ["mm"] Range::of(0.1, 1000.0);
        /// Time steps from the isthmus end to the ampulla end.
        pub steps: u32 = "Time steps" ["steps"] Count::of(1, MAX_STEPS);
        /// Steps run with the parameters of step 0 before it is recorded.
        pub burn_in: u32 = "Burn-in" ["steps"] Count::of(0, MAX_STEPS);
        /// Place along the tube as a fraction of its length, over the fraction of steps; strictly increasing from 0 to 1.
        pub z: Schedule = "Place along the tube" ["of the length"] Range::of(0.0, 1.0).steady();
        /// How many particles, and where new ones are made.
        pub particles: Particles = "Particles" [""] ();
        /// Spring between neighbours.
        pub spring: Spring = "Spring force" [""] ();
        /// Friction strength: the force is −k·v.
        pub friction: Schedule = "Friction" ["1/step"]
            Range::of(0.0, 2.5).because("one step of the integration is unstable beyond it");
        /// Bending stiffness: force along the normal part of the second difference.
        pub bending: Schedule = "Bending stiffness" ["1/step²"]
            Range::of(0.0, 0.5).because("one step of the integration is unstable beyond it");
        /// Containment region.
        pub containment: Containment = "Containment force" [""] ();
        /// Regulatory force toward the anchor.
        pub regulatory: Regulatory = "Regulatory force" [""] ();
        /// Contortion of single particles.
        pub contortion: Contortion = "Contortion force" [""] ();
        /// Self-intersection force, barrier and guard.
        pub collision: Collision = "Self-intersection force" [""] ();
        /// Variation of tissue thickness and lumen gap.
        pub variation: Variation = "Thickness variation" [""] ();
        /// Slow lobes of the outer wall.
        pub wall: Wall = "Outer wall" [""] ();
        /// Integrator, neighbour search, recording.
        pub solver: Solver = "Solver" [""] ();
        /// Options of the surface.
        pub mesh: MeshOptions = "Surface" [""] ();
    }
}

group! {
    /// Particle counts and growth.
    #[derive(Clone, Debug, PartialEq)]
    pub struct Particles {
        /// Particles of both loops; not decreasing, without fluctuation.
        pub total: Schedule = "Particles of both loops" ["particles"] Range::of(28.0, MAX_PARTICLES as f64).steady();
        /// Particles of the outer loop among them; not decreasing, without fluctuation.
        pub outer: Schedule = "Particles of the outer loop" ["particles"] Range::of(12.0, MAX_PARTICLES as f64).steady();
        /// Steps between growth events.
        pub every: u32 = "Growth interval" ["steps"] Count::of(1, 1000);
        /// Rest length that edges relax to.
        pub edge_um: Schedule = "Edge length" ["µm"] Range::of(1.0, 100.0);
        /// Weight of fold-tip curvature in the choice of the edge to split; 0 chooses by length alone.
        pub tip_weight: Schedule = "Growth at fold tips" [""] Range::of(0.0, 100.0);
        /// Random candidates of each tournament for the edge to split.
        pub candidates: u32 = "Candidates a tournament" ["edges"] Count::of(1, 64);
    }
}

group! {
    /// Spring force of the paper: −(k(x−r) + c·v) along an edge of length x and rest length r.
    #[derive(Clone, Debug, PartialEq)]
    pub struct Spring {
        /// Spring strength k.
        pub stiffness: Schedule = "Spring strength" ["1/step²"]
            Range::of(0.0, 2.0).because("one step of the integration is unstable beyond it");
        /// Damping strength c, on the relative velocity along the edge.
        pub damping: Schedule = "Spring damping" ["1/step"]
            Range::of(0.0, 0.7).because("one step of the integration is unstable beyond it");
        /// Fraction of its distance to `edge_um` by which a rest length relaxes each step.
        pub relaxation: Schedule = "Rest length relaxation" ["1/step"] Range::of(0.0, 1.0);
    }
}

group! {
    /// Containment force of the paper: toward the centre, outside the inner ellipse.
    #[derive(Clone, Debug, PartialEq)]
    pub struct Containment {
        /// Strength.
        pub strength: Schedule = "Containment strength" ["µm/step²"] FORCE;
        /// Distance over which the force sets in.
        pub ramp_um: Schedule = "Containment ramp" ["µm"] Range::of(1.0, 1000.0);
        /// Ratio of the y radius to the x radius of the ellipse.
        pub squash: Schedule = "Squash" [""] Range::of(0.3, 1.5);
        /// Spacing s of fold strands, which gives the region its size: `R_in` = sqrt(n·edge·s / (π·squash)).
        pub spacing_um: Schedule = "Strand spacing" ["µm"] Range::of(10.0, 1000.0);
        /// Thickness of the wall: `R_wall` − `R_in`.
        pub wall_um: Schedule = "Wall thickness" ["µm"] Range::of(20.0, 5000.0);
    }
}

group! {
    /// Regulatory force of the paper: toward the anchor, the point of the inner ellipse nearest to where the
    /// particle was made.
    #[derive(Clone, Debug, PartialEq)]
    pub struct Regulatory {
        /// Strength.
        pub strength: Schedule = "Regulatory strength" ["µm/step²"] FORCE;
        /// Distance to the anchor under which the force fades.
        pub softening_um: Schedule = "Regulatory softening" ["µm"] Range::of(1.0, 1000.0);
    }
}

group! {
    /// Contortion force of the paper: along the normal of the two neighbours, times angle/180°, m and c.
    #[derive(Clone, Debug, PartialEq)]
    pub struct Contortion {
        /// Fraction of the particles that are contorted.
        pub fraction: f64 = "Contorted fraction" [""] Range::of(0.0, 1.0);
        /// Magnitude m.
        pub magnitude: Schedule = "Contortion magnitude" ["µm/step²"] FORCE;
        /// Period of the global modifier c, which swings through [−1, 1].
        pub period: f64 = "Contortion period" ["steps"] Range::of(4.0, 1e6);
    }
}

group! {
    /// Self-intersection force of the paper, with the barrier and the guard that keep walls from crossing.
    #[derive(Clone, Debug, PartialEq)]
    pub struct Collision {
        /// Strength kr.
        pub strength: Schedule = "Self-intersection strength" ["µm/step²"] FORCE;
        /// Range Dt across tissue.
        pub tissue_um: Schedule = "Tissue thickness" ["µm"] Range::of(5.0, 1000.0);
        /// Range Dg across the lumen gap.
        pub gap_um: Schedule = "Lumen gap" ["µm"] Range::of(5.0, 1000.0);
        /// Reference range: the force is scaled by `reference_um`/D, so that thick sides do not crush thin ones.
        pub reference_um: f64 = "Reference range" ["µm"] Range::of(1.0, 1000.0);
        /// Strength fb of the barrier, an extra force fb(`barrier_um`/d − 1).
        pub barrier: Schedule = "Barrier strength" ["µm/step²"] FORCE;
        /// Distance under which the barrier acts; 0 switches it off.
        pub barrier_um: Schedule = "Barrier range" ["µm"] Range::of(0.0, 20.0);
        /// Least clearance `g_min` that the guard keeps.
        pub clearance_um: f64 = "Least clearance" ["µm"] Range::of(0.01, 1.0);
    }
}

group! {
    /// A smooth random field that varies thickness and gap: an answer to the first limit that the paper names.
    #[derive(Clone, Debug, PartialEq)]
    pub struct Variation {
        /// Amplitude a: ranges are scaled by exp(a·z). 0 switches the field off.
        pub amplitude: Schedule = "Variation amplitude" [""] Range::of(0.0, 1.0);
        /// Wavelength.
        pub wavelength_um: f64 = "Variation wavelength" ["µm"] Range::of(20.0, 10_000.0);
        /// Phase drift along the tube.
        pub drift: f64 = "Variation drift" ["rad/step"] DRIFT;
    }
}

group! {
    /// Slow lobed noise of the outer wall.
    #[derive(Clone, Debug, PartialEq)]
    pub struct Wall {
        /// Amplitude as a fraction of the radius.
        pub lobing: Schedule = "Lobing" ["of the radius"] Range::of(0.0, 0.3);
        /// Highest number of lobes.
        pub lobes: u32 = "Lobes" ["lobes"] Count::of(1, 16);
        /// Phase drift along the tube.
        pub drift: f64 = "Lobe drift" ["rad/step"] DRIFT;
    }
}

group! {
    /// How the model is computed.
    #[derive(Clone, Debug, PartialEq, Eq)]
    pub struct Solver {
        /// Time integration.
        pub integrator: Integrator = "Integrator" [""] ();
        /// Neighbour search; it changes speed, never results.
        pub search: Search = "Neighbour search" [""] ();
        /// Steps between recorded sections.
        pub record_every: u32 = "Recording interval" ["steps"] Count::of(1, MAX_INTERVAL);
    }
}

group! {
    /// Options of the exported surface.
    #[derive(Clone, Debug, PartialEq, Eq)]
    pub struct MeshOptions {
        /// Write the walls as triangle strips, as in the paper.
        pub strips: bool = "Triangle strips" [""] ();
    }
}

choice! {
    /// Time integration scheme.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub enum Integrator {
        /// Runge–Kutta of fourth order.
        Rk4 = "rk4",
        /// Semi-implicit Euler.
        Euler = "euler",
    }
}

choice! {
    /// Neighbour search.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub enum Search {
        /// Lists of blocks of consecutive segments, kept while displacements stay bounded.
        Lists = "lists",
        /// Uniform grid rebuilt for each evaluation.
        Grid = "grid",
        /// Every pair, as in the paper.
        AllPairs = "all_pairs",
    }
}
