//! Adapters of this machine. Software adapters (llvmpipe of Mesa, WARP) are listed only on request,
//! because a default request of wgpu would return one silently.

use super::error::GpuError;
use std::future::Future;
use std::pin::pin;
use std::task::{Context, Poll, Waker};
use std::time::Duration;

/// Selection of adapters, and limits of their use.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GpuOptions {
    /// True if adapters that compute on the CPU may be used: in tests, or on machines without a
    /// GPU.
    pub allow_software: bool,
    /// Maximum device memory of all batches together, bytes, for a GPU that other programs use as
    /// well. With `None`, only the limit of the driver applies.
    pub memory_bytes: Option<u64>,
    /// Time without a completed submission after which a device counts as lost. A submission takes
    /// about 50 ms, or one step of the batch if a step takes longer.
    pub stall: Duration,
}

impl GpuOptions {
    /// Hardware only, no memory limit, lost after 30 s without progress.
    pub const DEFAULT: Self = Self { allow_software: false, memory_bytes: None, stall: Duration::from_secs(30) };
}

impl Default for GpuOptions {
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// Kind of hardware.
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
    /// Name of the kind in lower case.
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

/// Adapter that may be opened.
#[derive(Clone, Debug)]
pub struct Adapter {
    /// Name of the hardware.
    pub name: String,
    /// Kind of hardware.
    pub kind: AdapterKind,
    /// `vulkan`, `metal` or `dx12`.
    pub backend: String,
    /// Name and version of the driver.
    pub driver: String,
    /// Maximum size of a storage binding of a shader, bytes.
    pub max_binding_bytes: u64,
    /// Maximum size of a buffer, bytes.
    pub max_buffer_bytes: u64,
    /// Vendor and device identifiers.
    hardware: (u32, u32),
    pub(super) handle: wgpu::Adapter,
}

/// Returns for each pair (hardware, backend) whether to list it. Several backends may list the same
/// hardware, as Vulkan and DX12 do; only the entries of the first of them are listed. Two equal
/// cards stay two entries.
fn shown_first(found: &[((u32, u32), &str)]) -> Vec<bool> {
    let first = |hardware| found.iter().find(|(other, _)| *other == hardware).map(|(_, backend)| *backend);
    found.iter().map(|&(hardware, backend)| first(hardware) == Some(backend)).collect()
}

/// Adapters that `options` allow, best first: discrete, integrated, virtual, software.
///
/// # Errors
/// [`GpuError::NoLoader`] if no graphics interface is installed, [`GpuError::NoAdapter`] if no
/// allowed adapter exists.
pub fn adapters(options: &GpuOptions) -> Result<Vec<Adapter>, GpuError> {
    let mut description = wgpu::InstanceDescriptor::new_without_display_handle();
    description.backends = wgpu::Backends::PRIMARY;
    // WGPU_VALIDATION=1 and WGPU_DEBUG=1 turn the driver's checks on.
    description.flags = wgpu::InstanceFlags::empty().with_env();
    // An allocation beyond this percentage of the memory fails instead of exhausting the machine.
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

/// Index of the adapter that `choice` names among those with these `names`: its place, or a part of
/// its name without regard to case.
///
/// # Errors
/// [`GpuError::NotChosen`] if no name matches, or several.
pub fn choose(names: &[String], choice: &str) -> Result<usize, GpuError> {
    if let Some(place) = choice.parse().ok().filter(|&place: &usize| place < names.len()) {
        return Ok(place);
    }
    let part = choice.to_lowercase();
    let listed = |places: &[usize]| {
        places.iter().map(|&place| format!("{place}: {}", names[place])).collect::<Vec<_>>().join(", ")
    };
    let all: Vec<usize> = (0..names.len()).collect();
    let matching: Vec<usize> =
        all.iter().copied().filter(|&place| names[place].to_lowercase().contains(&part)).collect();
    let detail = match matching[..] {
        [place] => return Ok(place),
        [] => format!("there is no GPU `{choice}`; this machine has {}", listed(&all)),
        _ => format!("`{choice}` names several GPUs; choose one by its number: {}", listed(&matching)),
    };
    Err(GpuError::NotChosen { detail })
}

/// True if a graphics interface was loaded. Called only if no adapter was found.
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
        handle,
    })
}

/// Value of a future that is ready immediately, as the futures of native backends are; otherwise
/// `None`.
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

    #[test]
    fn a_card_is_chosen_by_its_number_or_a_part_of_its_name() {
        let names = ["NVIDIA GeForce RTX 4090", "NVIDIA GeForce RTX 4090", "Intel(R) Arc(tm) A770"].map(String::from);
        let detail = |choice| choose(&names, choice).unwrap_err().to_string();
        assert_eq!(["0", "1", "2", "arc", "A770"].map(|choice| choose(&names, choice)), [0, 1, 2, 2, 2].map(Ok));
        assert_eq!(
            detail("4090"),
            "`4090` names several GPUs; choose one by its number: 0: NVIDIA GeForce RTX 4090, 1: NVIDIA GeForce RTX \
             4090"
        );
        for absent in ["3", "-1", "H200"] {
            let expected = format!("there is no GPU `{absent}`; this machine has 0: NVIDIA GeForce RTX 4090, 1: ");
            assert!(detail(absent).starts_with(&expected), "{}", detail(absent));
        }
    }
}
