//! The GPU compared with the CPU: stage by stage within stated tolerances, whole runs by their invariants and their shapes,
//! whole models by their certificates; devices that are lost, hang, are missing, or out of memory.
//!
//! Runs on the best adapter: a real GPU if there is one, else a software one (Debian packages mesa-vulkan-drivers,
//! libvulkan1). Without an adapter the tests fail and name the packages. With `OVIDUCT_TEST_GPU=hardware` they fail rather than
//! take a software adapter; on a real GPU some run at paper size. With `OVIDUCT_TEST_NO_VULKAN=1` only the behaviour of a
//! machine without a Vulkan loader is tested.

#![expect(clippy::unwrap_used, clippy::print_stdout, reason = "a test fails by panic and prints what it measured")]

#[path = "gpu/batches.rs"]
mod batches;
#[path = "gpu/common.rs"]
mod common;
#[path = "gpu/devices.rs"]
mod devices;
#[path = "gpu/functions.rs"]
mod functions;
#[path = "gpu/memory.rs"]
mod memory;
#[path = "gpu/models.rs"]
mod models;
#[path = "gpu/morphometry.rs"]
mod morphometry;
#[path = "gpu/reference.rs"]
mod reference;
#[path = "gpu/stages.rs"]
mod stages;
#[cfg(target_os = "linux")]
#[path = "gpu/starved.rs"]
mod starved;
