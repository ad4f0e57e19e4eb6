//! The table of all parameters: the only definition of their names, units, bounds and meaning.
//!
//! Structs, readers, canonical JSON and JSON Schema are generated from the table (see
//! [`super::table`]). Defaults come from the presets. Rules between parameters are in
//! [`super::check`]. The forces are those of the paper's section 3, with bending, barrier and guard
//! added. The time step and the mass of a particle are 1.

use super::bounds::{Count, Range};
use super::fault::child;
use super::schedule::Schedule;
use super::table::{Field, Kind, Parameter as _, choice, group};
use std::sync::LazyLock;

/// Maximum number of particles of both loops.
pub const MAX_PARTICLES: u32 = 200_000;
/// Maximum number of clefts.
const MAX_CLEFTS: u32 = 64;
/// Maximum number of time steps.
pub const MAX_STEPS: u32 = 100_000;
/// Maximum number of steps between two recorded sections. They are kept in memory until the slab
/// between the two sections is tested.
const MAX_INTERVAL: u32 = 1000;

/// Strength of a force between particles, µm/step².
const FORCE: Range = Range::of(0.0, 20.0).because("the guard would limit stronger forces in every step");
/// Phase drift along the tube, radians per step.
const DRIFT: Range =
    Range::of(0.0, 0.5).because("with a faster drift, neighbouring sections would no longer resemble each other");

group! {
    /// All parameters of a model. Lengths in micrometres unless the name says otherwise; time in
    /// steps; mass 1. A step is also a place along the tube, see [`Parameters::z`].
    #[derive(Clone, Debug, PartialEq)]
    pub struct Parameters {
        /// Length of the tube in millimetres.
        pub length_mm: f64 = "Length" ["mm"] Range::of(0.1, 1000.0);
        /// Ratio of the size of the organ to the size of the simulation: the sections are enlarged
        /// by this factor. All lengths across the tube refer to the simulation, except those of
        /// `lean`, `mesh`, `course`, `histology` and `labels`. An organ of several centimetres is
        /// therefore simulated as a small one, whose folds are some hundred micrometres apart.
        pub scale: f64 = "Scale" [""] Range::of(0.01, 100.0);
        /// Time steps from the isthmus end to the ampulla end.
        pub steps: u32 = "Time steps" ["steps"] Count::of(1, MAX_STEPS);
        /// Steps with the parameters of step 0 before the first section is recorded.
        pub burn_in: u32 = "Burn-in" ["steps"] Count::of(0, MAX_STEPS);
        /// Place along the tube, as a fraction of its length, over the fraction of the steps.
        /// Strictly increases from 0 to 1.
        pub z: Schedule = "Place along the tube" ["of the length"] Range::of(0.0, 1.0).steady();
        /// Number of particles, and where new ones are added.
        pub particles: Particles = "Particles" [""] ();
        /// Spring between neighbours.
        pub spring: Spring = "Spring force" [""] ();
        /// Friction strength: the force is −k·v.
        pub friction: Schedule = "Friction" ["1/step"]
            Range::of(0.0, 2.5).because("the integration is unstable above it");
        /// Bending stiffness: the force follows the normal component of the second difference of
        /// positions.
        pub bending: Schedule = "Bending stiffness" ["1/step²"]
            Range::of(0.0, 0.5).because("the integration is unstable above it");
        /// Containment region.
        pub containment: Containment = "Containment force" [""] ();
        /// Outline of the containment region.
        pub outline: Outline = "Outline" [""] ();
        /// Folds across the tube.
        pub folds: Folds = "Transverse folds" [""] ();
        /// Regulatory force toward the anchor.
        pub regulatory: Regulatory = "Regulatory force" [""] ();
        /// Clefts between the primary folds.
        pub primary: Primary = "Primary folds" [""] ();
        /// Contortion of individual particles.
        pub contortion: Contortion = "Contortion force" [""] ();
        /// Self-intersection force, barrier and guard.
        pub collision: Collision = "Self-intersection force" [""] ();
        /// Random variation of tissue thickness and lumen gap.
        pub variation: Variation = "Thickness variation" [""] ();
        /// Random differences between folds around the wall.
        pub variety: Variety = "Variety around the wall" [""] ();
        /// Slow sideways motion of the fronds.
        pub sway: Sway = "Sway" [""] ();
        /// Displacement of the surface along the tube.
        pub lean: Lean = "Lean" [""] ();
        /// Slow lobes of the outer wall.
        pub wall: Wall = "Outer wall" [""] ();
        /// Integrator, neighbour search, recording.
        pub solver: Solver = "Solver" [""] ();
        /// Options of the exported surface.
        pub mesh: MeshOptions = "Surface" [""] ();
        /// The centre line that the tube follows.
        pub course: Course = "Course" [""] ();
        /// Wave of contraction, as a series of frames.
        pub contraction: Contraction = "Contraction" [""] ();
        /// Piece of the tube that becomes the model.
        pub piece: Piece = "Piece" [""] ();
        /// Regions of the tube for which measures are reported.
        pub regions: Regions = "Regions" [""] ();
        /// Layers of the wall in stained sections and label volumes. They do not affect the
        /// surface.
        pub histology: Histology = "Histology" [""] ();
        /// Label volume of the output `labels`.
        pub labels: Labels = "Label volume" [""] ();
    }
}

