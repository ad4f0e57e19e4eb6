//! A job for tests.

use super::{JobKind, NewJob, Priority, Quota};
use crate::generate::{Backend, Output};
use std::collections::BTreeMap;

impl NewJob {
    /// A job for tests, with a separate digest for each seed.
    pub(super) fn sample(seed: u64) -> Self {
        Self {
            kind: JobKind::Model,
            preset: "pig".into(),
            seed,
            spec: serde_json::json!({}).into(),
            outputs: vec![Output::Glb].into(),
            backend: Backend::Auto,
            labels: BTreeMap::new(),
            priority: Priority::default(),
            digest: seed.to_string(),
            engine: crate::ENGINE_VERSION.into(),
            reuse: false,
            missing: Vec::new(),
            batch_key: None,
            short: false,
            idempotency: None,
            owner: None,
            quota: Quota::default(),
            weight: 1,
            trace: None,
            retry_of: None,
        }
    }
}
