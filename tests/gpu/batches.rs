//! Small whole runs in GPU batches: correct, repeatable, independent of each other.

use crate::common::{Kept, OPTIONS, device, is_hardware, no_vulkan, open, open_with, plan, short};
use oviduct::clock::Stopwatch;
use oviduct::geometry::polygon::{check_contour, check_nested};
use oviduct::measure::certify;
use oviduct::mesh::Lofter;
use oviduct::model::Section;
use oviduct::sim::cpu::CpuSimulation;
use oviduct::sim::gpu::{BatchSink, Checkpoint, GpuError, GpuOptions, replay, run_batch};
use oviduct::sim::{Plan, SimError, Statistics};
use oviduct::spec::{Integrator, ModelSpec, preset};
use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use std::time::Duration;

pub(crate) fn run(plans: &[Plan]) -> Kept {
    let mut kept = Kept::new(plans.len());
    let report = run_batch(device(), plans, &mut kept).unwrap();
    println!("{report:?}");
    let plan = &plans[0];
    let a_step = if plan.integrator == Integrator::Rk4 { 4 } else { 2 };
    let (steps, events) = (plan.burn_in + plan.steps, plan.steps.div_ceil(plan.grow_every));
    let records = (0..=plan.steps).filter(|&t| plan.records_at(i64::from(t))).count() as u32;
    // The outer loop lags one step behind. Separate dispatches advance it before each growth event
    // and before each record that follows a step.
    let catches_up = |t: u32| t + plan.burn_in > 0 && (plan.grows_at(i64::from(t)) || plan.records_at(i64::from(t)));
    let alone = (0..=plan.steps).filter(|&t| catches_up(t)).count() as u32;
    let wanted = steps * a_step + 2 * events + records + alone;
    assert_eq!(report.dispatches, u64::from(wanted), "as docs/gpu.md counts them");
    kept
}

pub(crate) fn assert_sound(section: &Section) {
    let (inner, outer) = (&section.inner.points, &section.outer.points);
    check_contour(inner).unwrap_or_else(|e| panic!("inner loop at step {}: {e}", section.step));
    check_contour(outer).unwrap_or_else(|e| panic!("outer loop at step {}: {e}", section.step));
    check_nested(inner, outer).unwrap_or_else(|e| panic!("step {}: {e}", section.step));
}

/// Lofts the sections as a worker does, mends slabs by replays, and certifies the surface.
pub(crate) fn certify_run(plan: &Plan, kept: &Kept, member: usize) {
    let run = &kept.sections[member];
    let mut lofter = Lofter::new(run[0].0.clone()).unwrap();
    let mut sections = vec![run[0].0.clone()];
    for pair in run.windows(2) {
        let accepted = match lofter.try_advance(&pair[1].0).unwrap() {
            Some(accepted) => accepted,
            None => lofter.advance(&replay(device(), plan, &pair[0].1).unwrap()).unwrap(),
        };
        sections.extend(accepted.sections);
    }
    let mesh = lofter.finish().unwrap();
    assert_eq!(certify(&mesh, &sections).first_failure(), None);
}

#[test]
fn runs_are_sound_and_certified() {
    if no_vulkan() {
        return;
    }
    let patch = json!({ "contortion": { "magnitude": 5, "fraction": 0.2 }, "variation": { "amplitude": 0.4 } });
    // The sway, which moves all particles, has a separate test (`stages`) and is enabled in the
    // other runs.
    let still = |mut patch: Value| {
        patch["sway"] = json!({ "strength": 0 });
        patch
    };
    let plans = [plan(&still(json!({})), 1), plan(&still(patch), 2)];
    let kept = run(&plans);
    for (member, plan) in plans.iter().enumerate() {
        assert_eq!(kept.failed[member], None);
        let statistics = kept.finished[member].unwrap();
        let sections = &kept.sections[member];
        let steps: Vec<f64> = sections.iter().map(|(s, _)| s.step).collect();
        assert_eq!(steps, (0..=15).map(|k| f64::from(10 * k)).collect::<Vec<_>>());
        for (section, checkpoint) in sections {
            assert_sound(section);
            let u = section.step / 150.0;
            let wanted = (260.0 + 640.0 * u).round() as usize;
            let missing = wanted.abs_diff(section.particles());
            assert!(missing <= statistics.splits_deferred as usize, "{} particles for {wanted}", section.particles());
            let mut ids = checkpoint.inner.id.clone();
            ids.sort_unstable();
            ids.dedup();
            assert_eq!(ids.len(), checkpoint.inner.len());
        }
        let last = &sections[15].0;
        assert_eq!(last.particles() as u64 + statistics.splits_missing, 900);
        assert_eq!(kept.reached[member], 150);
        assert!(statistics.list_builds > 15 && statistics.list_builds < 150, "{statistics:?}");
        assert!(statistics.moves_shortened > 0, "no move was shortened, so the guard was not tested");
        // A particle that moves far within a step must invalidate only its own block's list. If it
        // invalidated all lists, there would be at least 177 full searches.
        assert!(statistics.full_searches < 100, "{statistics:?}");
        certify_run(plan, &kept, member);
    }
}