group! {
    /// Particle counts and growth.
    #[derive(Clone, Debug, PartialEq)]
    pub struct Particles {
        /// Number of particles of both loops. Must neither decrease nor fluctuate.
        pub total: Schedule = "Particles of both loops" ["particles"] Range::of(28.0, MAX_PARTICLES as f64).steady();
        /// Number of particles of the outer loop, which `total` includes. Must neither decrease nor
        /// fluctuate.
        pub outer: Schedule = "Particles of the outer loop" ["particles"] Range::of(12.0, MAX_PARTICLES as f64).steady();
        /// Steps between growth events.
        pub every: u32 = "Growth interval" ["steps"] Count::of(1, 1000);
        /// Rest length that edges relax to.
        pub edge_um: Schedule = "Edge length" ["µm"] Range::of(1.0, 100.0);
        /// Weight of the curvature at fold tips in the choice of the edge to split. At 0, only the
        /// length of an edge counts.
        pub tip_weight: Schedule = "Growth at fold tips" [""] Range::of(0.0, 100.0);
        /// Growth where edges have room: the logarithm of the growth rate of an edge is this weight
        /// times the relative excess of its length over `edge_um`. Compressed edges grow less.
        pub room_weight: Schedule = "Growth where edges have room" [""] Range::of(0.0, 50.0);
        /// Random candidate edges in each tournament for the edge to split.
        pub candidates: u32 = "Candidates per tournament" ["edges"] Count::of(1, 64);
    }
}

group! {
    /// Spring force of the paper: −(k(x−r) + c·v) along an edge of length x and rest length r.
    #[derive(Clone, Debug, PartialEq)]
    pub struct Spring {
        /// Spring strength k.
        pub stiffness: Schedule = "Spring strength" ["1/step²"]
            Range::of(0.0, 2.0).because("the integration is unstable above it");
        /// Damping strength c, applied to the relative velocity along the edge.
        pub damping: Schedule = "Spring damping" ["1/step"]
            Range::of(0.0, 0.7).because("the integration is unstable above it");
        /// Fraction of the difference to `edge_um` by which a rest length relaxes in each step.
        pub relaxation: Schedule = "Rest length relaxation" ["1/step"] Range::of(0.0, 1.0);
    }
}

