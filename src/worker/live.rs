//! Progress and sections on their way from the generating thread to the heartbeat.
//!
//! The sink only leaves the newest state here; the keeper fetches it at its own pace, so a generation never
//! waits for the store.

use crate::clock::Stopwatch;
use crate::generate::{CancelToken, Progress, Sink, Stage};
use crate::jobs::LiveSection;
use crate::jobs::fault::{Faults, Injected};
use crate::model::{Ring, Section};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::{Notify, OwnedSemaphorePermit};
use tracing::Span;

/// Most points of a thinned ring.
const POINTS: usize = 512;

#[derive(Debug, Default)]
struct State {
    progress: Option<Progress>,
    /// Whether `progress` was not fetched yet.
    new_progress: bool,
    /// A section not fetched yet.
    section: Option<LiveSection>,
    /// Sections recorded so far.
    sections: u32,
    /// Least fraction to tell.
    floor: f64,
    injected: Option<Injected>,
    /// The stage that goes on, for traces.
    stage: Option<(Stage, Span)>,
    /// The right to claim the next job, kept until this one is nearly done.
    next: Option<OwnedSemaphorePermit>,
    /// Stops the generation that is at work.
    cancel: CancelToken,
    /// Since the last checkpoint, or the start.
    unsaved: Option<Stopwatch>,
    /// A checkpoint not fetched yet.
    checkpoint: Option<Vec<u8>>,
    /// Whether a checkpoint is wanted out of turn.
    asked: bool,
}

impl State {
    /// Ends the span of the stage before, where this is another. From the certificate on the next job may be claimed.
    fn enter(&mut self, stage: Stage, attempt: &Span) {
        if self.stage.as_ref().is_none_or(|(before, _)| *before != stage) {
            self.stage = None;
            self.stage = Some((stage, span(stage, attempt)));
            if matches!(stage, Stage::Certify | Stage::Export | Stage::Store) {
                self.next = None;
            }
        }
    }
}

/// The newest state of a generation.
#[derive(Debug)]
pub(super) struct Live {
    state: Mutex<State>,
    /// The attempt, for logs and traces.
    span: Span,
    faults: Faults,
    /// Time between checkpoints.
    every: Option<Duration>,
    /// Tells that a checkpoint is there.
    saved: Notify,
}

/// What is new since the last time.
#[derive(Debug, Default)]
pub(super) struct News {
    pub(super) progress: Option<Progress>,
    pub(super) section: Option<LiveSection>,
}

impl News {
    pub(super) fn is_empty(&self) -> bool {
        self.progress.is_none() && self.section.is_none()
    }
}

impl Live {
    /// An injected fault stops the generation by `cancel`. A checkpoint is taken `every` so often, where it is given.
    pub(super) fn new(faults: Faults, cancel: CancelToken, every: Option<Duration>) -> Self {
        let state = State { cancel, unsaved: Some(Stopwatch::start()), ..State::default() };
        Self { state: Mutex::new(state), span: Span::none(), faults, every, saved: Notify::new() }
    }

    /// The same within the span of an attempt.
    pub(super) fn within(self, span: Span) -> Self {
        Self { span, ..self }
    }

    /// Keeps the right to claim the `next` job until this one is nearly done.
    pub(super) fn keep(&self, next: OwnedSemaphorePermit) {
        self.state().next = Some(next);
    }

    /// The attempt, for logs and traces.
    pub(super) fn span(&self) -> &Span {
        &self.span
    }

    /// Asks for a checkpoint at the next step, where checkpoints are taken at all.
    pub(super) fn ask_for_checkpoint(&self) {
        self.state().asked = self.every.is_some();
    }

    /// Whether checkpoints are taken at all.
    pub(super) fn takes_checkpoints(&self) -> bool {
        self.every.is_some()
    }

    /// The next checkpoint, once it is there.
    pub(super) async fn next_checkpoint(&self) -> Vec<u8> {
        loop {
            let told = self.saved.notified();
            if let Some(bytes) = self.state().checkpoint.take() {
                return bytes;
            }
            told.await;
        }
    }

