//! `bench paper`: measurements for the paper's Figures 10 and 11 on this machine.
//!
//! All versions run the same model (preset `paper`, including burn-in). Versions with neighbour
//! lists run it completely. Versions with all pairs would take up to a quarter of an hour, so their
//! time per step is sampled at a few particle counts, on states of a real run, and integrated over
//! the counts of the steps of that run. The output states the method.

use super::curve::{self, Point};
use super::probe::{self, Run, Variant};
use super::report::Report;
use super::{device, machine};
use crate::plot::{self, Axes, Line, Scale, SeriesLabelPosition};
use oviduct::cli::GpuArgs;
use oviduct::cli::{gpu, term};
use oviduct::sim::Plan;
use oviduct::sim::cpu::{CpuSimulation, Kernel};
use oviduct::sim::gpu::GpuDevice;
use oviduct::spec::Search;
use serde::Serialize;
use serde_json::{Value, json};

/// Particle counts of the samples of all pairs: start, kink of the schedule, end, and values
/// between them.
const COUNTS: [u32; 6] = [710, 1175, 2000, 3500, 5500, 8300];
/// Steps of a sample with lists: one growth event and the steps until the next.
const WINDOW: u32 = 10;
/// Steps per point in the curve of a whole run.
const SMOOTH: usize = 50;
const SEED: u64 = 1;

/// Measurements in the paper (its Figure 11), in seconds.
pub(crate) const PAPER: [(&str, f64); 3] = [
    ("single core of an Intel Core 2 Quad Q6700", 29_007.491),
    ("four cores of the same", 8_932.576),
    ("NVidia GeForce GTX 280", 62.646),
];

/// A measured version of the simulation.
#[derive(Clone, Debug, Serialize)]
pub(crate) struct Version {
    /// Identifier.
    pub(crate) id: &'static str,
    /// Description.
    pub(crate) label: String,
    /// True if `seconds` is integrated from samples, false if it is a whole run.
    pub(crate) sampled: bool,
    /// Seconds of the whole run.
    pub(crate) seconds: f64,
    /// Speedup over the paper's single-core version on this machine.
    pub(crate) times_paper_single: f64,
    /// Time per step by number of particles.
    pub(super) points: Vec<Point>,
}

impl Version {
    fn whole(id: &'static str, label: String, run: &Run) -> Self {
        let points = curve::smooth(&run.steps, SMOOTH);
        Self { id, label, sampled: false, seconds: run.seconds, times_paper_single: 0.0, points }
    }

    /// Returns the seconds per step for a number of particles.
    pub(crate) fn seconds_at(&self, particles: u32) -> f64 {
        curve::at(&self.points, f64::from(particles))
    }

    /// Returns the milliseconds per step by number of particles.
    pub(crate) fn line(&self, name: &str) -> Line {
        let points = self.points.iter().map(|p| (p.particles, 1e3 * p.seconds_per_step)).collect();
        Line { label: format!("{name}{}", if self.sampled { " (sampled)" } else { "" }), points }
    }

    fn sampled(id: &'static str, label: String, points: Vec<Point>, counts: &[u32]) -> Self {
        let seconds = curve::integrate(&points, counts.iter().copied());
        Self { id, label, sampled: true, seconds, times_paper_single: 0.0, points }
    }
}

pub(super) fn run(quick: bool, args: &GpuArgs) -> anyhow::Result<Report> {
    let spec = probe::paper(&json!({}))?;
    report(&measure(&Plan::new(&spec, SEED), quick, args)?)
}

