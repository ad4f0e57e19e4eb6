//! Progress of a generation as a fraction of its work, and an estimate of the remaining time.

use super::cost::StageSeconds;
use super::types::{Progress, Request, Sink, Stage};
use crate::clock::Stopwatch;
use crate::model::Section;
use tempfile::TempPath;

const STAGES: [Stage; 6] = [Stage::Simulate, Stage::Mesh, Stage::Certify, Stage::Measure, Stage::Export, Stage::Store];
/// Completed fraction of the whole before the files are stored, which takes an unknown time.
const GROWN: f64 = 0.99;

/// Completed fraction of the whole at the end of each of [`STAGES`], by their predicted times.
fn ends(request: &Request) -> [f64; 6] {
    let StageSeconds { simulate, mesh, certify, measure, export, labels } =
        StageSeconds::new(&request.spec, &request.outputs);
    let stages = [simulate, mesh, certify, measure, export + labels];
    let scale = GROWN / stages.iter().sum::<f64>();
    let mut ends = [1.0; 6];
    let mut sum = 0.0;
    for (end, seconds) in ends.iter_mut().zip(stages) {
        sum += seconds;
        *end = sum * scale;
    }
    ends
}

/// Converts steps into progress. The weight of a step is its number of particles.
pub(super) struct ProgressMeter<'a> {
    sink: &'a dyn Sink,
    watch: Stopwatch,
    /// Completed fraction of the whole at the end of each of [`STAGES`].
    ends: [f64; 6],
    /// Completed fraction at the start of `watch`.
    begun: f64,
    burn_in: f64,
    /// Sum of the particles over the steps before each step.
    work: Vec<f64>,
    now: Progress,
}

impl<'a> ProgressMeter<'a> {
    pub(super) fn new(request: &Request, sink: &'a dyn Sink) -> Self {
        let spec = &request.spec;
        let particles = |t: u32| spec.particles.total.at(f64::from(t) / f64::from(spec.steps));
        let mut sum = f64::from(spec.burn_in) * particles(0);
        let last = *spec.recorded().end();
        let mut work = Vec::with_capacity(last as usize + 1);
        for t in 0..=last {
            work.push(sum);
            sum += particles(t);
        }
        let now = Progress {
            stage: Stage::Simulate,
            fraction: 0.0,
            step: 0,
            steps: last,
            particles: particles(0) as u32,
            sections: 0,
            eta_seconds: None,
        };
        sink.progress(&now);
        let ends = ends(request);
        Self { sink, watch: Stopwatch::start(), ends, begun: 0.0, burn_in: f64::from(spec.burn_in), work, now }
    }

    /// Reports a completed step.
    pub(super) fn step(&mut self, time: i64, particles: u32) {
        let all = self.work[self.work.len() - 1].max(1.0);
        let done = match usize::try_from(time) {
            Ok(t) => self.work[t.min(self.work.len() - 1)],
            Err(_) => self.work[0] * (self.burn_in + time as f64) / self.burn_in.max(1.0),
        };
        self.now.step = time.max(0) as u32;
        self.now.particles = particles;
        self.report(self.fraction(Stage::Simulate, done / all));
    }

    /// Reports that the generation continues from a checkpoint at this step.
    pub(super) fn resumed(&mut self, time: i64, particles: u32) {
        self.step(time, particles);
        self.watch = Stopwatch::start();
        self.begun = self.now.fraction;
    }

    /// True if the sink requests a checkpoint.
    pub(super) fn wants_checkpoint(&self) -> bool {
        self.sink.wants_checkpoint()
    }

    /// Passes the checkpoint to the sink.
    pub(super) fn checkpoint(&self, file: TempPath) {
        self.sink.checkpoint(file);
    }

    /// Reports a recorded section.
    pub(super) fn section(&mut self, section: &Section) {
        self.now.sections += 1;
        self.sink.section(section);
    }

    /// Reports a completed fraction of a stage.
    pub(super) fn stage(&mut self, stage: Stage, part: f64) {
        self.now.stage = stage;
        self.report(self.fraction(stage, part));
    }

    /// Completed fraction of the whole after a fraction of a stage.
    fn fraction(&self, stage: Stage, part: f64) -> f64 {
        let mut begin = 0.0;
        for (known, end) in STAGES.into_iter().zip(self.ends) {
            if known == stage {
                return begin + part * (end - begin);
            }
            begin = end;
        }
        1.0
    }

    fn report(&mut self, fraction: f64) {
        self.now.fraction = fraction.max(self.now.fraction);
        let elapsed = self.watch.seconds();
        let done = self.now.fraction - self.begun;
        let enough_data = elapsed > 0.2 && done > 0.01;
        self.now.eta_seconds = enough_data.then(|| elapsed * (1.0 - self.now.fraction) / done);
        self.sink.progress(&self.now);
    }
}
