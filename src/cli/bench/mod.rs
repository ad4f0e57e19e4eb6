//! `oviduct bench`: how fast this machine grows models.
//!
//! | benchmark | measures |
//! |---|---|
//! | `paper` | the paper's Figures 10 and 11: time per step by number of particles, total running times |
//! | `scaling` | time per step by number of threads and particles |
//! | `batch` | models per second on the GPU by batch size |
//! | `peers` | the same model grown by the numba and Warp peers, which are not part of this project |
//! | `overhead` | models per second over HTTP, compared with calling the generator directly, on the cores and on a GPU |

mod batch;
mod curve;
mod device;
pub(super) mod machine;
mod overhead;
pub(super) mod paper;
mod peers;
mod probe;
mod report;
mod scaling;

use super::args::{Bench, BenchArgs};
use super::exit::{Ended, Failure};
use super::interrupt;
use super::scratch::Scratch;
use super::term;
use anyhow::Context;

pub(super) async fn run(args: BenchArgs) -> Ended {
    let out = args.out.clone();
    let json = args.json;
    let (name, task) = match args.what {
        Bench::Paper => ("bench-paper", tokio::task::spawn_blocking(move || paper::run(args.quick, args.gpu))),
        Bench::Scaling => ("bench-scaling", tokio::task::spawn_blocking(move || scaling::run(args.quick))),
        Bench::Peers => {
            let dir = args
                .peers
                .ok_or_else(|| anyhow::anyhow!("--peers DIR is needed: where peer_numba.py and peer_warp.py are"))?;
            let peers = peers::Peers { dir, python: args.python };
            ("bench-peers", tokio::task::spawn_blocking(move || peers::run(args.quick, &peers, args.gpu)))
        }
        Bench::Batch => ("bench-batch", tokio::task::spawn_blocking(move || batch::run(args.quick, args.gpu))),
        Bench::Overhead => ("bench-overhead", tokio::spawn(overhead::run(args.quick, args.gpu))),
    };
    let report = tokio::select! {
        ended = task => ended.context("the benchmark panicked")??,
        () = interrupt::asked_to_stop() => return Err(Failure::Interrupted),
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
