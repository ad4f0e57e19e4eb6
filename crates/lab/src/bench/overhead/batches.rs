//! Models grown in batches on a GPU as a worker does: the next batch is simulated while the
//! surfaces of the previous batch are made.

use crate::bench::machine;
use oviduct::cli::load::{Model, Seeds};
use oviduct::generate::{Calls, CancelToken, GenerateError, Member, Outcome, Request, generate_batch};
use oviduct::lock::Mutex;
use oviduct::sim::gpu::GpuDevice;
use rayon::ThreadPool;
use std::collections::VecDeque;
use std::sync::mpsc::{Sender, channel};
use std::thread::ScopedJoinHandle;

/// Batches that a worker holds at a time.
const BATCHES: usize = 2;

/// Grows the models of these seeds in batches of `size`.
///
/// # Errors
/// If a model cannot be grown.
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
            // A batch that ended early sends no message.
            device_is_free.recv().ok();
        }
    })
}

/// Grows a batch in a temporary directory. Sends a message when the device is free.
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
    let free = || drop(simulated.lock().take());
    let ended = |_: usize, result: Result<Outcome, GenerateError>| {
        if let Err(error) = result {
            *failed.lock() = Some(error);
        }
    };
    generate_batch(device, Some(pool), &members, Calls { simulated: &free, ended: &ended });
    failed.lock().take().map_or(Ok(()), |error: GenerateError| Err(error.into()))
}
