//! Errors of the job store.

use std::error::Error;

/// The cause of an error, of any type.
pub(super) type Cause = Box<dyn Error + Send + Sync>;

/// A quantity that a [`Quota`](super::Quota) limits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// Queued and running jobs.
    Unfinished,
    /// Bytes of files.
    Bytes,
    /// Operations on many jobs that have not ended.
    Operations,
}

impl Quantity {
    /// Plural noun for messages.
    #[must_use]
    pub fn unit(self) -> &'static str {
        match self {
            Self::Unfinished => "queued and running models",
            Self::Bytes => "bytes of files",
            Self::Operations => "unfinished operations",
        }
    }
}

/// Reason why the job store refused a call, or failed.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// The idempotency key was used with another body.
    #[error("the idempotency key was used before with another request body")]
    IdempotencyConflict,
    /// The queue accepts no more jobs until it is shorter.
    #[error("the queue is full ({limit} jobs)")]
    QueueFull {
        /// Maximum number of queued jobs.
        limit: u64,
    },
    /// The owner has used up its quota.
    #[error("the owner has {used} {} of {limit} and requests {more} more", .what.unit())]
    QuotaExceeded {
        /// The quantity at its limit.
        what: Quantity,
        /// Its present value.
        used: u64,
        /// What the request would add; 0 if that is not known yet.
        more: u64,
        /// The limit.
        limit: u64,
    },
    /// The worker had lost its lease; nothing was written.
    #[error("the lease was lost to another attempt")]
    Fenced,
    /// The database failed or is unavailable.
    #[error("the job store failed: {0}")]
    Database(#[source] Cause),
}

/// An error and its causes in one line. Omits a cause that the line contains already, because many
/// libraries repeat the text of the cause in their own.
#[must_use]
pub fn with_causes(error: &dyn Error) -> String {
    let mut line = error.to_string();
    let mut next = error.source();
    while let Some(cause) = next {
        let text = cause.to_string();
        if !line.contains(&text) {
            line = format!("{line}: {text}");
        }
        next = cause.source();
    }
    line
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, thiserror::Error)]
    #[error("reading the list failed")]
    struct Reading(#[source] std::io::Error);

    #[test]
    fn each_cause_is_named_once() {
        let refused = StoreError::Database("connection refused".into());
        assert_eq!(with_causes(&refused), "the job store failed: connection refused");
        let nested = StoreError::Database(Box::new(Reading(std::io::Error::other("disk on fire"))));
        assert_eq!(with_causes(&nested), "the job store failed: reading the list failed: disk on fire");
    }
}
