//! `bench batch`: models per second on the GPU by batch size.

use super::report::Report;
use super::{device, machine, probe};
use crate::plot::{self, Axes, Line, Scale, SeriesLabelPosition};
use oviduct::cli::GpuArgs;
use oviduct::cli::{gpu, term};
use oviduct::sim::Plan;
use oviduct::sim::gpu::GpuDevice;
use oviduct::spec::ModelSpec;
use serde_json::json;

/// Largest batch size.
const LARGEST: usize = 64;
/// Largest batch size with `--quick`.
const LARGEST_QUICK: usize = 8;

pub(super) fn run(quick: bool, args: &GpuArgs) -> anyhow::Result<Report> {
    let (what, patch) = if quick {
        let small = json!({
            "steps": 200, "burn_in": 20,
            "particles": { "total": { "keys": [[0, 260], [1, 900]] }, "outer": { "keys": [[0, 60], [1, 90]] } },
        });
        ("a SMALL model (220 steps including burn-in, 260 to 900 particles)", small)
    } else {
        ("preset paper", json!({}))
    };
    let spec = probe::paper(&patch)?;
    match gpu::best(args) {
        Ok(device) => measure(&device, &spec, what, quick),
        Err(reason) => {
            let lines = vec![machine::line(), format!("nothing to measure: {reason}")];
            let json = json!({ "bench": "batch", "machine": machine::describe(), "device": null, "reason": reason });
            Ok(Report { lines, json, files: Vec::new() })
        }
    }
}

fn measure(device: &GpuDevice, spec: &ModelSpec, what: &str, quick: bool) -> anyhow::Result<Report> {
    let runs = if quick { 1 } else { 3 };
    let fit = device.max_batch(&Plan::new(spec, 1));
    let mut lines = device::lines(device);
    lines.push(machine::line());
    lines.push(format!("simulation of {what} with readback of sections, without a surface; {}", machine::runs(runs)));
    lines.push(String::new());
    let heads = ["batch", "seconds", "models/s", "host s", "dispatches", "µs/dispatch", "memory MB"];
    let [batch, rest @ ..] = heads;
    lines.push(format!("{batch:>6}{}", rest.map(|head| format!(" {head:>12}")).concat()));
    let (mut rows, mut points, mut search) = (Vec::new(), Vec::new(), None);
    let most = fit.min(if quick { LARGEST_QUICK } else { LARGEST });
    for size in std::iter::successors(Some(1), |n| Some(2 * n)).take_while(|&n| n <= most) {
        term::note(&format!("batch of {size} …"));
        let plans: Vec<Plan> = (1..=size as u64).map(|seed| Plan::new(spec, seed)).collect();
        let run = device::median(device, &plans, runs)?;
        let rate = size as f64 / run.seconds;
        let bytes = GpuDevice::batch_bytes(&plans[0], size);
        lines.push(format!(
            "{size:>6} {:>12.3} {rate:>12.3} {:>12.3} {:>12} {:>12.2} {:>12.0}",
            run.seconds,
            run.report.host_seconds,
            run.report.dispatches,
            run.microseconds_a_dispatch(),
            1e-6 * bytes as f64,
        ));
        rows.push(json!({ "batch": size, "models_per_second": rate, "memory_bytes": bytes, "run": run.describe() }));
        points.push((size as f64, rate));
        search.get_or_insert_with(|| run.search());
    }
    lines.extend(search);
    let json = json!({
        "bench": "batch", "engine": oviduct::ENGINE_VERSION, "machine": machine::describe(),
        "device": device::describe(device), "model": what, "runs": runs, "largest_that_fits": fit, "rows": rows,
    });
    let axes = Axes {
        title: format!("Models a second by the size of the batch: {}", device::label(device)),
        x: "models in the batch",
        y: "models per second",
        x_tick: plot::whole,
        names: SeriesLabelPosition::LowerRight,
    };
    let line = Line { label: what.to_owned(), points };
    let files = vec![("models-per-second.svg".to_owned(), plot::draw(&axes, &[line], Scale::Linear)?)];
    Ok(Report { lines, json, files })
}
