//! The simulation on a GPU (Vulkan, Metal, DX12 through wgpu): the twin of [`super::cpu`], many members at a time.
//!
//! Shaders lie in `shaders/`, one file a stage, named as the CPU's stage. Only this module and `render` name wgpu.

mod adapter;
mod batch;
mod course;
mod device;
mod error;
pub mod layout;
mod memory;
mod pace;
mod pipelines;
mod record;
mod ring;
pub mod shaders;

pub use crate::sim::Checkpoint;
pub use adapter::{Adapter, AdapterKind, GpuOptions, adapters};
pub use batch::{BatchReport, BatchSink, advance, replay, run_batch};
pub use device::GpuDevice;
pub use error::GpuError;
