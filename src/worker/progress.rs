//! The sink of a generation: latest progress for heartbeats, checkpoints for their mailbox, stages
//! for traces.
//!
//! The generating thread only writes the latest state here, and heartbeats fetch it at their own
//! pace. Therefore a generation never waits for the job store.

use super::checkpoint::{Mailbox, Saved};
use crate::clock::Stopwatch;
use crate::fit::{FitProgress, FitSink, FitStage};
use crate::generate::{CancelToken, Progress, Sink, Stage};
use crate::jobs::fault::{Faults, Injected};
use crate::jobs::{JobProgress, LiveSection};
use crate::lock::Mutex;
use crate::model::{Ring, Section};
use tempfile::TempPath;
use tokio::sync::watch;
use tracing::Span;

/// Time without a report of the work after which heartbeats estimate the progress. Some stages,
/// such as levels of detail, report only their start and their end.
const ESTIMATED_AFTER: f64 = 0.9;
/// Estimated time to the end of a generation from which its worker claims the next job.
pub(super) const NEARLY_FREE: f64 = 0.5;
/// Stage of a fit whose checkpoints contain all that was computed.
const SEARCH: &str = "search";
/// Maximum number of points of a thinned contour.
const MAX_POINTS: usize = 512;

/// Latest progress and section of an attempt.
#[derive(Debug, Default)]
pub(super) struct LiveProgress(Mutex<Latest>);

#[derive(Debug, Default)]
struct Latest {
    progress: Option<JobProgress>,
    /// Time since `progress` was reported.
    reported: Option<Stopwatch>,
    /// Time since the last fetch of a progress.
    fetched: Option<Stopwatch>,
    /// True if `progress` has not been fetched yet.
    is_new: bool,
    /// A section that has not been fetched yet.
    section: Option<LiveSection>,
    /// Number of recorded sections.
    sections: u32,
    /// Minimum fraction to report.
    floor: f64,
}

impl Latest {
    /// The progress by its own estimate of the remaining time, some time after the last fetch.
    fn estimate(&self) -> Option<JobProgress> {
        let is_due = self.fetched.is_some_and(|since| since.seconds() >= ESTIMATED_AFTER);
        let progress = self.progress.filter(|progress| is_due && progress.eta_seconds().is_some())?;
        Some(progress.after(self.reported?.seconds()).at_least(self.floor))
    }
}

/// Changes since the last heartbeat.
#[derive(Debug, Default)]
pub(super) struct Update {
    pub(super) progress: Option<JobProgress>,
    pub(super) section: Option<LiveSection>,
}

impl Update {
    pub(super) fn is_empty(&self) -> bool {
        self.progress.is_none() && self.section.is_none()
    }
}

impl LiveProgress {
    /// Fetches the changes since the last call. If the work has not reported any for some time, the
    /// progress is an estimate.
    pub(super) fn take(&self) -> Update {
        let mut latest = self.0.lock();
        let progress = if std::mem::take(&mut latest.is_new) { latest.progress } else { latest.estimate() };
        if let Some(progress) = progress {
            latest.fetched = Some(Stopwatch::start());
            // What was shown never falls.
            latest.floor = latest.floor.max(progress.fraction());
        }
        Update { progress, section: latest.section.take() }
    }

    /// Returns an update that could not be sent, unless a newer one has arrived.
    pub(super) fn put_back(&self, update: Update) {
        let mut latest = self.0.lock();
        latest.is_new |= update.progress.is_some();
        if latest.section.is_none() {
            latest.section = update.section;
        }
    }

    fn record(&self, progress: JobProgress) {
        let mut latest = self.0.lock();
        latest.progress = Some(progress.at_least(latest.floor));
        latest.reported = Some(Stopwatch::start());
        latest.is_new = true;
    }

    fn record_section(&self, section: &Section) {
        let mut latest = self.0.lock();
        let index = latest.sections;
        latest.sections += 1;
        latest.section = Some(LiveSection {
            index,
            step: section.step as u32,
            z_um: section.z_um,
            inner: thin(&section.inner),
            outer: thin(&section.outer),
        });
    }

    /// Records that a model is complete except for its files. A fit has no such stage.
    fn record_storing(&self) {
        let mut latest = self.0.lock();
        if let Some(JobProgress::Model(progress)) = &mut latest.progress {
            progress.stage = Stage::Store;
            progress.fraction = progress.fraction.max(0.99);
            progress.eta_seconds = None;
            latest.is_new = true;
        }
    }

    /// Counts sections from 0 again. The reported fraction stays until the new one exceeds it, so
    /// that it never falls.
    fn restart(&self) {
        let mut latest = self.0.lock();
        latest.sections = 0;
        latest.section = None;
        latest.floor = latest.progress.map_or(0.0, JobProgress::fraction);
    }
}

/// Sink of the generations of one attempt.
#[derive(Debug)]
pub(super) struct AttemptSink {
    pub(super) progress: LiveProgress,
    pub(super) checkpoints: Mailbox,
    /// Span of the attempt, for logs and traces.
    pub(super) span: Span,
    faults: Faults,
    run: Mutex<Run>,
}

