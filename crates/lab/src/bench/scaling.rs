//! `bench scaling`: time per step with neighbour lists, by number of threads and particles, and by
//! the size of similar sections.

use super::machine;
use super::probe::{self, Variant};
use super::report::Report;
use oviduct::sim::Plan;
use oviduct::sim::cpu::{CpuSimulation, Kernel, PairTerms, reference_force};
use oviduct::spec::Search;
use serde_json::json;

/// Steps of a sample: one growth event and the steps until the next.
const WINDOW: u32 = 10;
const SEED: u64 = 1;
/// Particles at the end of the preset `paper`.
const PAPER: f64 = 8300.0;
/// Particles whose interactions are counted.
const COUNTED: usize = 500;

pub(super) fn run(quick: bool) -> anyhow::Result<Report> {
    let spec = probe::paper(&json!({}))?;
    let plan = Plan::new(&spec, SEED);
    let all = machine::threads();
    let mut threads: Vec<usize> = std::iter::successors(Some(1), |n| Some(2 * n)).take_while(|&n| n < all).collect();
    threads.push(all);
    let (counts, repeats): (&[u32], _) =
        if quick { (&[1175, 3500, 8300], 3) } else { (&[710, 1175, 2000, 3500, 5500, 8300], 15) };
    let states = probe::states(&plan, counts, 1)?;
    let mut rows = Vec::new();
    let mut lines = vec![
        machine::line(),
        format!(
            "microseconds per step with neighbour lists, median of {repeats} or more samples of {WINDOW} steps (preset paper, seed {SEED})"
        ),
        format!(
            "{:>9} {}",
            "particles",
            threads.iter().map(|n| format!("{:>12}", threads_in_words(*n))).collect::<String>()
        ),
    ];
    for state in &states {
        let mut row = Vec::new();
        let mut line = String::new();
        let mut particles = 0.0;
        for &n in &threads {
            let variant = Variant { search: Search::Lists, kernel: Kernel::Vector, threads: n };
            let point = probe::sample(state, variant, &variant.pool()?, WINDOW, repeats)?;
            particles = point.particles;
            line += &format!("{:>12.1}", 1e6 * point.seconds_per_step);
            row.push(json!({ "threads": n, "seconds_per_step": point.seconds_per_step }));
        }
        lines.push(format!("{particles:>9} {line}"));
        rows.push(json!({ "particles": particles, "by_threads": row }));
    }
    let sizes: &[u32] = if quick { &[1000, 3000, 10_000] } else { &[1000, 3000, 10_000, 30_000, 100_000] };
    lines.extend([
        String::new(),
        format!("one thread, sections grown halfway, median of {repeats} or more samples of {WINDOW} steps"),
        format!(
            "{:>9} {:>9} {:>16} {:>18} {:>19}",
            "particles", "of steps", "ns per particle", "repelling segments", "ns per interaction"
        ),
    ]);
    let mut by_size = Vec::new();
    for &particles in sizes {
        let HalfGrown { particles, steps, nanoseconds, interactions } = half_grown(particles, repeats)?;
        let each = nanoseconds / interactions;
        lines.push(format!("{particles:>9} {steps:>9} {nanoseconds:>16.0} {interactions:>18.1} {each:>19.2}"));
        by_size.push(json!({
            "particles": particles, "steps": steps, "nanoseconds_per_particle_and_step": nanoseconds,
            "interactions_per_particle": interactions,
        }));
    }
    let json = json!({
        "bench": "scaling", "engine": oviduct::ENGINE_VERSION, "machine": machine::describe(), "preset": "paper",
        "seed": SEED, "samples": repeats, "steps_per_sample": WINDOW, "rows": rows, "by_size": by_size,
    });
    Ok(Report { lines, json, files: Vec::new() })
}

/// A section grown halfway.
struct HalfGrown {
    particles: f64,
    /// Steps of the whole run.
    steps: u32,
    /// Nanoseconds per particle and step.
    nanoseconds: f64,
    /// Mean number of segments that repel a particle.
    interactions: f64,
}

/// Grows a section to `particles`, half of its final number, with the schedules of `paper`. The
/// area of the region is proportional to the particles, and the number of steps to its radius, so
/// that the folds have time to spread.
fn half_grown(particles: u32, repeats: usize) -> anyhow::Result<HalfGrown> {
    let area = 2.0 * f64::from(particles) / PAPER;
    let radius = area.sqrt();
    let steps = (2000.0 * radius.max(1.0)).round() as u32;
    let inner = |paper: f64| (paper * area).round();
    let outer = |paper: f64| (paper * radius).round();
    let patch = json!({
        "steps": steps, "solver": { "record_every": steps.div_ceil(200) }, "wall": { "lobing": 0 },
        "particles": {
            "total": { "keys": [[0, inner(710.0)], [0.2125, inner(1175.0)], [1, 2 * particles]] },
            "outer": { "keys": [[0, outer(110.0)], [1, outer(300.0)]] },
        },
    });
    let spec = probe::paper(&patch)?;
    let plan = Plan::new(&spec, SEED);
    let variant = |threads| Variant { search: Search::Lists, kernel: Kernel::Vector, threads };
    let state = probe::grown(&plan, variant(machine::threads()), particles)?;
    let point = probe::sample(&state, variant(1), &variant(1).pool()?, WINDOW, repeats)?;
    Ok(HalfGrown {
        particles: point.particles,
        steps,
        nanoseconds: 1e9 * point.seconds_per_step / point.particles,
        interactions: interactions_per_particle(&plan, &state),
    })
}

fn interactions_per_particle(plan: &Plan, simulation: &CpuSimulation) -> f64 {
    let (row, s) = (plan.at(simulation.time()), simulation.inner());
    let n = s.x.len();
    let point = |i: usize| [s.x[i % n], s.y[i % n]];
    let repelling = |i: usize| {
        let (before, after) = (point(i + n - 1), point(i + 1));
        let along = [after[0] - before[0], after[1] - before[1]];
        let length = along[0].hypot(along[1]);
        let terms = PairTerms::new(row, point(i), [-along[1] / length, along[0] / length], s.scale[i]);
        let others = (0..n).filter(|&j| j != i && (j + 1) % n != i);
        others.filter(|&j| reference_force(&terms, point(j), point(j + 1)).0 != [0.0; 2]).count()
    };
    let counts: Vec<usize> = (0..n).step_by(n.div_ceil(COUNTED)).map(repelling).collect();
    counts.iter().sum::<usize>() as f64 / counts.len() as f64
}

fn threads_in_words(count: usize) -> String {
    format!("{count} thread{}", if count == 1 { "" } else { "s" })
}
