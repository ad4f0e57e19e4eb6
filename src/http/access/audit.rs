//! Audit lines: who changed what. Their target is `oviduct::audit`, so a log filter can separate
//! them.

use super::Caller;
use crate::jobs::StoreError;
use std::fmt::Display;
use std::future::Future;
use tracing::Instrument;

/// Logs that `caller` did `action` to `subject`: a model, a batch or a filter. The span of the
/// request contributes the request id.
pub(in crate::http) fn audit(caller: &Caller, action: &'static str, subject: impl Display) {
    let (owner, key) = match caller {
        Caller::Anyone => ("", ""),
        Caller::Key(key) => (key.owner.name(), key.prefix.as_str()),
    };
    tracing::info!(target: "oviduct::audit", action, %subject, owner, key);
}

/// Runs a change to completion and logs it, unless the change is `None`: there was nothing to
/// change.
pub(in crate::http) async fn audited<T: Send + 'static>(
    caller: &Caller,
    action: &'static str,
    subject: impl Display + Send + 'static,
    change: impl Future<Output = Result<Option<T>, StoreError>> + Send + 'static,
) -> Result<Option<T>, StoreError> {
    let caller = caller.clone();
    run_to_completion(async move {
        let changed = change.await?;
        if changed.is_some() {
            audit(&caller, action, subject);
        }
        Ok(changed)
    })
    .await
}

/// Runs work to completion even if the client closes the connection, so every change gets its audit
/// line.
pub(in crate::http) async fn run_to_completion<T: Send + 'static>(work: impl Future<Output = T> + Send + 'static) -> T {
    match tokio::spawn(work.in_current_span()).await {
        Ok(output) => output,
        Err(error) => match error.try_into_panic() {
            Ok(panic) => std::panic::resume_unwind(panic),
            // The runtime is shutting down.
            Err(_) => std::future::pending().await,
        },
    }
}
