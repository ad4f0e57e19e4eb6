//! The simulation on a GPU (Vulkan, Metal or DX12 through wgpu): the counterpart of [`super::cpu`]
//! for batches of models.
//!
//! The shaders are in `shaders/`, one file per stage, named like the stage on the CPU. Only this
//! module names wgpu.

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
mod sizes;

pub use crate::sim::Checkpoint;
pub use adapter::{Adapter, AdapterKind, GpuOptions, adapters, choose};
pub use batch::{BatchReport, BatchSink, advance, replay, run_batch};
pub use device::GpuDevice;
pub use error::GpuError;
