//! Errors of the job store.

/// What a [`Quota`](super::Quota) limits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// Queued and running jobs.
    Unfinished,
    /// Bytes of files.
    Bytes,
}

impl Quantity {
    /// What is counted.
    #[must_use]
    pub fn unit(self) -> &'static str {
        match self {
            Self::Unfinished => "queued and running models",
            Self::Bytes => "bytes of files",
        }
    }
}

/// Why the store refused or failed.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// The idempotency key was used with another body.
    #[error("the idempotency key was used before with another request body")]
    IdempotencyConflict,
    /// No jobs are accepted until the queue is shorter.
    #[error("the queue is full ({limit} jobs)")]
    QueueFull {
        /// The limit.
        limit: u64,
    },
    /// The owner has used up its quota.
    #[error("the owner has {used} {} of {limit}", .what.unit())]
    QuotaExceeded {
        /// What there is too much of.
        what: Quantity,
        /// How much there is.
        used: u64,
        /// The limit.
        limit: u64,
    },
    /// The worker's lease was lost; nothing was written.
    #[error("the lease was lost to another attempt")]
    Fenced,
    /// The database failed or is unavailable.
    #[error("the job store failed: {0}")]
    Database(String),
}
