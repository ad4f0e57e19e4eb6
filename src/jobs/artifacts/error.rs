//! Errors of the artifact store.

use crate::jobs::error::Cause;
use crate::jobs::{StoreError, with_causes};
use std::path::PathBuf;

/// Reason why the artifact store refused a call, or failed.
#[derive(Debug, thiserror::Error)]
pub enum ArtifactError {
    /// The file does not exist.
    #[error("no file has the key {key}")]
    NotFound {
        /// The key.
        key: String,
    },
    /// The file is not the one that its record describes.
    #[error("{name} at {key} is damaged: {detail}")]
    Damaged {
        /// Name of the file.
        name: String,
        /// The key.
        key: String,
        /// The difference.
        detail: String,
    },
    /// The range lies outside the file.
    #[error("the range lies outside the file: {0}")]
    Range(String),
    /// A scratch file could not be read or written.
    #[error("reading {path} failed")]
    Scratch {
        /// The file.
        path: PathBuf,
        /// Cause.
        #[source]
        source: std::io::Error,
    },
    /// A symbolic link below the root of a local store.
    #[error("{path} is a symbolic link; the artifact store does not follow links below its root")]
    Link {
        /// The link.
        path: PathBuf,
    },
    /// The store is unavailable, full or broken.
    #[error("the artifact store failed: {}", with_causes(&**.0))]
    Store(#[source] Cause),
    /// The job store failed when it was asked for the keys in use.
    #[error(transparent)]
    Jobs(#[from] StoreError),
}

impl ArtifactError {
    /// The store failed with `error`.
    pub(super) fn store(error: impl std::error::Error + Send + Sync + 'static) -> Self {
        Self::Store(Box::new(error))
    }
}

impl From<object_store::Error> for ArtifactError {
    fn from(error: object_store::Error) -> Self {
        match error {
            object_store::Error::NotFound { path, .. } => Self::NotFound { key: path },
            other => Self::store(other),
        }
    }
}
