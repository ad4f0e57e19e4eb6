//! `bench peers`: compares the simulation with Python implementations of the same model, which are
//! not part of this project.
//!
//! A peer grows the paper's model with the same steps and particles, on the threads of
//! `NUMBA_NUM_THREADS` or the device of `--device`. It prints one line of JSON with `device`,
//! `seconds` and `burn_seconds`. Runs of a peer and of oviduct alternate. Times are those of the
//! steps, without compilation.

use super::probe::{self, Variant};
use super::report::Report;
use super::{device, machine};
use anyhow::{Context, bail, ensure};
use oviduct::cli::GpuArgs;
use oviduct::cli::{gpu, term};
use oviduct::sim::Plan;
use oviduct::sim::cpu::Kernel;
use oviduct::sim::gpu::GpuDevice;
use oviduct::spec::Search;
use serde::{Deserialize, Serialize};
use serde_json::json;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

const SEED: u64 = 1;

/// Directory of the peers and their interpreter.
#[derive(Clone, Debug)]
pub(super) struct Peers {
    pub(super) dir: PathBuf,
    pub(super) python: PathBuf,
}

/// Members of the JSON that a peer prints.
#[derive(Debug, Deserialize)]
struct PeerResult {
    device: String,
    seconds: f64,
    burn_seconds: f64,
}

/// Hardware of a comparison.
#[derive(Clone, Copy)]
enum Hardware<'a> {
    Cpu { threads: usize },
    Gpu(&'a GpuDevice),
}

/// A comparison: times of all runs in pairs.
#[derive(Debug, Serialize)]
struct Comparison {
    peer: &'static str,
    peer_device: String,
    ours: String,
    peer_seconds: Vec<f64>,
    seconds: Vec<f64>,
    /// Speedup of oviduct over the peer, by the medians.
    ratio: f64,
}

pub(super) fn run(quick: bool, peers: &Peers, args: &GpuArgs) -> anyhow::Result<Report> {
    let spec = probe::paper(&json!({}))?;
    let plan = Plan::new(&spec, SEED);
    let runs = if quick { 1 } else { 5 };
    let all = machine::threads();
    let mut comparisons = vec![("numba", Hardware::Cpu { threads: 1 })];
    if all > 1 {
        comparisons.push(("numba", Hardware::Cpu { threads: all }));
    }
    let device = gpu::best(args);
    comparisons.push(match &device {
        Ok(device) => ("warp", Hardware::Gpu(device)),
        Err(reason) => {
            term::note(&format!("no GPU ({reason}): Warp runs on one core"));
            ("warp", Hardware::Cpu { threads: 1 })
        }
    });
    // The failure of a peer does not discard the results of the others.
    let (mut rows, mut failures) = (Vec::new(), Vec::new());
    for (peer, place) in comparisons {
        match compare(peer, peers, &plan, place, runs) {
            Ok(row) => rows.push(row),
            Err(error) => failures.push(format!("{peer} beside ours on {}: {error:#}", named(place))),
        }
    }
    ensure!(!rows.is_empty(), "no peer could be compared: {}", failures.join("; "));
    Ok(report(&rows, failures, runs))
}

fn compare(
    peer: &'static str,
    peers: &Peers,
    plan: &Plan,
    place: Hardware<'_>,
    runs: usize,
) -> anyhow::Result<Comparison> {
    let (mut peer_device, mut peer_seconds, mut seconds) = (String::new(), Vec::new(), Vec::new());
    for run in 1..=runs {
        term::note(&format!("{peer} and ours, {}, run {run} of {runs} …", named(place)));
        let told = peers.run(peer, plan, place)?;
        peer_seconds.push(told.seconds + told.burn_seconds);
        seconds.push(ours(plan, place)?);
        peer_device = told.device;
    }
    let ratio = machine::median(peer_seconds.clone()) / machine::median(seconds.clone());
    Ok(Comparison { peer, peer_device, ours: named(place), peer_seconds, seconds, ratio })
}

fn named(place: Hardware<'_>) -> String {
    match place {
        Hardware::Cpu { threads: 1 } => "one core".to_owned(),
        Hardware::Cpu { threads } => format!("{threads} threads"),
        Hardware::Gpu(device) => device::label(device),
    }
}

/// Returns the seconds of one run of oviduct.
fn ours(plan: &Plan, place: Hardware<'_>) -> anyhow::Result<f64> {
    match place {
        Hardware::Cpu { threads } => {
            let variant = Variant { search: Search::Lists, kernel: Kernel::Vector, threads };
            Ok(probe::whole(plan, variant, |_| {})?.seconds)
        }
        Hardware::Gpu(device) => Ok(device::median(device, std::slice::from_ref(plan), 1)?.seconds),
    }
}