#[test]
fn results_depend_neither_on_the_batch_nor_on_the_run_and_replays_repeat_them() {
    if no_vulkan() {
        return;
    }
    let plans: Vec<Plan> = (1..=3).map(short).collect();
    let together = run(&plans);
    let again = run(&plans);
    let alone = run(&plans[1..2]);
    assert_eq!(together.sections, again.sections);
    assert_eq!(together.finished, again.finished);
    assert_eq!(together.sections[1], alone.sections[0]);
    assert_ne!(together.sections[0], together.sections[1]);
    for k in [0, 3] {
        let history = replay(device(), &plans[1], &together.sections[1][k].1).unwrap();
        let steps: Vec<f64> = history.iter().map(|s| s.step).collect();
        assert_eq!(steps, (1..=10).map(|i| (10 * k + i) as f64).collect::<Vec<_>>());
        assert_eq!(history[9], together.sections[1][k + 1].0, "a replay ends where the batch went on");
        history.iter().for_each(assert_sound);
    }
    let end = &together.sections[1].last().unwrap().1;
    assert!(matches!(replay(device(), &plans[1], end), Err(GpuError::Unfit { .. })));
}

/// One digest per member over all its sections.
struct Digests(Vec<Sha256>);

impl BatchSink for Digests {
    fn section(&mut self, member: usize, section: Section, _: Checkpoint) {
        for ring in [&section.inner, &section.outer] {
            self.0[member].update(bytemuck::cast_slice(&ring.ids));
            self.0[member].update(bytemuck::cast_slice(ring.points.as_flattened()));
        }
    }
    fn progress(&mut self, _: usize, _: i64, _: u32) {}
    fn cancelled(&mut self, _: usize) -> bool {
        false
    }
    fn failed(&mut self, member: usize, error: SimError) {
        panic!("member {member}: {error}");
    }
    fn finished(&mut self, _: usize, _: Statistics) {}
}

fn digests(plans: &[Plan]) -> Vec<String> {
    let mut digests = Digests(vec![Sha256::new(); plans.len()]);
    run_batch(device(), plans, &mut digests).unwrap();
    digests.0.into_iter().map(|digest| hex::encode(digest.finalize())).collect()
}

/// On a real GPU, the models have paper size.
#[test]
fn a_model_has_the_same_bytes_alone_in_a_batch_of_any_size_and_again() {
    if no_vulkan() {
        return;
    }
    let paper = |seed| Plan::new(&ModelSpec::resolve(preset("paper").unwrap(), &json!({})).unwrap(), seed);
    let (plan, sizes, repeats): (&dyn Fn(u64) -> Plan, _, _) =
        if is_hardware() { (&paper, [16, 64], 10) } else { (&short, [3, 7], 2) };
    let alone = digests(&[plan(1)]);
    for _ in 1..repeats {
        assert_eq!(digests(&[plan(1)]), alone);
    }
    let [small, large] = sizes.map(|size| digests(&(1..=size).map(plan).collect::<Vec<_>>()));
    assert_eq!((&small[..1], &small[..]), (&alone[..], &large[..small.len()]));
    let last = large.len() as u64;
    assert_eq!(digests(&[plan(last)]), large[large.len() - 1..]);
    assert_ne!(large[0], large[1]);
}