group! {
    /// Containment force of the paper: pulls particles outside the inner ellipse toward the centre.
    #[derive(Clone, Debug, PartialEq)]
    pub struct Containment {
        /// Strength.
        pub strength: Schedule = "Containment strength" ["µm/step²"] FORCE;
        /// Distance outside the ellipse over which the force rises to its full strength.
        pub ramp_um: Schedule = "Containment ramp" ["µm"] Range::of(1.0, 1000.0);
        /// Ratio of the y radius to the x radius of the ellipse.
        pub squash: Schedule = "Squash" [""] Range::of(0.3, 1.5);
        /// Spacing s of fold strands. Determines the size of the region: `R_in` = sqrt(n·edge·s /
        /// (π·squash)) for n particles of the inner loop.
        pub spacing_um: Schedule = "Strand spacing" ["µm"] Range::of(10.0, 1000.0);
        /// Thickness of the wall: `R_wall` − `R_in`.
        pub wall_um: Schedule = "Wall thickness" ["µm"] Range::of(20.0, 5000.0);
    }
}

group! {
    /// Outline of the region that contains the folds, where it is not the ellipse of `containment`.
    /// It is given in units of `R_in` in the flattened plane (x, y/squash), in which the ellipse is
    /// the circle of radius 1. Each ray from the axis must meet it once. Not in the paper.
    #[derive(Clone, Debug, PartialEq)]
    pub struct Outline {
        /// Kind of the outline.
        pub kind: OutlineKind = "Outline" [""] ();
        /// Blend between the ellipse (0) and this outline (1).
        pub strength: Schedule = "Strength of the outline" [""] Range::of(0.0, 1.0);
        /// Exponent n of a superellipse |x|ⁿ + |y|ⁿ = 1: 1 is a rhomb, 2 the ellipse, 20 nearly a
        /// rectangle.
        pub exponent: f64 = "Exponent" [""] Range::of(0.7, 20.0);
        /// Corners of a polygon around the axis, in order.
        pub points: Vec<[f64; 2]> = "Corners" ["R_in"] Range::of(-3.0, 3.0);
        /// Signed distances at the nodes of a square grid around the axis, negative inside, in rows
        /// from the smallest y to the largest. The outline is where they are 0. Only signs and
        /// ratios matter, so any function works whose sign changes at the outline.
        pub grid: Vec<Vec<f64>> = "Signed distances" ["R_in"] Range::of(-1e6, 1e6);
        /// Half the side of the grid.
        pub grid_half: f64 = "Half side of the grid" ["R_in"] Range::of(0.3, 10.0);
    }
}

group! {
    /// Folds across the tube, where the region is drawn in: the semilunar folds between the haustra
    /// of a colon, the circular folds of a small intestine. They stand in rows around the tube. Not
    /// in the paper.
    #[derive(Clone, Debug, PartialEq)]
    pub struct Folds {
        /// Height of the folds; 0 for none.
        pub depth: Schedule = "Height of the folds" ["of the radius"] Range::of(0.0, 0.7);
        /// Rows around the tube.
        pub rows: u32 = "Rows" ["rows"] Count::of(1, 16);
        /// Width of the bands without folds between the rows, such as the taeniae of a colon.
        pub band: f64 = "Bands between the rows" ["of a row"] Range::of(0.0, 0.9);
        /// Distance between two folds of a row along the tube.
        pub period_mm: f64 = "Distance between folds" ["mm"] Range::of(0.01, 1000.0);
        /// Offset along the tube between a row and the next one.
        pub stagger: f64 = "Stagger of the rows" ["of the distance"] Range::of(0.0, 1.0);
        /// Maximum random shift of a fold along the tube.
        pub irregularity: f64 = "Irregularity" ["of the distance"] Range::of(0.0, 0.5);
        /// Fraction of the fold height by which the outer wall is drawn in, too: 1 for haustra, 0
        /// for folds of the mucosa alone.
        pub wall: f64 = "Fold depth of the outer wall" [""] Range::of(0.0, 1.0);
    }
}

group! {
    /// Regulatory force of the paper: toward the anchor, the point of the inner ellipse nearest to
    /// the place where the particle was added.
    #[derive(Clone, Debug, PartialEq)]
    pub struct Regulatory {
        /// Strength.
        pub strength: Schedule = "Regulatory strength" ["µm/step²"] FORCE;
        /// Distance to the anchor below which the force decreases to zero.
        pub softening_um: Schedule = "Regulatory softening" ["µm"] Range::of(1.0, 1000.0);
    }
}

