//! Bodies of responses about operations.

use crate::jobs::{BulkAction, BulkOperation, Status};
use jiff::Timestamp;
use serde::Serialize;
use std::collections::BTreeMap;
use utoipa::ToSchema;
use uuid::Uuid;

/// An operation on many models. It continues if the client disconnects or the service restarts, and
/// is kept for a week after its end.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub(in crate::http) struct Operation {
    /// Identifier, a UUIDv7.
    id: Uuid,
    /// Owner of the key with which the request was submitted; null if it was submitted without a
    /// key.
    owner: Option<String>,
    /// Change of each model.
    action: BulkAction,
    /// Conditions of the request: names of parameters and their values.
    conditions: BTreeMap<String, Vec<String>>,
    /// Status. `succeeded` if all models that matched have been considered.
    status: Status,
    /// Increases with every change.
    #[schema(minimum = 1)]
    version: u64,
    /// Progress.
    progress: OperationProgress,
    /// Time at which the request was accepted.
    #[schema(value_type = String, format = DateTime)]
    created_at: Timestamp,
    /// Time of the end; null before.
    #[schema(value_type = Option<String>, format = DateTime)]
    finished_at: Option<Timestamp>,
}

/// Progress of an operation.
#[derive(Clone, Copy, Debug, Serialize, ToSchema)]
pub(in crate::http) struct OperationProgress {
    /// Number of models that have changed.
    #[schema(minimum = 0)]
    changed: u64,
    /// Number of models that matched when the request was accepted; at most a million is counted
    /// for each status. Models that change otherwise in the meantime are not in `changed`.
    #[schema(minimum = 0)]
    total: u64,
    /// Fraction of the whole, 0 to 1; 1 if the operation has succeeded.
    fraction: f64,
}

/// A page of operations, newest first.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub(in crate::http) struct OperationList {
    /// The operations.
    pub(super) operations: Vec<Operation>,
    /// Value of `cursor` for the next page; null on the last page.
    pub(super) next: Option<String>,
}

impl From<&BulkOperation> for Operation {
    fn from(stored: &BulkOperation) -> Self {
        let &BulkOperation { action, status, version, total, changed, created_at, finished_at, .. } = stored;
        let mut conditions: BTreeMap<String, Vec<String>> = BTreeMap::new();
        for (name, value) in &stored.conditions {
            conditions.entry(name.clone()).or_default().push(value.clone());
        }
        let fraction = match status {
            Status::Succeeded => 1.0,
            _ => (changed as f64 / total.max(1) as f64).min(1.0),
        };
        let progress = OperationProgress { changed, total, fraction };
        let (id, owner) = (stored.id.0, stored.owner.clone());
        Self { id, owner, action, conditions, status, version, progress, created_at, finished_at }
    }
}
