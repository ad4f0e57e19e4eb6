//! Execution of operations. The store changes some models in each transaction, so other requests
//! come between, and an operation continues in any process of the service.

use crate::http::AppState;
use crate::jobs::{BulkOperation, BulkStep, OperationId, StoreError};
use std::time::Duration;
use tokio::time::{sleep, timeout};

/// Time between two searches for operations that other processes accepted or left.
const POLL: Duration = Duration::from_secs(5);
/// Wait after a failure of the job store.
const RETRY: Duration = Duration::from_secs(2);

/// Executes an operation to its end.
///
/// # Errors
/// A failure of the job store. [`execute_operations`] continues the operation.
pub(super) async fn complete(state: &AppState, id: OperationId) -> Result<Option<BulkOperation>, StoreError> {
    while let Some(BulkStep { operation, keys }) = state.store.step_operation(Some(id)).await? {
        state.forget(keys).await;
        if operation.status.is_ended() {
            return Ok(Some(operation));
        }
    }
    // Another process has taken the last step, or the operation was cancelled.
    state.store.operation(id).await
}

/// Executes the operations on many models that this and other processes have accepted, until
/// dropped.
pub async fn execute_operations(state: AppState) {
    loop {
        match state.store.step_operation(None).await {
            Ok(Some(BulkStep { operation, keys })) => {
                state.remove_files(&keys).await;
                if operation.status.is_ended() {
                    let BulkOperation { id, changed, total, .. } = operation;
                    tracing::info!(operation = %id, changed, total, "an operation on many models has ended");
                }
            }
            Ok(None) => drop(timeout(POLL, state.operations.notified()).await),
            Err(error) => {
                tracing::warn!(%error, "an operation on many models could not continue; it is tried again");
                sleep(RETRY).await;
            }
        }
    }
}
