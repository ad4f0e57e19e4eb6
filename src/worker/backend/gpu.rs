//! Generations on a GPU, in batches whose members end one by one.

use super::cpu::threads;
use super::{GenerateFailure, Generation, GenerationOutput, Task, request, resolve};
use crate::generate::{Backend, Calls, GenerateError, Member, Outcome, UsedBackend, generate_batch};
use crate::jobs::{BackendReport, Job};
use crate::lock::Mutex;
use crate::panics::panic_message;
use crate::sim::Plan;
use crate::sim::gpu::{Adapter, GpuDevice, GpuError, GpuOptions, adapters};
use crate::worker::generator::{AdmittedPlan, BatchCallbacks, BatchGenerator, BatchMember, GenerationInput, WorkError};
use crate::worker::verdict;
use rayon::ThreadPool;
use rayon::prelude::*;
use std::io;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, oneshot};

type ResultSender = oneshot::Sender<Result<Outcome, WorkError>>;

/// The device of a GPU worker.
pub(in crate::worker) struct Gpu {
    generator: Arc<dyn BatchGenerator>,
    /// Threads for the surfaces.
    pool: Arc<ThreadPool>,
    free: Arc<Semaphore>,
}

impl Gpu {
    /// Starts the threads of a GPU worker, of which `count` are for the surfaces.
    ///
    /// # Errors
    /// The error of creating threads.
    pub(in crate::worker) fn new(
        worker: &str,
        count: usize,
        nice: u8,
        generator: Arc<dyn BatchGenerator>,
    ) -> io::Result<Self> {
        let pool = threads(&format!("{worker}-batch"), count, nice)?;
        Ok(Self { generator, pool, free: Arc::new(Semaphore::new(1)) })
    }

    /// Description of the device.
    pub(in crate::worker) fn device(&self) -> String {
        self.generator.device()
    }

    /// The report of a job that runs here, by its requested backend.
    pub(in crate::worker) fn report(&self, requested: Backend) -> BackendReport {
        BackendReport { requested, used: Some(UsedBackend::Gpu), device: Some(self.device()), fallback: None }
    }

    /// Waits until the device simulates no batch.
    pub(in crate::worker) async fn free(&self) -> OwnedSemaphorePermit {
        Arc::clone(&self.free).acquire_owned().await.expect("the semaphore is never closed")
    }

    /// Opens the device, or opens it again if it was lost.
    ///
    /// # Errors
    /// The reason why the device cannot be opened.
    pub(in crate::worker) async fn open(&self) -> Result<(), String> {
        let generator = Arc::clone(&self.generator);
        let opened = tokio::task::spawn_blocking(move || generator.open()).await;
        opened.unwrap_or_else(|panic| Err(panic.to_string()))
    }

    /// Selects the jobs that fit on the device together; see [`BatchGenerator::admit`].
    ///
    /// # Errors
    /// The reason why not even the first job can run on the device.
    pub(in crate::worker) async fn admit(&self, jobs: Vec<Job>) -> Result<Vec<Option<AdmittedPlan>>, String> {
        let generator = Arc::clone(&self.generator);
        let admitted = tokio::task::spawn_blocking(move || generator.admit(&jobs.iter().collect::<Vec<_>>())).await;
        admitted.unwrap_or_else(|panic| Err(format!("the GPU worker panicked: {panic}")))
    }

    /// Starts a batch on a thread that may block. The thread drives the device and keeps `permit`
    /// until the device is free again. Returns one generation per task, in the same order.
    pub(in crate::worker) fn generate(
        &self,
        tasks: Vec<(Task, AdmittedPlan)>,
        permit: OwnedSemaphorePermit,
    ) -> Vec<Generation> {
        let (mut senders, mut generations): (Vec<Mutex<Option<ResultSender>>>, _) = (Vec::new(), Vec::new());
        for (task, _) in &tasks {
            let (sender, result) = oneshot::channel();
            senders.push(Mutex::new(Some(sender)));
            let result = async move {
                match result.await {
                    Ok(result) => Ok(GenerationOutput::from(result?)),
                    Err(_) => Err(GenerateFailure::Verdict(verdict::of_silence())),
                }
            };
            generations.push(Generation::new(result, task.cancel.clone()));
        }
        if tasks.is_empty() {
            return generations;
        }
        let (generator, pool) = (Arc::clone(&self.generator), Arc::clone(&self.pool));
        tokio::task::spawn_blocking(move || {
            let permit = Mutex::new(Some(permit));
            let simulated = || drop(permit.lock().take());
            let members: Vec<BatchMember<'_>> = tasks.iter().map(|(task, plan)| member(task, plan.as_ref())).collect();
            let end = |place: usize, result| {
                let sender = senders[place].lock().take();
                // Fails if the member was interrupted.
                sender.map(|sender| sender.send(result).is_ok());
            };
            let callbacks = BatchCallbacks { simulated: &simulated, ended: &|place, result| end(place, result) };
            let run = || generator.generate(&members, &pool, callbacks);
            if let Err(panic) = catch_unwind(AssertUnwindSafe(run)) {
                let detail = panic_message(panic.as_ref()).to_owned();
                for place in 0..members.len() {
                    end(place, Err(GenerateError::Panic { detail: detail.clone() }.into()));
                }
            }
        });
        generations
    }
}

