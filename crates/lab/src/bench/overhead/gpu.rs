//! `bench overhead` on a GPU: models are requested from a service with a GPU worker, and grown in
//! batches of the same size by direct calls of the generator.

use super::comparison::{Comparison, Direct, Row, Serving, model, ratio};
use crate::bench::{device, machine};
use anyhow::Context;
use oviduct::cli::GpuArgs;
use oviduct::cli::gpu;
use oviduct::generate::Backend;
use oviduct::sim::Plan;
use serde_json::{Value, json};

/// Models of a batch: the default of `--gpu-batch`, and fewer on a software adapter, which does not
/// profit from large batches.
const BATCH: usize = 16;
const SOFTWARE_BATCH: usize = 4;

/// Models as steps and particles at start and end, on a GPU and on a software adapter.
const SIZES: [(u32, u32, u32); 3] = [(400, 500, 1800), (1000, 710, 4000), (2000, 710, 8300)];
const SOFTWARE_SIZES: [(u32, u32, u32); 1] = [(60, 300, 420)];

/// Returns lines of text and results, or the reason why there are none.
pub(super) async fn run(args: GpuArgs, rounds: u32, seconds_a_round: f64) -> anyhow::Result<(Vec<String>, Value)> {
    let chosen = args.clone();
    let device =
        match tokio::task::spawn_blocking(move || gpu::best(&chosen)).await.context("the graphics driver failed")? {
            Ok(device) => device,
            Err(reason) => {
                return Ok((vec![format!("nothing to measure on a GPU: {reason}")], json!({ "reason": reason })));
            }
        };
    let (sizes, batch): (&[_], usize) =
        if device::is_software(&device) { (&SOFTWARE_SIZES, SOFTWARE_BATCH) } else { (&SIZES, BATCH) };
    let (at_a_time, which) = (batch.to_string(), args.gpu.to_string());
    let mut options = vec!["--cpu-workers", "0", "--gpu", &which, "--gpu-batch", &at_a_time];
    if args.allow_software_adapter {
        options.push("--allow-software-adapter");
    }
    let serving = Serving::start(&options).await?;
    let mut lines = device::lines(&device);
    lines.push(format!(
        "models per second, median of {rounds} rounds: a GPU worker with {} threads for the surfaces over HTTP, the generator \
         called directly with batches of {batch}, and their simulation alone",
        machine::threads(),
    ));
    lines.push(format!("{:<36} {:>11} {:>9} {:>9} {:>7}", "model", "simulated", "direct", "service", "ratio"));
    let mut rows = Vec::new();
    for &size in sizes {
        let plans: Vec<Plan> = {
            let model = model(size, Backend::Gpu)?;
            (1..=batch as u64).map(|seed| Plan::new(&model.spec, seed)).collect()
        };
        let (of, simulated) = (device.clone(), batch as f64);
        let alone =
            tokio::task::spawn_blocking(move || device::median(&of, &plans, 1)).await.context("a task panicked")??;
        let comparison = Comparison {
            client: &serving.client,
            size,
            backend: Backend::Gpu,
            // One batch is simulated, one gets its surfaces, and one waits.
            asked: 3 * batch as u32,
            rounds,
            seconds_a_round,
            direct: Direct::Batches(device.clone(), batch),
        };
        let Row { label, direct, service, .. } = &comparison.measure().await?;
        let ratio = ratio(service, direct);
        let simulated = simulated / alone.seconds;
        lines.push(format!(
            "{label:<36} {simulated:>11.2} {:>9.2} {:>9.2} {:>6.1}%",
            machine::median(direct.clone()),
            machine::median(service.clone()),
            1e2 * ratio,
        ));
        rows.push(json!({
            "model": label, "simulated_per_second": simulated, "direct_per_second": direct,
            "service_per_second": service, "ratio": ratio,
        }));
    }
    serving.stop().await?;
    Ok((lines, json!({ "device": device::describe(&device), "batch": batch, "rows": rows })))
}
