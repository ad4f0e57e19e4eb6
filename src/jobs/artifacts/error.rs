//! Errors of the artifact store.

use crate::jobs::store::StoreError;
use std::path::PathBuf;

/// Why the artifact store refused or failed.
#[derive(Debug, thiserror::Error)]
pub enum ArtifactError {
    /// There is no such file.
    #[error("no file has the key {key}")]
    NotFound {
        /// The key.
        key: String,
    },
    /// The range lies outside the file.
    #[error("the range lies outside the file: {0}")]
    Range(String),
    /// A scratch file could not be read.
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
    #[error("the artifact store failed: {0}")]
    Store(String),
    /// The job store, asked which keys are in use, failed.
    #[error(transparent)]
    Jobs(#[from] StoreError),
}

impl From<object_store::Error> for ArtifactError {
    fn from(error: object_store::Error) -> Self {
        match error {
            object_store::Error::NotFound { path, .. } => Self::NotFound { key: path },
            other => Self::Store(chain(&other)),
        }
    }
}

/// An error with its causes, in one line.
pub(super) fn chain(error: &dyn std::error::Error) -> String {
    let mut line = error.to_string();
    let mut source = error.source();
    while let Some(cause) = source {
        let cause_line = cause.to_string();
        if !line.contains(&cause_line) {
            line = format!("{line}: {cause_line}");
        }
        source = cause.source();
    }
    line
}
