//! Comparison of whole runs on both backends by the shapes of their sections. The simulation is
//! chaotic: with different rounding, runs of the same seed diverge step by step. The shapes must
//! still be statistically equal.
//!
//! Several seeds are grown on both backends. The rule:
//!
//! - The means of each measure differ by at most half the standard deviation between the CPU's
//!   seeds.
//! - No model of the GPU lies outside the CPU's range by more than one standard deviation.
//! - On both backends, the particle counts follow the schedule.
//! - No contour crosses itself or the other contour.
//! - Every surface passes its certificate.

use crate::batches::{assert_sound, certify_run, run};
use crate::common::{no_vulkan, plan};
use oviduct::geometry::polygon::signed_area;
use oviduct::model::{Ring, Section};
use oviduct::sim::cpu::CpuSimulation;
use oviduct::sim::{Plan, StepRow};
use serde_json::json;
use std::sync::OnceLock;

const SEEDS: std::ops::RangeInclusive<u64> = 1..=6;
/// Steps whose sections are measured; the loop is folded at these steps.
const MEASURED: [f64; 4] = [90.0, 110.0, 130.0, 150.0];
/// Elliptic radius at which folds are counted, as a fraction of the maximum radius.
const FOLD_RADIUS: f64 = 0.75;

/// Maximum difference of the means, in standard deviations.
const MOST_OFF: f64 = 0.5;

/// Names of the measures of a section. Lengths are in µm.
const MEASURES: [&str; 10] = [
    "lumen area",
    "tissue area",
    "perimeter of the lumen over that of the wall",
    "folds",
    "gap, 5th percentile",
    "gap, median",
    "gap, 95th percentile",
    "tissue thickness, 5th percentile",
    "tissue thickness, median",
    "tissue thickness, 95th percentile",
];
type Shape = [f64; MEASURES.len()];

fn wide(p: [f32; 2]) -> [f64; 2] {
    p.map(f64::from)
}

fn edges(ring: &Ring) -> impl Iterator<Item = ([f64; 2], [f64; 2])> {
    let n = ring.len();
    (0..n).map(move |i| (wide(ring.points[i]), wide(ring.points[(i + 1) % n])))
}

fn perimeter(ring: &Ring) -> f64 {
    edges(ring).map(|(a, b)| (b[0] - a[0]).hypot(b[1] - a[1])).sum()
}

/// Number of inward crossings of the ellipse at [`FOLD_RADIUS`] by the contour.
fn folds(ring: &Ring) -> f64 {
    let axis = |k: usize| ring.points.iter().fold(0.0f64, |m, p| m.max(f64::from(p[k]).abs()));
    let (a, b) = (axis(0), axis(1));
    let outside = |p: [f64; 2]| (p[0] / a).hypot(p[1] / b) > FOLD_RADIUS;
    edges(ring).filter(|&(p, q)| outside(p) && !outside(q)).count() as f64
}

/// Distance from `p` in the direction `u` to the segment from `a` to `b`, or `None` if the ray
/// misses the segment.
fn hit(p: [f64; 2], u: [f64; 2], (a, b): ([f64; 2], [f64; 2])) -> Option<f64> {
    let (d, r) = ([b[0] - a[0], b[1] - a[1]], [a[0] - p[0], a[1] - p[1]]);
    let turn = u[0] * d[1] - u[1] * d[0];
    let distance = (r[0] * d[1] - r[1] * d[0]) / turn;
    let along = (r[0] * u[1] - r[1] * u[0]) / turn;
    (distance > 0.0 && (0.0..=1.0).contains(&along)).then_some(distance)
}

/// Distances along the normals of the inner contour, from each vertex: the gap to the opposite
/// wall, and the thickness of the tissue.
fn across(section: &Section) -> [Vec<f64>; 2] {
    let inner: Vec<_> = edges(&section.inner).collect();
    let outer: Vec<_> = edges(&section.outer).collect();
    let n = inner.len();
    let mut found = [Vec::new(), Vec::new()];
    for i in 0..n {
        let (before, (p, after)) = (inner[(i + n - 1) % n].0, inner[i]);
        let t = [after[0] - before[0], after[1] - before[1]];
        let length = t[0].hypot(t[1]);
        // The lumen is to the left of the contour's direction.
        let normal = [-t[1] / length, t[0] / length];
        let others = || (2..n).map(|k| inner[(i + k - 1) % n]);
        let least = |distances: &mut dyn Iterator<Item = f64>| distances.reduce(f64::min);
        let gap = least(&mut others().filter_map(|edge| hit(p, normal, edge)));
        let back = normal.map(|x| -x);
        let tissue = least(&mut others().chain(outer.iter().copied()).filter_map(|edge| hit(p, back, edge)));
        found[0].extend(gap);
        found[1].extend(tissue);
    }
    found
}

