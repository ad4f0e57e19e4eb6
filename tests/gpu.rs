//! The GPU against its twin on the CPU: stage by stage within stated tolerances, whole runs by what must hold and by
//! their shapes, whole models by their certificates; devices that are lost, missing, or out of memory.
//!
//! Runs on the best adapter there is: a real GPU where there is one, else a software one (Debian packages
//! mesa-vulkan-drivers, libvulkan1). Nothing is skipped where there is none: the tests fail and name the packages. With
//! `OVIDUCT_TEST_NO_VULKAN=1` only what a machine without a Vulkan loader does is tested.

#![expect(clippy::unwrap_used, clippy::print_stdout, reason = "a test fails by panic and tells what it measured")]

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
#[path = "gpu/stages.rs"]
mod stages;
#[cfg(target_os = "linux")]
#[path = "gpu/starved.rs"]
mod starved;
