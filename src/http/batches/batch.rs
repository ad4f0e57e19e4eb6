//! Bodies of responses about batches.

use super::study::BatchStudy;
use crate::jobs::Priority;
use jiff::Timestamp;
use serde::Serialize;
use utoipa::ToSchema;
use uuid::Uuid;

/// A batch: many models of one spec, or of the points of a study, requested together. Models that
/// were deleted individually are not listed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub struct Batch {
    /// Identifier, a UUIDv7.
    pub id: Uuid,
    /// Owner of the key with which the request was submitted; null if it was submitted without a
    /// key.
    pub owner: Option<String>,
    /// Time at which the request was accepted.
    #[schema(value_type = String, format = DateTime)]
    pub created_at: Timestamp,
    /// Priority of the models.
    #[schema(value_type = i64, minimum = -100, maximum = 100)]
    pub priority: Priority,
    /// Number of the models by status.
    pub counts: BatchCounts,
    /// Ids of the models, in the order of the seeds. In a study, the models of a point follow each
    /// other, in the order of the seeds. Retries follow at the end. Absent in lists.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(required = false, nullable = false)]
    pub models: Option<Vec<Uuid>>,
    /// Study of the batch; null if there is none. Absent in lists.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(value_type = Option<BatchStudy>, required = false)]
    pub study: Option<Option<BatchStudy>>,
}

/// A page of batches, newest first.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct BatchList {
    /// The batches.
    pub batches: Vec<Batch>,
    /// Value of `cursor` for the next page; null on the last page.
    pub next: Option<String>,
}

/// Number of models of a batch by status.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub struct BatchCounts {
    /// Number of all models.
    #[schema(minimum = 0)]
    pub total: u64,
    /// Number of models that wait for a worker.
    #[schema(minimum = 0)]
    pub queued: u64,
    /// Number of models that a worker grows.
    #[schema(minimum = 0)]
    pub running: u64,
    /// Number of models that have succeeded.
    #[schema(minimum = 0)]
    pub succeeded: u64,
    /// Number of models that have failed.
    #[schema(minimum = 0)]
    pub failed: u64,
    /// Number of models that were cancelled.
    #[schema(minimum = 0)]
    pub cancelled: u64,
}

impl From<&crate::jobs::Batch> for Batch {
    fn from(batch: &crate::jobs::Batch) -> Self {
        let counts = &batch.counts;
        Self {
            id: batch.id.0,
            owner: batch.owner.clone(),
            created_at: batch.created_at,
            priority: batch.priority,
            counts: BatchCounts {
                total: counts.total(),
                queued: counts.queued,
                running: counts.running,
                succeeded: counts.succeeded,
                failed: counts.failed,
                cancelled: counts.cancelled,
            },
            models: Some(batch.jobs.iter().map(|job| job.0).collect()),
            study: Some(BatchStudy::of(batch)),
        }
    }
}
