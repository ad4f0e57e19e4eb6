//! The open loop: each call starts when it is due, whatever the state of earlier calls.

use super::calls;
use super::plan::{Plan, Planned};
use super::target::Target;
use crate::cli::exit::Failure;
use anyhow::Context;
use std::sync::Arc;
use std::time::Duration;
use tokio::runtime::Handle;
use tokio::sync::Semaphore;
use tokio_util::task::TaskTracker;

/// Maximum sleep between two checks for the end of the run.
const LOOK: Duration = Duration::from_millis(100);

/// Makes the calls of a plan, at most `most` at a time, and waits for the calls in flight.
///
/// # Errors
/// If the thread that starts calls panics.
pub(super) async fn run(target: &Arc<Target>, plan: Plan, most: u32) -> Result<(), Failure> {
    let calls = TaskTracker::new();
    let (started, tracker, runtime) = (Arc::clone(target), calls.clone(), Handle::current());
    // A separate thread, because timers of the runtime have a resolution of a millisecond.
    let paced = tokio::task::spawn_blocking(move || start(&started, plan, most as usize, &tracker, &runtime));
    paced.await.context("the thread that starts calls panicked")?;
    calls.close();
    tokio::select! {
        () = calls.wait() => {}
        () = target.stop.cancelled() => {}
    }
    Ok(())
}

/// Starts each call when it is due.
fn start(target: &Arc<Target>, plan: Plan, most: usize, calls: &TaskTracker, runtime: &Handle) {
    let places = Arc::new(Semaphore::new(most));
    for planned in plan.calls() {
        if !wait_until(target, planned.at) {
            return;
        }
        let Planned { call, at, .. } = planned;
        target.record.due(call, at);
        let Ok(place) = Arc::clone(&places).try_acquire_owned() else {
            target.record.dropped(call, at);
            continue;
        };
        let target = Arc::clone(target);
        let made = async move {
            calls::make(&target, planned).await;
            drop(place);
        };
        calls.spawn_on(made, runtime);
    }
}

/// Waits until this time of the run. Returns false if the run was stopped.
fn wait_until(target: &Target, due: Duration) -> bool {
    while !target.stop.is_cancelled() {
        let left = due.saturating_sub(target.watch.elapsed());
        if left.is_zero() {
            return true;
        }
        std::thread::sleep(left.min(LOOK));
    }
    false
}
