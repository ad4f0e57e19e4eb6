//! `bench scaling`: time per step with neighbour lists, by number of threads and particles.

use super::machine;
use super::probe::{self, Variant};
use super::report::Report;
use crate::sim::Plan;
use crate::sim::cpu::Kernel;
use crate::spec::{ModelSpec, Search, preset};
use anyhow::Context;
use serde_json::json;

/// Steps of a sample: one growth event and the steps until the next.
const WINDOW: u32 = 10;
const SEED: u64 = 1;

pub(super) fn run(quick: bool) -> anyhow::Result<Report> {
    let spec = ModelSpec::resolve(preset("paper").context("there is no preset `paper`")?, &json!({}))
        .map_err(|faults| anyhow::anyhow!("the preset `paper` is not valid: {faults:?}"))?;
    let plan = Plan::new(&spec, SEED);
    let all = machine::threads();
    let mut threads: Vec<usize> = std::iter::successors(Some(1), |n| Some(2 * n)).take_while(|&n| n < all).collect();
    threads.push(all);
    let (counts, repeats): (&[u32], _) =
        if quick { (&[1175, 3500, 8300], 3) } else { (&[710, 1175, 2000, 3500, 5500, 8300], 15) };
    let states = probe::states(&plan, counts, 1)?;
    let mut rows = Vec::new();
    let mut lines = vec![
        machine::line(),
        format!(
            "microseconds per step with neighbour lists, median of {repeats} samples of {WINDOW} steps (preset paper, seed {SEED})"
        ),
        format!(
            "{:>9} {}",
            "particles",
            threads.iter().map(|n| format!("{:>12}", threads_in_words(*n))).collect::<String>()
        ),
    ];
    for state in &states {
        let mut row = Vec::new();
        let mut line = String::new();
        let mut particles = 0.0;
        for &n in &threads {
            let variant = Variant { search: Search::Lists, kernel: Kernel::Vector, threads: n };
            let point = probe::sample(state, variant, &variant.pool()?, WINDOW, repeats)?;
            particles = point.particles;
            line += &format!("{:>12.1}", 1e6 * point.seconds_per_step);
            row.push(json!({ "threads": n, "seconds_per_step": point.seconds_per_step }));
        }
        lines.push(format!("{particles:>9} {line}"));
        rows.push(json!({ "particles": particles, "by_threads": row }));
    }
    let json = json!({
        "bench": "scaling", "engine": crate::ENGINE_VERSION, "machine": machine::describe(), "preset": "paper",
        "seed": SEED, "samples": repeats, "steps_per_sample": WINDOW, "rows": rows,
    });
    Ok(Report { lines, json, files: Vec::new() })
}

fn threads_in_words(count: usize) -> String {
    format!("{count} thread{}", if count == 1 { "" } else { "s" })
}
