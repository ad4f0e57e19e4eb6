//! Comparison of single stages: one step on both backends from the same state, with all other
//! stages disabled.
//!
//! A force is measured as the velocity that one Euler step gives to a loop at rest. Tolerances are
//! relative to the force plus 1 µm/step. Both sides round to f32. In addition, a GPU may be off by
//! a few units in the last place in division, square root and exponential, and by 7e-5 in the arc
//! cosine.

use crate::common::{device, no_vulkan, plan};
use oviduct::sim::cpu::CpuSimulation;
use oviduct::sim::gpu::{Checkpoint, advance};
use oviduct::sim::{InnerLoop, LANES, Plan, StepRow};
use oviduct::spec::{Integrator, Search};
use serde_json::{Value, json};

/// Step at which stages are compared. It begins with a growth event, and the loop is buckled.
const AT: i64 = 80;

/// A plan, and the state that the CPU reaches with it at step [`AT`].
pub(crate) fn buckled(patch: &Value, seed: u64) -> (Plan, Checkpoint) {
    let plan = plan(patch, seed);
    let mut simulation = CpuSimulation::new(plan.clone(), 1);
    while simulation.time() < AT {
        simulation.step().unwrap();
    }
    (plan, simulation.checkpoint())
}

/// States of both backends after one step. The CPU visits all pairs of particles.
fn both(plan: &Plan, start: &Checkpoint) -> (Checkpoint, Checkpoint) {
    let mut cpu = CpuSimulation::resume(Plan { search: Search::AllPairs, ..plan.clone() }, start, 1);
    cpu.step().unwrap();
    let gpu = advance(device(), std::slice::from_ref(plan), std::slice::from_ref(start), start.time + 1).unwrap();
    assert_eq!((gpu.len(), gpu[0].len()), (1, 1));
    (cpu.checkpoint(), gpu[0][0].clone())
}

/// Disables growth, the guard and every force except the forces that `keep` restores, and selects
/// the Euler integrator.
pub(crate) fn only(plan: &mut Plan, start: &mut Checkpoint, keep: impl Fn(&StepRow, &mut StepRow)) {
    let (inner, outer) = (start.inner.len() as u32, start.outer.len() as u32);
    for row in &mut plan.rows {
        let mut bare = StepRow {
            edge: row.edge,
            ramp: row.ramp,
            squash: row.squash,
            r_in: row.r_in,
            r_wall: row.r_wall,
            softening: row.softening,
            range_mean: row.range_mean,
            range_half: row.range_half,
            barrier_distance: row.barrier_distance,
            variation: row.variation,
            outline: row.outline,
            fold: row.fold,
            fold_of_wall: row.fold_of_wall,
            fold_phase: row.fold_phase,
            margin: row.margin,
            clefts: row.clefts,
            cleft_width: row.cleft_width,
            reach: row.reach,
            inner_target: inner,
            outer_target: outer,
            ..StepRow::default()
        };
        keep(row, &mut bare);
        *row = bare;
    }
    plan.integrator = Integrator::Euler;
    // The negative clearance leaves only the general limit of 5 µm per move.
    plan.clearance = -1e3;
    start.inner.vx.fill(0.0);
    start.inner.vy.fill(0.0);
}

fn assert_close(what: &str, cpu: &[f32], gpu: &[f32], relative: f32) {
    assert_eq!(cpu.len(), gpu.len(), "{what}");
    let mut worst = (0.0f32, 0);
    for (i, (a, b)) in cpu.iter().zip(gpu).enumerate() {
        assert!(a.is_finite() && b.is_finite(), "{what}: entry {i} is {a} and {b}");
        let off = (a - b).abs() / (1.0 + a.abs());
        if off > worst.0 {
            worst = (off, i);
        }
    }
    println!("{what}: {:.2e}", worst.0);
    let i = worst.1;
    assert!(worst.0 <= relative, "{what}: entry {i} is {} on the CPU, {} on the GPU ({:.2e})", cpu[i], gpu[i], worst.0);
}

fn assert_velocities(cpu: &InnerLoop, gpu: &InnerLoop, relative: f32) {
    assert!(cpu.vx.iter().any(|v| v.abs() > 0.01), "nothing moves, so nothing is tested");
    assert_eq!(cpu.id, gpu.id);
    assert_close("vx", &cpu.vx, &gpu.vx, relative);
    assert_close("vy", &cpu.vy, &gpu.vy, relative);
}

