//! Computations on threads outside the async runtime.

use super::problem::{Kind, Problem};

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
    tokio::task::spawn_blocking(task).await.map_err(|error| {
        tracing::error!(%error, what, "work for a request panicked");
        Problem::new(Kind::Internal, format!("{what} failed."))
    })
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