fn member<'a>(task: &'a Task, plan: Option<&'a Plan>) -> BatchMember<'a> {
    let Task { job, spec, dir, sink, cancel, memory_limit_bytes, .. } = task;
    let (backend, memory_limit_bytes) = (UsedBackend::Gpu, *memory_limit_bytes);
    BatchMember {
        input: GenerationInput {
            job,
            spec: spec.as_ref(),
            backend,
            dir: dir.path(),
            memory_limit_bytes,
            checkpoint: None,
        },
        plan,
        sink: &**sink,
        cancel,
    }
}

/// The generator on one GPU. Opens its device at the first use, and opens it again if it was lost.
#[derive(Debug)]
pub struct GpuGenerator {
    name: String,
    /// Index among the adapters of the same name.
    ordinal: usize,
    options: GpuOptions,
    device: Mutex<Option<GpuDevice>>,
}

impl GpuGenerator {
    /// A generator for each adapter that `options` allow, best first.
    ///
    /// # Errors
    /// [`GpuError`] if there is no such adapter.
    pub fn all(options: GpuOptions) -> Result<Vec<Self>, GpuError> {
        let found = adapters(&options)?;
        let generator = |(place, adapter): (usize, &Adapter)| Self {
            name: adapter.name.clone(),
            ordinal: found[..place].iter().filter(|other| other.name == adapter.name).count(),
            options,
            device: Mutex::new(None),
        };
        Ok(found.iter().enumerate().map(generator).collect())
    }

    /// The device, open.
    ///
    /// # Errors
    /// [`GpuError`] if it cannot be opened.
    pub fn device(&self) -> Result<GpuDevice, GpuError> {
        let mut place = self.device.lock();
        if let Some(device) = place.as_ref().filter(|device| !device.is_lost()) {
            return Ok(device.clone());
        }
        // A lost device is dropped before a new one is opened.
        *place = None;
        let found = adapters(&self.options)?;
        let mut same = found.iter().filter(|adapter| adapter.name == self.name);
        let gone = || GpuError::NotOpened { adapter: self.name.clone(), detail: "it is no longer there".to_owned() };
        let device = GpuDevice::open(same.nth(self.ordinal).ok_or_else(gone)?, &self.options)?;
        Ok(place.insert(device).clone())
    }

    /// Loses the device on purpose during a computation, for tests of the fallback.
    pub fn lose(&self) {
        if let Some(device) = self.device.lock().as_ref() {
            device.lose();
        }
    }
}

impl BatchGenerator for GpuGenerator {
    fn device(&self) -> String {
        self.name.clone()
    }

    fn open(&self) -> Result<(), String> {
        Self::device(self).map(drop).map_err(|error| error.to_string())
    }

    fn admit(&self, jobs: &[&Job]) -> Result<Vec<Option<AdmittedPlan>>, String> {
        let device = Self::device(self).map_err(|error| error.to_string())?;
        // The device is idle in the meantime. A job without a plan fails later, with the reason.
        let plan = |job: &&Job| resolve(job).map(|spec| Plan::new(&spec, job.seed)).ok();
        let plans: Vec<Option<Plan>> = jobs.par_iter().map(plan).collect();
        if let Some(first) = &plans[0] {
            device.fits(&[first]).map_err(|error| error.to_string())?;
        }
        let mut together: Vec<&Plan> = Vec::new();
        let mut fits = Vec::with_capacity(plans.len());
        for plan in &plans {
            together.extend(plan);
            fits.push(together.is_empty() || device.fits(&together).is_ok());
            if fits.last() == Some(&false) {
                together.pop();
            }
        }
        Ok(plans.into_iter().zip(fits).map(|(plan, fits)| fits.then_some(plan)).collect())
    }

    fn generate(&self, members: &[BatchMember<'_>], pool: &ThreadPool, callbacks: BatchCallbacks<'_>) {
        let mut places = Vec::with_capacity(members.len());
        let mut requests = Vec::with_capacity(members.len());
        for (place, member) in members.iter().enumerate() {
            match request(member.input) {
                Ok(request) => {
                    places.push(place);
                    requests.push(request);
                }
                Err(error) => (callbacks.ended)(place, Err(error)),
            }
        }
        match Self::device(self) {
            Ok(device) => {
                let member = |(request, &place): (_, &usize)| Member {
                    request,
                    plan: members[place].plan,
                    sink: members[place].sink,
                    cancel: members[place].cancel,
                };
                let batch: Vec<Member<'_>> = requests.iter().zip(&places).map(member).collect();
                let ended = |index: usize, result: Result<_, GenerateError>| {
                    (callbacks.ended)(places[index], result.map_err(WorkError::from));
                };
                let calls = Calls { simulated: callbacks.simulated, ended: &ended };
                generate_batch(&device, Some(pool), &batch, calls);
            }
            Err(error) => {
                for &place in &places {
                    (callbacks.ended)(place, Err(GenerateError::Gpu(error.clone()).into()));
                }
            }
        }
    }
}