/// Compares the positions after a step from the same state, if the velocities may differ by
/// `relative`. A position may differ by as much, plus its own rounding (1e-6 of 500 µm is ten units
/// in the last place).
fn assert_positions(cpu: &InnerLoop, gpu: &InnerLoop, relative: f32) {
    assert_eq!(cpu.id, gpu.id);
    for (what, cpu, gpu, speeds) in [("x", &cpu.x, &gpu.x, &cpu.vx), ("y", &cpu.y, &gpu.y, &cpu.vy)] {
        for (i, ((a, b), speed)) in cpu.iter().zip(gpu).zip(speeds).enumerate() {
            let allowed = 1e-6 * (1.0 + a.abs()) + relative * (1.0 + speed.abs());
            assert!(
                (a - b).abs() <= allowed,
                "{what}: entry {i} is {a} on the CPU, {b} on the GPU, {allowed:.1e} allowed"
            );
        }
    }
}

#[test]
fn pair_forces_match() {
    if no_vulkan() {
        return;
    }
    let (plan, start) = buckled(&json!({ "variation": { "amplitude": 0.4 } }), 3);
    let (mut plan, mut start) = (plan, start);
    only(&mut plan, &mut start, |row, bare| {
        (bare.repulsion, bare.barrier) = (row.repulsion, row.barrier);
    });
    let (cpu, gpu) = both(&plan, &start);
    assert_velocities(&cpu.inner, &gpu.inner, 2e-5);
    assert_close("clearance", &cpu.clearance, &gpu.clearance, 1e-4);
}

#[test]
fn pair_forces_match_where_lists_overflow() {
    if no_vulkan() {
        return;
    }
    // 1,340 particles, all within range: more segments than the list of a block can hold.
    let plan = plan(&json!({ "particles": { "total": 1400, "outer": 60 } }), 4);
    let mut start = CpuSimulation::new(plan.clone(), 1).checkpoint();
    let mut plan = plan;
    only(&mut plan, &mut start, |row, bare| {
        bare.repulsion = 0.02 * row.repulsion;
        bare.range_mean = 2000.0;
    });
    let (cpu, gpu) = both(&plan, &start);
    assert_velocities(&cpu.inner, &gpu.inner, 2e-4);
}

#[test]
fn pair_forces_match_where_there_are_more_blocks_than_threads() {
    if no_vulkan() {
        return;
    }
    // 4,940 particles form 309 blocks, so the lists are built in three rounds of 128 blocks.
    let mut plan = plan(&json!({ "particles": { "total": 5000, "outer": 60 } }), 4);
    let mut start = CpuSimulation::new(plan.clone(), 1).checkpoint();
    only(&mut plan, &mut start, |row, bare| bare.repulsion = row.repulsion);
    let (cpu, gpu) = both(&plan, &start);
    assert_velocities(&cpu.inner, &gpu.inner, 2e-5);
}

/// In a loop of one block, the segment before the block's first particle is also the segment after
/// its last one.
#[test]
fn pair_forces_match_in_a_loop_of_one_block() {
    if no_vulkan() {
        return;
    }
    let mut plan = plan(&json!({ "particles": { "total": 28, "outer": 12 } }), 4);
    let mut start = CpuSimulation::new(plan.clone(), 1).checkpoint();
    assert_eq!(start.inner.len(), LANES);
    only(&mut plan, &mut start, |row, bare| bare.repulsion = row.repulsion);
    let (cpu, gpu) = both(&plan, &start);
    assert_velocities(&cpu.inner, &gpu.inner, 2e-5);
    assert_close("clearance", &cpu.clearance, &gpu.clearance, 1e-4);
}

