//! Jobs for tests.

use crate::generate::{Backend, Progress, Stage};
use crate::jobs::{BackendReport, Job, JobId, JobKind, JobProgress, LiveSection, Status};
use serde_json::json;

/// A queued job.
pub(super) fn job() -> Job {
    Job {
        kind: JobKind::Model,
        owner: None,
        id: JobId(uuid::Uuid::from_u128(7)),
        status: Status::Queued,
        version: 1,
        preset: "pig".into(),
        seed: 7,
        spec: json!({}).into(),
        outputs: Vec::new().into(),
        labels: Default::default(),
        priority: Default::default(),
        trace: None,
        backend: BackendReport { requested: Backend::Auto, used: None, device: None, fallback: None },
        queue_position: Some(0),
        waits_for_equal: false,
        progress: None,
        section: None,
        attempts: 0,
        worker: None,
        cancel_requested: false,
        created_at: jiff::Timestamp::UNIX_EPOCH,
        started_at: None,
        finished_at: None,
        files: vec![],
        summary: None,
        problem: None,
        digest: String::new(),
        engine: String::new(),
        batch: None,
        checkpoint: None,
        reused_from: None,
        retry_of: None,
    }
}

/// A running job at this step.
pub(super) fn running(step: u32) -> Job {
    let progress = Progress {
        stage: Stage::Simulate,
        fraction: f64::from(step) / 1000.0,
        step,
        steps: 1000,
        particles: 710,
        sections: step / 10,
        eta_seconds: None,
    };
    let section = LiveSection { index: step / 10, step, z_um: 1.0, inner: vec![], outer: vec![] };
    Job {
        status: Status::Running,
        queue_position: None,
        attempts: 1,
        progress: Some(JobProgress::Model(progress)),
        section: Some(section),
        ..job()
    }
}
