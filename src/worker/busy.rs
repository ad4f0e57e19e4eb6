//! Busy workers, for the metrics. A worker that holds two claims counts as one busy slot.

use crate::jobs::WorkerKind;
use crate::metrics::Metrics;
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

/// Number of running claims of one worker.
#[derive(Debug)]
pub(super) struct Busy {
    running: AtomicU32,
    metrics: Metrics,
    backend: &'static str,
}

/// A running claim; dropping it ends the claim.
#[derive(Debug)]
pub(super) struct Running(Arc<Busy>);

impl Busy {
    /// Registers a new worker.
    pub(super) fn new(metrics: &Metrics, kind: WorkerKind) -> Arc<Self> {
        metrics.add_slot(kind.name());
        Arc::new(Self { running: AtomicU32::new(0), metrics: metrics.clone(), backend: kind.name() })
    }

    /// Begins a claim.
    pub(super) fn begin(self: &Arc<Self>) -> Running {
        if self.running.fetch_add(1, Ordering::AcqRel) == 0 {
            self.metrics.slot_busy(self.backend, true);
        }
        Running(Arc::clone(self))
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        if self.0.running.fetch_sub(1, Ordering::AcqRel) == 1 {
            self.0.metrics.slot_busy(self.0.backend, false);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_worker_with_two_claims_is_one_busy_slot() {
        let metrics = Metrics::default();
        let busy =
            |count: u32| metrics.text().contains(&format!("oviduct_worker_slots_busy{{backend=\"gpu\"}} {count}\n"));
        let worker = Busy::new(&metrics, WorkerKind::Gpu);
        assert!(busy(0));
        let (first, second) = (worker.begin(), worker.begin());
        assert!(busy(1));
        drop(first);
        assert!(busy(1));
        drop(second);
        assert!(busy(0));
    }
}