/// Measures all versions on a plan.
pub(crate) fn measure(plan: &Plan, quick: bool, args: &GpuArgs) -> anyhow::Result<Measured> {
    let cores = machine::threads();
    let (runs, repeats) = if quick { (1, 1) } else { (5, 7) };
    let variant = |search, kernel, threads| Variant { search, kernel, threads };
    let all = |variant: Variant| whole(plan, variant, runs);

    term::note("whole runs with neighbour lists …");
    let lists = all(variant(Search::Lists, Kernel::Vector, 1))?;
    let multi = all(variant(Search::Lists, Kernel::Vector, cores))?;
    let particles: Vec<u32> = lists.steps.iter().map(|step| step.particles as u32).collect();
    let counts = sampled_at(&particles);
    let states = probe::states(plan, &counts, cores)?;

    term::note("all pairs, sampled …");
    let pairs = |kernel, threads| samples(&states, variant(Search::AllPairs, kernel, threads), 1, repeats);
    let paper_single = pairs(Kernel::Scalar, 1)?;
    let paper_multi = pairs(Kernel::Scalar, cores)?;
    let vector_pairs = pairs(Kernel::Vector, 1)?;
    let scalar_lists = if quick {
        let points = samples(&states, variant(Search::Lists, Kernel::Scalar, 1), WINDOW, repeats)?;
        Version::sampled("lists-scalar", "lists, scalar, one core".into(), points, &particles)
    } else {
        let run = whole(plan, variant(Search::Lists, Kernel::Scalar, 1), 1)?;
        Version::whole("lists-scalar", "lists, scalar, one core".into(), &run)
    };
    // A sample of a version that was also measured as a whole run shows the accuracy of sampling.
    let check = samples(&states, variant(Search::Lists, Kernel::Vector, 1), WINDOW, repeats.max(3))?;
    let check = curve::integrate(&check, particles.iter().copied());

    let many = |what: &str| format!("{what}, {cores} threads");
    let (version, on_gpu) = match gpu::best(args) {
        Ok(device) => {
            let (version, on_gpu) = gpu_version(&device, plan, runs)?;
            (Some(version), on_gpu)
        }
        Err(reason) => (None, OnGpu { lines: vec![format!("no GPU: {reason}")], json: json!({ "reason": reason }) }),
    };
    let mut versions = vec![
        Version::sampled("paper-single", "paper's: all pairs, scalar, one core".into(), paper_single, &particles),
        Version::sampled("paper-multi", many("paper's: all pairs, scalar"), paper_multi, &particles),
        Version::sampled("all-pairs-vector", "all pairs, vectors, one core".into(), vector_pairs, &particles),
        scalar_lists,
        Version::whole("lists", "lists, vectors, one core".into(), &lists),
        Version::whole("lists-multi", many("lists, vectors"), &multi),
    ];
    versions.extend(version);
    let single = versions[0].seconds;
    for version in &mut versions {
        version.times_paper_single = single / version.seconds;
    }
    let burn_in = plan.burn_in;
    Ok(Measured { versions, particles, burn_in, counts, runs, repeats, check, on_gpu })
}

/// Returns the particle counts at which a run is sampled: those of [`COUNTS`] that it reaches, and
/// its first and last.
fn sampled_at(particles: &[u32]) -> Vec<u32> {
    let (Some(&first), Some(&last)) = (particles.first(), particles.last()) else { return Vec::new() };
    let between = COUNTS.into_iter().filter(|count| (first + 1..last).contains(count));
    let mut counts: Vec<u32> = std::iter::once(first).chain(between).chain([last]).collect();
    counts.dedup();
    counts
}

/// Measures whole runs on the GPU, including the readback of sections.
fn gpu_version(device: &GpuDevice, plan: &Plan, runs: usize) -> anyhow::Result<(Version, OnGpu)> {
    term::note(&format!("{} …", device::label(device)));
    let run = device::median(device, std::slice::from_ref(plan), runs)?;
    let points = curve::smooth(&run.points, SMOOTH / plan.record_every.max(1) as usize + 1);
    let label = format!("lists, {}", device::label(device));
    let version = Version { id: "gpu", label, sampled: false, seconds: run.seconds, times_paper_single: 0.0, points };
    let mut lines = device::lines(device);
    let dispatches = run.report.dispatches;
    lines.push(format!(
        "{dispatches} dispatches of {:.2} µs on average; the host spent {} of {} reading the sections",
        run.microseconds_a_dispatch(),
        show(run.report.host_seconds),
        show(run.seconds),
    ));
    let json = json!({ "device": device::describe(device), "run": run.describe() });
    Ok((version, OnGpu { lines, json }))
}

/// Returns the run of median time of `runs`.
fn whole(plan: &Plan, variant: Variant, runs: usize) -> anyhow::Result<Run> {
    let mut all: Vec<Run> = (0..runs).map(|_| probe::whole(plan, variant, |_| {})).collect::<anyhow::Result<_>>()?;
    all.sort_by(|a, b| a.seconds.total_cmp(&b.seconds));
    Ok(all.swap_remove((runs - 1) / 2))
}

fn samples(states: &[CpuSimulation], variant: Variant, window: u32, repeats: usize) -> anyhow::Result<Vec<Point>> {
    let pool = variant.pool()?;
    states.iter().map(|state| probe::sample(state, variant, &pool, window, repeats)).collect()
}

/// All versions and the method of measurement.
pub(crate) struct Measured {
    pub(crate) versions: Vec<Version>,
    /// Particles in each step, including the burn-in.
    pub(crate) particles: Vec<u32>,
    pub(crate) burn_in: u32,
    /// Particle counts of the samples.
    counts: Vec<u32>,
    runs: usize,
    repeats: usize,
    /// Sampled seconds of a run with lists.
    check: f64,
    on_gpu: OnGpu,
}

