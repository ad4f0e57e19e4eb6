//! Bodies of responses about batches.

use super::study::BatchStudy;
use crate::jobs::Priority;
use jiff::Timestamp;
use serde::Serialize;
use utoipa::ToSchema;
use uuid::Uuid;

/// A batch: many models of one spec, or of the points of a study, requested together. Models that were deleted individually are not listed.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub struct Batch {
    /// Identifier, a UUIDv7.
    pub id: Uuid,
    /// Who submitted it; null if that was done without a key.
    pub owner: Option<String>,
    /// When it was accepted.
    #[schema(value_type = String, format = DateTime)]
    pub created_at: Timestamp,
    /// Priority of its models.
    #[schema(value_type = i64, minimum = -100, maximum = 100)]
    pub priority: Priority,
    /// Number of its models by status.
    pub counts: BatchCounts,
    /// Ids of its models, in the order of the seeds; of a study, in the order of the points, each with its seeds; then those of
    /// retries. Absent in lists.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(required = false, nullable = false)]
    pub models: Option<Vec<Uuid>>,
    /// The study that its models are the points of; null if it has none. Absent in lists.
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
    /// All models.
    #[schema(minimum = 0)]
    pub total: u64,
    /// Models that wait for a worker.
    #[schema(minimum = 0)]
    pub queued: u64,
    /// Models that a worker grows.
    #[schema(minimum = 0)]
    pub running: u64,
    /// Models that have succeeded.
    #[schema(minimum = 0)]
    pub succeeded: u64,
    /// Models that have failed.
    #[schema(minimum = 0)]
    pub failed: u64,
    /// Models that were cancelled.
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
