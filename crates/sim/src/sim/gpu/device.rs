//! Open device: its compiled pipelines, its limits, and whether it is lost.

use super::adapter::{Adapter, GpuOptions, ready};
use super::error::GpuError;
use super::pace::FIRST_STEPS;
use super::pipelines::{IMMEDIATES, Pipelines, STORAGE_BUFFERS};
use super::sizes::Sizes;
use crate::lock::Mutex;
use crate::sim::Plan;
use rayon::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicI64, Ordering};
use std::thread::available_parallelism;
use std::time::Duration;

/// Maximum number of members of a batch. More members would not raise the throughput.
const MAX_BATCH: usize = 256;
/// Maximum number of threads that prepare and read batches.
const THREADS: usize = 4;
/// Number of consecutive panics of a poll after which the device counts as lost.
const POLLS: usize = 3;
/// Maximum wait at the end of a batch for its submissions.
const TIDY: Duration = Duration::from_secs(5);

/// Open device. Cheap to clone; several threads may use it.
#[derive(Clone, Debug)]
pub struct GpuDevice {
    adapter: Arc<Adapter>,
    pub(super) device: wgpu::Device,
    pub(super) queue: wgpu::Queue,
    pub(super) pipelines: Arc<Pipelines>,
    /// Threads that prepare and read batches. Other threads may be busy with surfaces for seconds
    /// while the device would wait.
    threads: Arc<ThreadPool>,
    /// Number of steps of a submission of about 50 ms, from the last batch.
    pub(super) steps: Arc<AtomicI64>,
    health: Arc<Health>,
    options: GpuOptions,
}

/// Errors that the driver reported outside of calls.
#[derive(Debug, Default)]
struct Health {
    lost: AtomicBool,
    /// Set by [`GpuDevice::hang`].
    hung: AtomicBool,
    told: Mutex<Option<GpuError>>,
}

impl Health {
    /// Records the first error; a loss replaces any other error.
    fn note(&self, error: GpuError) {
        let mut told = self.told.lock();
        if matches!(error, GpuError::Lost { .. }) {
            if !self.lost.swap(true, Ordering::SeqCst) {
                *told = Some(error);
            }
        } else {
            told.get_or_insert(error);
        }
    }
}