group! {
    /// Clefts between the primary folds. A cleft has a fixed direction; the directions are random,
    /// and far from each other. With clefts, a new particle has the mean anchor of its two
    /// neighbours, so that the anchors keep their order along the loop. Not in the paper.
    #[derive(Clone, Debug, PartialEq)]
    pub struct Primary {
        /// Number of clefts, which is the number of primary folds. With 8.3, eight clefts act fully
        /// and a ninth acts with 0.3 of the strength. 0 disables the clefts.
        pub clefts: Schedule = "Clefts" ["clefts"] Range::of(0.0, MAX_CLEFTS as f64).steady();
        /// Additional regulatory strength at the bottom of a cleft, which holds it at the wall.
        pub hold: Schedule = "Hold of a cleft" ["µm/step²"] FORCE;
        /// Distance along the wall from the bottom of a cleft at which the hold falls to 1/e.
        pub width_um: f64 = "Width of a cleft" ["µm"] Range::of(1.0, 1000.0);
        /// Fraction by which growth is reduced at the bottom of a cleft.
        pub spare: f64 = "Reduced growth in clefts" [""] Range::of(0.0, 1.0);
        /// Strength of the force toward the ray from the axis to the anchor. Folds then point from
        /// the wall to the axis.
        pub guide: Schedule = "Guidance along rays" ["µm/step²"] FORCE;
        /// Distance from the ray below which the guidance decreases to zero.
        pub reach_um: f64 = "Softening of the guidance" ["µm"] Range::of(1.0, 1000.0);
    }
}

group! {
    /// Contortion force of the paper: along the normal to the line between the two neighbours,
    /// times angle/180°, m and c.
    #[derive(Clone, Debug, PartialEq)]
    pub struct Contortion {
        /// Fraction of the particles that are contorted.
        pub fraction: f64 = "Contorted fraction" [""] Range::of(0.0, 1.0);
        /// Magnitude m.
        pub magnitude: Schedule = "Contortion magnitude" ["µm/step²"] FORCE;
        /// Period of the global modifier c, a sine between −1 and 1.
        pub period: f64 = "Contortion period" ["steps"] Range::of(4.0, 1e6);
    }
}

group! {
    /// Self-intersection force of the paper, with the barrier and the guard that keep walls from
    /// crossing.
    #[derive(Clone, Debug, PartialEq)]
    pub struct Collision {
        /// Strength kr.
        pub strength: Schedule = "Self-intersection strength" ["µm/step²"] FORCE;
        /// Range Dt of the force across tissue.
        pub tissue_um: Schedule = "Tissue thickness" ["µm"] Range::of(5.0, 1000.0);
        /// Range Dg of the force across the lumen gap.
        pub gap_um: Schedule = "Lumen gap" ["µm"] Range::of(5.0, 1000.0);
        /// Reference range: the force is scaled by `reference_um`/D, so that long ranges do not
        /// overpower short ones.
        pub reference_um: f64 = "Reference range" ["µm"] Range::of(1.0, 1000.0);
        /// Strength fb of the barrier, an additional force fb(`barrier_um`/d − 1) at distance d.
        pub barrier: Schedule = "Barrier strength" ["µm/step²"] FORCE;
        /// Distance below which the barrier acts; 0 disables it.
        pub barrier_um: Schedule = "Barrier range" ["µm"] Range::of(0.0, 20.0);
        /// Minimum distance `g_min` between walls, which the guard maintains.
        pub clearance_um: f64 = "Minimum clearance" ["µm"] Range::of(0.01, 1.0);
    }
}

group! {
    /// A smooth random field that varies tissue thickness and lumen gap; without it both are
    /// uniform, as in the paper.
    #[derive(Clone, Debug, PartialEq)]
    pub struct Variation {
        /// Amplitude a. Ranges are scaled by exp(a·z), where z is a field of unit variance. 0
        /// disables the field.
        pub amplitude: Schedule = "Variation amplitude" [""] Range::of(0.0, 1.0);
        /// Mean wavelength of the field.
        pub wavelength_um: f64 = "Variation wavelength" ["µm"] Range::of(20.0, 10_000.0);
        /// Maximum phase drift of the field per step.
        pub drift: f64 = "Variation drift" ["rad/step"] DRIFT;
    }
}

