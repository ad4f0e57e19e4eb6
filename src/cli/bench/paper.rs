//! `bench paper`: the paper's Figures 10 and 11 on this machine.
//!
//! All versions run the same model (preset `paper`, including burn-in). Versions with neighbour lists run it completely. All
//! pairs would take minutes to a quarter of an hour: their time per step is measured at a few particle counts, on states
//! of a real run, and integrated over the counts of that run's steps. The output states which method was used.

use super::super::plot::{self, Axes, Line, Scale, SeriesLabelPosition};
use super::curve::{self, Point};
use super::probe::{self, Run, Variant};
use super::report::Report;
use super::{device, machine};
use crate::cli::args::GpuArgs;
use crate::cli::{gpu, term};
use crate::sim::Plan;
use crate::sim::cpu::{CpuSimulation, Kernel};
use crate::sim::gpu::GpuDevice;
use crate::spec::{ModelSpec, Search, preset};
use anyhow::Context;
use serde::Serialize;
use serde_json::{Value, json};

/// Particle counts at which all pairs are sampled: start, kink of the schedule, end, and between them.
const COUNTS: [u32; 6] = [710, 1175, 2000, 3500, 5500, 8300];
/// Steps of a sample with lists: one growth event and the steps until the next.
const WINDOW: u32 = 10;
/// Steps per point in the curve of a whole run.
const SMOOTH: usize = 50;
const SEED: u64 = 1;

/// Measurements in the paper (its Figure 11), in seconds.
const PAPER: [(&str, f64); 3] = [
    ("single core of an Intel Core 2 Quad Q6700", 29_007.491),
    ("four cores of the same", 8_932.576),
    ("NVidia GeForce GTX 280", 62.646),
];

/// A measured version of the simulation.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Version {
    /// Identifier.
    pub(super) id: &'static str,
    /// Description.
    pub(super) label: String,
    /// Whether `seconds` was measured as a whole run, or integrated from samples.
    pub(super) sampled: bool,
    /// Seconds of the whole run.
    pub(super) seconds: f64,
    /// How many times faster than the paper's single core on this machine.
    pub(super) times_paper_single: f64,
    /// Time per step by number of particles.
    pub(super) points: Vec<Point>,
}

impl Version {
    fn whole(id: &'static str, label: String, run: &Run) -> Self {
        let points = curve::smooth(&run.steps, SMOOTH);
        Self { id, label, sampled: false, seconds: run.seconds, times_paper_single: 0.0, points }
    }

    fn sampled(id: &'static str, label: String, points: Vec<Point>, counts: &[u32]) -> Self {
        let seconds = curve::integrate(&points, counts.iter().copied());
        Self { id, label, sampled: true, seconds, times_paper_single: 0.0, points }
    }
}

