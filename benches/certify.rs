//! Duration of the certificate of a surface as large as the paper's models: about 790,000 vertices
//! and 1.6 million triangles.

#[path = "common/tube.rs"]
mod tube;

use criterion::{Criterion, criterion_group, criterion_main};
use oviduct::measure::{CheckOptions, certify, check_surface};
use oviduct::model::{BodyKind, Mesh, Ring, Section};
use std::hint::black_box;

fn model() -> (Mesh, Vec<Section>) {
    let tube = tube::tube(201, 3_700, 230, 36);
    let ring = |points: Vec<[f32; 2]>| Ring { ids: (0..points.len() as u32).collect(), points };
    let sections = tube
        .sections
        .into_iter()
        .map(|(z_um, inner, outer)| Section { z_um, inner: ring(inner), outer: ring(outer), ..Section::default() })
        .collect();
    let mesh =
        Mesh { body: BodyKind::Tissue, positions: tube.positions, triangles: tube.triangles, patches: Vec::new() };
    (mesh, sections)
}

fn bench(criterion: &mut Criterion) {
    let (mesh, sections) = model();
    let certificate = certify(&mesh, &sections);
    assert!(certificate.passed, "{:?}", certificate.first_failure());
    let mut group = criterion.benchmark_group("certify");
    group.sample_size(10);
    for threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads can be started");
        group.bench_function(format!("paper size, {threads} threads"), |b| {
            b.iter(|| pool.install(|| certify(black_box(&mesh), black_box(&sections))));
        });
    }
    let positions: Vec<[f64; 3]> = mesh.positions.iter().map(|p| p.map(f64::from)).collect();
    // An order without spatial coherence.
    let mut triangles = mesh.triangles.clone();
    let count = triangles.len();
    for i in 0..count {
        triangles.swap(i, (i * 7_919 + 13) % count);
    }
    group.bench_function("paper size as a soup", |b| {
        b.iter(|| check_surface(black_box(&positions), &triangles, &CheckOptions::default()));
    });
    group.finish();
}

criterion_group!(benches, bench);
criterion_main!(benches);
