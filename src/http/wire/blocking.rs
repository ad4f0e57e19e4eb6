//! Work of the processor, on threads for it.

use super::problem::{Kind, Problem};

/// Does work that may take seconds. If it panics, the client is told that `what` failed, such as "Making the cut".
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