#[test]
fn local_forces_match() {
    if no_vulkan() {
        return;
    }
    let primary = json!({ "clefts": 6.5, "hold": 0.6, "width_um": 60, "guide": 0.2 });
    let (plan, start) = buckled(&json!({ "contortion": { "fraction": 0.5 }, "primary": primary }), 5);
    for (name, relative, keep) in [
        ("spring", 2e-5, (|row, bare| bare.stiffness = row.stiffness) as fn(&StepRow, &mut StepRow)),
        ("bending", 2e-5, |row, bare| bare.bending = row.bending),
        ("containment", 2e-5, |row, bare| {
            bare.containment = row.containment;
            bare.r_in = 0.9 * row.r_in;
        }),
        ("regulatory", 2e-5, |row, bare| bare.regulatory = row.regulatory),
        ("hold of clefts", 2e-5, |row, bare| bare.hold = row.hold),
        ("guidance", 2e-5, |row, bare| bare.guide = row.guide),
        ("contortion", 2e-4, |_, bare| bare.contortion = [0.5; 3]),
    ] {
        println!("{name}");
        let (mut plan, mut start) = (plan.clone(), start.clone());
        only(&mut plan, &mut start, keep);
        let (cpu, gpu) = both(&plan, &start);
        assert_velocities(&cpu.inner, &gpu.inner, relative);
    }
    // Friction and damping act only on moving particles.
    let (mut plan, mut moving) = (plan, start.clone());
    only(&mut plan, &mut moving, |row, bare| (bare.friction, bare.damping) = (row.friction, row.damping));
    (moving.inner.vx, moving.inner.vy) = (start.inner.vx, start.inner.vy);
    let (cpu, gpu) = both(&plan, &moving);
    assert_velocities(&cpu.inner, &gpu.inner, 2e-5);
}

#[test]
fn integrate_matches() {
    if no_vulkan() {
        return;
    }
    for integrator in [Integrator::Rk4, Integrator::Euler] {
        let (mut plan, start) = buckled(&json!({ "variation": { "amplitude": 0.4 } }), 6);
        plan.integrator = integrator;
        let (cpu, gpu) = both(&plan, &start);
        assert_velocities(&cpu.inner, &gpu.inner, 2e-4);
        assert_positions(&cpu.inner, &gpu.inner, 2e-4);
        assert_close("rest", &cpu.inner.rest, &gpu.inner.rest, 1e-6);
        assert_close("clearance", &cpu.clearance, &gpu.clearance, 1e-4);
    }
}

/// The lists allow for the drift of eight calm steps. They cannot foresee the moves within the
/// stages of the ninth step.
#[test]
fn integrate_matches_where_stages_leave_the_lists_behind() {
    if no_vulkan() {
        return;
    }
    let (mut plan, mut start) = buckled(&json!({}), 7);
    let repulsion = plan.at(AT).repulsion;
    only(&mut plan, &mut start, |_, bare| (bare.range_mean, bare.range_half) = (30.0, 0.0));
    plan.integrator = Integrator::Rk4;
    let last = AT + 8;
    let kick = (last + i64::from(plan.burn_in)) as usize;
    (plan.rows[kick].friction, plan.rows[kick].repulsion) = (-9.0, 50.0 * repulsion);
    // Both halves drift toward the middle.
    for (vx, x) in start.inner.vx.iter_mut().zip(&start.inner.x) {
        *vx = -x.signum();
    }
    let mut cpu = CpuSimulation::resume(Plan { search: Search::AllPairs, ..plan.clone() }, &start, 1);
    while cpu.time() <= last {
        cpu.step().unwrap();
    }
    let gpu = advance(device(), std::slice::from_ref(&plan), std::slice::from_ref(&start), last + 1).unwrap();
    assert_velocities(&cpu.checkpoint().inner, &gpu[8][0].inner, 2e-4);
    assert_positions(&cpu.checkpoint().inner, &gpu[8][0].inner, 2e-4);
}

#[test]
fn guard_matches() {
    if no_vulkan() {
        return;
    }
    let (plan, mut start) = buckled(&json!({ "collision": { "strength": 0.02, "barrier": 0 } }), 8);
    for (i, v) in start.inner.vx.iter_mut().enumerate() {
        *v = if i % 3 == 0 { 8.0 } else { 0.0 };
    }
    let (cpu, gpu) = both(&plan, &start);
    assert_close("clearance", &cpu.clearance, &gpu.clearance, 1e-4);
    assert_close("x", &cpu.inner.x, &gpu.inner.x, 1e-5);
    assert_close("y", &cpu.inner.y, &gpu.inner.y, 1e-5);
    // Particles that growth added have no earlier position, so only the original ones are compared.
    let mut cut = 0;
    for (k, id) in start.inner.id.iter().enumerate() {
        let i = gpu.inner.id.iter().position(|other| other == id).unwrap();
        let (dx, dy) = (gpu.inner.x[i] - start.inner.x[k], gpu.inner.y[i] - start.inner.y[k]);
        let limit = (0.45 * (gpu.clearance[i] - plan.clearance)).clamp(1e-5, 5.0);
        assert!(dx.hypot(dy) <= limit + 1e-3, "particle {id} moved {} µm, {limit} allowed", dx.hypot(dy));
        cut += usize::from(dx.hypot(dy) > limit - 1e-3);
    }
    assert!(cut > 10, "no move was shortened, so the guard was not tested");
}