impl Peers {
    fn run(&self, peer: &str, plan: &Plan, place: Hardware<'_>) -> anyhow::Result<PeerResult> {
        let program = self.dir.join(format!("peer_{peer}.py"));
        ensure!(program.is_file(), "--peers: there is no {}", program.display());
        let mut command = Command::new(&self.python);
        command.arg(&program).args(["--steps", &plan.steps.to_string(), "--seed", &SEED.to_string()]);
        match place {
            Hardware::Cpu { threads } => command.env("NUMBA_NUM_THREADS", threads.to_string()),
            Hardware::Gpu(_) => command.args(["--device", "cuda:0"]),
        };
        let done = command
            .stdin(Stdio::null())
            .output()
            .with_context(|| format!("--python: {} cannot be run", self.python.display()))?;
        if !done.status.success() {
            let told = String::from_utf8_lossy(&done.stderr);
            let last = told.lines().rfind(|line| !line.trim().is_empty()).unwrap_or("it printed nothing");
            bail!("{} failed ({}): {last}", program.display(), done.status);
        }
        read_result(&program, &String::from_utf8_lossy(&done.stdout))
    }
}

/// Reads the last line that a peer printed.
fn read_result(program: &Path, output: &str) -> anyhow::Result<PeerResult> {
    let line = output.lines().rfind(|line| !line.trim().is_empty()).unwrap_or_default();
    let told: PeerResult =
        serde_json::from_str(line).with_context(|| format!("{} printed no result, but {line:?}", program.display()))?;
    ensure!(told.seconds + told.burn_seconds > 0.0, "{} took no time", program.display());
    Ok(told)
}

fn report(rows: &[Comparison], failures: Vec<String>, runs: usize) -> Report {
    let mut lines = vec![
        machine::line(),
        format!("preset paper, seed {SEED}, all steps with burn-in, {}, alternated", machine::runs(runs)),
        String::new(),
        format!(
            "{:<8} {:<24} {:>10}   {:<24} {:>10} {:>14}",
            "peer", "on", "seconds", "ours on", "seconds", "times as fast"
        ),
    ];
    for row in rows {
        lines.push(format!(
            "{:<8} {:<24} {:>10.3}   {:<24} {:>10.3} {:>14.2}",
            row.peer,
            row.peer_device,
            machine::median(row.peer_seconds.clone()),
            row.ours,
            machine::median(row.seconds.clone()),
            row.ratio
        ));
    }
    let json = json!({
        "bench": "peers", "engine": oviduct::ENGINE_VERSION, "machine": machine::describe(), "preset": "paper", "seed": SEED,
        "runs": runs, "comparisons": rows, "failures": failures,
    });
    lines.extend(failures.into_iter().map(|failure| format!("failed: {failure}")));
    Report { lines, json, files: Vec::new() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use oviduct::cli::GpuUse;

    #[test]
    fn the_last_line_of_a_peer_is_its_result() {
        let path = Path::new("peer_numba.py");
        let line =
            r#"{"peer": "numba", "device": "cpu x2 (omp)", "seconds": 1.5, "burn_seconds": 0.25, "final_n": 7956}"#;
        let found = read_result(path, &format!("a warning\n{line}\n\n")).unwrap();
        assert_eq!((found.device.as_str(), found.seconds, found.burn_seconds), ("cpu x2 (omp)", 1.5, 0.25));
        assert!(read_result(path, "").unwrap_err().to_string().contains("peer_numba.py printed no result"));
        assert!(read_result(path, &line.replace("1.5", "0").replace("0.25", "0")).is_err());
    }

    /// Peers written for the shell, in place of Python.
    #[cfg(unix)]
    fn peers(dir: &Path, numba: &str) -> Peers {
        std::fs::write(dir.join("peer_numba.py"), numba).unwrap();
        Peers { dir: dir.to_owned(), python: "sh".into() }
    }

    #[cfg(unix)]
    #[test]
    fn a_peer_that_fails_is_named_with_what_it_said_last() {
        let dir = tempfile::tempdir().unwrap();
        let spec = probe::paper(&json!({})).unwrap();
        let plan = Plan::new(&spec, SEED);
        let run = |numba: &str| peers(dir.path(), numba).run("numba", &plan, Hardware::Cpu { threads: 2 });
        let line = r#"{"device": "cpu", "seconds": 1, "burn_seconds": 0.5}"#;
        let told = run(&format!("[ \"$NUMBA_NUM_THREADS $1 $2\" = '2 --steps 2000' ] && echo '{line}'")).unwrap();
        assert_eq!(told.seconds, 1.0);
        let error = run("echo first >&2; echo no numba >&2; exit 3").unwrap_err().to_string();
        assert!(error.contains("peer_numba.py failed (exit status: 3): no numba"), "{error}");
        let error = run("exit 1").unwrap_err().to_string();
        assert!(error.contains("it printed nothing"), "{error}");
    }

    #[cfg(unix)]
    #[test]
    fn without_any_peer_the_benchmark_fails_and_names_all() {
        let dir = tempfile::tempdir().unwrap();
        let peers = peers(dir.path(), "exit 1");
        let off = GpuArgs { gpu: GpuUse::Off, allow_software_adapter: false };
        let error = run(true, &peers, &off).err().unwrap().to_string();
        for wanted in ["no peer could be compared", "peer_numba.py failed", "there is no", "peer_warp.py"] {
            assert!(error.contains(wanted), "{error}");
        }
    }
}
