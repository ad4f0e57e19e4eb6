//! Division of an evaluation among the threads of the rayon pool.
//!
//! An evaluation takes a few hundred microseconds, so little of it may be lost at its two ends. To
//! wake a sleeping thread takes tens of microseconds; therefore the threads stay awake for a whole
//! step. Each thread first processes the same items in every evaluation, because these are in its
//! cache, and then takes the last items of other threads.

use crate::lock::Mutex;
use rayon::Yield;
use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// Runs `work` while up to `threads` threads of the pool stay awake for its calls of [`each`].
pub(super) fn awake<R>(threads: usize, work: impl FnOnce() -> R) -> R {
    let helpers = threads.min(rayon::current_num_threads()).saturating_sub(1);
    if helpers == 0 {
        return work();
    }
    let done = AtomicBool::new(false);
    rayon::in_place_scope(|scope| {
        let _end = AtEnd(|| done.store(true, Ordering::Release));
        for _ in 0..helpers {
            scope.spawn(|_| {
                while !done.load(Ordering::Acquire) {
                    if rayon::yield_now() != Some(Yield::Executed) {
                        std::thread::yield_now();
                    }
                }
            });
        }
        work()
    })
}

/// Runs `work` on every item, on all threads of the pool.
pub(super) fn each<T: Send>(items: impl Iterator<Item = T>, work: impl Fn(T) + Sync + Send) {
    let items: Vec<T> = items.collect();
    let all = items.len();
    let threads = rayon::current_num_threads().min(all);
    if threads <= 1 {
        items.into_iter().for_each(work);
        return;
    }
    let mut items = items.into_iter();
    let share = |k: usize| (k + 1) * all / threads - k * all / threads;
    let shares: Vec<Mutex<VecDeque<T>>> =
        (0..threads).map(|k| Mutex::new(items.by_ref().take(share(k)).collect())).collect();
    let finished = AtomicUsize::new(0);
    let process = |item: T| {
        let _end = AtEnd(|| _ = finished.fetch_add(1, Ordering::Release));
        work(item);
    };
    let process_all = || {
        let own = rayon::current_thread_index().unwrap_or(0) % threads;
        while let Some(item) = next(&shares[own], VecDeque::pop_front) {
            process(item);
        }
        for other in (1..threads).map(|k| &shares[(own + k) % threads]) {
            while let Some(item) = next(other, VecDeque::pop_back) {
                process(item);
            }
        }
    };
    rayon::in_place_scope(|scope| {
        for _ in 1..threads {
            scope.spawn(|_| process_all());
        }
        process_all();
        // The end of the scope would put this thread to sleep.
        while finished.load(Ordering::Acquire) < all {
            std::thread::yield_now();
        }
    });
}

/// Takes an item; the lock is released before the item is processed.
fn next<T>(share: &Mutex<VecDeque<T>>, take: impl Fn(&mut VecDeque<T>) -> Option<T>) -> Option<T> {
    take(&mut share.lock())
}

/// Calls a function when dropped, so that no thread waits forever for one that panicked.
struct AtEnd<F: Fn()>(F);

impl<F: Fn()> Drop for AtEnd<F> {
    fn drop(&mut self) {
        (self.0)();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::panic::{AssertUnwindSafe, catch_unwind};

    #[test]
    fn every_item_is_processed_once_on_any_number_of_threads() {
        for threads in [1, 2, 3, 7] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                awake(threads, || {
                    for count in [0, 1, 2, 5, 100] {
                        let mut items = vec![0; count];
                        each(items.iter_mut(), |item| *item += 1);
                        assert!(items.iter().all(|&item| item == 1), "{threads} threads, {count} items");
                    }
                });
            });
        }
    }

    #[test]
    fn a_panic_ends_the_work_instead_of_a_wait() {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(3).build().unwrap();
        for bad in [0, 20, 39] {
            let work = || pool.install(|| awake(3, || each(0..40, |item| assert_ne!(item, bad))));
            assert!(catch_unwind(AssertUnwindSafe(work)).is_err());
        }
        let outside = || pool.install(|| awake(3, || panic!("on purpose")));
        assert!(catch_unwind(AssertUnwindSafe(outside)).is_err());
    }
}
