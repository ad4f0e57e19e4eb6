//! The simulation on a GPU (Vulkan, Metal, DX12 through wgpu): the twin of [`super::cpu`], many members at a time.
//!
//! Shaders lie in `shaders/`, one file a stage, named as the CPU's stage. Only this module and `render` name wgpu.

mod adapter;
mod batch;
mod device;
mod error;

pub use adapter::{Adapter, AdapterKind, GpuOptions, adapters};
pub use batch::{BatchReport, BatchSink, Checkpoint, replay, run_batch};
pub use device::GpuDevice;
pub use error::GpuError;
