//! Why a fit gave no result.

use super::evaluate::Unmeasured;

/// Why a fit gave no result.
#[derive(Debug, thiserror::Error)]
pub enum FitError {
    /// It was cancelled.
    #[error("cancelled")]
    Cancelled,
    /// No candidate could be measured.
    #[error("{detail}")]
    Search {
        /// What went wrong.
        detail: String,
    },
    /// Its models need more memory than allowed.
    #[error("a model of the fit needs about {needed} bytes of memory; the limit is {limit}")]
    Memory {
        /// Predicted need of the largest.
        needed: u64,
        /// The limit.
        limit: u64,
    },
    /// A directory for a model could not be made.
    #[error("{0}")]
    Io(#[from] std::io::Error),
}

impl From<Unmeasured> for FitError {
    fn from(unmeasured: Unmeasured) -> Self {
        match unmeasured {
            Unmeasured::Cancelled => Self::Cancelled,
            Unmeasured::Failed(detail) => Self::Search { detail },
        }
    }
}
