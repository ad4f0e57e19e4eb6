//! The result of a benchmark.

use serde_json::Value;

/// The result of a benchmark, as text and as JSON.
pub(super) struct Report {
    /// Lines of text.
    pub(super) lines: Vec<String>,
    /// The same results as JSON.
    pub(super) json: Value,
    /// Further files for `--out`: name and content.
    pub(super) files: Vec<(String, String)>,
}
