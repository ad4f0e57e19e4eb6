//! The GPU against its twin on the CPU: stage by stage within stated tolerances, whole runs by what must hold.
//!
//! Runs on any adapter, software ones included (Debian packages mesa-vulkan-drivers, libvulkan1). Nothing is skipped where
//! there is none: the tests fail and name the packages. With `OVIDUCT_TEST_NO_VULKAN=1` they test instead that the
//! missing loader is told.

#[path = "gpu/common.rs"]
mod common;
#[path = "gpu/runs.rs"]
mod runs;
