//! Tests of batches on a device of CPU simulations, which can fail, be lost or panic.

use super::super::{Backend, Output, Progress, Stage, generate};
use super::*;
use crate::sim::cpu::{CpuSimulation, Kernel};
use crate::sim::gpu::GpuError;
use crate::spec::{ModelSpec, Search, preset};
use serde_json::json;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::atomic::{AtomicU32, AtomicU64};

/// Device that runs all members step by step on one thread.
#[derive(Default)]
struct Twin {
    /// The step at which the device is lost.
    lost_at: Option<i64>,
    /// A member and the step at which one of its positions is not finite.
    fails_at: Option<(usize, i64)>,
    /// Number of members that fit into the memory of the device.
    room: Option<usize>,
    /// Number of members of each run, including runs that did not fit into memory.
    runs: Mutex<Vec<usize>>,
    replays: AtomicU64,
    /// Number of reported sections.
    reported: AtomicU64,
}

impl Device for Twin {
    type Mark = CpuSimulation;

    fn name(&self) -> String {
        "a twin".to_owned()
    }

    fn run(&self, plans: &[Plan], sink: &mut dyn BatchSink<CpuSimulation>) -> Result<(), GpuError> {
        self.runs.lock().push(plans.len());
        if self.room.is_some_and(|room| plans.len() > room) {
            return Err(GpuError::OutOfMemory);
        }
        let mut members: Vec<Option<CpuSimulation>> =
            plans.iter().map(|plan| Some(CpuSimulation::new(plan.clone(), 1))).collect();
        for time in -i64::from(plans[0].burn_in)..=i64::from(plans[0].steps) {
            if self.lost_at == Some(time) {
                return Err(GpuError::Lost { detail: "unplugged".to_owned() });
            }
            for (index, (place, plan)) in members.iter_mut().zip(plans).enumerate() {
                let Some(simulation) = place else { continue };
                if plan.records_at(time) {
                    self.reported.fetch_add(1, Ordering::Relaxed);
                    sink.section(index, simulation.section(), fork(simulation));
                }
                sink.progress(index, time, simulation.particles());
                if self.fails_at == Some((index, time)) {
                    sink.failed(index, SimError::NotFinite { step: time });
                    *place = None;
                } else if sink.cancelled(index) {
                    *place = None;
                } else if time == i64::from(plan.steps) {
                    sink.finished(index, simulation.statistics());
                } else {
                    simulation.step().unwrap();
                }
            }
        }
        Ok(())
    }

    fn replay(&self, plan: &Plan, mark: &CpuSimulation) -> Result<Vec<Section>, GpuError> {
        self.replays.fetch_add(1, Ordering::Relaxed);
        let mut simulation = fork(mark);
        let mut sections = Vec::new();
        loop {
            simulation.step().unwrap();
            sections.push(simulation.section());
            if plan.records_at(simulation.time()) {
                return Ok(sections);
            }
        }
    }
}

fn fork(simulation: &CpuSimulation) -> CpuSimulation {
    simulation.fork(Search::Lists, Kernel::Vector, 1)
}

fn request(seed: u64, dir: &Path) -> Request {
    let patch = json!({
        "steps": 120, "burn_in": 40,
        "particles": { "total": { "keys": [[0, 260], [1, 620]] }, "outer": { "keys": [[0, 60], [1, 90]] } },
    });
    let dir = dir.join(seed.to_string());
    std::fs::create_dir_all(&dir).unwrap();
    Request {
        preset: "pig".into(),
        spec: ModelSpec::resolve(preset("pig").unwrap(), &patch).unwrap(),
        seed,
        backend: Backend::Cpu,
        outputs: vec![Output::Glb].into(),
        dir,
        memory_limit_bytes: None,
    }
}

fn hashes(outcome: &Outcome) -> BTreeMap<String, String> {
    outcome.files.iter().map(|f| (f.name.clone(), f.sha256.clone())).collect()
}

type Ends = Vec<Result<Outcome, GenerateError>>;

/// Runs requests with these sinks over a pool of `threads` threads. Asserts that every member ends
/// exactly once and that the device is released once.
fn run(device: &Twin, requests: &[Request], sinks: &[&dyn Sink], cancels: &[CancelToken], threads: usize) -> Ends {
    let members: Vec<Member<'_>> = (0..requests.len())
        .map(|i| Member { request: &requests[i], plan: None, sink: sinks[i], cancel: &cancels[i] })
        .collect();
    let ends: Vec<Mutex<Option<Result<Outcome, GenerateError>>>> = requests.iter().map(|_| Mutex::new(None)).collect();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    let (idle, ended) = (AtomicU32::new(0), |index: usize, result| {
        assert!(ends[index].lock().replace(result).is_none(), "{index} ended twice");
    });
    let simulated = || assert_eq!(idle.fetch_add(1, Ordering::Relaxed), 0, "the device was released twice");
    on(device, Some(&pool), &members, Calls { simulated: &simulated, ended: &ended });
    assert_eq!(idle.into_inner(), 1);
    ends.into_iter().map(|end| end.lock().take().expect("ended")).collect()
}

