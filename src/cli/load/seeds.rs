//! Seeds of the models of a load test.

use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

/// Consecutive seeds, each taken once. Clones share them.
#[derive(Clone, Debug)]
pub struct Seeds {
    next: Arc<AtomicU64>,
    end: u64,
}

impl Seeds {
    /// Creates the `count` seeds that start with `first`.
    pub fn new(first: u64, count: u64) -> Self {
        Self { next: Arc::new(AtomicU64::new(first)), end: first.saturating_add(count) }
    }

    /// Returns the number of seeds that are left.
    #[must_use]
    pub fn left(&self) -> u64 {
        self.end.saturating_sub(self.next.load(Ordering::Relaxed))
    }

    /// Takes the next seed; `None` if all are taken.
    #[must_use]
    pub fn take(&self) -> Option<u64> {
        Some(self.next.fetch_add(1, Ordering::Relaxed)).filter(|seed| *seed < self.end)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_seed_is_taken_once() {
        let seeds = Seeds::new(5, 3);
        let other = seeds.clone();
        assert_eq!(seeds.left(), 3);
        assert_eq!([seeds.take(), other.take(), seeds.take(), other.take()], [Some(5), Some(6), Some(7), None]);
        assert_eq!(seeds.left(), 0);
    }
}
