//! Plain data shared with the shaders: every field is four bytes wide, and there is no padding.

use bytemuck::{Pod, Zeroable};

/// Number of particles, and of segments, in a block on a GPU.
pub const LANES: usize = 16;

/// Distance by which the lists on a GPU extend beyond the range of the forces, µm.
pub(super) const DEVICE_SKIN: f32 = 20.0;

/// All parameters of one time step, sampled from the schedules. [`crate::spec`] explains their
/// physical meaning.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
pub struct StepRow {
    /// Spring stiffness k.
    pub stiffness: f32,
    /// Spring damping c.
    pub damping: f32,
    /// Fraction by which rest lengths relax.
    pub relaxation: f32,
    /// Length to which the rest lengths of edges relax, µm.
    pub edge: f32,
    /// Friction.
    pub friction: f32,
    /// Bending stiffness.
    pub bending: f32,
    /// Containment strength.
    pub containment: f32,
    /// Containment ramp, µm.
    pub ramp: f32,
    /// y radius over x radius.
    pub squash: f32,
    /// Inner radius of the containment region, µm (x axis).
    pub r_in: f32,
    /// Outer radius of the containment region, µm (x axis).
    pub r_wall: f32,
    /// Regulatory strength.
    pub regulatory: f32,
    /// Regulatory softening, µm.
    pub softening: f32,
    /// Contortion magnitude m times c(t) at the start, in the middle and at the end of the step.
    pub contortion: [f32; 3],
    /// kr times the reference range, µm.
    pub repulsion: f32,
    /// (Dg + Dt)/2, µm.
    pub range_mean: f32,
    /// (Dg − Dt)/2, µm.
    pub range_half: f32,
    /// Barrier strength fb.
    pub barrier: f32,
    /// Barrier distance, µm.
    pub barrier_distance: f32,
    /// Amplitude a of the thickness field.
    pub variation: f32,
    /// Weight of fold-tip curvature in the growth score.
    pub tip_weight: f32,
    /// Lobing of the outer wall, fraction of its radius.
    pub lobing: f32,
    /// Spring stiffness of the outer wall.
    pub wall_stiffness: f32,
    /// Spring damping of the outer wall.
    pub wall_damping: f32,
    /// Friction of the outer wall.
    pub wall_friction: f32,
    /// Friction times the root mean square speed of the sway.
    pub sway: f32,
    /// Amplitude of the logarithm of the growth rate between the sides of the tube.
    pub asymmetry: f32,
    /// Root mean square of the logarithm of the growth rate around the wall.
    pub height: f32,
    /// Root mean square of the logarithm of the force ranges around the wall.
    pub thickness: f32,
    /// Change of the logarithm of the growth rate, and of the force ranges, per root mean square
    /// shift along the tube.
    pub shift: [f32; 2],
    /// Strength of the outline.
    pub outline: f32,
    /// Height of the transverse folds divided by the radius.
    pub fold: f32,
    /// Part of the fold height by which the wall is drawn in.
    pub fold_of_wall: f32,
    /// Phase of the folds, turns.
    pub fold_phase: f32,
    /// Minimum thickness of the wall as a difference of gauges, µm.
    pub margin: f32,
    /// Number of clefts between primary folds.
    pub clefts: f32,
    /// Regulatory strength that is added at the bottom of a cleft.
    pub hold: f32,
    /// Half width of a cleft divided by `R_in`.
    pub cleft_width: f32,
    /// Fraction by which growth is reduced at the bottom of a cleft.
    pub spare: f32,
    /// Strength of the force toward the ray of the anchor.
    pub guide: f32,
    /// Distance from this ray below which the force decreases to zero, µm.
    pub reach: f32,
    /// Change of the logarithm of the growth rate per relative excess length of an edge.
    pub room: f32,
    /// Number of particles that the inner loop should have after the growth event at the start of
    /// this step.
    pub inner_target: u32,
    /// Number of particles that the outer loop should have after this growth event.
    pub outer_target: u32,
}