impl GpuDevice {
    /// Opens an adapter and compiles the pipelines.
    ///
    /// # Errors
    /// [`GpuError::NoAdapter`] for a software adapter that `options` do not allow,
    /// [`GpuError::NotOpened`] if the driver or the compilation fails.
    pub fn open(adapter: &Adapter, options: &GpuOptions) -> Result<Self, GpuError> {
        if adapter.kind == super::AdapterKind::Software && !options.allow_software {
            return Err(GpuError::NoAdapter { software: true });
        }
        let not_opened = |detail: String| GpuError::NotOpened { adapter: adapter.name.clone(), detail };
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("oviduct"),
            required_features: wgpu::Features::IMMEDIATES,
            required_limits: adapter.handle.limits(),
            memory_hints: wgpu::MemoryHints::MemoryUsage,
            ..Default::default()
        };
        let limits = adapter.handle.limits();
        if limits.max_storage_buffers_per_shader_stage < STORAGE_BUFFERS || limits.max_immediate_size < IMMEDIATES {
            return Err(not_opened("it offers too few storage buffers or immediates".to_owned()));
        }
        let (device, queue) = ready(adapter.handle.request_device(&descriptor))
            .ok_or_else(|| not_opened("the driver does not answer".to_owned()))?
            .map_err(|e| not_opened(e.to_string()))?;
        let health = Arc::new(Health::default());
        let lost = Arc::clone(&health);
        device.set_device_lost_callback(move |_, detail| lost.note(GpuError::Lost { detail }));
        let refused = Arc::clone(&health);
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| refused.note(from_wgpu(&error))));
        let pipelines = attempt(&device, Pipelines::new).map_err(|e| not_opened(e.to_string()))?;
        let threads = ThreadPoolBuilder::new()
            .num_threads(available_parallelism().map_or(1, usize::from).min(THREADS))
            .thread_name(|i| format!("gpu-{i}"))
            .build()
            .map_err(|e| not_opened(e.to_string()))?;
        Ok(Self {
            adapter: Arc::new(adapter.clone()),
            device,
            queue,
            pipelines: Arc::new(pipelines),
            threads: Arc::new(threads),
            steps: Arc::new(AtomicI64::new(FIRST_STEPS)),
            health,
            options: *options,
        })
    }

    /// Name of the adapter.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.adapter.name
    }

    /// Adapter of the device.
    #[must_use]
    pub fn adapter(&self) -> &Adapter {
        &self.adapter
    }

    /// True if the device is lost. It stays lost: open a new one.
    #[must_use]
    pub fn is_lost(&self) -> bool {
        self.health.lost.load(Ordering::SeqCst)
    }

    /// Destroys the device, as if the driver had lost it. Batches that run on the device end with
    /// [`GpuError::Lost`].
    pub fn lose(&self) {
        self.device.destroy();
        self.health.note(GpuError::Lost { detail: "the device was destroyed".to_owned() });
    }

    /// Simulates a hanging device in tests: no later submission completes.
    pub fn hang(&self) {
        self.health.hung.store(true, Ordering::SeqCst);
    }

    /// Time without a completed submission after which the device counts as lost.
    pub(super) fn stall(&self) -> Duration {
        self.options.stall
    }

    /// Marks the device as lost because it completes nothing. Returns the error.
    pub(super) fn abandon(&self) -> GpuError {
        let seconds = self.options.stall.as_secs_f64();
        let error = GpuError::Lost { detail: format!("nothing was completed for {seconds} s; the device hangs") };
        if !self.is_lost() {
            self.health.note(error.clone());
            // Dropping the last handle of a queue waits for its submissions without limit, so this
            // handle is never dropped.
            std::mem::forget(self.clone());
        }
        error
    }

    /// Checks that `plans` can run together as one batch: they must have the same `steps`,
    /// `burn_in`, `grow_every`, `record_every` and integrator, and fit the limits of the device.
    ///
    /// # Errors
    /// [`GpuError::Unfit`] with the reason.
    pub fn fits(&self, plans: &[&Plan]) -> Result<(), GpuError> {
        let Some(first) = plans.first() else {
            return Err(GpuError::Unfit { detail: "a batch needs a plan".to_owned() });
        };
        if let Some(other) = plans.iter().find(|p| !alike(p, first)) {
            let detail = format!("simulations with different steps in a batch (seeds {}, {})", first.seed, other.seed);
            return Err(GpuError::Unfit { detail });
        }
        Sizes::new(plans, plans.len()).check(&self.device.limits())
    }

    /// Maximum number of simulations like `plan` in one batch within the limits of the device; 0 if
    /// none fits. The free memory is not known in advance, so a batch of this size may still fail
    /// with [`GpuError::OutOfMemory`].
    #[must_use]
    pub fn max_batch(&self, plan: &Plan) -> usize {
        let limits = self.device.limits();
        let fits = |members: usize| Sizes::new(&[plan], members).check(&limits).is_ok();
        // Bisection: if a size fits, all smaller ones do.
        let (mut low, mut high) = (0, MAX_BATCH);
        while low < high {
            let middle = (low + high).div_ceil(2);
            if fits(middle) {
                low = middle;
            } else {
                high = middle - 1;
            }
        }
        low
    }

    /// Bytes of device memory of a batch of `members` simulations like `plan`, including staging
    /// buffers.
    #[must_use]
    pub fn batch_bytes(plan: &Plan, members: usize) -> u64 {
        Sizes::new(&[plan], members).total_bytes()
    }

    /// Bytes of allocated device memory; `None` if the backend does not report them.
    #[must_use]
    pub fn memory_in_use(&self) -> Option<u64> {
        self.device.generate_allocator_report().map(|report| report.total_allocated_bytes)
    }

    /// Fails if another `bytes` would exceed [`GpuOptions::memory_bytes`].
    pub(super) fn room_for(&self, bytes: u64) -> Result<(), GpuError> {
        match self.options.memory_bytes {
            Some(most) if self.memory_in_use().unwrap_or(0) + bytes > most => Err(GpuError::OutOfMemory),
            _ => Ok(()),
        }
    }

    /// Calls `of` for each member of a batch, in parallel. A single member is processed on this
    /// thread: a waiting thread of another pool would take up other work, such as a whole surface.
    pub(super) fn each<T: Send>(&self, plans: &[Plan], of: impl Fn(usize, &Plan) -> T + Sync) -> Vec<T> {
        match plans {
            [plan] => vec![of(0, plan)],
            _ => self.threads.install(|| plans.par_iter().enumerate().map(|(i, plan)| of(i, plan)).collect()),
        }
    }

    /// Runs `what` on the device. Fails with an error that `what` caused, or if the device is lost.
    pub(super) fn attempt<R>(&self, what: impl FnOnce(&wgpu::Device) -> R) -> Result<R, GpuError> {
        let result = attempt(&self.device, what)?;
        self.check()?;
        Ok(result)
    }

    /// Fails with the error that the driver reported outside of calls since the last check, if
    /// there is one.
    pub(super) fn check(&self) -> Result<(), GpuError> {
        let mut told = self.health.told.lock();
        // A loss is permanent.
        let error = if self.is_lost() { told.clone() } else { told.take() };
        error.map_or(Ok(()), Err)
    }

    /// Waits at most `timeout` for a submission to complete. Returns true if it did.
    pub(super) fn wait(&self, submission: &wgpu::SubmissionIndex, timeout: Duration) -> Result<bool, GpuError> {
        if self.health.hung.load(Ordering::SeqCst) {
            std::thread::sleep(timeout);
            return self.check().map(|()| false);
        }
        let poll = wgpu::PollType::Wait { submission_index: Some(submission.clone()), timeout: Some(timeout) };
        let result = self.poll(&poll);
        self.check()?;
        match result? {
            Ok(_) => Ok(true),
            Err(wgpu::PollError::Timeout) => Ok(false),
            Err(error) => Err(GpuError::Refused { detail: error.to_string() }),
        }
    }

    /// Waits until all submissions and later writes are complete, because only then the device
    /// frees their memory.
    pub(super) fn tidy(&self) {
        if self.is_lost() {
            return;
        }
        let submission_index = Some(self.queue.submit([]));
        // An error is reported to the next batch.
        let _ = self.poll(&wgpu::PollType::Wait { submission_index, timeout: Some(TIDY) });
    }

    fn poll(&self, poll: &wgpu::PollType) -> Result<Result<wgpu::PollStatus, wgpu::PollError>, GpuError> {
        // wgpu panics if the driver reports the loss during a poll. It also panics occasionally if
        // another thread empties the queue just after this poll timed out (an assertion in
        // `Device::maintain`); another poll then succeeds.
        for _ in 0..POLLS {
            if let Ok(result) = catch_unwind(AssertUnwindSafe(|| self.device.poll(poll.clone()))) {
                return Ok(result);
            }
        }
        let error = GpuError::Lost { detail: "the driver reported it during a poll".to_owned() };
        self.health.note(error.clone());
        Err(error)
    }
}

/// True if two plans result in the same sequence of dispatches.
fn alike(a: &Plan, b: &Plan) -> bool {
    let course = |p: &Plan| (p.steps, p.burn_in, p.grow_every, p.record_every, p.integrator);
    course(a) == course(b)
}

fn attempt<R>(device: &wgpu::Device, what: impl FnOnce(&wgpu::Device) -> R) -> Result<R, GpuError> {
    use wgpu::ErrorFilter::{Internal, OutOfMemory, Validation};
    let scopes = [Internal, Validation, OutOfMemory].map(|filter| device.push_error_scope(filter));
    let result = what(device);
    let mut error = None;
    for scope in scopes.into_iter().rev() {
        error = error.or(ready(scope.pop()).flatten());
    }
    error.map_or(Ok(result), |e| Err(from_wgpu(&e)))
}

fn from_wgpu(error: &wgpu::Error) -> GpuError {
    match error {
        wgpu::Error::OutOfMemory { .. } => GpuError::OutOfMemory,
        other => GpuError::Refused { detail: other.to_string() },
    }
}