pub(super) fn run(quick: bool, args: GpuArgs) -> anyhow::Result<Report> {
    let spec = ModelSpec::resolve(preset("paper").context("there is no preset `paper`")?, &json!({}))
        .map_err(|faults| anyhow::anyhow!("the preset `paper` is not valid: {faults:?}"))?;
    let plan = Plan::new(&spec, SEED);
    let cores = machine::threads();
    let (runs, repeats) = if quick { (1, 1) } else { (5, 7) };
    let variant = |search, kernel, threads| Variant { search, kernel, threads };
    let all = |variant: Variant| whole(&plan, variant, runs);

    term::note("whole runs with neighbour lists …");
    let lists = all(variant(Search::Lists, Kernel::Vector, 1))?;
    let multi = all(variant(Search::Lists, Kernel::Vector, cores))?;
    let counts: Vec<u32> = lists.steps.iter().map(|step| step.particles as u32).collect();
    let states = probe::states(&plan, &COUNTS, cores)?;

    term::note("all pairs, sampled …");
    let pairs = |kernel, threads| samples(&states, variant(Search::AllPairs, kernel, threads), 1, repeats);
    let paper_single = pairs(Kernel::Scalar, 1)?;
    let paper_multi = pairs(Kernel::Scalar, cores)?;
    let vector_pairs = pairs(Kernel::Vector, 1)?;
    let scalar_lists = if quick {
        let points = samples(&states, variant(Search::Lists, Kernel::Scalar, 1), WINDOW, repeats)?;
        Version::sampled("lists-scalar", "lists, scalar, one core".into(), points, &counts)
    } else {
        let run = whole(&plan, variant(Search::Lists, Kernel::Scalar, 1), 1)?;
        Version::whole("lists-scalar", "lists, scalar, one core".into(), &run)
    };
    // Sampling a version whose whole run was measured shows its accuracy.
    let check = samples(&states, variant(Search::Lists, Kernel::Vector, 1), WINDOW, repeats.max(3))?;
    let check = curve::integrate(&check, counts.iter().copied());

    let many = |what: &str| format!("{what}, {cores} threads");
    let (version, on_gpu) = match gpu::best(args) {
        Ok(device) => {
            let (version, on_gpu) = gpu_version(&device, &plan, runs)?;
            (Some(version), on_gpu)
        }
        Err(reason) => (None, OnGpu { lines: vec![format!("no GPU: {reason}")], json: json!({ "reason": reason }) }),
    };
    let mut versions = vec![
        Version::sampled("paper-single", "paper's: all pairs, scalar, one core".into(), paper_single, &counts),
        Version::sampled("paper-multi", many("paper's: all pairs, scalar"), paper_multi, &counts),
        Version::sampled("all-pairs-vector", "all pairs, vectors, one core".into(), vector_pairs, &counts),
        scalar_lists,
        Version::whole("lists", "lists, vectors, one core".into(), &lists),
        Version::whole("lists-multi", many("lists, vectors"), &multi),
    ];
    versions.extend(version);
    report(versions, &plan, &Basis { runs, repeats, check, whole: lists.seconds, on_gpu })
}

/// Whole runs on the GPU with readback of sections.
fn gpu_version(device: &GpuDevice, plan: &Plan, runs: usize) -> anyhow::Result<(Version, OnGpu)> {
    term::note(&format!("{} …", device::label(device)));
    let run = device::median(device, std::slice::from_ref(plan), runs)?;
    let points = curve::smooth(&run.points, SMOOTH / plan.record_every.max(1) as usize + 1);
    let label = format!("lists, {}", device::label(device));
    let version = Version { id: "gpu", label, sampled: false, seconds: run.seconds, times_paper_single: 0.0, points };
    let mut lines = device::lines(device);
    let dispatches = run.report.dispatches;
    if let Some(seconds) = run.report.device_seconds {
        lines.push(format!(
            "{} of its {} in compute passes by its own clock: {dispatches} dispatches of {:.2} µs on average; the host \
             spent {} reading the sections",
            show(seconds),
            show(run.seconds),
            run.microseconds_a_dispatch(),
            show(run.report.host_seconds),
        ));
    }
    let json = json!({ "device": device::describe(device), "run": run.describe() });
    Ok((version, OnGpu { lines, json }))
}

/// The run of median time of `runs`.
fn whole(plan: &Plan, variant: Variant, runs: usize) -> anyhow::Result<Run> {
    let mut all: Vec<Run> = (0..runs).map(|_| probe::whole(plan, variant, |_| {})).collect::<anyhow::Result<_>>()?;
    all.sort_by(|a, b| a.seconds.total_cmp(&b.seconds));
    Ok(all.swap_remove((runs - 1) / 2))
}

fn samples(states: &[CpuSimulation], variant: Variant, window: u32, repeats: usize) -> anyhow::Result<Vec<Point>> {
    let pool = variant.pool()?;
    states.iter().map(|state| probe::sample(state, variant, &pool, window, repeats)).collect()
}

/// How it was measured.
struct Basis {
    runs: usize,
    repeats: usize,
    /// Seconds of a run with lists by sampling, and as measured.
    check: f64,
    whole: f64,
    on_gpu: OnGpu,
}

/// Results of the GPU, or the reason why there is none.
struct OnGpu {
    lines: Vec<String>,
    json: Value,
}