fn plainly(device: &Twin, requests: &[Request], threads: usize) -> Ends {
    let sinks: Vec<&dyn Sink> = requests.iter().map(|_| &() as &dyn Sink).collect();
    run(device, requests, &sinks, &vec![CancelToken::default(); requests.len()], threads)
}

#[test]
fn a_batch_makes_what_each_would_be_alone() {
    let dir = tempfile::tempdir().unwrap();
    let requests: Vec<Request> = [1, 2, 3].map(|seed| request(seed, dir.path())).into();
    let alone: Vec<_> = requests.iter().map(|r| hashes(&generate(r, &(), &CancelToken::default()).unwrap())).collect();
    let device = Twin::default();
    for threads in [1, 3] {
        for (end, alone) in plainly(&device, &requests, threads).into_iter().zip(&alone) {
            let outcome = end.unwrap();
            assert_eq!((outcome.used, outcome.device.as_str()), (UsedBackend::Gpu, "a twin"));
            assert_eq!(&hashes(&outcome), alone);
            assert!(outcome.seconds.simulate > 0.0 && outcome.seconds.total >= outcome.seconds.simulate);
        }
    }
}

#[test]
fn even_surfaces_and_pieces_are_those_of_a_cpu() {
    let dir = tempfile::tempdir().unwrap();
    let of = |seed: u64, patch: &serde_json::Value| {
        let mut request = request(seed, dir.path());
        let mut whole = request.spec.to_json();
        json_patch::merge(&mut whole, patch);
        request.spec = ModelSpec::from_json(&whole).unwrap();
        request
    };
    let piece = json!({ "piece": { "from": 0.25, "to": 0.6 } });
    let even = json!({ "length_mm": 4, "mesh": { "resolution_um": 80 }, "piece": { "from": 0.25, "to": 0.6 } });
    for patch in [piece, even] {
        let requests = [of(1, &patch), of(2, &patch)];
        let ends = plainly(&Twin::default(), &requests, 2);
        for (end, request) in ends.into_iter().zip(&requests) {
            let alone = generate(request, &(), &CancelToken::default()).unwrap();
            assert_eq!(hashes(&end.unwrap()), hashes(&alone), "{patch}");
        }
    }
}

/// Measures the maximum number of reported sections that wait for the loft.
struct Behind<'a> {
    device: &'a Twin,
    lofted: AtomicU64,
    most: AtomicU64,
}

impl Sink for Behind<'_> {
    fn progress(&self, _: &Progress) {}
    fn section(&self, _: &Section) {
        let lofted = self.lofted.fetch_add(1, Ordering::Relaxed);
        self.most.fetch_max(self.device.reported.load(Ordering::Relaxed) - lofted, Ordering::Relaxed);
    }
}

#[test]
fn the_device_waits_for_a_loft_that_lags_behind() {
    let dir = tempfile::tempdir().unwrap();
    let patch = json!({
        "steps": 100, "burn_in": 0, "solver": { "record_every": 1 },
        "particles": { "total": { "keys": [[0, 180], [1, 220]] }, "outer": 50 },
    });
    let spec = ModelSpec::resolve(preset("pig").unwrap(), &patch).unwrap();
    let request = Request { spec, ..request(1, dir.path()) };
    let device = Twin::default();
    let behind = Behind { device: &device, lofted: AtomicU64::new(0), most: AtomicU64::new(0) };
    let ends = run(&device, &[request], &[&behind], &[CancelToken::default()], 1);
    assert!(ends[0].is_ok(), "{ends:?}");
    assert_eq!(behind.lofted.into_inner(), 101);
    // The sections in the inbox, the section that is lofted, and the section that fills the inbox.
    let most = behind.most.into_inner();
    assert!((1..=INBOX as u64 + 2).contains(&most), "{most}");
}

/// Sink that stops at a step, or panics at a section.
#[derive(Default)]
struct Watcher {
    stops_at: Option<(u32, CancelToken)>,
    panics: bool,
    stages: Mutex<Vec<(Stage, f64)>>,
    sections: AtomicU32,
}

impl Sink for Watcher {
    fn progress(&self, progress: &Progress) {
        self.stages.lock().push((progress.stage, progress.fraction));
        if let Some((step, cancel)) = &self.stops_at
            && progress.step >= *step
        {
            cancel.cancel();
        }
    }

