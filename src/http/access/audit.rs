//! Audit lines: who changed what. They have the target `oviduct::audit`, so that a filter can send them elsewhere.

use super::Caller;
use crate::jobs::StoreError;
use std::fmt::Display;
use std::future::Future;
use tracing::Instrument;

/// Records that `caller` did something with the model, batch or filter `subject`. The request's span has its id.
pub(in crate::http) fn audit(caller: &Caller, action: &'static str, subject: impl Display) {
    let (owner, key) = match caller {
        Caller::Anyone => ("", ""),
        Caller::Key(key) => (key.owner.name(), key.prefix.as_str()),
    };
    tracing::info!(target: "oviduct::audit", action, %subject, owner, key);
}

/// Makes a change and records it, unless there was nothing to change (`None`).
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

/// Does work to its end, also if the client closes the connection: no change is left without its audit line.
pub(in crate::http) async fn run_to_completion<T: Send + 'static>(work: impl Future<Output = T> + Send + 'static) -> T {
    match tokio::spawn(work.in_current_span()).await {
        Ok(output) => output,
        Err(error) => match error.try_into_panic() {
            Ok(panic) => std::panic::resume_unwind(panic),
            // The process ends.
            Err(_) => std::future::pending().await,
        },
    }
}