group! {
    /// Random differences around the wall: functions of the angle of a fold's base, which drift
    /// slowly along the tube. Strengths of zero disable them. Not in the paper.
    #[derive(Clone, Debug, PartialEq)]
    pub struct Variety {
        /// Amplitude of the logarithm of the growth rate between the two sides of the tube: folds
        /// are longer on one side.
        pub asymmetry: Schedule = "Asymmetry" [""] Range::of(0.0, 1.0);
        /// Root mean square of the logarithm of the growth rate around the wall: folds of different
        /// heights stand side by side.
        pub height: Schedule = "Variety of fold height" [""] Range::of(0.0, 1.0);
        /// Root mean square of the logarithm of the ranges `tissue_um` and `gap_um` around the
        /// wall: folds have different thicknesses.
        pub thickness: Schedule = "Variety of fold thickness" [""] Range::of(0.0, 0.5);
        /// Root mean square shift of growth and ranges along the tube, which differs around the
        /// wall, as a fraction of all steps. Where the schedules change, for example at the
        /// junction, some folds change earlier than others.
        pub shift: Schedule = "Shift along the tube" [""] Range::of(0.0, 0.5);
        /// Maximum number of maxima around the wall.
        pub waves: u32 = "Waves around the wall" ["waves"] Count::of(2, 64);
        /// Maximum phase drift per step.
        pub drift: f64 = "Variety drift" ["rad/step"] DRIFT;
    }
}

group! {
    /// A smooth random flow that carries the fronds sideways from section to section, most near the
    /// axis; the wall holds their bases. Not in the paper.
    #[derive(Clone, Debug, PartialEq)]
    pub struct Sway {
        /// Root mean square speed of the flow. 0 disables the sway.
        pub strength: Schedule = "Sway" ["µm/step"] Range::of(0.0, 5.0).because("the guard would limit faster motion in every step");
        /// Mean wavelength of the flow.
        pub wavelength_um: f64 = "Sway wavelength" ["µm"] Range::of(20.0, 100_000.0);
        /// Mean period of the flow.
        pub period: f64 = "Sway period" ["steps"] Range::of(4.0, 1e6);
    }
}

group! {
    /// A smooth random displacement of the finished surface along the tube. A plane across the tube
    /// then meets neighbouring fronds at different steps; where fronds sway, it cuts some of them
    /// apart, and they appear as islands. Not in the paper.
    #[derive(Clone, Debug, PartialEq)]
    pub struct Lean {
        /// Root mean square displacement. No displacement exceeds twice this value. 0 disables the
        /// lean.
        pub strength_um: Schedule = "Lean" ["µm"] Range::of(0.0, 5000.0).steady();
        /// Mean wavelength across the tube.
        pub wavelength_um: f64 = "Lean wavelength" ["µm"] Range::of(20.0, 100_000.0);
        /// Wavelength along the tube.
        pub along_mm: f64 = "Lean wavelength along the tube" ["mm"] Range::of(0.1, 10_000.0);
        /// Distance from either end of the model over which the displacement increases from zero,
        /// so the ends stay planar.
        pub ends_mm: f64 = "Planar ends" ["mm"] Range::of(0.1, 1000.0);
    }
}

group! {
    /// Lobes of the outer wall that change slowly along the tube.
    #[derive(Clone, Debug, PartialEq)]
    pub struct Wall {
        /// Amplitude of the lobes as a fraction of the radius.
        pub lobing: Schedule = "Lobing" ["of the radius"] Range::of(0.0, 0.3);
        /// Maximum number of lobes around the tube.
        pub lobes: u32 = "Lobes" ["lobes"] Count::of(1, 16);
        /// Maximum phase drift of the lobes per step.
        pub drift: f64 = "Lobe drift" ["rad/step"] DRIFT;
    }
}