#[test]
fn growth_matches() {
    if no_vulkan() {
        return;
    }
    for (seed, inner, outer) in [(9, 37, 5), (10, 300, 40), (11, 0, 0), (12, 100_000, 100_000)] {
        let (mut plan, start) = buckled(&json!({ "contortion": { "fraction": 0.5 } }), seed);
        for row in &mut plan.rows {
            // If the target is out of reach, every edge with enough clearance is split.
            row.inner_target = (start.inner.len() as u32 + inner).min(2000);
            row.outer_target = (start.outer.len() as u32 + outer).min(400);
        }
        let (cpu, gpu) = both(&plan, &start);
        assert!(inner == 0 || cpu.inner.len() > start.inner.len());
        assert_eq!(cpu.inner.id, gpu.inner.id, "the same edges are split, in the same order");
        assert_eq!(cpu.inner.next_id, gpu.inner.next_id);
        assert_eq!(cpu.inner.sign, gpu.inner.sign);
        assert_eq!(cpu.outer.id, gpu.outer.id);
        assert_close("rest", &cpu.inner.rest, &gpu.inner.rest, 1e-6);
        assert_close("anchor_x", &cpu.inner.anchor_x, &gpu.inner.anchor_x, 2e-5);
        assert_close("anchor_y", &cpu.inner.anchor_y, &gpu.inner.anchor_y, 2e-5);
        assert_close("x", &cpu.inner.x, &gpu.inner.x, 1e-5);
    }
}

#[test]
fn thickness_matches() {
    if no_vulkan() {
        return;
    }
    let (plan, start) = buckled(&json!({ "variation": { "amplitude": 0.7 } }), 13);
    let (cpu, gpu) = both(&plan, &start);
    let spread = cpu.inner.scale.iter().fold([f32::MAX, 0.0], |s, &x| [s[0].min(x), s[1].max(x)]);
    assert!(spread[1] > 1.2 * spread[0], "{spread:?}: too little difference to test");
    assert_close("scale", &cpu.inner.scale, &gpu.inner.scale, 2e-5);
}

/// Containment, anchors, sway and wall in an outline with a notch and folds.
#[test]
fn outlines_match() {
    if no_vulkan() {
        return;
    }
    let points = [[1.2, 0.0], [0.9, 0.9], [0.1, 0.5], [-0.8, 1.0], [-1.0, -0.6], [0.2, -0.9]];
    let patch = json!({
        "outline": { "kind": "polygon", "points": points }, "sway": { "strength": 3 }, "containment": { "wall_um": 60 },
        "folds": { "depth": 0.4, "rows": 3, "period_mm": 110, "stagger": 0.3, "wall": 0.6 },
    });
    let (plan, start) = buckled(&patch, 17);
    for (name, keep) in [
        (
            "containment",
            (|row, bare| {
                bare.containment = row.containment;
                bare.r_in = 0.9 * row.r_in;
            }) as fn(&StepRow, &mut StepRow),
        ),
        ("regulatory", |row, bare| bare.regulatory = row.regulatory),
        ("sway", |row, bare| bare.sway = row.sway),
    ] {
        println!("{name}");
        let (mut plan, mut start) = (plan.clone(), start.clone());
        only(&mut plan, &mut start, keep);
        let (cpu, gpu) = both(&plan, &start);
        assert_velocities(&cpu.inner, &gpu.inner, 5e-5);
        let (elliptic, _) = both(&Plan { spokes: Vec::new(), ..plan }, &start);
        assert_ne!(cpu.inner.vx, elliptic.inner.vx, "the outline does not matter, so nothing is tested");
    }
    let (cpu, gpu) = both(&plan, &start);
    assert!(cpu.inner.len() > start.inner.len());
    assert_eq!(cpu.inner.id, gpu.inner.id);
    // A corner of the outline is the nearest point for a range of particles, so anchors may differ
    // slightly there.
    assert_close("anchor_x", &cpu.inner.anchor_x, &gpu.inner.anchor_x, 1e-4);
    assert_close("anchor_y", &cpu.inner.anchor_y, &gpu.inner.anchor_y, 1e-4);
    let flat = |p: &[[f32; 2]]| p.iter().flatten().copied().collect::<Vec<f32>>();
    assert_close("outer positions", &flat(&cpu.outer.p), &flat(&gpu.outer.p), 2e-5);
    assert_close("outer velocities", &flat(&cpu.outer.v), &flat(&gpu.outer.v), 2e-3);
}

