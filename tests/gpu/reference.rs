//! Comparison of the GPU with the simulation as the paper describes it: each force, and a step of
//! both integrators.
//!
//! The inner loop of a buckled section makes one step on the GPU and in the reference, which
//! computes in f64. A force is measured as the velocity that one Euler step gives to a loop at
//! rest. The tolerances equal those of the comparison with the CPU (`stages`): relative to the
//! velocity plus 1 µm/step.

use crate::common::{device, no_vulkan};
use crate::stages::{buckled, only};
use oviduct::sim::gpu::{Checkpoint, advance};
use oviduct::sim::reference::{Coefficients, Loop};
use oviduct::sim::{Plan, StepRow};
use oviduct::spec::Integrator;
use serde_json::json;

/// Inner loop of the reference and of the GPU after one step without growth.
fn both(plan: &Plan, start: &Checkpoint) -> [Loop; 2] {
    let gpu = advance(device(), std::slice::from_ref(plan), std::slice::from_ref(start), start.time + 1).unwrap();
    let inner = &gpu[0][0].inner;
    assert_eq!(inner.id, start.inner.id, "the step begins with growth");
    let mut reference = Loop::from(&start.inner);
    // The step begins with an update of the ranges, which the reference does not compute.
    for (own, &scale) in reference.particles.iter_mut().zip(&inner.scale) {
        own.scale = scale.into();
    }
    reference.step(&Coefficients::from(plan.at(start.time)), plan.integrator);
    [reference, Loop::from(inner)]
}

fn assert_close(name: &str, [reference, gpu]: &[Loop; 2], relative: f64) {
    let mut worst = [0f64; 2];
    let mut fastest = 0f64;
    for (i, (expected, found)) in reference.particles.iter().zip(&gpu.particles).enumerate() {
        let speed = expected.v.length();
        // Above this speed, the GPU would limit the moves.
        assert!(speed < 5.0, "{name}: particle {i} moves by {speed} µm");
        let off = [expected.v.distance(found.v), expected.p.distance(found.p)];
        // A position may be off by as much as the velocity, plus ten roundings of the position.
        let allowed = [relative * (1.0 + speed), relative * (1.0 + speed) + 6e-7 * expected.p.length()];
        for ((worst, off), allowed) in worst.iter_mut().zip(off).zip(allowed) {
            assert!(off <= allowed, "{name}: particle {i} is off by {off}, {allowed} allowed");
            *worst = worst.max(off / allowed);
        }
        assert!((expected.r - found.r).abs() <= 1e-6 * expected.r);
        fastest = fastest.max(speed);
    }
    println!("{name}: {worst:.3?} of the tolerance, {fastest:.2} µm/step");
    assert!(fastest > 0.01, "{name}: nothing moves, so nothing is tested");
}

#[test]
fn forces_match_the_paper() {
    if no_vulkan() {
        return;
    }
    let patch = json!({ "variation": { "amplitude": 0.4 }, "contortion": { "fraction": 0.5 } });
    let (plan, start) = buckled(&patch, 21);
    for (name, relative, keep) in [
        ("spring", 2e-5, (|row, bare| bare.stiffness = row.stiffness) as fn(&StepRow, &mut StepRow)),
        ("containment", 2e-5, |row, bare| (bare.containment, bare.r_in) = (row.containment, 0.9 * row.r_in)),
        ("regulatory", 2e-5, |row, bare| bare.regulatory = row.regulatory),
        ("contortion", 2e-4, |_, bare| bare.contortion = [0.5; 3]),
        ("self-intersection", 2e-5, |row, bare| bare.repulsion = row.repulsion),
        ("barrier", 2e-5, |row, bare| (bare.barrier, bare.barrier_distance) = (row.barrier, 9.0)),
        ("bending", 2e-5, |row, bare| bare.bending = row.bending),
        ("friction and damping", 2e-5, |row, bare| (bare.friction, bare.damping) = (row.friction, row.damping)),
    ] {
        let (mut plan, mut at_rest) = (plan.clone(), start.clone());
        only(&mut plan, &mut at_rest, keep);
        if name == "friction and damping" {
            (at_rest.inner.vx, at_rest.inner.vy) = (start.inner.vx.clone(), start.inner.vy.clone());
        }
        assert_close(name, &both(&plan, &at_rest), relative);
    }
}

#[test]
fn a_step_matches_the_paper() {
    if no_vulkan() {
        return;
    }
    for integrator in [Integrator::Rk4, Integrator::Euler] {
        let (mut plan, start) = buckled(&json!({ "variation": { "amplitude": 0.4 } }), 22);
        plan.integrator = integrator;
        // The negative clearance leaves only the general limit of 5 µm per move.
        plan.clearance = -1e3;
        for row in &mut plan.rows {
            (row.sway, row.inner_target) = (0.0, start.inner.len() as u32);
        }
        assert_close(&format!("{integrator:?}"), &both(&plan, &start), 2e-4);
    }
}
