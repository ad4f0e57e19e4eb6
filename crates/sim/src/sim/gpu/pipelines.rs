//! Compiled stages of a device.

use super::layout::Now;
use super::shaders::{self, Shader};
use std::mem::size_of;

/// Number of storage buffers of a stage.
pub(super) const STORAGE_BUFFERS: u32 = 11;
/// Bytes of the immediates.
pub(super) const IMMEDIATES: u32 = size_of::<Now>() as u32;

/// Pipelines: one per stage, or one per stage and evaluation.
#[derive(Debug)]
pub(super) struct Pipelines {
    pub(super) layout: wgpu::BindGroupLayout,
    /// Evaluations 1 to 4 of Runge–Kutta.
    pub(super) integrate: [wgpu::ComputePipeline; 4],
    /// The evaluation of an Euler step, and its guard.
    pub(super) euler: [wgpu::ComputePipeline; 2],
    pub(super) growth: wgpu::ComputePipeline,
    pub(super) split: wgpu::ComputePipeline,
    pub(super) record: wgpu::ComputePipeline,
}

impl Pipelines {
    pub(super) fn new(device: &wgpu::Device) -> Self {
        let entry = |binding: u32, ty| wgpu::BindGroupLayoutEntry {
            binding,
            visibility: wgpu::ShaderStages::COMPUTE,
            ty: wgpu::BindingType::Buffer { ty, has_dynamic_offset: false, min_binding_size: None },
            count: None,
        };
        let storage = |read_only| wgpu::BufferBindingType::Storage { read_only };
        // Rows, members and tables are read only.
        let mut entries = vec![entry(0, wgpu::BufferBindingType::Uniform)];
        entries.extend((1..=STORAGE_BUFFERS).map(|binding| entry(binding, storage(binding <= 3))));
        let layout = device
            .create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some("batch"), entries: &entries });
        let pipeline_layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some("batch"),
            bind_group_layouts: &[Some(&layout)],
            immediate_size: IMMEDIATES,
        });
        let module = |shader: &Shader| {
            device.create_shader_module(wgpu::ShaderModuleDescriptor {
                label: Some(shader.name),
                source: wgpu::ShaderSource::Wgsl(shader.source.into()),
            })
        };
        let pipeline = |module: &wgpu::ShaderModule, entry: &str, constants: &[(&str, f64)]| {
            device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
                label: Some(entry),
                layout: Some(&pipeline_layout),
                module,
                entry_point: Some(entry),
                compilation_options: wgpu::PipelineCompilationOptions {
                    constants,
                    // Every word of shared memory is written before it is read.
                    zero_initialize_workgroup_memory: false,
                },
                cache: None,
            })
        };
        let integrate = module(&shaders::INTEGRATE);
        let growth = module(&shaders::GROWTH);
        let evaluation = |k: u32| pipeline(&integrate, "integrate", &[("EVALUATION", f64::from(k)), ("EULER", 0.0)]);
        let euler = |entry| pipeline(&integrate, entry, &[("EVALUATION", 0.0), ("EULER", 1.0)]);
        Self {
            integrate: [0, 1, 2, 3].map(evaluation),
            euler: ["integrate", "guard"].map(euler),
            growth: pipeline(&growth, "growth", &[]),
            split: pipeline(&growth, "split", &[]),
            record: pipeline(&module(&shaders::RECORD), "record", &[]),
            layout,
        }
    }
}
