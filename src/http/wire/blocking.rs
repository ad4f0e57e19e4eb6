//! Computations on threads outside the async runtime.

use super::problem::{Kind, Problem};

/// Runs work that may take seconds. If the work panics, the problem says that `what` failed, for
/// example "Making the cut".
pub(in crate::http) async fn blocking<T: Send + 'static>(
    what: &str,
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<T, Problem> {
    let span = tracing::Span::current();
    tokio::task::spawn_blocking(move || span.in_scope(work)).await.map_err(|error| {
        tracing::error!(%error, what, "work for a request panicked");
        Problem::new(Kind::Internal, format!("{what} failed."))
    })
}
