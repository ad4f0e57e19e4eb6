//! Parts of JSON responses that the commands read.

use serde::Deserialize;

/// A model. Members that are not listed here are ignored.
#[derive(Clone, Debug, Deserialize)]
pub(in crate::cli) struct Model {
    /// Id of the model.
    pub(in crate::cli) id: String,
    /// `queued`, `running`, `succeeded`, `failed` or `cancelled`.
    pub(in crate::cli) status: String,
    #[serde(default)]
    pub(in crate::cli) queue: Option<Queue>,
    #[serde(default)]
    pub(in crate::cli) progress: Option<Progress>,
    #[serde(default)]
    pub(in crate::cli) files: Vec<RemoteFile>,
    #[serde(default)]
    pub(in crate::cli) warnings: Vec<Warning>,
    #[serde(default)]
    problem: Option<Problem>,
}

impl Model {
    /// Returns true if the model can no longer change.
    pub(in crate::cli) fn is_ended(&self) -> bool {
        !matches!(self.status.as_str(), "queued" | "running")
    }

    /// Returns a sentence about the end of the model, with the problem that the service reports.
    pub(in crate::cli) fn why(&self) -> String {
        let ended = match self.status.as_str() {
            "cancelled" => "was cancelled",
            _ => "failed",
        };
        match &self.problem {
            Some(problem) => format!("the model {ended}: {}", problem.text()),
            None => format!("the model {ended}"),
        }
    }
}

/// Position in the queue.
#[derive(Clone, Debug, Deserialize)]
pub(in crate::cli) struct Queue {
    /// Number of models ahead in the queue, counted up to 1000; `None` for a model that has left
    /// the queue.
    pub(in crate::cli) position: Option<u64>,
}

/// Progress of a running model.
#[derive(Clone, Debug, Deserialize)]
pub(in crate::cli) struct Progress {
    pub(in crate::cli) stage: String,
    /// 0 to 1.
    pub(in crate::cli) fraction: f64,
    pub(in crate::cli) step: u64,
    pub(in crate::cli) steps: u64,
    pub(in crate::cli) particles: u64,
}

/// A file that can be downloaded.
#[derive(Clone, Debug, Deserialize)]
pub(in crate::cli) struct RemoteFile {
    pub(in crate::cli) name: String,
    pub(in crate::cli) bytes: u64,
    /// In hexadecimal.
    pub(in crate::cli) sha256: String,
    /// Path on the service.
    pub(in crate::cli) href: String,
}

/// A warning about a model that grew poorly although it was certified.
#[derive(Clone, Debug, Deserialize)]
pub(in crate::cli) struct Warning {
    pub(in crate::cli) detail: String,
}

/// A problem (RFC 9457).
#[derive(Clone, Debug, Default, Deserialize)]
pub(super) struct Problem {
    #[serde(default)]
    title: String,
    #[serde(default)]
    detail: String,
    #[serde(default)]
    pub(super) errors: Vec<Fault>,
}

impl Problem {
    /// Returns title and detail; empty if there are neither.
    pub(super) fn text(&self) -> String {
        match (self.title.is_empty(), self.detail.is_empty()) {
            (false, false) => format!("{}: {}", self.title, self.detail),
            (true, _) => self.detail.clone(),
            (_, true) => self.title.clone(),
        }
    }
}

/// One fault of a request.
#[derive(Clone, Debug, Deserialize)]
pub(super) struct Fault {
    pointer: Option<String>,
    header: Option<String>,
    detail: String,
}

impl std::fmt::Display for Fault {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.pointer.as_ref().or(self.header.as_ref()) {
            Some(place) if !place.is_empty() => write!(f, "{place}: {}", self.detail),
            _ => self.detail.fmt(f),
        }
    }
}
