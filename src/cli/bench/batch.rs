//! `bench batch`: models a second on the GPU, by the size of the batch.

use super::{Report, device, machine};
use crate::cli::args::GpuArgs;
use crate::cli::{gpu, term};
use crate::sim::Plan;
use crate::spec::{ModelSpec, preset};
use anyhow::Context;
use serde_json::json;

/// Largest batch that is tried.
const LARGEST: usize = 64;

pub(super) fn run(quick: bool, args: GpuArgs) -> anyhow::Result<Report> {
    let spec = ModelSpec::resolve(preset("paper").context("there is no preset `paper`")?, &json!({}))
        .map_err(|faults| anyhow::anyhow!("the preset `paper` is not valid: {faults:?}"))?;
    let device = match gpu::best(args) {
        Ok(device) => device,
        Err(reason) => {
            let lines = vec![machine::line(), format!("nothing to measure: {reason}")];
            let json = json!({ "bench": "batch", "machine": machine::describe(), "device": null, "reason": reason });
            return Ok(Report { lines, json, files: Vec::new() });
        }
    };
    let most = device.max_batch(&Plan::new(&spec, 1)).min(if quick { 8 } else { LARGEST });
    let mut lines = vec![
        format!("{} on {}", device.name(), machine::line()),
        "simulation of the preset paper, sections read back, no surface".to_owned(),
        format!("{:>6} {:>12} {:>14} {:>18}", "batch", "seconds", "models/s", "device seconds"),
    ];
    let mut rows = Vec::new();
    for size in std::iter::successors(Some(1), |n| Some(2 * n)).take_while(|&n| n <= most) {
        term::note(&format!("a batch of {size} …"));
        let plans: Vec<Plan> = (1..=size as u64).map(|seed| Plan::new(&spec, seed)).collect();
        // What drivers put off until the first run does not count.
        device::run(&device, &plans)?;
        let runs = if quick { 1 } else { 3 };
        let mut all: Vec<device::Batch> = (0..runs).map(|_| device::run(&device, &plans)).collect::<Result<_, _>>()?;
        all.sort_by(|a, b| a.seconds.total_cmp(&b.seconds));
        let run = &all[(runs - 1) / 2];
        let rate = size as f64 / run.seconds;
        let on_device = run.report.device_seconds.map_or("unknown".to_owned(), |s| format!("{s:.3}"));
        lines.push(format!("{size:>6} {:>12.3} {rate:>14.2} {on_device:>18}", run.seconds));
        rows.push(json!({
            "batch": size, "seconds": run.seconds, "models_per_second": rate,
            "device_seconds": run.report.device_seconds, "dispatches": run.report.dispatches,
            "submissions": run.report.submissions,
        }));
    }
    let json = json!({
        "bench": "batch", "engine": crate::ENGINE_VERSION, "machine": machine::describe(), "device": device.name(),
        "preset": "paper", "largest_that_fits": device.max_batch(&Plan::new(&spec, 1)), "rows": rows,
    });
    Ok(Report { lines, json, files: Vec::new() })
}
