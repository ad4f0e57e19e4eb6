//! Measuring simulations on a GPU.

use super::curve::Point;
use crate::clock::Stopwatch;
use crate::model::Section;
use crate::sim::gpu::{BatchReport, BatchSink, Checkpoint, GpuDevice, run_batch};
use crate::sim::{Plan, SimError, Statistics};

/// A batch that was run.
pub(super) struct Batch {
    /// Seconds from the call to the last section of the last member.
    pub(super) seconds: f64,
    pub(super) report: BatchReport,
    /// Time per step of the first member between its recorded sections.
    pub(super) points: Vec<Point>,
}

/// Simulates `plans` together. Sections are taken and dropped.
pub(super) fn run(device: &GpuDevice, plans: &[Plan]) -> anyhow::Result<Batch> {
    let mut times = Times { watch: Stopwatch::start(), last: None, points: Vec::new(), failed: None };
    let report = run_batch(device, plans, &mut times)?;
    let seconds = times.watch.seconds();
    match times.failed {
        Some(error) => Err(error.into()),
        None => Ok(Batch { seconds, report, points: times.points }),
    }
}

struct Times {
    watch: Stopwatch,
    /// Step and seconds of the first member's last section.
    last: Option<(f64, f64)>,
    points: Vec<Point>,
    failed: Option<SimError>,
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

    fn finished(&mut self, _: usize, _: Statistics) {}
}
