//! Measures steps of the simulation on the CPU.

use super::curve::Point;
use anyhow::{Context, anyhow};
use oviduct::clock::Stopwatch;
use oviduct::sim::Plan;
use oviduct::sim::cpu::{CpuSimulation, Kernel};
use oviduct::spec::{ModelSpec, Search, preset};
use rayon::ThreadPool;
use serde_json::Value;

/// Returns the spec of preset `paper`, changed by a patch.
pub(super) fn paper(patch: &Value) -> anyhow::Result<ModelSpec> {
    ModelSpec::resolve(preset("paper").context("there is no preset `paper`")?, patch)
        .map_err(|faults| anyhow!("the preset `paper` is not valid: {faults:?}"))
}

/// A variant of the simulation on the CPU.
#[derive(Clone, Copy, Debug)]
pub(super) struct Variant {
    pub(super) search: Search,
    pub(super) kernel: Kernel,
    pub(super) threads: usize,
}

impl Variant {
    /// Creates a pool with the number of threads.
    pub(super) fn pool(self) -> anyhow::Result<ThreadPool> {
        Ok(rayon::ThreadPoolBuilder::new().num_threads(self.threads).build()?)
    }
}

/// A whole run with all its steps, including burn-in.
pub(super) struct Run {
    pub(super) steps: Vec<Point>,
    pub(super) seconds: f64,
}

/// Runs `plan` from start to end and calls `each` with the state before each growth event. The time
/// of `each` is not measured.
pub(super) fn whole(plan: &Plan, variant: Variant, mut each: impl FnMut(&CpuSimulation) + Send) -> anyhow::Result<Run> {
    let plan = Plan { search: variant.search, ..plan.clone() };
    let pool = variant.pool()?;
    pool.install(|| {
        let mut simulation =
            CpuSimulation::new(plan.clone(), variant.threads).fork(variant.search, variant.kernel, variant.threads);
        let mut steps = Vec::with_capacity(plan.rows.len());
        let mut seconds = 0.0;
        while simulation.time() < i64::from(plan.steps) {
            if plan.grows_at(simulation.time()) {
                each(&simulation);
            }
            let watch = Stopwatch::start();
            simulation.step()?;
            let taken = watch.seconds();
            seconds += taken;
            steps.push(Point { particles: f64::from(simulation.particles()), seconds_per_step: taken });
        }
        Ok(Run { steps, seconds })
    })
}

/// Minimum duration of sampling in seconds: new threads may share a core for some tens of
/// milliseconds.
const LEAST_SECONDS: f64 = 0.5;

/// Returns the median time per step of `repeats` or more samples, each of `window` steps from
/// `state`.
pub(super) fn sample(
    state: &CpuSimulation,
    variant: Variant,
    pool: &ThreadPool,
    window: u32,
    repeats: usize,
) -> anyhow::Result<Point> {
    pool.install(|| {
        let mut taken = Vec::with_capacity(repeats);
        let mut particles = 0;
        while taken.len() < repeats || taken.iter().sum::<f64>() * f64::from(window) < LEAST_SECONDS {
            let mut fork = state.fork(variant.search, variant.kernel, variant.threads);
            let watch = Stopwatch::start();
            for _ in 0..window {
                fork.step()?;
            }
            taken.push(watch.seconds() / f64::from(window));
            particles = fork.particles();
        }
        taken.sort_by(f64::total_cmp);
        Ok(Point { particles: f64::from(particles), seconds_per_step: taken[(taken.len() - 1) / 2] })
    })
}

/// Returns states of a run with about `counts` particles (ascending), each just before a growth
/// event. The last state is the last such state of the run.
pub(super) fn states(plan: &Plan, counts: &[u32], threads: usize) -> anyhow::Result<Vec<CpuSimulation>> {
    let variant = Variant { search: Search::Lists, kernel: Kernel::Vector, threads };
    let mut states: Vec<CpuSimulation> = Vec::new();
    let last = (plan.steps - 1) / plan.grow_every * plan.grow_every;
    whole(plan, variant, |simulation| {
        let due = counts.get(states.len()).is_some_and(|&count| simulation.particles() >= count);
        if due || (simulation.time() == i64::from(last) && states.len() < counts.len()) {
            states.push(simulation.fork(variant.search, variant.kernel, variant.threads));
        }
    })?;
    Ok(states)
}

/// Returns the state of a run just before the first growth event with at least `particles`
/// particles, or at the end if there is none.
pub(super) fn grown(plan: &Plan, variant: Variant, particles: u32) -> anyhow::Result<CpuSimulation> {
    variant.pool()?.install(|| {
        let mut simulation = CpuSimulation::new(plan.clone(), variant.threads);
        let is_due = |at: &CpuSimulation| at.particles() >= particles && plan.grows_at(at.time());
        while simulation.time() < i64::from(plan.steps) && !is_due(&simulation) {
            simulation.step()?;
        }
        Ok(simulation)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn states_have_the_counts_asked_for() {
        let patch = json!({ "steps": 60, "burn_in": 5, "particles": {
            "total": { "keys": [[0, 200], [1, 500]] }, "outer": { "keys": [[0, 60], [1, 90]] } } });
        let spec = paper(&patch).unwrap();
        let plan = Plan::new(&spec, 1);
        let states = states(&plan, &[200, 300, 500], 1).unwrap();
        let counts: Vec<u32> = states.iter().map(CpuSimulation::particles).collect();
        assert_eq!(counts.len(), 3);
        assert!(counts[0] == 200 && (300..=350).contains(&counts[1]) && (400..500).contains(&counts[2]), "{counts:?}");
        let variant = Variant { search: Search::AllPairs, kernel: Kernel::Scalar, threads: 1 };
        let grown = grown(&plan, Variant { search: Search::Lists, kernel: Kernel::Vector, threads: 2 }, 300).unwrap();
        assert!(grown.checkpoint() == states[1].checkpoint());
        let point = sample(&states[2], variant, &variant.pool().unwrap(), 1, 3).unwrap();
        assert!((f64::from(counts[2])..=500.0).contains(&point.particles) && point.seconds_per_step > 0.0);
    }
}