fn percentiles(mut values: Vec<f64>) -> [f64; 3] {
    values.sort_by(f64::total_cmp);
    [5, 50, 95].map(|p| values[(values.len() - 1) * p / 100])
}

fn measure(section: &Section) -> Shape {
    let lumen = signed_area(&section.inner.points);
    let tissue = signed_area(&section.outer.points) - lumen;
    let [gaps, thicknesses] = across(section).map(percentiles);
    let mut shape =
        [lumen, tissue, perimeter(&section.inner) / perimeter(&section.outer), folds(&section.inner)].to_vec();
    shape.extend(gaps);
    shape.extend(thicknesses);
    shape.try_into().unwrap()
}

/// Means over the measured sections of a model.
fn shape(sections: &[Section]) -> Shape {
    let shapes: Vec<Shape> = sections.iter().filter(|s| MEASURED.contains(&s.step)).map(measure).collect();
    std::array::from_fn(|k| mean(&shapes.iter().map(|shape| shape[k]).collect::<Vec<_>>()))
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

/// Standard deviation of a sample.
fn spread(values: &[f64]) -> f64 {
    let mean = mean(values);
    (values.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / (values.len() - 1) as f64).sqrt()
}

fn on_cpu(plan: &Plan) -> Vec<Section> {
    let mut simulation = CpuSimulation::new(plan.clone(), 1);
    let mut sections = Vec::new();
    while simulation.time() < i64::from(plan.steps) {
        if plan.records_at(simulation.time()) {
            sections.push(simulation.section());
        }
        simulation.step().unwrap();
    }
    sections.push(simulation.section());
    sections
}

/// Violations of the rule by the measures `found`, compared with the measures `twins`.
fn differences(twins: &[Shape], found: &[Shape]) -> Vec<String> {
    let mut faults = Vec::new();
    for (k, name) in MEASURES.into_iter().enumerate() {
        let [twins, found] = [twins, found].map(|shapes| shapes.iter().map(|shape| shape[k]).collect::<Vec<f64>>());
        let spread = spread(&twins);
        let off = (mean(&found) - mean(&twins)).abs() / spread;
        let range = twins.iter().fold([f64::MAX, f64::MIN], |r, &x| [r[0].min(x), r[1].max(x)]);
        let astray = found.iter().filter(|&&x| x < range[0] - spread || x > range[1] + spread).count();
        println!("{name}: {:.3} ± {spread:.3} and {:.3}: {off:.3} spreads off", mean(&twins), mean(&found));
        if off > MOST_OFF || astray > 0 {
            faults.push(format!("{name}: {off:.2} spreads off, {astray} models out of range"));
        }
    }
    faults
}

fn shapes(runs: &[Vec<Section>]) -> Vec<Shape> {
    runs.iter().map(|run| shape(run)).collect()
}

fn plans() -> Vec<Plan> {
    SEEDS.map(|seed| plan(&json!({}), seed)).collect()
}

fn cpu() -> &'static [Vec<Section>] {
    static RUNS: OnceLock<Vec<Vec<Section>>> = OnceLock::new();
    RUNS.get_or_init(|| plans().iter().map(on_cpu).collect())
}

#[test]
fn whole_runs_have_statistically_equal_shapes() {
    if no_vulkan() {
        return;
    }
    let plans = plans();
    let kept = run(&plans);
    let gpu: Vec<Vec<Section>> =
        kept.sections.iter().map(|run| run.iter().map(|(section, _)| section.clone()).collect()).collect();
    for (member, (cpu, gpu)) in cpu().iter().zip(&gpu).enumerate() {
        assert_eq!(kept.finished[member].unwrap().splits_missing, 0);
        assert_eq!(cpu.len(), gpu.len());
        for run in [cpu, gpu] {
            let last = run.last().unwrap();
            assert_eq!([last.inner.len(), last.outer.len()], [810, 90]);
        }
        cpu.iter().chain(gpu).for_each(assert_sound);
        certify_run(&plans[member], &kept, member);
    }
    let faults = differences(&shapes(cpu()), &shapes(&gpu));
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

/// The rule can fail: it detects a force that is wrong by 20 %, shown here with two runs on the
/// CPU.
#[test]
fn a_wrong_force_is_detected() {
    type Change = fn(&mut StepRow);
    let changes: [(&str, Change); 3] = [
        ("bending", |row| row.bending *= 0.8),
        ("repulsion", |row| row.repulsion *= 1.2),
        ("friction", |row| row.friction *= 1.2),
    ];
    for (name, change) in changes {
        println!("{name}");
        let grow = |mut plan: Plan| {
            plan.rows.iter_mut().for_each(change);
            on_cpu(&plan)
        };
        let wrong: Vec<Vec<Section>> = plans().into_iter().map(grow).collect();
        assert!(!differences(&shapes(cpu()), &shapes(&wrong)).is_empty(), "{name} may be off unseen");
    }
}