group! {
    /// How the model is computed.
    #[derive(Clone, Debug, PartialEq, Eq)]
    pub struct Solver {
        /// Time integration.
        pub integrator: Integrator = "Integrator" [""] ();
        /// Neighbour search. Affects only the speed, never the result.
        pub search: Search = "Neighbour search" [""] ();
        /// Steps between two recorded sections. The first and the last step are always recorded.
        pub record_every: u32 = "Recording interval" ["steps"] Count::of(1, MAX_INTERVAL);
    }
}

group! {
    /// Options of the exported surface.
    #[derive(Clone, Debug, PartialEq)]
    pub struct MeshOptions {
        /// Edge length of an even surface through the sections of all steps; edges of the outer
        /// wall are twice as long. At 0, the vertices of the surface are the particles of the
        /// recorded sections, as in the paper.
        pub resolution_um: f64 = "Resolution" ["µm"] Range::of(0.0, 500.0);
        /// Maximum distance, in both directions, between the even surface and the surface through
        /// all particles of all steps.
        pub tolerance_um: f64 = "Tolerance" ["µm"] Range::of(1.0, 50.0);
        /// Maximum distance by which contours are moved to round sharp angles. At 5, no two
        /// adjacent edges of a contour turn by more than 60 degrees. At 0, contours keep the angles
        /// at the particles, as in the paper.
        pub smooth_um: f64 = "Smoothing" ["µm"] Range::of(0.0, 20.0);
        /// Write the walls as triangle strips, as in the paper, instead of separate triangles.
        pub strips: bool = "Triangle strips" [""] ();
        /// Write `model.glb` and `model.gltf` with texture coordinates and textures: cells and
        /// relief of the mucosa, fibres and vessels of the serosa, stained sections at both ends.
        /// Positions and triangles stay the same. Not for even surfaces.
        pub textured: bool = "Textures" [""] ();
    }
}

group! {
    /// The centre line that the finished surface follows. The simulation does not depend on it, nor
    /// do the sections: they lie across the centre line, whose length is `length_mm`. Not in the
    /// paper, whose tubes are straight.
    #[derive(Clone, Debug, PartialEq)]
    pub struct Course {
        /// Kind of the curve. All curves except `points` begin at the origin in the direction of z.
        pub shape: CourseShape = "Shape" [""] ();
        /// Angle by which an arc turns, or to which a sigmoid swings.
        pub turn_deg: f64 = "Turn" ["°"] Range::of(0.1, 720.0);
        /// Number of windings of a coil.
        pub windings: f64 = "Windings" [""] Range::of(0.1, 1000.0);
        /// Advance of a coil per winding.
        pub pitch_mm: f64 = "Pitch" ["mm"] Range::of(0.01, 1000.0);
        /// Ratio of the length of a random course to the distance between its ends.
        pub tortuosity: f64 = "Tortuosity" [""] Range::of(1.001, 10.0);
        /// Mean wavelength of a random course.
        pub wavelength_mm: f64 = "Wavelength" ["mm"] Range::of(0.1, 10_000.0);
        /// Seed of a random course. It is independent of the seed of the model, so different models
        /// can follow the same course, and the same folds different courses.
        pub seed: u32 = "Seed of the course" [""] Count::of(0, u32::MAX);
        /// Points of the centre line, from the isthmus end. The centre line passes through all of
        /// them and is then scaled around the first point to the length `length_mm`.
        pub points_mm: Vec<[f64; 3]> = "Points" ["mm"] Range::of(-10_000.0, 10_000.0);
        /// Twist of the tube around the centre line from end to end, relative to frames of minimum
        /// rotation.
        pub twist_deg: f64 = "Twist" ["°"] Range::of(-3600.0, 3600.0);
        /// Minimum distance between the outer walls of distant parts of the tube that approach each
        /// other.
        pub clearance_um: f64 = "Distance between distant parts" ["µm"] Range::of(1.0, 1e6);
        /// Change a course as little as needed, instead of refusing it, if it is too tight or
        /// approaches itself too closely.
        pub relax: bool = "Relax" [""] ();
    }
}

