//! Computations on threads outside the async runtime: those of rayon's global pool. `serve` gives
//! them the niceness of the workers, so that requests for pictures do not starve models.

use super::problem::{Kind, Problem};
use crate::panics::panic_message;
use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind};
use tokio::sync::oneshot;

/// Runs work that may take seconds. If the work panics, the problem says that `what` failed, for
/// example "Making the cut".
///
/// `held` is dropped when the work has ended: the turn, permit or memory that bounds such work. A
/// client that disconnects ends the request, but not its work, so the request alone must not hold
/// them.
pub(in crate::http) async fn blocking<T: Send + 'static>(
    what: &str,
    held: impl Send + 'static,
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, Problem> {
    let span = tracing::Span::current();
    let task = move || {
        let _held = held;
        span.in_scope(work)
    };
    compute(task).await.map_err(|panic| {
        tracing::error!(panic = panic_message(&*panic), what, "work for a request panicked");
        Problem::new(Kind::Internal, format!("{what} failed."))
    })
}

/// Runs work to its end, even if the returned future is dropped.
///
/// # Errors
/// The panic of the work.
pub(in crate::http) async fn compute<T: Send + 'static>(
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, Box<dyn Any + Send>> {
    let (done, result) = oneshot::channel();
    rayon::spawn(move || drop(done.send(catch_unwind(AssertUnwindSafe(work)))));
    result.await.unwrap_or_else(|_| unreachable!("the work sends its result"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::{Arc, mpsc};
    use std::time::Duration;

    #[tokio::test]
    async fn an_aborted_request_holds_its_turn_until_its_work_has_ended() {
        let held = Arc::new(());
        let ((begun, begins), (end, ends)) = (mpsc::channel(), mpsc::channel::<()>());
        let turn = Arc::clone(&held);
        let request = tokio::spawn(blocking("Waiting", turn, move || {
            begun.send(()).unwrap();
            ends.recv().unwrap();
        }));
        while begins.try_recv().is_err() {
            tokio::task::yield_now().await;
        }
        request.abort();
        assert!(request.await.unwrap_err().is_cancelled());
        assert_eq!(Arc::strong_count(&held), 2, "the work goes on");
        end.send(()).unwrap();
        let released = async {
            while Arc::strong_count(&held) > 1 {
                tokio::time::sleep(Duration::from_millis(1)).await;
            }
        };
        tokio::time::timeout(Duration::from_secs(60), released).await.expect("the turn ends with the work");
    }
}
