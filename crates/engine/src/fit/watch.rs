//! Progress of a fit, and checkpoints on request.

use super::request::Physics;
use crate::clock::Stopwatch;
use crate::generate::CancelToken;
use crate::lock::Mutex;
use serde::{Deserialize, Serialize};

/// Fraction of the whole fit that the search counts as.
const SEARCH: f64 = 0.85;

/// Stage of a fit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
#[serde(rename_all = "lowercase")]
pub enum FitStage {
    /// Searching for parameters.
    Search,
    /// Growing models of the result.
    Verify,
}

/// Progress of a fit: always the complete current state.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct FitProgress {
    /// Stage.
    pub stage: FitStage,
    /// Fraction of the whole, 0 to 1, never decreasing. A search may end before it has used all
    /// evaluations.
    pub fraction: f64,
    /// Number of candidates measured so far.
    #[cfg_attr(feature = "schema", schema(minimum = 0))]
    pub evaluations: u32,
    /// Maximum number of candidates.
    #[cfg_attr(feature = "schema", schema(minimum = 0))]
    pub evaluations_most: u32,
    /// Number of models grown in full so far.
    #[cfg_attr(feature = "schema", schema(minimum = 0))]
    pub models: u32,
    /// Minimum misfit so far: on reduced models or, once such candidates exist, with the physics of
    /// the spec. See `misfit` of the result.
    pub misfit: Option<f64>,
    /// Estimated seconds until all evaluations are used, at the current pace.
    pub eta_seconds: Option<f64>,
}

/// Receiver of progress and checkpoints. Called on the threads of the fit, so only
/// [`FitSink::pause`] may block.
pub trait FitSink: Sync {
    /// Receives the progress after each candidate and each model.
    fn progress(&self, progress: &FitProgress);
    /// Returns true to request a checkpoint, from which the search can continue elsewhere. Called
    /// after each candidate.
    fn wants_checkpoint(&self) -> bool {
        false
    }
    /// Receives the requested checkpoint.
    fn checkpoint(&self, _: Vec<u8>) {}
    /// Called before each step of a candidate and before each model. May block while others need
    /// the cores; must return soon after `cancel`.
    fn pause(&self, _cancel: &CancelToken) {}
}

impl FitSink for () {
    fn progress(&self, _: &FitProgress) {}
}

/// Reports the progress of a fit to a sink.
pub(super) struct Watch<'a> {
    sink: &'a dyn FitSink,
    cancel: &'a CancelToken,
    since: Stopwatch,
    now: Mutex<WatchState>,
}

struct WatchState {
    progress: FitProgress,
    /// Number of models that are grown after the search.
    models: u32,
    /// Number of candidates that this attempt measured itself.
    own: u32,
    /// Physics of the candidates over which `misfit` is the minimum.
    physics: Physics,
}

impl<'a> Watch<'a> {
    pub(super) fn new(sink: &'a dyn FitSink, cancel: &'a CancelToken, evaluations: u32, models: u32) -> Self {
        let progress = FitProgress {
            stage: FitStage::Search,
            fraction: 0.0,
            evaluations: 0,
            evaluations_most: evaluations,
            models: 0,
            misfit: None,
            eta_seconds: None,
        };
        sink.progress(&progress);
        Self {
            sink,
            cancel,
            since: Stopwatch::start(),
            now: Mutex::new(WatchState { progress, models, own: 0, physics: Physics::Reduced }),
        }
    }

    pub(super) fn cancel(&self) -> &'a CancelToken {
        self.cancel
    }

    pub(super) fn sink(&self) -> &'a dyn FitSink {
        self.sink
    }

    /// Reports a measured candidate, and takes a checkpoint if the sink requests one.
    pub(super) fn measured(&self, physics: Physics, misfit: Option<f64>, checkpoint: impl FnOnce() -> Vec<u8>) {
        self.report(|now| {
            now.own += 1;
            now.count(physics, misfit);
        });
        // The lock admits one thread at a time, so that several threads do not take checkpoints for
        // the same request.
        let _now = self.now.lock();
        if self.sink.wants_checkpoint() {
            self.sink.checkpoint(checkpoint());
        }
    }

    /// Reports a candidate that the checkpoint contained.
    pub(super) fn remembered(&self, physics: Physics, misfit: Option<f64>) {
        self.report(|now| now.count(physics, misfit));
    }

    /// Reports the end of the search.
    pub(super) fn verify(&self) {
        self.report(|now| now.progress.stage = FitStage::Verify);
    }

    /// Reports the end of a model of the result.
    pub(super) fn grown(&self) {
        self.report(|now| now.progress.models += 1);
    }

    fn report(&self, change: impl FnOnce(&mut WatchState)) {
        let mut now = self.now.lock();
        change(&mut now);
        let WatchState { progress, models, own, .. } = &mut *now;
        let part = |done: u32, all: u32| (f64::from(done) / f64::from(all.max(1))).min(1.0);
        progress.fraction = match progress.stage {
            FitStage::Verify => SEARCH + (0.98 - SEARCH) * part(progress.models, *models),
            FitStage::Search => SEARCH * part(progress.evaluations, progress.evaluations_most),
        };
        // Estimates only the time of the candidates, because the time of the models is not known in
        // advance.
        let left = progress.evaluations_most.saturating_sub(progress.evaluations);
        let searching = progress.stage == FitStage::Search && *own > 1;
        progress.eta_seconds = searching.then(|| self.since.seconds() / f64::from(*own) * f64::from(left));
        self.sink.progress(progress);
    }
}

impl WatchState {
    fn count(&mut self, physics: Physics, misfit: Option<f64>) {
        let progress = &mut self.progress;
        progress.evaluations = (progress.evaluations + 1).min(progress.evaluations_most);
        let before = progress.misfit.filter(|_| physics == self.physics);
        self.physics = physics;
        progress.misfit = match (before, misfit) {
            (Some(best), Some(misfit)) => Some(best.min(misfit)),
            (best, misfit) => best.or(misfit),
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Default)]
    struct Told(Mutex<Vec<FitProgress>>, Mutex<Vec<Vec<u8>>>);

    impl FitSink for Told {
        fn progress(&self, progress: &FitProgress) {
            self.0.lock().push(*progress);
        }
        fn wants_checkpoint(&self) -> bool {
            self.1.lock().is_empty()
        }
        fn checkpoint(&self, bytes: Vec<u8>) {
            self.1.lock().push(bytes);
        }
    }

    #[test]
    fn progress_grows_and_keeps_the_least_misfit() {
        let (told, cancel) = (Told::default(), CancelToken::default());
        let watch = Watch::new(&told, &cancel, 4, 2);
        watch.remembered(Physics::Reduced, Some(3.0));
        watch.measured(Physics::Reduced, None, || vec![1]);
        watch.measured(Physics::Reduced, Some(5.0), || vec![2]);
        watch.verify();
        watch.grown();
        watch.grown();
        // The misfits of reduced models do not count once there are whole ones.
        assert_eq!(told.0.lock().last().and_then(|p| p.misfit), Some(3.0));
        watch.measured(Physics::Whole, Some(4.0), Vec::new);
        let all = told.0.lock();
        let fractions: Vec<f64> = all.iter().map(|p| p.fraction).collect();
        assert!(fractions.is_sorted() && fractions.last() < Some(&1.0), "{fractions:?}");
        assert_eq!(
            all.last().map(|p| (p.stage, p.evaluations, p.models, p.misfit)),
            Some((FitStage::Verify, 4, 2, Some(4.0)))
        );
        assert_eq!(*told.1.lock(), [vec![1]]);
    }
}
