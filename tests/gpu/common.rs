//! The device that all tests share, and plans to run on it.

use oviduct::sim::Plan;
use oviduct::sim::gpu::{GpuDevice, GpuOptions, adapters};
use oviduct::spec::{ModelSpec, preset};
use serde_json::{Value, json};
use std::sync::OnceLock;

pub(crate) const OPTIONS: GpuOptions = GpuOptions { allow_software: true };

/// A device of its own.
pub(crate) fn open() -> GpuDevice {
    let found = adapters(&OPTIONS).unwrap_or_else(|e| {
        panic!("{e}\nThese tests need a Vulkan adapter: apt-get install mesa-vulkan-drivers libvulkan1")
    });
    GpuDevice::open(&found[0], &OPTIONS).unwrap()
}

/// The device that tests share.
pub(crate) fn device() -> &'static GpuDevice {
    static DEVICE: OnceLock<GpuDevice> = OnceLock::new();
    DEVICE.get_or_init(open)
}

/// A small model: 150 steps, 200 to 810 inner particles.
pub(crate) fn plan(patch: &Value, seed: u64) -> Plan {
    let mut whole = json!({
        "steps": 150, "burn_in": 60,
        "particles": { "total": { "keys": [[0, 260], [1, 900]] }, "outer": { "keys": [[0, 60], [1, 90]] } },
    });
    json_patch::merge(&mut whole, patch);
    Plan::new(&ModelSpec::resolve(preset("pig").unwrap(), &whole).unwrap(), seed)
}