group! {
    /// A wave of contraction that travels along the finished tube. Each frame of one period is a
    /// surface of its own with the vertices and triangles of the model, which is the tube at rest:
    /// tissue keeps its volume, the lumen gives way. Not in the paper.
    #[derive(Clone, Debug, PartialEq)]
    pub struct Contraction {
        /// Number of frames of one period; 0 for no contraction.
        pub frames: u32 = "Frames" ["frames"] Count::of(0, 200);
        /// Fraction of the lumen that is closed at the crest of the wave. It is smaller where folds
        /// leave no room for the tissue.
        pub closure: Schedule = "Closure of the lumen" ["of the lumen"] Range::of(0.0, 0.9).steady();
        /// Fraction by which the tube is shortened at the crest.
        pub shortening: Schedule = "Shortening" ["of the length"] Range::of(0.0, 0.3).steady();
        /// Wavelength.
        pub wavelength_mm: Schedule = "Wavelength" ["mm"] Range::of(0.5, 1000.0).steady();
        /// Wavelengths between the isthmus end of the model and a crest in the first frame.
        pub phase: f64 = "Phase" ["of the wavelength"] Range::of(0.0, 1.0);
        /// Direction in which the wave travels.
        pub toward: Toward = "Direction" [""] ();
        /// Period.
        pub period_s: f64 = "Period" ["s"] Range::of(0.01, 3600.0);
        /// Distance from either end of the model over which the wave increases from zero.
        pub ends_mm: f64 = "Relaxed ends" ["mm"] Range::of(0.1, 1000.0);
    }
}

group! {
    /// The piece of the tube that is recorded: surface, sections, measures and labels. It reaches
    /// from the last recorded section that is not after its begin to the first that is not before
    /// its end. The simulation begins at the isthmus end all the same.
    #[derive(Clone, Debug, PartialEq)]
    pub struct Piece {
        /// Start of the piece, as a fraction of the length from the isthmus end.
        pub from: f64 = "Start" ["of the length"] Range::of(0.0, 1.0);
        /// End of the interval; greater than `from`.
        pub to: f64 = "End" ["of the length"] Range::of(0.0, 1.0);
    }
}

group! {
    /// Where measures divide the tube: isthmus, ampullary–isthmic junction, ampulla. The surface
    /// does not depend on it.
    #[derive(Clone, Debug, PartialEq)]
    pub struct Regions {
        /// Start of the junction.
        pub junction_from: f64 = "Start of the junction" ["of the length"] Range::of(0.0, 1.0);
        /// End of the junction.
        pub junction_to: f64 = "End of the junction" ["of the length"] Range::of(0.0, 1.0);
    }
}

group! {
    /// Layers between the lumen and the outside, drawn in stained sections and written as labels.
    /// Keys of schedules are fractions of the length of the tube.
    #[derive(Clone, Debug, PartialEq)]
    pub struct Histology {
        /// Height of the epithelium along the lumen. Folds thinner than twice this height consist
        /// of epithelium only.
        pub epithelium_um: Schedule = "Epithelium height" ["µm"] Range::of(1.0, 200.0).steady();
        /// Minimum thickness of the lamina propria between epithelium and muscle.
        pub lamina_um: Schedule = "Lamina propria under the epithelium" ["µm"]
            Range::of(0.0, 1000.0).steady();
        /// Radius of a disc that fits into every part of the muscle: half the width of the widest
        /// core of a fold that contains no muscle.
        pub opening_um: Schedule = "Half width of a core without muscle" ["µm"]
            Range::of(0.0, 5000.0).steady();
        /// Thickness of a longitudinal layer inside the circular muscle. It takes at most 40 % of
        /// the muscle.
        pub inner_longitudinal_um: Schedule = "Inner longitudinal muscle" ["µm"]
            Range::of(0.0, 1000.0).steady();
        /// Fraction of the muscle's thickness that the outer longitudinal layer takes; the circular
        /// layer takes the rest.
        pub longitudinal_share: Schedule = "Longitudinal share of the muscle" [""]
            Range::of(0.0, 1.0).steady();
        /// Share of the circumference that the outer longitudinal layer covers. Below 1, it
        /// consists of bundles with circular muscle between them.
        pub longitudinal_cover: Schedule = "Cover of the longitudinal muscle" ["of the circumference"]
            Range::of(0.0, 1.0).steady();
        /// Thickness of the loose connective tissue between muscle and serosa; three times as much
        /// at the mesosalpinx, which lies in the direction of −y.
        pub subserosa_um: Schedule = "Subserosa thickness" ["µm"] Range::of(0.0, 1000.0).steady();
        /// Thickness of the serosa.
        pub serosa_um: Schedule = "Serosa thickness" ["µm"] Range::of(0.0, 1000.0).steady();
        /// Number of larger vessels in a section: half of them between the muscles, half of them in
        /// the subserosa.
        pub vessels: Schedule = "Vessels" ["vessels"] Range::of(0.0, 64.0).steady();
    }
}