    fn section(&self, _: &Section) {
        assert!(self.sections.fetch_add(1, Ordering::Relaxed) < 3 || !self.panics, "a fault in one member");
    }
}

#[test]
fn what_ends_badly_ends_alone() {
    let dir = tempfile::tempdir().unwrap();
    let mut requests: Vec<Request> = [1, 2, 3, 4, 5].map(|seed| request(seed, dir.path())).into();
    requests[4].memory_limit_bytes = Some(1);
    let cancels: Vec<CancelToken> = (0..5).map(|_| CancelToken::default()).collect();
    let mut sinks: Vec<Watcher> = (0..5).map(|_| Watcher::default()).collect();
    sinks[1].stops_at = Some((50, cancels[1].clone()));
    sinks[2].panics = true;
    let device = Twin { fails_at: Some((3, 60)), ..Twin::default() };
    let seen: Vec<&dyn Sink> = sinks.iter().map(|s| s as &dyn Sink).collect();
    let ends = run(&device, &requests, &seen, &cancels, 2);
    let alone = generate(&request(1, &dir.path().join("alone")), &(), &CancelToken::default()).unwrap();
    assert_eq!(hashes(ends[0].as_ref().unwrap()), hashes(&alone));
    assert!(matches!(ends[1], Err(GenerateError::Cancelled)));
    assert!(matches!(&ends[2], Err(GenerateError::Panic { detail }) if detail.contains("a fault in one member")));
    assert!(matches!(&ends[3], Err(GenerateError::Simulation { detail }) if detail.contains("step 60")));
    assert!(matches!(ends[4], Err(GenerateError::Memory { limit: 1, .. })));

    let stages = sinks[0].stages.lock();
    assert!(stages.windows(2).all(|w| w[0].1 <= w[1].1), "progress decreased");
    for stage in [Stage::Simulate, Stage::Mesh, Stage::Certify, Stage::Export] {
        assert!(stages.iter().any(|(seen, _)| *seen == stage), "{stage:?}");
    }
    assert_eq!(sinks[0].sections.load(Ordering::Relaxed), 13);
    assert!(sinks[1].sections.load(Ordering::Relaxed) <= 6);
}

#[test]
fn a_lost_device_is_reported_to_all_members_that_it_did_not_finish() {
    let dir = tempfile::tempdir().unwrap();
    let requests: Vec<Request> = [1, 2].map(|seed| request(seed, dir.path())).into();
    let device = Twin { lost_at: Some(70), ..Twin::default() };
    for end in plainly(&device, &requests, 2) {
        let error = end.unwrap_err();
        assert!(matches!(&error, GenerateError::Gpu(GpuError::Lost { .. })), "{error}");
        assert_eq!(error.to_string(), "the GPU was lost: unplugged");
    }
    // The directories can be used again.
    let outcome = generate(&requests[0], &(), &CancelToken::default()).unwrap();
    assert_eq!(outcome.used, UsedBackend::Cpu);
}

#[test]
fn a_batch_that_gets_no_memory_is_halved() {
    let dir = tempfile::tempdir().unwrap();
    let requests: Vec<Request> = [1, 2, 3, 4, 5].map(|seed| request(seed, dir.path())).into();
    let device = Twin { room: Some(2), fails_at: Some((1, 30)), ..Twin::default() };
    let cancels: Vec<CancelToken> = (0..5).map(|_| CancelToken::default()).collect();
    // The member waits for the others when it is cancelled.
    cancels[3].cancel();
    let ends = run(&device, &requests, &[&() as &dyn Sink; 5], &cancels, 2);
    assert_eq!(*device.runs.lock(), [5, 3, 2, 1, 2]);
    for member in [0, 2] {
        let alone = generate(&requests[member], &(), &CancelToken::default()).unwrap();
        let outcome = ends[member].as_ref().unwrap();
        assert_eq!((outcome.used, hashes(outcome)), (UsedBackend::Gpu, hashes(&alone)));
    }
    // The second member of each group that has one fails.
    for member in [1, 4] {
        assert!(matches!(&ends[member], Err(GenerateError::Simulation { detail }) if detail.contains("step 30")));
    }
    assert!(matches!(ends[3], Err(GenerateError::Cancelled)));

    let device = Twin { room: Some(0), ..Twin::default() };
    for end in plainly(&device, &requests[..2], 2) {
        let error = end.unwrap_err();
        assert!(matches!(error, GenerateError::Gpu(GpuError::OutOfMemory)), "{error}");
        assert_eq!(error.to_string(), "the GPU ran out of memory");
    }
    assert_eq!(*device.runs.lock(), [2, 1, 1]);
}