    pub(super) fn news(&self) -> News {
        let mut state = self.state();
        let progress = if std::mem::take(&mut state.new_progress) { state.progress } else { None };
        News { progress, section: state.section.take() }
    }

    /// Puts back what could not be told, unless something newer came meanwhile.
    pub(super) fn put_back(&self, news: News) {
        let mut state = self.state();
        state.new_progress |= news.progress.is_some();
        if state.section.is_none() {
            state.section = news.section;
        }
    }

    /// The files are on their way to the artifact store.
    pub(super) fn storing(&self) {
        let mut state = self.state();
        state.enter(Stage::Store, &self.span);
        let mut progress = state.progress.unwrap_or(Progress {
            stage: Stage::Store,
            fraction: 0.99,
            step: 0,
            steps: 0,
            particles: 0,
            sections: 0,
            eta_seconds: None,
        });
        progress.stage = Stage::Store;
        progress.fraction = progress.fraction.max(0.99);
        progress.eta_seconds = None;
        state.progress = Some(progress);
        state.new_progress = true;
    }

    /// The generation begins again from the start: sections are counted anew. The fraction that was told stays until
    /// the new one has passed it, so that it never falls. An injected fault now stops it by `cancel`.
    pub(super) fn restart(&self, cancel: CancelToken) {
        let mut state = self.state();
        state.cancel = cancel;
        state.unsaved = Some(Stopwatch::start());
        state.sections = 0;
        state.section = None;
        state.floor = state.progress.map_or(0.0, |progress| progress.fraction);
    }

