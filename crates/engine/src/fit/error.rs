//! Errors of a fit.

/// Error of a fit.
#[derive(Debug, thiserror::Error)]
pub enum FitError {
    /// The fit was cancelled.
    #[error("cancelled")]
    Cancelled,
    /// A candidate, or every candidate of the search, could not be measured.
    #[error("{detail}")]
    Search {
        /// Reason.
        detail: String,
    },
    /// The models of the fit need more memory than allowed.
    #[error("a model of the fit needs about {needed} bytes of memory; the limit is {limit}")]
    Memory {
        /// Predicted memory of the largest model, bytes.
        needed: u64,
        /// Limit, bytes.
        limit: u64,
    },
    /// The directory of a model could not be created.
    #[error("{0}")]
    Io(#[from] std::io::Error),
}