#[test]
fn threads_can_share_a_device() {
    if no_vulkan() {
        return;
    }
    let plans = [short(6), short(7)];
    let alone = plans.each_ref().map(|plan| run(std::slice::from_ref(plan)));
    let shared = std::thread::scope(|scope| {
        let runs = plans.each_ref().map(|plan| scope.spawn(|| run(std::slice::from_ref(plan))));
        // Slabs of earlier batches are replayed while the new batches run.
        let mut replays = 0;
        while replays == 0 || runs.iter().any(|run| !run.is_finished()) {
            let (member, slab) = (replays % 2, replays % 5);
            let sections = &alone[member].sections[0];
            let history = replay(device(), &plans[member], &sections[slab].1).unwrap();
            assert_eq!(history.last().unwrap(), &sections[slab + 1].0);
            replays += 1;
        }
        runs.map(|run| run.join().unwrap())
    });
    for (alone, shared) in alone.iter().zip(shared) {
        assert_eq!(shared.sections, alone.sections);
    }
}

#[test]
fn batches_run_with_the_euler_integrator() {
    if no_vulkan() {
        return;
    }
    let mut one = short(5);
    one.integrator = Integrator::Euler;
    let kept = run(&[one]);
    assert_eq!(kept.sections[0].len(), 7);
    kept.sections[0].iter().for_each(|(s, _)| assert_sound(s));
}

#[test]
fn a_member_that_is_cancelled_or_fails_leaves_the_others_whole() {
    if no_vulkan() {
        return;
    }
    let mut plans: Vec<Plan> = (1..=3).map(short).collect();
    // An invalid stiffness makes member 2 fail at step 25.
    let at = plans[2].burn_in as usize + 25;
    plans[2].rows[at].stiffness = f32::NAN;
    let mut kept = Kept::new(3);
    kept.cancel = Some((0, 5));
    run_batch(device(), &plans, &mut kept).unwrap();
    assert_eq!((kept.finished[0], kept.failed[0].clone()), (None, None));
    assert!(kept.sections[0].len() < 7, "cancelled at step {}", kept.reached[0]);
    assert_eq!(kept.failed[2], Some(SimError::NotFinite { step: 26 }));
    assert_eq!((kept.finished[2], kept.sections[2].len()), (None, 3));
    assert!(kept.finished[1].is_some());
    assert_eq!(kept.sections[1], run(&plans[1..2]).sections[0]);
}

#[test]
fn a_lost_device_is_reported_and_a_new_one_continues() {
    if no_vulkan() {
        return;
    }
    let device = open();
    let plans: Vec<Plan> = (1..=2).map(short).collect();
    let mut kept = Kept::new(2);
    kept.lose = Some((device.clone(), 10));
    let error = run_batch(&device, &plans, &mut kept).unwrap_err();
    assert!(matches!(error, GpuError::Lost { .. }), "{error}");
    assert!(device.is_lost());
    assert_eq!(kept.finished, [None, None]);
    let again = run_batch(&device, &plans, &mut Kept::new(2)).unwrap_err();
    assert!(matches!(again, GpuError::Lost { .. }), "{again}");
    let mut kept = Kept::new(2);
    run_batch(&open(), &plans, &mut kept).unwrap();
    assert!(kept.finished.iter().all(Option::is_some));
}

#[test]
fn a_device_that_completes_nothing_counts_as_lost() {
    if no_vulkan() {
        return;
    }
    let device = open_with(&GpuOptions { stall: Duration::from_millis(500), ..OPTIONS });
    let plans: Vec<Plan> = (1..=2).map(short).collect();
    let mut kept = Kept::new(2);
    kept.hang = Some((device.clone(), 10));
    let error = run_batch(&device, &plans, &mut kept).unwrap_err();
    let detail = "nothing was completed for 0.5 s; the device hangs";
    assert_eq!(error, GpuError::Lost { detail: detail.to_owned() });
    assert!(device.is_lost());
    assert_eq!(kept.finished, [None, None]);
    // The next batch fails immediately, without another wait.
    assert_eq!(run_batch(&device, &plans, &mut Kept::new(2)).unwrap_err(), error);
    let device = open_with(&GpuOptions { stall: Duration::from_millis(500), ..OPTIONS });
    device.hang();
    let start = CpuSimulation::new(plans[0].clone(), 1).checkpoint();
    assert_eq!(replay(&device, &plans[0], &start).unwrap_err(), error);
    drop(device);
    let mut kept = Kept::new(2);
    run_batch(&open(), &plans, &mut kept).unwrap();
    assert!(kept.finished.iter().all(Option::is_some));
}