#[derive(Debug)]
struct Run {
    /// Name and span of the current stage.
    stage: Option<(&'static str, Span)>,
    /// Stops the current generation.
    cancel: CancelToken,
    injected: Option<Injected>,
    /// Is set when the generation nearly ends: its threads will be free soon.
    nearly_free: Option<watch::Sender<bool>>,
}

impl AttemptSink {
    /// The sink of an attempt with this `span`. An injected fault stops the generation through
    /// `cancel`.
    pub(super) fn new(checkpoints: Mailbox, span: Span, faults: Faults, cancel: CancelToken) -> Self {
        let run = Mutex::new(Run { stage: None, cancel, injected: None, nearly_free: None });
        Self { progress: LiveProgress::default(), checkpoints, span, faults, run }
    }

    /// Reports that the upload of the files begins.
    pub(super) fn storing(&self) {
        self.enter(name(Stage::Store));
        self.progress.record_storing();
    }

    /// Reports that another generation of the attempt starts from the beginning. An injected fault
    /// stops it through `cancel`.
    pub(super) fn restart(&self, cancel: CancelToken) {
        self.run.lock().cancel = cancel;
        self.progress.restart();
        self.checkpoints.restart();
    }

    /// Sets `nearly_free` when the next generation nearly ends.
    pub(super) fn announce_end(&self, nearly_free: watch::Sender<bool>) {
        self.run.lock().nearly_free = Some(nearly_free);
    }

    /// True if the next attempt of a fit would resume with all that was computed, except for a few
    /// candidates.
    pub(super) fn may_release(&self) -> bool {
        let is_searching = self.run.lock().stage.as_ref().is_some_and(|(stage, _)| *stage == SEARCH);
        is_searching && self.checkpoints.has_taken()
    }

    /// The fault that was injected into the generation.
    pub(super) fn injected(&self) -> Option<Injected> {
        self.run.lock().injected
    }

    /// Ends the span of the previous stage and starts the span of `stage`.
    fn enter(&self, stage: &'static str) {
        let mut run = self.run.lock();
        if run.stage.as_ref().is_none_or(|(before, _)| *before != stage) {
            run.stage = None;
            run.stage = Some((stage, span(stage, &self.span)));
        }
    }

    /// Records progress and passes the fault point of the stage.
    fn advance(&self, stage: &'static str, progress: JobProgress) {
        self.enter(stage);
        self.progress.record(progress);
        if let Err(injected) = self.faults.point_blocking(stage) {
            let mut run = self.run.lock();
            run.injected = Some(injected);
            run.cancel.cancel();
        }
    }
}

impl Sink for AttemptSink {
    fn progress(&self, progress: &Progress) {
        let is_late = matches!(progress.stage, Stage::Certify | Stage::Measure | Stage::Export);
        // Without an estimate, the generation is short.
        if is_late
            && progress.eta_seconds.is_none_or(|eta| eta < NEARLY_FREE)
            && let Some(nearly_free) = self.run.lock().nearly_free.take()
        {
            nearly_free.send_replace(true);
        }
        self.advance(name(progress.stage), JobProgress::Model(*progress));
    }

    fn section(&self, section: &Section) {
        if !section.added {
            self.progress.record_section(section);
        }
    }

    fn wants_checkpoint(&self) -> bool {
        self.checkpoints.wants()
    }

    fn checkpoint(&self, file: TempPath) {
        self.checkpoints.put(Saved::File(file));
    }
}

impl FitSink for AttemptSink {
    fn progress(&self, progress: &FitProgress) {
        let stage = match progress.stage {
            FitStage::Search => SEARCH,
            FitStage::Verify => "verify",
        };
        self.advance(stage, JobProgress::Fit(*progress));
    }

    fn wants_checkpoint(&self) -> bool {
        self.checkpoints.wants()
    }

    fn checkpoint(&self, bytes: Vec<u8>) {
        self.checkpoints.put(Saved::Bytes(bytes));
    }
}

fn name(stage: Stage) -> &'static str {
    match stage {
        Stage::Simulate => "simulate",
        Stage::Mesh => "mesh",
        Stage::Certify => "certify",
        Stage::Measure => "measure",
        Stage::Export => "export",
        Stage::Store => "store",
    }
}

/// The span of a stage. The names of spans are constants.
fn span(stage: &'static str, attempt: &Span) -> Span {
    macro_rules! span_of {
        ($($name:literal),+) => {
            match stage {
                $($name => tracing::info_span!(parent: attempt, $name),)+
                _ => Span::none(),
            }
        };
    }
    span_of!("simulate", "mesh", "certify", "measure", "export", "store", "search", "verify")
}

