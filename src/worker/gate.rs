//! Divides the time of a worker between models and a fit.
//!
//! A fit runs beside the models of its worker, on threads of its own, and stops between steps while
//! a model computes. Models that follow each other without a pause leave it a quarter of the time:
//! the worker then claims the next model only after the fit has had its turn.

use crate::clock::Stopwatch;
use crate::generate::CancelToken;
use crate::lock::Mutex;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::thread::sleep;
use std::time::Duration;
use tokio::sync::watch;
use tokio::time::timeout;

/// Computing time of models after which a fit has a turn.
const MODEL_TIME: Duration = Duration::from_secs(3);
/// The turn of a fit as a fraction of the time of the models before it.
const TURN: u32 = 3;
/// Maximum duration of a turn, which delays a model.
const MAX_TURN: Duration = Duration::from_secs(2);
/// Time between two looks of a stopped fit.
const LOOK: Duration = Duration::from_millis(5);

/// Counts what computes on one worker.
#[derive(Debug)]
pub(super) struct Gate {
    /// Number of models that compute.
    models: AtomicU32,
    /// True while a fit runs or is stopped.
    fit: watch::Sender<bool>,
    /// Computing time of models since the last turn of a fit.
    model_time: Mutex<Duration>,
}

impl Gate {
    pub(super) fn new() -> Arc<Self> {
        Arc::new(Self { models: AtomicU32::new(0), fit: watch::Sender::new(false), model_time: Mutex::default() })
    }

    /// Stops the fit until the returned value is dropped.
    pub(super) fn model(self: &Arc<Self>) -> ComputingModel {
        self.models.fetch_add(1, Ordering::AcqRel);
        ComputingModel { gate: Arc::clone(self), since: Stopwatch::start() }
    }

    /// Announces a fit until the returned value is dropped.
    pub(super) fn fit(self: &Arc<Self>) -> PresentFit {
        *self.model_time.lock() = Duration::ZERO;
        self.fit.send_replace(true);
        PresentFit(Arc::clone(self))
    }

    /// Blocks the thread of a fit while models compute, unless it is cancelled.
    pub(super) fn wait(&self, cancel: &CancelToken) {
        while self.models.load(Ordering::Acquire) > 0 && !cancel.is_cancelled() {
            sleep(LOOK);
        }
    }

    /// Waits for the turn of the fit if it is due. To be called before a model is claimed.
    pub(super) async fn give_turn(&self) {
        let Some(turn) = self.due() else { return };
        // Ends early with the fit.
        let _ = timeout(turn, self.fit.subscribe().wait_for(|present| !present)).await;
    }

    fn due(&self) -> Option<Duration> {
        let mut model_time = self.model_time.lock();
        let is_due = *self.fit.borrow() && *model_time >= MODEL_TIME;
        is_due.then(|| std::mem::take(&mut *model_time) / TURN).map(|turn| turn.min(MAX_TURN))
    }
}

/// A model that computes.
pub(super) struct ComputingModel {
    gate: Arc<Gate>,
    since: Stopwatch,
}

impl Drop for ComputingModel {
    fn drop(&mut self) {
        *self.gate.model_time.lock() += self.since.elapsed();
        self.gate.models.fetch_sub(1, Ordering::AcqRel);
    }
}

/// A fit that runs or is stopped.
pub(super) struct PresentFit(Arc<Gate>);

impl Drop for PresentFit {
    fn drop(&mut self) {
        self.0.fit.send_replace(false);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fit_waits_for_all_models_unless_it_is_cancelled() {
        let (gate, cancel) = (Gate::new(), CancelToken::default());
        gate.wait(&cancel);
        let (first, second) = (gate.model(), gate.model());
        let waiting = std::thread::spawn({
            let (gate, cancel) = (Arc::clone(&gate), cancel.clone());
            move || gate.wait(&cancel)
        });
        drop(first);
        sleep(10 * LOOK);
        assert!(!waiting.is_finished(), "the second model computes");
        drop(second);
        waiting.join().expect("the fit goes on");
        let _model = gate.model();
        cancel.cancel();
        gate.wait(&cancel);
    }

    #[test]
    fn a_fit_has_a_quarter_of_the_time_in_turns_of_at_most_two_seconds() {
        let gate = Gate::new();
        let computed = |seconds: u64| *gate.model_time.lock() += Duration::from_secs(seconds);
        computed(9);
        assert_eq!(gate.due(), None, "there is no fit");
        let fit = gate.fit();
        assert_eq!(gate.due(), None, "models before the fit do not count");
        computed(2);
        assert_eq!(gate.due(), None);
        computed(4);
        assert_eq!((gate.due(), gate.due()), (Some(Duration::from_secs(2)), None));
        computed(60);
        assert_eq!(gate.due(), Some(MAX_TURN));
        drop(fit);
        computed(60);
        assert_eq!(gate.due(), None, "the fit has ended");
    }

    #[tokio::test]
    async fn the_turn_of_a_fit_ends_with_the_fit() {
        let gate = Gate::new();
        let fit = gate.fit();
        *gate.model_time.lock() += Duration::from_secs(12);
        let turn = gate.give_turn();
        tokio::pin!(turn);
        assert!(futures_util::poll!(&mut turn).is_pending());
        drop(fit);
        assert!(futures_util::poll!(&mut turn).is_ready());
    }
}
