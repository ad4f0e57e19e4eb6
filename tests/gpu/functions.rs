//! Small shader functions, called from a separate kernel. Random numbers must match bit for bit;
//! other functions are compared with f64.

use crate::common::{found, no_vulkan};
use oviduct::random::{Stream, words};
use std::future::Future;
use std::pin::pin;
use std::task::{Context, Poll, Waker};

const COUNT: usize = 4096;

/// Evaluates `value(i)`, defined in the WGSL source `functions`, for i in 0..[`COUNT`].
fn call(functions: &str) -> Vec<[u32; 4]> {
    let source = [
        include_str!("../../shaders/shared/random.wgsl"),
        include_str!("../../shaders/shared/maths.wgsl"),
        "@group(0) @binding(0) var<storage, read_write> values: array<vec4<u32>>;\n",
        functions,
        "@compute @workgroup_size(64) fn main(@builtin(global_invocation_id) id: vec3<u32>) {
             values[id.x] = value(id.x);
         }",
    ]
    .concat();
    let name = &found()[0].name;
    let instance = wgpu::Instance::new(wgpu::InstanceDescriptor::new_without_display_handle());
    let found = ready(instance.enumerate_adapters(wgpu::Backends::PRIMARY));
    let adapter = found.iter().find(|a| a.get_info().name == *name).unwrap();
    let (device, queue) = ready(adapter.request_device(&wgpu::DeviceDescriptor::default())).unwrap();
    let module = device.create_shader_module(wgpu::ShaderModuleDescriptor {
        label: None,
        source: wgpu::ShaderSource::Wgsl(source.into()),
    });
    let pipeline = device.create_compute_pipeline(&wgpu::ComputePipelineDescriptor {
        label: None,
        layout: None,
        module: &module,
        entry_point: None,
        compilation_options: wgpu::PipelineCompilationOptions::default(),
        cache: None,
    });
    let buffer = |usage| {
        let size = 16 * COUNT as u64;
        device.create_buffer(&wgpu::BufferDescriptor { label: None, size, usage, mapped_at_creation: false })
    };
    let values = buffer(wgpu::BufferUsages::STORAGE | wgpu::BufferUsages::COPY_SRC);
    let staging = buffer(wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST);
    let group = device.create_bind_group(&wgpu::BindGroupDescriptor {
        label: None,
        layout: &pipeline.get_bind_group_layout(0),
        entries: &[wgpu::BindGroupEntry { binding: 0, resource: values.as_entire_binding() }],
    });
    let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    {
        let mut pass = encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default());
        pass.set_pipeline(&pipeline);
        pass.set_bind_group(0, &group, &[]);
        pass.dispatch_workgroups(COUNT as u32 / 64, 1, 1);
    }
    encoder.copy_buffer_to_buffer(&values, 0, &staging, 0, staging.size());
    queue.submit([encoder.finish()]);
    staging.map_async(wgpu::MapMode::Read, .., Result::unwrap);
    device.poll(wgpu::PollType::wait_indefinitely()).unwrap();
    let view = staging.get_mapped_range(..).unwrap();
    bytemuck::pod_collect_to_vec(&view[..])
}

fn ready<F: Future>(future: F) -> F::Output {
    let Poll::Ready(value) = pin!(future).poll(&mut Context::from_waker(Waker::noop())) else { panic!("not ready") };
    value
}

#[test]
fn random_words_are_the_same() {
    if no_vulkan() {
        return;
    }
    let found = call(
        "fn value(i: u32) -> vec4<u32> {
             return random_words(vec2<u32>(i * 2654435761u, i % 7u), STREAM_GROWTH, i, i * i);
         }",
    );
    for (i, found) in (0u32..).zip(found) {
        let seed = u64::from(i.wrapping_mul(2_654_435_761)) | u64::from(i % 7) << 32;
        assert_eq!(found, words(seed, Stream::Growth, i, i * i));
    }
}

#[test]
fn units_and_bounded_numbers_are_the_same() {
    if no_vulkan() {
        return;
    }
    let found = call(
        "fn value(i: u32) -> vec4<u32> {
             let word = i * 2654435761u;
             return vec4<u32>(bitcast<u32>(random_unit(word)), random_below(word, i % 100u + 1u), 0u, 0u);
         }",
    );
    for (i, found) in (0u32..).zip(found) {
        let word = i.wrapping_mul(2_654_435_761);
        assert_eq!(f32::from_bits(found[0]), oviduct::random::unit(word));
        assert_eq!(found[1], oviduct::random::below(word, i % 100 + 1));
    }
}

#[test]
fn cosine_is_close_to_f64() {
    if no_vulkan() {
        return;
    }
    let found = call(
        "fn value(i: u32) -> vec4<u32> {
             return vec4<u32>(bitcast<u32>(cos_turns(f32(i) * 0.0037 - 7.0)), 0u, 0u, 0u);
         }",
    );
    for (i, found) in found.into_iter().enumerate() {
        let x = f64::from(i as f32 * 0.0037 - 7.0);
        let exact = (std::f64::consts::TAU * x).cos();
        // One unit in the last place of x at about 7 turns changes the value by 3e-6.
        assert!((f64::from(f32::from_bits(found[0])) - exact).abs() < 1e-5, "x = {x}");
    }
}

#[test]
fn nearest_point_of_an_ellipse_is_nearest() {
    if no_vulkan() {
        return;
    }
    let found = call(
        "fn value(i: u32) -> vec4<u32> {
             let p = vec2<f32>(f32(i % 64u) * 31.0 - 960.0, f32(i / 64u) * 29.0 - 900.0);
             let t = nearest_on_ellipse(p, 700.0, 0.88);
             return vec4<u32>(bitcast<u32>(t.x), bitcast<u32>(t.y), 0u, 0u);
         }",
    );
    let (r, squash) = (700.0f64, 0.88f64);
    for (i, found) in found.into_iter().enumerate() {
        let p = [(i % 64) as f64 * 31.0 - 960.0, (i / 64) as f64 * 29.0 - 900.0];
        let distance = |c: f64, s: f64| (r * c - p[0]).hypot(squash * r * s - p[1]);
        let t = [0, 1].map(|k| f64::from(f32::from_bits(found[k])));
        assert!((t[0].hypot(t[1]) - 1.0).abs() < 1e-6);
        let best = (0..3000)
            .map(|k| f64::from(k) * std::f64::consts::TAU / 3000.0)
            .map(|a| distance(a.cos(), a.sin()))
            .fold(f64::INFINITY, f64::min);
        // The CPU has the same error: near the segment between the foci, six iterations leave some
        // hundredths of a micrometre.
        assert!(distance(t[0], t[1]) < best + 0.05, "point {p:?}: {} against {best}", distance(t[0], t[1]));
    }
}