fn report(mut versions: Vec<Version>, plan: &Plan, basis: &Basis) -> anyhow::Result<Report> {
    let seconds = |id: &str| versions.iter().find(|v| v.id == id).map_or(f64::NAN, |v| v.seconds);
    let single = seconds("paper-single");
    let ratios = [
        ("all pairs over lists, both scalar, one core", single / seconds("lists-scalar")),
        ("all pairs over lists, both with vectors, one core", seconds("all-pairs-vector") / seconds("lists")),
        ("all pairs scalar over lists with vectors, one core", single / seconds("lists")),
    ];
    for version in &mut versions {
        version.times_paper_single = single / version.seconds;
    }

    let steps = plan.steps + plan.burn_in;
    let how = format!(
        "whole: {steps} steps ({} of them burn-in), {}; sampled: time per step at {} particles, {}, from states of a \
         real run, integrated over the counts of its steps by power laws between them",
        plan.burn_in,
        machine::runs(basis.runs),
        COUNTS.map(|n| n.to_string()).join(", "),
        machine::runs(basis.repeats),
    );
    let check =
        format!("accuracy of sampling: lists on one core sampled {}, whole {}", show(basis.check), show(basis.whole));
    let mut lines = vec![machine::line(), format!("preset paper, seed {SEED}"), how.clone(), check, String::new()];
    lines.push(format!("{:<40} {:>8} {:>14} {:>12}", "version", "", "total", "times faster"));
    for v in &versions {
        let how = if v.sampled { "sampled" } else { "whole" };
        lines.push(format!("{:<40} {how:>8} {:>14} {:>12.1}", v.label, show(v.seconds), v.times_paper_single));
    }
    lines.push(String::new());
    lines.extend(basis.on_gpu.lines.iter().cloned());
    lines.push(String::new());
    lines.extend(ratios.iter().map(|(what, ratio)| format!("{what}: {ratio:.1}")));
    lines.push(format!("as measured in the paper: {}", PAPER.map(|(what, s)| format!("{what} {s} s")).join("; ")));

    let curve = |v: &Version| {
        let points = v.points.iter().map(|p| (p.particles, 1e3 * p.seconds_per_step)).collect();
        Line { label: format!("{}{}", v.label, if v.sampled { " (sampled)" } else { "" }), points }
    };
    let curves: Vec<Line> = versions.iter().map(curve).collect();
    let axes = Axes {
        title: format!("Time per step, preset paper: {}", machine::line()),
        x: "particles (both loops)",
        y: "time per step, ms",
        x_tick: plot::whole,
        names: SeriesLabelPosition::UpperLeft,
    };
    let files = vec![
        ("time-per-step.svg".to_owned(), plot::draw(&axes, &curves, Scale::Linear)?),
        ("time-per-step-log.svg".to_owned(), plot::draw(&axes, &curves, Scale::Logarithmic)?),
    ];
    let json = json!({
        "bench": "paper", "engine": crate::ENGINE_VERSION, "machine": machine::describe(), "preset": "paper",
        "seed": SEED, "steps": plan.steps, "burn_in": plan.burn_in, "method": how,
        "sampled_at_particles": COUNTS, "runs": basis.runs, "samples": basis.repeats,
        "sampling_check": { "lists_sampled_seconds": basis.check, "lists_whole_seconds": basis.whole },
        "versions": versions, "gpu": basis.on_gpu.json,
        "ratios": {
            "all_pairs_over_lists_scalar": ratios[0].1,
            "all_pairs_over_lists_vector": ratios[1].1,
            "all_pairs_scalar_over_lists_vector": ratios[2].1,
        },
        "paper": PAPER.map(|(what, seconds)| json!({ "device": what, "seconds": seconds })),
    });
    Ok(Report { lines, json, files })
}

/// Seconds as text.
fn show(seconds: f64) -> String {
    match seconds {
        s if s >= 100.0 => format!("{s:.0} s"),
        s if s >= 1.0 => format!("{s:.2} s"),
        s => format!("{:.1} ms", 1e3 * s),
    }
}
