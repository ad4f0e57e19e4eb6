//! `oviduct-lab bench`: how fast this machine grows models.
//!
//! | benchmark | measures |
//! |---|---|
//! | `paper` | the paper's Figures 10 and 11: time per step by number of particles, total running times |
//! | `scaling` | time per step by number of threads and particles |
//! | `model` | seconds of each stage of whole models, compared with another build |
//! | `batch` | models per second on the GPU by batch size |
//! | `peers` | the same model grown by the numba and Warp peers, which are not part of this project |
//! | `queue` | submissions, claims and ends per second of the job store |
//! | `overhead` | models per second over HTTP, compared with calling the generator directly, on the cores and on a GPU |

mod batch;
mod curve;
mod device;
pub(crate) mod machine;
mod model;
mod overhead;
pub(crate) mod paper;
mod peers;
mod probe;
mod queue;
mod report;
mod scaling;

use anyhow::Context;
use clap::builder::FalseyValueParser;
use clap::{Args, ValueEnum};
use oviduct::cli::{Ended, Failure, GpuArgs, Scratch, Signals, term};
use std::path::PathBuf;

/// Options of `bench`.
#[derive(Clone, Debug, Args)]
pub(crate) struct BenchArgs {
    /// Benchmark to run
    #[arg(value_name = "WHAT", value_enum)]
    what: Bench,
    /// Take fewer measurements, within half a minute
    #[arg(long, value_parser = FalseyValueParser::new())]
    quick: bool,
    /// Print one JSON object
    #[arg(long, value_parser = FalseyValueParser::new())]
    json: bool,
    /// Directory for the results as JSON and text, and for plots
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// With `peers`: the directory of peer_numba.py and peer_warp.py
    #[arg(long, value_name = "DIR")]
    peers: Option<PathBuf>,
    /// With `peers`: a Python interpreter with the packages of the peers
    #[arg(long, value_name = "PROGRAM", default_value = "python3")]
    python: PathBuf,
    /// With `model`: the program that grows the models [default: `oviduct` beside this program]
    #[arg(long, value_name = "PROGRAM")]
    program: Option<PathBuf>,
    /// With `model`: another build of the program, whose runs alternate with those of the first
    #[arg(long, value_name = "PROGRAM")]
    before: Option<PathBuf>,
    /// With `model`: preset of a model; may be repeated
    #[arg(long = "preset", value_name = "NAME", default_values = ["pig", "paper", "human"])]
    presets: Vec<String>,
    /// With `queue`: URL of an empty PostgreSQL database [default: SQLite in a temporary directory]
    #[arg(long, value_name = "URL")]
    database: Option<String>,
    #[command(flatten)]
    pub(crate) gpu: GpuArgs,
}

/// Benchmarks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Bench {
    /// The paper's comparison: all pairs and neighbour lists, one core and all cores
    Paper,
    /// Seconds of each stage of whole models, on one core and on all
    Model,
    /// Time per step by number of threads and particles
    Scaling,
    /// The same model grown by this program and by peers in Python (numba and Warp)
    Peers,
    /// Models per second on the GPU by batch size
    Batch,
    /// Models per second over HTTP, compared with direct calls of the generator
    Overhead,
    /// Submissions, claims and ends per second of the job store
    Queue,
}

pub(crate) async fn run(args: BenchArgs) -> Ended {
    let BenchArgs { what, quick, json, out, peers, python, program, before, presets, database, gpu } = args;
    let (name, task) = match what {
        Bench::Paper => ("bench-paper", tokio::task::spawn_blocking(move || paper::run(quick, &gpu))),
        Bench::Model => {
            let models = model::Models { program, before, presets };
            ("bench-model", tokio::task::spawn_blocking(move || model::run(quick, &models)))
        }
        Bench::Scaling => ("bench-scaling", tokio::task::spawn_blocking(move || scaling::run(quick))),
        Bench::Peers => {
            let dir = peers
                .ok_or_else(|| anyhow::anyhow!("--peers DIR is needed: where peer_numba.py and peer_warp.py are"))?;
            let peers = peers::Peers { dir, python };
            ("bench-peers", tokio::task::spawn_blocking(move || peers::run(quick, &peers, &gpu)))
        }
        Bench::Batch => ("bench-batch", tokio::task::spawn_blocking(move || batch::run(quick, &gpu))),
        Bench::Overhead => ("bench-overhead", tokio::spawn(overhead::run(quick, gpu))),
        Bench::Queue => ("bench-queue", tokio::spawn(queue::run(quick, database))),
    };
    let mut signals = Signals::listen();
    let report = tokio::select! {
        ended = task => ended.context("the benchmark panicked")??,
        () = signals.asked_to_stop() => return Err(Failure::Interrupted),
    };
    if let Some(out) = out {
        let scratch = Scratch::new(&out).with_context(|| format!("--out {}", out.display()))?;
        let text = serde_json::to_string_pretty(&report.json)?;
        let main = [(format!("{name}.json"), text), (format!("{name}.txt"), report.lines.join("\n") + "\n")];
        for (name, text) in main.into_iter().chain(report.files) {
            std::fs::write(scratch.dir().join(&name), text).with_context(|| name.clone())?;
            scratch.publish(&name).with_context(|| name.clone())?;
        }
    }
    if json {
        return Ok(term::print_json(&report.json)?);
    }
    for line in report.lines {
        term::print(&line)?;
    }
    Ok(())
}
