//! Whose turn it is on the threads of a worker.
//!
//! A job is claimed a moment before the one before it is done, and waits for its turn. Where that does not come soon it
//! goes back to its place in the queue, for another worker may be free; after that the worker claims its next job only
//! once its threads are free, until they come free as quickly as they should again.

use crate::clock::Stopwatch;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{OwnedSemaphorePermit, Semaphore, watch};
use tokio::time::{sleep, timeout};

/// How long a job that was claimed early waits for its turn. A certificate with its files takes less, but of the largest
/// models.
const SOON: Duration = Duration::from_secs(3);

/// The turns on the threads of one worker.
#[derive(Debug)]
pub(super) struct Turns {
    free: Arc<Semaphore>,
    pace: watch::Sender<Pace>,
    /// [`SOON`], but in tests.
    soon: Duration,
}

/// How quickly turns come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Pace {
    /// What has the turn is soon done with it.
    Quick,
    /// It is to be seen whether it is again.
    Wary,
    /// One that waited went back to the queue.
    Slow,
    /// What has the turn was broken off, and has not stopped yet.
    Stuck,
}

/// How long to wait for a turn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Patience {
    /// Another worker could run the job.
    Short,
    /// As long as those before it work: the job has been worked on here.
    Long,
}

/// The right to use the threads of a worker.
#[derive(Debug)]
pub(super) struct Turn {
    turns: Arc<Turns>,
    _permit: OwnedSemaphorePermit,
}

impl Turn {
    /// What has it was broken off and has not stopped yet: nobody waits for it.
    pub(super) fn is_stuck(&self) {
        self.turns.pace.send_replace(Pace::Stuck);
    }
}

impl Drop for Turn {
    fn drop(&mut self) {
        self.turns.step(Pace::Stuck, Pace::Wary);
    }
}

impl Turns {
    pub(super) fn new() -> Self {
        Self { free: Arc::new(Semaphore::new(1)), pace: watch::Sender::new(Pace::Quick), soon: SOON }
    }

    /// A turn; `None` where it does not come soon enough.
    pub(super) async fn take(self: &Arc<Self>, patience: Patience) -> Option<Turn> {
        let turn = |permit| Turn { turns: Arc::clone(self), _permit: permit };
        if let Ok(permit) = Arc::clone(&self.free).try_acquire_owned() {
            return Some(turn(permit));
        }
        let mut pace = self.pace.subscribe();
        let hopeless =
            pace.wait_for(|pace| *pace == Pace::Stuck || (*pace == Pace::Slow && patience == Patience::Short));
        tokio::select! {
            biased;
            permit = Arc::clone(&self.free).acquire_owned() => permit.ok().map(turn),
            _ = hopeless => None,
            () = sleep(self.soon), if patience == Patience::Short => {
                self.pace.send_if_modified(|pace| {
                    *pace = if *pace == Pace::Stuck { Pace::Stuck } else { Pace::Slow };
                    true
                });
                None
            }
        }
    }

    /// Until the next job may be claimed: at once where its turn will come soon, else when the threads are free.
    pub(super) async fn near(&self) {
        let pace = *self.pace.borrow();
        if pace == Pace::Quick {
            return;
        }
        let since = Stopwatch::start();
        drop(self.free.acquire().await);
        match pace {
            Pace::Wary if since.elapsed() < self.soon => self.step(Pace::Wary, Pace::Quick),
            Pace::Wary | Pace::Quick => {}
            Pace::Slow | Pace::Stuck => self.step(pace, Pace::Wary),
        }
    }

    /// Until the threads are free, but no longer than this.
    pub(super) async fn free_within(&self, longest: Duration) {
        let _ = timeout(longest, self.free.acquire()).await;
    }

    fn step(&self, from: Pace, to: Pace) {
        self.pace.send_if_modified(|pace| {
            let steps = *pace == from;
            if steps {
                *pace = to;
            }
            steps
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MOMENT: Duration = Duration::from_millis(50);

    fn turns() -> Arc<Turns> {
        Arc::new(Turns { soon: MOMENT, ..Turns::new() })
    }

    #[tokio::test]
    async fn who_waits_too_long_goes_and_the_next_comes_when_the_threads_are_free() {
        let turns = turns();
        let first = turns.take(Patience::Short).await.unwrap();
        turns.near().await;
        assert!(turns.take(Patience::Short).await.is_none(), "it waits for ever");
        assert!(timeout(4 * MOMENT, turns.near()).await.is_err(), "the next would wait too");
        drop(first);
        turns.near().await;
        // It came free at once: so it may again.
        turns.near().await;
        let second = turns.take(Patience::Short).await.unwrap();
        turns.near().await;
        drop(second);
    }

    #[tokio::test]
    async fn nobody_waits_for_what_does_not_stop() {
        let turns = Arc::new(Turns { soon: Duration::from_secs(600), ..Turns::new() });
        let first = turns.take(Patience::Short).await.unwrap();
        for patience in [Patience::Short, Patience::Long] {
            let breaks = async {
                sleep(MOMENT).await;
                first.is_stuck();
            };
            let (turn, ()) = tokio::join!(turns.take(patience), breaks);
            assert!(turn.is_none());
            turns.step(Pace::Stuck, Pace::Quick);
        }
        first.is_stuck();
        drop(first);
        assert_eq!(*turns.pace.borrow(), Pace::Wary);
        assert!(turns.take(Patience::Long).await.is_some());
    }

    #[tokio::test]
    async fn what_was_worked_on_here_waits_for_its_turn() {
        let turns = turns();
        let first = turns.take(Patience::Short).await.unwrap();
        let works = async {
            sleep(4 * MOMENT).await;
            drop(first);
        };
        assert!(tokio::join!(turns.take(Patience::Long), works).0.is_some());
    }
}