impl Measured {
    /// Returns a version if it was measured.
    pub(crate) fn version(&self, id: &str) -> Option<&Version> {
        self.versions.iter().find(|version| version.id == id)
    }

    /// Returns the method of measurement as text.
    pub(crate) fn method(&self) -> String {
        format!(
            "whole: {} steps ({} of them burn-in), {}; sampled: time per step at {} particles, {} or more, from states of a \
             real run, integrated over the counts of its steps by power laws between them",
            self.particles.len(),
            self.burn_in,
            machine::runs(self.runs),
            self.counts.iter().map(u32::to_string).collect::<Vec<_>>().join(", "),
            machine::runs(self.repeats),
        )
    }

    /// Returns the accuracy of sampling as text.
    pub(crate) fn accuracy(&self) -> String {
        let whole = self.version("lists").map_or(f64::NAN, |version| version.seconds);
        format!("accuracy of sampling: lists on one core sampled {}, whole {}", show(self.check), show(whole))
    }

    /// Returns the GPU and its run, or the reason why there is none.
    pub(crate) fn gpu(&self) -> &Value {
        &self.on_gpu.json
    }
}

/// Results of the GPU, or the reason why there is none.
struct OnGpu {
    lines: Vec<String>,
    json: Value,
}

fn report(measured: &Measured) -> anyhow::Result<Report> {
    let versions = &measured.versions;
    let seconds = |id: &str| measured.version(id).map_or(f64::NAN, |v| v.seconds);
    let single = seconds("paper-single");
    let ratios = [
        ("all pairs over lists, both scalar, one core", single / seconds("lists-scalar")),
        ("all pairs over lists, both with vectors, one core", seconds("all-pairs-vector") / seconds("lists")),
        ("all pairs scalar over lists with vectors, one core", single / seconds("lists")),
    ];
    let how = measured.method();
    let mut lines =
        vec![machine::line(), format!("preset paper, seed {SEED}"), how.clone(), measured.accuracy(), String::new()];
    lines.push(format!("{:<40} {:>8} {:>14} {:>12}", "version", "", "total", "times faster"));
    for v in versions {
        let how = if v.sampled { "sampled" } else { "whole" };
        lines.push(format!("{:<40} {how:>8} {:>14} {:>12.1}", v.label, show(v.seconds), v.times_paper_single));
    }
    lines.push(String::new());
    lines.extend(measured.on_gpu.lines.iter().cloned());
    lines.push(String::new());
    lines.extend(ratios.iter().map(|(what, ratio)| format!("{what}: {ratio:.1}")));
    lines.push(format!("as measured in the paper: {}", PAPER.map(|(what, s)| format!("{what} {s} s")).join("; ")));

    let curves: Vec<Line> = versions.iter().map(|v| v.line(&v.label)).collect();
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
        "bench": "paper", "engine": oviduct::ENGINE_VERSION, "machine": machine::describe(), "preset": "paper",
        "seed": SEED, "steps": measured.particles.len() as u64 - u64::from(measured.burn_in), "burn_in": measured.burn_in,
        "method": how, "sampled_at_particles": measured.counts, "runs": measured.runs, "samples": measured.repeats,
        "sampling_check": { "lists_sampled_seconds": measured.check, "lists_whole_seconds": seconds("lists") },
        "versions": versions, "gpu": measured.on_gpu.json,
        "ratios": {
            "all_pairs_over_lists_scalar": ratios[0].1,
            "all_pairs_over_lists_vector": ratios[1].1,
            "all_pairs_scalar_over_lists_vector": ratios[2].1,
        },
        "paper": PAPER.map(|(what, seconds)| json!({ "device": what, "seconds": seconds })),
    });
    Ok(Report { lines, json, files })
}

/// Formats seconds.
fn show(seconds: f64) -> String {
    match seconds {
        s if s >= 100.0 => format!("{s:.0} s"),
        s if s >= 1.0 => format!("{s:.2} s"),
        s => format!("{:.1} ms", 1e3 * s),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_is_sampled_from_its_start_to_its_end() {
        assert_eq!(sampled_at(&[710, 710, 720, 8300]), COUNTS);
        assert_eq!(sampled_at(&[300, 420]), [300, 420]);
        assert_eq!(sampled_at(&[500, 1000, 2000]), [500, 710, 1175, 2000]);
        assert_eq!(sampled_at(&[300, 300]), [300]);
        assert_eq!(sampled_at(&[]), [0; 0]);
    }
}