/// Both effects of variety: the ranges of forces and the choice of split edges.
#[test]
fn variety_matches() {
    if no_vulkan() {
        return;
    }
    let strong = json!({ "asymmetry": 0.5, "height": 0.3, "thickness": 0.3, "shift": 0.5, "drift": 0.01, "waves": 9 });
    let (plan, start) = buckled(&json!({ "variety": strong, "variation": { "amplitude": 0.2 } }), 16);
    let row = plan.at(AT);
    assert!(row.inner_target as usize > start.inner.len() && row.shift != [0.0; 2], "nothing to test");
    let (cpu, gpu) = both(&plan, &start);
    let spread = cpu.inner.scale.iter().fold([f32::MAX, 0.0], |s, &x| [s[0].min(x), s[1].max(x)]);
    assert!(spread[1] > 1.5 * spread[0], "{spread:?}: too little difference to test");
    assert_eq!(cpu.inner.id, gpu.inner.id);
    assert_close("scale", &cpu.inner.scale, &gpu.inner.scale, 2e-5);
    let (without, _) = both(&Plan { modes: Vec::new(), rows: even(&plan.rows), ..plan.clone() }, &start);
    assert_ne!(cpu.inner.id, without.inner.id, "the same edges are split without variety");
}

/// Shares of clefts, anchors of new particles, and growth by room and outside clefts.
#[test]
fn primary_folds_match() {
    if no_vulkan() {
        return;
    }
    let primary = json!({ "clefts": 6.5, "hold": 0.6, "width_um": 60, "spare": 0.9, "guide": 0.2 });
    let patch = json!({ "primary": primary, "particles": { "room_weight": 8 } });
    let (plan, start) = buckled(&patch, 18);
    let (cpu, gpu) = both(&plan, &start);
    assert!(cpu.inner.len() > start.inner.len(), "nothing grows");
    assert_eq!(cpu.inner.id, gpu.inner.id);
    for (what, cpu, gpu) in [
        ("cleft", &cpu.inner.cleft, &gpu.inner.cleft),
        ("anchor_x", &cpu.inner.anchor_x, &gpu.inner.anchor_x),
        ("anchor_y", &cpu.inner.anchor_y, &gpu.inner.anchor_y),
    ] {
        assert_close(what, cpu, gpu, 2e-5);
    }
    let in_clefts = cpu.inner.cleft.iter().filter(|&&share| share > 0.5).count();
    assert!(in_clefts > 10 && in_clefts < cpu.inner.len() / 2, "{in_clefts} of {}", cpu.inner.len());
    let rows = plan.rows.iter().map(|row| StepRow { room: 0.0, spare: 0.0, ..*row }).collect();
    let (even, _) = both(&Plan { rows, ..plan.clone() }, &start);
    assert_ne!(cpu.inner.id, even.inner.id, "the same edges are split without weights");
}

fn even(rows: &[StepRow]) -> Vec<StepRow> {
    rows.iter().map(|row| StepRow { asymmetry: 0.0, height: 0.0, thickness: 0.0, shift: [0.0; 2], ..*row }).collect()
}

/// All evaluations within a step use the flow at the start of the step.
#[test]
fn sway_matches() {
    if no_vulkan() {
        return;
    }
    let (plan, start) = buckled(&json!({ "sway": { "strength": 3 } }), 15);
    for integrator in [Integrator::Euler, Integrator::Rk4] {
        let (mut plan, mut start) = (plan.clone(), start.clone());
        only(&mut plan, &mut start, |row, bare| bare.sway = row.sway);
        plan.integrator = integrator;
        let (cpu, gpu) = both(&plan, &start);
        assert_velocities(&cpu.inner, &gpu.inner, 2e-5);
    }
}