    /// The fault that was injected into the generation.
    pub(super) fn injected(&self) -> Option<Injected> {
        self.state().injected
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Sink for Live {
    fn progress(&self, progress: &Progress) {
        {
            let mut state = self.state();
            state.enter(progress.stage, &self.span);
            state.progress = Some(Progress { fraction: progress.fraction.max(state.floor), ..*progress });
            state.new_progress = true;
        }
        if let Err(injected) = self.faults.point_blocking(name(progress.stage)) {
            let mut state = self.state();
            state.injected = Some(injected);
            state.cancel.cancel();
        }
    }

    fn section(&self, section: &Section) {
        let mut state = self.state();
        if section.added {
            return;
        }
        let index = state.sections;
        state.sections += 1;
        state.section = Some(LiveSection {
            index,
            step: section.step as u32,
            z_um: section.z_um,
            inner: thin(&section.inner),
            outer: thin(&section.outer),
        });
    }

    fn wants_checkpoint(&self) -> bool {
        let Some(every) = self.every else { return false };
        let state = self.state();
        let due = state.unsaved.is_none_or(|since| since.elapsed() >= every);
        // One that is still on its way goes first.
        state.asked || (due && state.checkpoint.is_none())
    }

    fn checkpoint(&self, bytes: Vec<u8>) {
        let mut state = self.state();
        state.checkpoint = Some(bytes);
        state.unsaved = Some(Stopwatch::start());
        state.asked = false;
        drop(state);
        self.saved.notify_one();
    }
}

fn name(stage: Stage) -> &'static str {
    match stage {
        Stage::Simulate => "simulate",
        Stage::Mesh => "mesh",
        Stage::Certify => "certify",
        Stage::Export => "export",
        Stage::Store => "store",
    }
}

fn span(stage: Stage, attempt: &Span) -> Span {
    match stage {
        Stage::Simulate => tracing::info_span!(parent: attempt, "simulate"),
        Stage::Mesh => tracing::info_span!(parent: attempt, "mesh"),
        Stage::Certify => tracing::info_span!(parent: attempt, "certify"),
        Stage::Export => tracing::info_span!(parent: attempt, "export"),
        Stage::Store => tracing::info_span!(parent: attempt, "store"),
    }
}

/// At most [`POINTS`] points, evenly by count.
fn thin(ring: &Ring) -> Vec<[f32; 2]> {
    let n = ring.len();
    let kept = n.min(POINTS);
    (0..kept).map(|i| ring.points[i * n / kept]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ring(n: u32) -> Ring {
        Ring { ids: (0..n).collect(), points: (0..n).map(|i| [i as f32, 0.0]).collect() }
    }

    #[test]
    fn rings_are_thinned_evenly_and_in_order() {
        for n in [0, 1, 511, 512, 513, 8300] {
            let thinned = thin(&ring(n));
            assert_eq!(thinned.len(), (n as usize).min(POINTS));
            let gaps: Vec<f32> = thinned.windows(2).map(|w| w[1][0] - w[0][0]).collect();
            let fair = n as f32 / thinned.len().max(1) as f32;
            assert!(gaps.iter().all(|gap| *gap >= 1.0 && (gap - fair).abs() <= 1.0), "{n}");
        }
    }

    #[test]
    fn news_are_the_newest_and_told_once() {
        let live = Live::new(Faults::none(), CancelToken::default(), None);
        let at = |step| Progress {
            stage: Stage::Simulate,
            fraction: 0.1,
            step,
            steps: 10,
            particles: 3,
            sections: 1,
            eta_seconds: None,
        };
        let section = |step, added| Section { step, added, inner: ring(3), outer: ring(4), ..Section::default() };
        live.progress(&at(1));
        live.progress(&at(2));
        live.section(&section(0.0, false));
        live.section(&section(0.5, true));
        live.section(&section(1.0, false));
        let news = live.news();
        assert_eq!(news.progress.unwrap().step, 2);
        assert_eq!(news.section.as_ref().unwrap().index, 1);
        assert!(live.news().is_empty());
        live.put_back(news);
        assert_eq!(live.news().section.unwrap().index, 1);
        live.storing();
        assert_eq!(live.news().progress.unwrap().stage, Stage::Store);
    }

    #[test]
    fn a_second_start_counts_anew_but_never_falls_back() {
        let live = Live::new(Faults::none(), CancelToken::default(), None);
        let at = |fraction| Progress {
            stage: Stage::Simulate,
            fraction,
            step: 1,
            steps: 10,
            particles: 3,
            sections: 1,
            eta_seconds: None,
        };
        let section = Section { inner: ring(3), outer: ring(4), ..Section::default() };
        live.progress(&at(0.4));
        live.section(&section);
        live.section(&section);
        live.restart(CancelToken::default());
        assert!(live.news().section.is_none());
        live.progress(&at(0.1));
        live.section(&section);
        let news = live.news();
        assert_eq!((news.progress.unwrap().fraction, news.section.unwrap().index), (0.4, 0));
        live.progress(&at(0.5));
        assert_eq!(live.news().progress.unwrap().fraction, 0.5);
    }

    #[test]
    fn an_injected_error_stops_the_generation() {
        let cancel = CancelToken::default();
        let live = Live::new(Faults::parse("mesh:error").unwrap(), cancel.clone(), None);
        let mut progress = Progress {
            stage: Stage::Simulate,
            fraction: 0.5,
            step: 10,
            steps: 10,
            particles: 3,
            sections: 1,
            eta_seconds: None,
        };
        live.progress(&progress);
        assert!(live.injected().is_none() && !cancel.is_cancelled());
        progress.stage = Stage::Mesh;
        live.progress(&progress);
        assert!(live.injected() == Some(Injected("mesh")) && cancel.is_cancelled());
    }

    #[tokio::test]
    async fn checkpoints_are_taken_in_turn_or_when_asked_for() {
        let never = Live::new(Faults::none(), CancelToken::default(), None);
        never.ask_for_checkpoint();
        assert!(!never.wants_checkpoint());
        let live = Live::new(Faults::none(), CancelToken::default(), Some(Duration::from_secs(3600)));
        assert!(!live.wants_checkpoint());
        live.ask_for_checkpoint();
        assert!(live.wants_checkpoint());
        live.checkpoint(vec![1]);
        assert!(!live.wants_checkpoint());
        assert_eq!(live.next_checkpoint().await, [1]);
        let always = Live::new(Faults::none(), CancelToken::default(), Some(Duration::ZERO));
        assert!(always.wants_checkpoint());
        always.checkpoint(vec![2]);
        assert!(!always.wants_checkpoint(), "the last one is still on its way");
        let (bytes, ()) = tokio::join!(always.next_checkpoint(), async {});
        assert_eq!(bytes, [2]);
        assert!(always.wants_checkpoint());
    }
}
