//! An open device: knows whether it is lost, what fits it, and holds its compiled pipelines.

use super::adapter::{Adapter, GpuOptions, ready};
use super::error::GpuError;
use crate::sim::Plan;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// An open device. Cheap to clone, may be used from several threads.
#[derive(Clone, Debug)]
pub struct GpuDevice {
    name: Arc<str>,
    pub(super) device: wgpu::Device,
    pub(super) queue: wgpu::Queue,
    health: Arc<Health>,
}

/// What the driver told outside of calls.
#[derive(Debug, Default)]
struct Health {
    lost: AtomicBool,
    detail: Mutex<Option<GpuError>>,
}

impl Health {
    fn note(&self, error: GpuError) {
        if matches!(error, GpuError::Lost { .. }) {
            self.lost.store(true, Ordering::SeqCst);
        }
        self.detail.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
    }
}

impl GpuDevice {
    /// Opens an adapter and compiles the pipelines.
    ///
    /// # Errors
    /// [`GpuError::NoAdapter`] for a software adapter that `options` do not allow, [`GpuError::NotOpened`].
    pub fn open(adapter: &Adapter, options: &GpuOptions) -> Result<Self, GpuError> {
        if adapter.kind == super::AdapterKind::Software && !options.allow_software {
            return Err(GpuError::NoAdapter { software: true });
        }
        let not_opened = |detail: String| GpuError::NotOpened { adapter: adapter.name.clone(), detail };
        let mut features = wgpu::Features::IMMEDIATES;
        if adapter.timestamps {
            features |= wgpu::Features::TIMESTAMP_QUERY;
        }
        let descriptor = wgpu::DeviceDescriptor {
            label: Some("oviduct"),
            required_features: features,
            required_limits: adapter.handle.limits(),
            memory_hints: wgpu::MemoryHints::MemoryUsage,
            ..Default::default()
        };
        let (device, queue) = ready(adapter.handle.request_device(&descriptor))
            .ok_or_else(|| not_opened("the driver does not answer".to_owned()))?
            .map_err(|e| not_opened(e.to_string()))?;
        let health = Arc::new(Health::default());
        let lost = Arc::clone(&health);
        device.set_device_lost_callback(move |_, detail| lost.note(GpuError::Lost { detail }));
        let refused = Arc::clone(&health);
        device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| refused.note(from_wgpu(&error))));
        Ok(Self { name: adapter.name.as_str().into(), device, queue, health })
    }

    /// Name of the adapter.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Whether the device is gone; it does not come back, open a new one.
    #[must_use]
    pub fn is_lost(&self) -> bool {
        self.health.lost.load(Ordering::SeqCst)
    }

    /// Gives the device up as if it had been lost; batches that run on it end with [`GpuError::Lost`].
    pub fn lose(&self) {
        self.device.destroy();
        self.health.note(GpuError::Lost { detail: "the device was destroyed".to_owned() });
    }

    /// Whether `plans` can run together as one batch.
    ///
    /// # Errors
    /// [`GpuError::Unfit`] with what does not fit.
    pub fn fits(&self, plans: &[&Plan]) -> Result<(), GpuError> {
        if plans.is_empty() {
            return Err(GpuError::Unfit { detail: "a batch needs a plan".to_owned() });
        }
        Ok(())
    }

    /// How many simulations like `plan` one batch can hold by the limits of the device (0: not even one). Memory
    /// that others use is not known beforehand: a batch of this size may still end with [`GpuError::OutOfMemory`].
    #[must_use]
    pub fn max_batch(&self, plan: &Plan) -> usize {
        usize::from(self.fits(&[plan]).is_ok())
    }

    /// The error that was told since the last call, if any.
    pub(super) fn fault(&self) -> Option<GpuError> {
        self.health.detail.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

fn from_wgpu(error: &wgpu::Error) -> GpuError {
    match error {
        wgpu::Error::OutOfMemory { .. } => GpuError::OutOfMemory,
        other => GpuError::Refused { detail: other.to_string() },
    }
}
