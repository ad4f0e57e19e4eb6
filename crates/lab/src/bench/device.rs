//! Measures simulations on a GPU.

use super::curve::Point;
use oviduct::clock::Stopwatch;
use oviduct::model::Section;
use oviduct::sim::gpu::{AdapterKind, BatchReport, BatchSink, Checkpoint, GpuDevice, run_batch};
use oviduct::sim::{Plan, SimError, Statistics};
use serde_json::{Value, json};

/// A measured batch.
pub(super) struct Batch {
    /// Seconds from the call to the last section of the last member.
    pub(super) seconds: f64,
    pub(super) report: BatchReport,
    /// Report of the first member.
    pub(super) first: Statistics,
    /// Time per step of the first member between its recorded sections.
    pub(super) points: Vec<Point>,
}

impl Batch {
    /// Returns details as JSON.
    pub(super) fn describe(&self) -> Value {
        let report = &self.report;
        json!({
            "seconds": self.seconds, "host_seconds": report.host_seconds, "dispatches": report.dispatches,
            "submissions": report.submissions, "bytes_back": report.bytes_back, "first": self.first,
        })
    }

    /// Returns the work of the neighbour search in the first member as text.
    pub(super) fn search(&self) -> String {
        let Statistics { list_builds, full_searches, .. } = self.first;
        format!("seed 1: neighbour lists built {list_builds} times; a block searched all others {full_searches} times")
    }

    /// Returns the mean microseconds per dispatch, including the time of the host.
    pub(super) fn microseconds_a_dispatch(&self) -> f64 {
        1e6 * self.seconds / self.report.dispatches.max(1) as f64
    }
}

/// Returns the device as JSON.
pub(super) fn describe(device: &GpuDevice) -> Value {
    let adapter = device.adapter();
    json!({
        "name": adapter.name, "kind": adapter.kind.as_str(), "backend": adapter.backend, "driver": adapter.driver,
    })
}

/// Returns true if the adapter computes on the CPU.
pub(super) fn is_software(device: &GpuDevice) -> bool {
    device.adapter().kind == AdapterKind::Software
}

/// Returns the device as text, with a warning if it is a software adapter.
pub(super) fn lines(device: &GpuDevice) -> Vec<String> {
    let adapter = device.adapter();
    let mut lines = vec![format!(
        "{}, {} over {}, driver {}",
        adapter.name,
        adapter.kind.as_str(),
        adapter.backend,
        adapter.driver
    )];
    if is_software(device) {
        lines.push("a SOFTWARE adapter, which computes on the CPU: its times are not those of a GPU".to_owned());
    }
    lines
}

/// Returns a short name for tables and plots.
pub(super) fn label(device: &GpuDevice) -> String {
    // The rest of the name lists versions.
    let name = device.name().split(" (").next().unwrap_or_default();
    if is_software(device) { format!("{name}, a SOFTWARE adapter") } else { name.to_owned() }
}

/// Returns the run of median time of `runs`. The first run is not measured, because drivers defer
/// work to it. A software adapter defers little and takes minutes per run, so all of its runs are
/// measured.
pub(super) fn median(device: &GpuDevice, plans: &[Plan], runs: usize) -> anyhow::Result<Batch> {
    if !is_software(device) {
        run(device, plans)?;
    }
    let mut all: Vec<Batch> = (0..runs).map(|_| run(device, plans)).collect::<anyhow::Result<_>>()?;
    all.sort_by(|a, b| a.seconds.total_cmp(&b.seconds));
    Ok(all.swap_remove((runs - 1) / 2))
}

/// Simulates `plans` together and discards the sections.
fn run(device: &GpuDevice, plans: &[Plan]) -> anyhow::Result<Batch> {
    let (watch, first) = (Stopwatch::start(), Statistics::default());
    let mut times = Times { watch, last: None, points: Vec::new(), failed: None, first };
    let report = run_batch(device, plans, &mut times)?;
    let seconds = times.watch.seconds();
    match times.failed {
        Some(error) => Err(error.into()),
        None => Ok(Batch { seconds, report, first: times.first, points: times.points }),
    }
}

struct Times {
    watch: Stopwatch,
    /// Step and seconds of the first member's last section.
    last: Option<(f64, f64)>,
    points: Vec<Point>,
    failed: Option<SimError>,
    first: Statistics,
}

impl BatchSink for Times {
    fn section(&mut self, member: usize, section: Section, _: Checkpoint) {
        if member != 0 {
            return;
        }
        let now = self.watch.seconds();
        if let Some((step, seconds)) = self.last.replace((section.step, now)) {
            let steps = (section.step - step).max(1.0);
            let particles = section.particles() as f64;
            self.points.push(Point { particles, seconds_per_step: ((now - seconds) / steps).max(1e-9) });
        }
    }

    fn progress(&mut self, _: usize, _: i64, _: u32) {}

    fn cancelled(&mut self, _: usize) -> bool {
        false
    }

    fn failed(&mut self, _: usize, error: SimError) {
        self.failed = Some(error);
    }

    fn finished(&mut self, member: usize, statistics: Statistics) {
        if member == 0 {
            self.first = statistics;
        }
    }
}