#[test]
fn outer_matches() {
    if no_vulkan() {
        return;
    }
    let (plan, start) = buckled(&json!({ "wall": { "lobing": 0.1 } }), 14);
    let (mut cpu, mut gpu) = (start.clone(), start);
    // Each backend continues from its own state for several steps, so that the load on the wall
    // changes.
    for _ in 0..5 {
        let mut simulation = CpuSimulation::resume(plan.clone(), &cpu, 1);
        simulation.step().unwrap();
        cpu = simulation.checkpoint();
        gpu = advance(device(), std::slice::from_ref(&plan), &[gpu.clone()], gpu.time + 1).unwrap()[0][0].clone();
    }
    assert_eq!(cpu.outer.id, gpu.outer.id);
    let flat = |p: &[[f32; 2]]| p.iter().flatten().copied().collect::<Vec<f32>>();
    assert_close("outer positions", &flat(&cpu.outer.p), &flat(&gpu.outer.p), 1e-5);
    assert_close("outer velocities", &flat(&cpu.outer.v), &flat(&gpu.outer.v), 2e-3);
}

/// On a flat ellipse the wall buckles at the tips, so particles are limited by their neighbours.
#[test]
fn outer_matches_on_a_flat_ellipse() {
    if no_vulkan() {
        return;
    }
    let patch = json!({
        "steps": 100, "burn_in": 50, "containment": { "squash": 0.3 }, "wall": { "lobes": 16 },
        "particles": { "total": { "keys": [[0, 400], [1, 600]] }, "outer": { "keys": [[0, 110], [1, 300]] } },
    });
    let plan = plan(&patch, 2);
    let mut simulation = CpuSimulation::new(plan.clone(), 1);
    let flat = |p: &[[f32; 2]]| p.iter().flatten().copied().collect::<Vec<f32>>();
    let mut least = f64::INFINITY;
    for _ in 0..5 {
        for _ in 0..8 {
            simulation.step().unwrap();
        }
        let start = simulation.checkpoint();
        let angles: Vec<f64> = start.outer.p.iter().map(|p| f64::from(p[1] / 0.3).atan2(f64::from(p[0]))).collect();
        let turns =
            angles.iter().zip(angles.iter().cycle().skip(1)).map(|(a, b)| (b - a).rem_euclid(std::f64::consts::TAU));
        least = turns.fold(least, f64::min);
        let (cpu, gpu) = both(&plan, &start);
        assert_close("outer positions", &flat(&cpu.outer.p), &flat(&gpu.outer.p), 1e-5);
        assert_close("outer velocities", &flat(&cpu.outer.v), &flat(&gpu.outer.v), 2e-3);
    }
    let mean = std::f64::consts::TAU / 110.0;
    assert!(least < 0.25 * mean, "no particles come close to each other ({least} of {mean}): the test shows nothing");
}

/// Two straight strands 40 µm apart come within the range of a barrier that was off when the lists
/// were built.
#[test]
fn lists_follow_a_barrier_that_grows_between_growth_events() {
    if no_vulkan() {
        return;
    }
    let patch = json!({
        "steps": 20, "burn_in": 0, "particles": { "total": 260, "outer": 60, "every": 1000 },
        "collision": { "tissue_um": 12, "gap_um": 12, "barrier": 0.02, "barrier_um": { "keys": [[0, 0], [0.3, 20], [1, 20]] } },
    });
    let mut plan = plan(&patch, 1);
    let mut start = CpuSimulation::new(plan.clone(), 1).checkpoint();
    only(&mut plan, &mut start, |row, bare| bare.barrier = row.barrier);
    plan.integrator = Integrator::Rk4;
    let n = start.inner.len();
    for i in 0..n {
        let (side, k) = if i < n / 2 { (-1.0, i) } else { (1.0, n - 1 - i) };
        start.inner.x[i] = 10.0 * (k as f32 - 0.25 * n as f32);
        start.inner.y[i] = 20.0 * side;
        start.inner.vy[i] = -1.1 * side;
    }
    let run = |from: &Checkpoint| {
        advance(device(), std::slice::from_ref(&plan), std::slice::from_ref(from), 12).unwrap().pop().unwrap().remove(0)
    };
    let end = run(&start);
    assert!(end.inner.vy.iter().any(|v| v.abs() < 1.0999), "the barrier did not act, so it was not tested");
    let states = advance(device(), std::slice::from_ref(&plan), std::slice::from_ref(&start), 8).unwrap();
    for k in [3, 7] {
        assert!(run(&states[k][0]) == end, "from step {}", k + 1);
    }
}