/// At most [`MAX_POINTS`] points of a contour, evenly by index.
fn thin(ring: &Ring) -> Vec<[f32; 2]> {
    let n = ring.len();
    let kept = n.min(MAX_POINTS);
    (0..kept).map(|i| ring.points[i * n / kept]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ring(n: u32) -> Ring {
        Ring { ids: (0..n).collect(), points: (0..n).map(|i| [i as f32, 0.0]).collect() }
    }

    fn sink(faults: Faults, cancel: CancelToken) -> AttemptSink {
        AttemptSink::new(Mailbox::new(None), Span::none(), faults, cancel)
    }

    fn model(update: &Update) -> Progress {
        update.progress.and_then(JobProgress::model).expect("it is a model's")
    }

    fn at(stage: Stage, step: u32, fraction: f64) -> Progress {
        Progress { stage, fraction, step, steps: 10, particles: 3, sections: 1, eta_seconds: None }
    }

    #[test]
    fn rings_are_thinned_evenly_and_in_order() {
        for n in [0, 1, 511, 512, 513, 8300] {
            let thinned = thin(&ring(n));
            assert_eq!(thinned.len(), (n as usize).min(MAX_POINTS));
            let gaps: Vec<f32> = thinned.windows(2).map(|w| w[1][0] - w[0][0]).collect();
            let fair = n as f32 / thinned.len().max(1) as f32;
            assert!(gaps.iter().all(|gap| *gap >= 1.0 && (gap - fair).abs() <= 1.0), "{n}");
        }
    }

    #[test]
    fn an_update_holds_what_is_newest_and_is_given_once() {
        let sink = sink(Faults::default(), CancelToken::default());
        let section = |step, added| Section { step, added, inner: ring(3), outer: ring(4), ..Section::default() };
        Sink::progress(&sink, &at(Stage::Simulate, 1, 0.1));
        Sink::progress(&sink, &at(Stage::Simulate, 2, 0.1));
        sink.section(&section(0.0, false));
        sink.section(&section(0.5, true));
        sink.section(&section(1.0, false));
        let update = sink.progress.take();
        assert_eq!(model(&update).step, 2);
        assert_eq!(update.section.as_ref().unwrap().index, 1);
        assert!(sink.progress.take().is_empty());
        sink.progress.put_back(update);
        assert_eq!(sink.progress.take().section.unwrap().index, 1);
        sink.storing();
        assert_eq!(model(&sink.progress.take()).stage, Stage::Store);
    }

    #[test]
    fn a_restart_counts_sections_from_0_and_the_fraction_never_falls() {
        let sink = sink(Faults::default(), CancelToken::default());
        let section = Section { inner: ring(3), outer: ring(4), ..Section::default() };
        Sink::progress(&sink, &at(Stage::Simulate, 1, 0.4));
        sink.section(&section);
        sink.section(&section);
        sink.restart(CancelToken::default());
        assert!(sink.progress.take().section.is_none());
        Sink::progress(&sink, &at(Stage::Simulate, 1, 0.1));
        sink.section(&section);
        let update = sink.progress.take();
        assert_eq!((model(&update).fraction, update.section.unwrap().index), (0.4, 0));
        Sink::progress(&sink, &at(Stage::Simulate, 1, 0.5));
        assert_eq!(model(&sink.progress.take()).fraction, 0.5);
    }

    #[test]
    fn progress_goes_on_while_a_stage_reports_none() {
        let sink = sink(Faults::default(), CancelToken::default());
        let slow = Progress { eta_seconds: Some(2.0), ..at(Stage::Export, 10, 0.6) };
        Sink::progress(&sink, &slow);
        assert_eq!(model(&sink.progress.take()), slow);
        assert!(sink.progress.take().is_empty(), "too early for an estimate");
        std::thread::sleep(std::time::Duration::from_secs_f64(ESTIMATED_AFTER));
        let estimate = model(&sink.progress.take());
        assert!(estimate.fraction > 0.7 && estimate.fraction < 1.0, "{estimate:?}");
        assert!(estimate.eta_seconds.unwrap() < 1.5, "{estimate:?}");
        // A report never takes back what was shown.
        Sink::progress(&sink, &at(Stage::Export, 10, 0.65));
        assert_eq!(model(&sink.progress.take()).fraction, estimate.fraction);
    }

    #[test]
    fn a_long_generation_announces_its_end_late() {
        let sink = sink(Faults::default(), CancelToken::default());
        let announced = watch::Sender::new(false);
        sink.announce_end(announced.clone());
        let with_eta = |stage, eta_seconds| Progress { eta_seconds, ..at(stage, 10, 0.9) };
        for early in
            [with_eta(Stage::Simulate, None), with_eta(Stage::Certify, Some(5.0)), with_eta(Stage::Export, Some(2.0))]
        {
            Sink::progress(&sink, &early);
            assert!(!*announced.borrow(), "{early:?}");
        }
        Sink::progress(&sink, &with_eta(Stage::Export, Some(0.1)));
        assert!(*announced.borrow());
    }

    #[test]
    fn an_injected_fault_stops_the_generation() {
        let cancel = CancelToken::default();
        let sink = sink(Faults::parse("mesh:error").unwrap(), cancel.clone());
        Sink::progress(&sink, &at(Stage::Simulate, 10, 0.5));
        assert!(sink.injected().is_none() && !cancel.is_cancelled());
        Sink::progress(&sink, &at(Stage::Mesh, 10, 0.5));
        assert!(sink.injected() == Some(Injected("mesh")) && cancel.is_cancelled());
    }
}
