//! The same comparison for models that a GPU grows: requested from a service that has a GPU worker, and grown in batches of the
//! same size by the generator directly, the next batch while the surfaces of the last one are made.

use super::super::super::args::GpuArgs;
use super::super::{device, machine};
use super::{Comparison, Direct, Row, Serving, model};
use crate::cli::gpu;
use crate::cli::load::{Model, Seeds};
use crate::generate::{Backend, Calls, CancelToken, GenerateError, Member, Outcome, Request, generate_batch};
use crate::sim::Plan;
use crate::sim::gpu::GpuDevice;
use anyhow::Context;
use rayon::ThreadPool;
use serde_json::{Value, json};
use std::collections::VecDeque;
use std::sync::mpsc::{Sender, channel};
use std::sync::{Mutex, PoisonError};
use std::thread::ScopedJoinHandle;

/// Models of a batch: the default of `--gpu-batch`; and on a software adapter, whose batches take longer the larger they are.
const BATCH: usize = 16;
const SOFTWARE_BATCH: usize = 4;
/// Batches that a worker holds at a time: one is simulated while the surfaces of another are made.
const BATCHES: usize = 2;

/// Models: steps, and particles at start and end; on a GPU, and on a software adapter.
const SIZES: [(u32, u32, u32); 3] = [(400, 500, 1800), (1000, 710, 4000), (2000, 710, 8300)];
const SOFTWARE_SIZES: [(u32, u32, u32); 1] = [(60, 300, 420)];

/// Lines and results, or why there are none.
pub(super) async fn run(args: GpuArgs, rounds: u32, seconds_a_round: f64) -> anyhow::Result<(Vec<String>, Value)> {
    let device =
        match tokio::task::spawn_blocking(move || gpu::best(args)).await.context("the graphics driver failed")? {
            Ok(device) => device,
            Err(reason) => {
                return Ok((vec![format!("nothing to measure on a GPU: {reason}")], json!({ "reason": reason })));
            }
        };
    let (sizes, batch): (&[_], usize) =
        if device::is_software(&device) { (&SOFTWARE_SIZES, SOFTWARE_BATCH) } else { (&SIZES, BATCH) };
    let at_a_time = batch.to_string();
    let mut options = vec!["--cpu-workers", "0", "--gpu", "auto", "--gpu-batch", &at_a_time];
    if args.allow_software_adapter {
        options.push("--allow-software-adapter");
    }
    let serving = Serving::start(&options, |_| ()).await?;
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
            // A batch that is simulated, one whose surfaces are made, and the next one.
            asked: 3 * batch as u32,
            rounds,
            seconds_a_round,
            direct: Direct::Batches(device.clone(), batch),
        };
        let Row { label, direct, service, .. } = &comparison.measure().await?;
        let ratio = super::ratio(service, direct);
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

/// Grows the models of these seeds in batches of `size`.
///
/// # Errors
/// If one of them is not grown.
pub(super) fn grow(device: &GpuDevice, model: &Model, seeds: &Seeds, size: usize) -> anyhow::Result<()> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(machine::threads()).build()?;
    let joined = |driver: ScopedJoinHandle<'_, anyhow::Result<()>>| {
        driver.join().unwrap_or_else(|_| Err(anyhow::anyhow!("a batch panicked")))
    };
    std::thread::scope(|scope| {
        let mut drivers = VecDeque::new();
        loop {
            let batch: Vec<u64> = std::iter::from_fn(|| seeds.take()).take(size).collect();
            if batch.is_empty() {
                return drivers.into_iter().try_for_each(joined);
            }
            if drivers.len() == BATCHES {
                drivers.pop_front().map_or(Ok(()), joined)?;
            }
            let (simulated, device_is_free) = channel();
            let pool = &pool;
            drivers.push_back(scope.spawn(move || one(device, pool, model, &batch, simulated)));
            // A batch that has ended early says nothing.
            device_is_free.recv().ok();
        }
    })
}

/// Grows a batch in a directory that is removed afterwards; says when the device is free.
fn one(
    device: &GpuDevice,
    pool: &ThreadPool,
    model: &Model,
    seeds: &[u64],
    simulated: Sender<()>,
) -> anyhow::Result<()> {
    let folder = tempfile::tempdir()?;
    let requests: Vec<Request> = seeds
        .iter()
        .map(|&seed| {
            let dir = folder.path().join(seed.to_string());
            std::fs::create_dir(&dir)?;
            Ok(Request {
                preset: model.preset.clone(),
                spec: model.spec.as_ref().clone(),
                seed,
                backend: model.backend,
                outputs: model.outputs.clone(),
                dir,
                memory_limit_bytes: None,
            })
        })
        .collect::<anyhow::Result<_>>()?;
    let (cancel, failed) = (CancelToken::default(), Mutex::new(None));
    let members: Vec<Member<'_>> =
        requests.iter().map(|request| Member { request, plan: None, sink: &(), cancel: &cancel }).collect();
    let simulated = Mutex::new(Some(simulated));
    let free = || drop(simulated.lock().unwrap_or_else(PoisonError::into_inner).take());
    let ended = |_: usize, result: Result<Outcome, GenerateError>| {
        if let Err(error) = result {
            *failed.lock().unwrap_or_else(PoisonError::into_inner) = Some(error);
        }
    };
    generate_batch(device, Some(pool), &members, Calls { simulated: &free, ended: &ended });
    match failed.into_inner().unwrap_or_else(PoisonError::into_inner) {
        Some(error) => Err(error.into()),
        None => Ok(()),
    }
}
