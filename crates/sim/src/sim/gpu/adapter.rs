//! The adapters of this machine. Software adapters (Mesa's llvmpipe, WARP) are listed only on request: a default request of
//! wgpu would return one silently.

use super::error::GpuError;
use std::future::Future;
use std::pin::pin;
use std::task::{Context, Poll, Waker};
use std::time::Duration;

/// Which adapters may be used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GpuOptions {
    /// Whether adapters that compute on the CPU may be used (tests, machines without a GPU).
    pub allow_software: bool,
    /// Most bytes of device memory of all batches together, for a GPU shared with other programs; `None`: no limit but that
    /// of the driver.
    pub memory_bytes: Option<u64>,
    /// Time without a completed submission after which a device counts as lost. A submission takes about 50 ms, or one
    /// step of the batch if that takes longer.
    pub stall: Duration,
}

impl GpuOptions {
    /// Hardware only, no bound on memory, lost after 30 s without progress.
    pub const DEFAULT: Self = Self { allow_software: false, memory_bytes: None, stall: Duration::from_secs(30) };
}

impl Default for GpuOptions {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// What kind of hardware an adapter is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum AdapterKind {
    /// A separate card with its own memory.
    Discrete,
    /// Part of the processor, with shared memory.
    Integrated,
    /// Part of a card, assigned to a virtual machine.
    Virtual,
    /// An implementation on the CPU.
    Software,
}

impl AdapterKind {
    /// The name of the kind in lower case.
    #[must_use]
    pub fn as_str(self) -> &'static str {
        match self {
            Self::Discrete => "discrete",
            Self::Integrated => "integrated",
            Self::Virtual => "virtual",
            Self::Software => "software",
        }
    }
}

/// An adapter that may be opened.
#[derive(Clone, Debug)]
pub struct Adapter {
    /// Name of the hardware.
    pub name: String,
    /// Its kind.
    pub kind: AdapterKind,
    /// `vulkan`, `metal` or `dx12`.
    pub backend: String,
    /// Name and version of the driver.
    pub driver: String,
    /// The largest storage binding of a shader, bytes.
    pub max_binding_bytes: u64,
    /// The largest single buffer, bytes.
    pub max_buffer_bytes: u64,
    /// Whether the device has timestamp queries.
    pub timestamps: bool,
    /// Vendor and device identifiers.
    hardware: (u32, u32),
    pub(super) handle: wgpu::Adapter,
}

/// Which of (hardware, backend) to keep if several backends list the same hardware, as Vulkan and DX12 do: the entries of
/// the first of these backends. Two equal cards stay two entries.
fn shown_first(found: &[((u32, u32), &str)]) -> Vec<bool> {
    let first = |hardware| found.iter().find(|(other, _)| *other == hardware).map(|(_, backend)| *backend);
    found.iter().map(|&(hardware, backend)| first(hardware) == Some(backend)).collect()
}

/// The adapters that `options` allow, best first (discrete, integrated, virtual, software).
///
/// # Errors
/// [`GpuError::NoLoader`] if no graphics interface is installed, [`GpuError::NoAdapter`] if no allowed adapter exists.
pub fn adapters(options: &GpuOptions) -> Result<Vec<Adapter>, GpuError> {
    let mut description = wgpu::InstanceDescriptor::new_without_display_handle();
    description.backends = wgpu::Backends::PRIMARY;
    // WGPU_VALIDATION=1 and WGPU_DEBUG=1 turn the driver's checks on.
    description.flags = wgpu::InstanceFlags::empty().with_env();
    // An allocation beyond this share of the memory is refused instead of exhausting the machine.
    description.memory_budget_thresholds.for_resource_creation = Some(95);
    let instance = wgpu::Instance::new(description);
    let handles = ready(instance.enumerate_adapters(wgpu::Backends::PRIMARY)).unwrap_or_default();
    let found = handles.len();
    let mut adapters: Vec<Adapter> = handles.into_iter().filter_map(describe).collect();
    let mut shown =
        shown_first(&adapters.iter().map(|a| (a.hardware, a.backend.as_str())).collect::<Vec<_>>()).into_iter();
    adapters.retain(|_| shown.next().unwrap_or(true));
    adapters.sort_by_key(|a| a.kind);
    if !options.allow_software {
        adapters.retain(|a| a.kind != AdapterKind::Software);
    }
    if !adapters.is_empty() {
        return Ok(adapters);
    }
    if found == 0 && !has_interface(&instance) {
        return Err(GpuError::NoLoader);
    }
    Err(GpuError::NoAdapter { software: found > 0 })
}

/// Whether any graphics interface was loaded; called only if no adapter was found.
fn has_interface(instance: &wgpu::Instance) -> bool {
    let options = wgpu::RequestAdapterOptions::default();
    match ready(instance.request_adapter(&options)) {
        Some(Err(wgpu::RequestAdapterError::NotFound { active_backends, .. })) => !active_backends.is_empty(),
        _ => true,
    }
}

fn describe(handle: wgpu::Adapter) -> Option<Adapter> {
    let info = handle.get_info();
    let kind = match info.device_type {
        wgpu::DeviceType::DiscreteGpu => AdapterKind::Discrete,
        wgpu::DeviceType::IntegratedGpu => AdapterKind::Integrated,
        wgpu::DeviceType::VirtualGpu => AdapterKind::Virtual,
        wgpu::DeviceType::Cpu => AdapterKind::Software,
        // An adapter that does not report its kind may not be hardware.
        wgpu::DeviceType::Other => return None,
    };
    let limits = handle.limits();
    Some(Adapter {
        name: info.name,
        kind,
        backend: info.backend.to_str().to_owned(),
        driver: format!("{} {}", info.driver, info.driver_info).trim().to_owned(),
        max_binding_bytes: limits.max_storage_buffer_binding_size,
        max_buffer_bytes: limits.max_buffer_size,
        hardware: (info.vendor, info.device),
        timestamps: handle.features().contains(wgpu::Features::TIMESTAMP_QUERY),
        handle,
    })
}

/// The value of a future that is ready at once, as those of native backends are; none otherwise.
pub(super) fn ready<F: Future>(future: F) -> Option<F::Output> {
    match pin!(future).poll(&mut Context::from_waker(Waker::noop())) {
        Poll::Ready(value) => Some(value),
        Poll::Pending => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hardware_that_two_backends_show_counts_once() {
        let (card, chip) = ((0x10de, 0x2335), (0x8086, 0x9a49));
        let found = [(card, "vulkan"), (card, "vulkan"), (chip, "dx12"), (card, "dx12"), (card, "dx12")];
        assert_eq!(shown_first(&found), [true, true, true, false, false]);
        assert_eq!(shown_first(&[]), [false; 0]);
    }
}
