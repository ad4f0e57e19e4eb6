//! Relative references (RFC 3986, section 4.2) to models and batches. The service may be reached under any path prefix, which a
//! proxy strips, so it never names a path from the root.

use std::fmt::Display;

/// Where the URL of an answer lies.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::http) enum At {
    /// `/models`, `/events`, `/batches`.
    Root,
    /// `/models/{id}`.
    Models,
    /// `/models/{id}/events`, or another resource of a model.
    Model,
}

impl At {
    /// A reference to a model.
    pub(in crate::http) fn model(self, id: impl Display) -> String {
        match self {
            Self::Root => format!("models/{id}"),
            Self::Models => id.to_string(),
            Self::Model => format!("../{id}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn references_resolve_under_any_prefix() {
        for prefix in ["http://localhost:8080", "https://lab.example/tools/oviduct"] {
            for (at, paths) in [
                (At::Root, vec!["/models", "/events", "/models?limit=3", "/batches"]),
                (At::Models, vec!["/models/7", "/models/7?view=full"]),
                (At::Model, vec!["/models/7/events", "/models/7/cancel", "/models/7/retry"]),
            ] {
                for path in paths {
                    let base = reqwest::Url::parse(&format!("{prefix}{path}")).unwrap();
                    let resolved = base.join(&format!("{}/files/model.glb", at.model(7))).unwrap();
                    assert_eq!(resolved.as_str(), format!("{prefix}/models/7/files/model.glb"), "{path}");
                }
            }
        }
    }
}
