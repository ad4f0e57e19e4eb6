//! Operations on many jobs: cancellations and deletions of all models that match a filter.

use super::job::Status;
use super::list::ListFilter;
use jiff::Timestamp;
use serde::{Deserialize, Serialize};

/// Identity of an operation: a UUIDv7.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(transparent)]
pub struct OperationId(pub uuid::Uuid);

impl std::fmt::Display for OperationId {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        self.0.hyphenated().fmt(f)
    }
}

/// Change of many models.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "lowercase")]
pub enum BulkAction {
    /// Cancel the models.
    Cancel,
    /// Delete the models and their files.
    Delete,
}

/// Request for an operation.
#[derive(Clone, Debug)]
pub struct NewBulk {
    /// Change of each model.
    pub action: BulkAction,
    /// The models; `before` and `limit` are ignored.
    pub filter: ListFilter,
    /// Conditions as the client gave them: names and values of parameters.
    pub conditions: Vec<(String, String)>,
    /// Owner of the operation; `None` if the request had no key.
    pub owner: Option<String>,
}

/// An operation on many jobs.
#[derive(Clone, Debug, PartialEq)]
pub struct BulkOperation {
    /// Identity.
    pub id: OperationId,
    /// Owner; `None` if the request had no key.
    pub owner: Option<String>,
    /// Change of each model.
    pub action: BulkAction,
    /// Conditions as the client gave them.
    pub conditions: Vec<(String, String)>,
    /// Status: an operation is `running` from its first transaction on.
    pub status: Status,
    /// Increases with every change.
    pub version: u64,
    /// Number of models that matched when the operation was accepted.
    pub total: u64,
    /// Number of models that have changed.
    pub changed: u64,
    /// Time of acceptance.
    pub created_at: Timestamp,
    /// Time of the end; `None` before.
    pub finished_at: Option<Timestamp>,
}

/// Result of one transaction of an operation.
#[derive(Clone, Debug, PartialEq)]
pub struct BulkStep {
    /// The operation after the transaction.
    pub operation: BulkOperation,
    /// Keys for removal from the artifact store.
    pub keys: Vec<String>,
}

/// A page of operations, newest first.
#[derive(Clone, Debug)]
pub struct BulkPage {
    /// The operations.
    pub operations: Vec<BulkOperation>,
    /// Cursor of the next page.
    pub next: Option<OperationId>,
}