group! {
    /// The part of the model (of its `piece` of the tube) that output `labels` covers, and its
    /// voxels.
    #[derive(Clone, Debug, PartialEq)]
    pub struct Labels {
        /// Side of a voxel in the plane of a section.
        pub voxel_um: f64 = "Voxel side" ["µm"] Range::of(0.5, 100.0);
        /// Side of a voxel along the tube: the distance between two slices.
        pub slice_um: f64 = "Distance between slices" ["µm"] Range::of(0.5, 1000.0);
        /// Start of the labelled part, as a fraction of the length of the piece.
        pub from: f64 = "Start" ["of the piece"] Range::of(0.0, 1.0);
        /// End of the interval; greater than `from`.
        pub to: f64 = "End" ["of the piece"] Range::of(0.0, 1.0);
    }
}

choice! {
    /// Curves that a tube can follow.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub enum CourseShape {
        /// Straight line along z.
        Straight = "straight",
        /// Part of a circle: `turn_deg`.
        Arc = "arc",
        /// S-shaped curve: `turn_deg` to the side and back.
        Sigmoid = "sigmoid",
        /// A helix: `windings`, `pitch_mm`.
        Coil = "coil",
        /// Random curve: `tortuosity`, `wavelength_mm`, `seed`.
        Random = "random",
        /// Curve through `points_mm`.
        Points = "points",
    }
}

choice! {
    /// Ends toward which a wave travels.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub enum Toward {
        /// From the ampulla to the isthmus.
        Uterus = "uterus",
        /// From the isthmus to the ampulla.
        Ovary = "ovary",
    }
}

choice! {
    /// Outlines of the region that contains the folds.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub enum OutlineKind {
        /// The ellipse of `containment`.
        Ellipse = "ellipse",
        /// Rhomb, ellipse or rectangle, or a shape in between: `exponent`.
        Superellipse = "superellipse",
        /// Polygon with the corners `points`.
        Polygon = "polygon",
        /// Curve where `grid` is 0.
        Grid = "grid",
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
        /// Lists of blocks of consecutive segments, reused while displacements are small.
        Lists = "lists",
        /// Uniform grid, rebuilt for every evaluation of the forces.
        Grid = "grid",
        /// All pairs, as in the paper.
        AllPairs = "all_pairs",
    }
}

/// The fields of [`Parameters`], groups included.
pub(super) fn table() -> &'static [Field] {
    static TABLE: LazyLock<Vec<Field>> = LazyLock::new(|| match Parameters::kind(()) {
        Kind::Group(fields) => fields,
        _ => Vec::new(),
    });
    &TABLE
}

/// All parameters except groups, with their JSON pointers, in the order of the table.
pub(super) fn leaves() -> Vec<(String, &'static Field)> {
    fn collect(fields: &'static [Field], at: &str, found: &mut Vec<(String, &'static Field)>) {
        for field in fields {
            let here = child(at, field.name);
            match &field.kind {
                Kind::Group(fields) => collect(fields, &here, found),
                _ => found.push((here, field)),
            }
        }
    }
    let mut found = Vec::new();
    collect(table(), "", &mut found);
    found
}
