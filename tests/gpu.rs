//! Comparisons of the GPU with the CPU, and faults of the GPU. Single stages must agree within
//! stated tolerances, whole runs in their invariants and shapes, whole models in their
//! certificates. Devices may be lost, hang, be missing, or run out of memory.
//!
//! The tests use the best adapter: a real GPU if there is one, otherwise a software adapter (Debian
//! packages mesa-vulkan-drivers and libvulkan1). Without any adapter they fail and name these
//! packages. On a real GPU some tests run at paper size.
//!
//! - `OVIDUCT_TEST_GPU=hardware`: tests fail unless there is a real GPU.
//! - `OVIDUCT_TEST_NO_VULKAN=1`: only the behaviour of a machine without a Vulkan loader is tested.

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