#[test]
fn only_similar_models_that_fit_run_together() {
    if no_vulkan() {
        return;
    }
    let (a, b) = (short(1), plan(&json!({}), 1));
    let error = device().fits(&[&a, &b]).unwrap_err();
    assert!(matches!(&error, GpuError::Unfit { .. }), "{error}");
    assert!(matches!(run_batch(device(), &[], &mut Kept::new(0)), Err(GpuError::Unfit { .. })));
    let giant = plan(&json!({ "particles": { "total": 80_000, "outer": 100 }, "wall": { "lobing": 0 } }), 1);
    assert!(matches!(device().fits(&[&giant]), Err(GpuError::Unfit { .. })));
    assert_eq!(device().max_batch(&giant), 0);
    let most = device().max_batch(&a);
    assert!(most >= 16, "{most}");
    assert!(device().fits(&vec![&a; most]).is_ok());
}

/// Number of progress calls after which the batch is stopped.
const SIGNS: usize = 12;
/// Time after which the batch is stopped in any case, seconds.
const DEADLINE: f64 = 120.0;

/// Records the times of a batch's calls and stops the batch.
struct Pulse {
    since: Stopwatch,
    /// Times of the progress calls for the first member, seconds.
    heard: Vec<f64>,
    stopped: Option<f64>,
}

impl BatchSink for Pulse {
    fn section(&mut self, _: usize, _: Section, _: Checkpoint) {}
    fn progress(&mut self, member: usize, _: i64, _: u32) {
        if member == 0 {
            self.heard.push(self.since.seconds());
        }
    }
    fn cancelled(&mut self, _: usize) -> bool {
        let now = self.since.seconds();
        if self.stopped.is_none() && (self.heard.len() >= SIGNS || now > DEADLINE) {
            self.stopped = Some(now);
        }
        self.stopped.is_some()
    }
    fn failed(&mut self, _: usize, error: SimError) {
        panic!("{error}");
    }
    fn finished(&mut self, _: usize, _: Statistics) {}
}

/// A step of this batch takes some ten milliseconds on a software adapter. On a GPU, many steps
/// form one submission.
#[test]
fn progress_and_cancellation_keep_within_a_second_on_a_slow_adapter_too() {
    if no_vulkan() {
        return;
    }
    let patch = json!({ "steps": 20_000, "particles": { "total": 1000, "outer": 90 }, "wall": { "lobing": 0 } });
    let mut plans: Vec<Plan> = (1..=3).map(|seed| plan(&patch, seed)).collect();
    for plan in &mut plans {
        // Records also cause progress calls, several at a time, so record only the last step.
        plan.record_every = plan.steps;
    }
    // Other tests run concurrently on few cores, so the best round counts.
    let (mut usual, mut back) = (f64::INFINITY, f64::INFINITY);
    for round in 0..5 {
        let mut pulse = Pulse { since: Stopwatch::start(), heard: Vec::new(), stopped: None };
        run_batch(device(), &plans, &mut pulse).unwrap();
        let end = pulse.since.seconds();
        let stopped = pulse.stopped.expect("the batch ended before it was stopped");
        let mut gaps: Vec<f64> = pulse.heard.windows(2).map(|w| w[1] - w[0]).collect();
        gaps.sort_by(f64::total_cmp);
        println!("round {round}: gaps {gaps:.3?}, back after {:.3} s", end - stopped);
        assert!(gaps.len() + 1 >= SIGNS, "{} progress calls in {DEADLINE} s", pulse.heard.len());
        (usual, back) = (usual.min(gaps[gaps.len() / 2]), back.min(end - stopped));
        if usual < 1.0 && back < 1.0 {
            return;
        }
    }
    panic!("{usual:.3} s from one sign of life to the next, {back:.3} s to stop");
}
