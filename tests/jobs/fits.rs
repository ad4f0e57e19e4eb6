//! Real fits on a worker: completed, cancelled, and resumed after a shutdown.

use crate::scripted::{Place, scripted};
use oviduct::fit::{FitResult, FitSpec, FitStage};
use oviduct::generate::Backend;
use oviduct::jobs::{Job, JobId, JobKind, JobProgress, NewJob, Status};
use oviduct::worker::{WorkerPool, generate_on_cpu};
use serde_json::{Value, json};
use std::sync::Arc;
use std::time::Duration;

fn request(evaluations: u32) -> FitSpec {
    let body = json!({
        "spec": {
            "steps": 120, "burn_in": 40,
            "particles": { "total": { "keys": [[0, 260], [1, 620]] }, "outer": { "keys": [[0, 60], [1, 90]] } },
        },
        // No candidate can reach this target, so the fit uses all evaluations.
        "targets": [{ "region": "ampulla", "quantity": "lumen_perimeter_mm", "value": 100 }],
        "vary": [{ "parameter": "/collision/gap_um" }, { "parameter": "/friction", "from": 0.2, "to": 0.4 }],
        "evaluations": evaluations, "seeds": 1, "models": 1,
    });
    FitSpec::read(&body, Vec::new(), &[]).unwrap()
}

async fn submit(place: &Place, fit: &FitSpec) -> JobId {
    let new = NewJob {
        kind: JobKind::Fit,
        spec: fit.to_json().into(),
        outputs: Vec::new().into(),
        backend: Backend::Cpu,
        digest: fit.digest(),
        ..scripted("fit", 1)
    };
    place.store.submit(new).await.unwrap().job().id
}

fn start(place: &Place) -> WorkerPool {
    place.start_with(place.store.clone(), Arc::new(generate_on_cpu), |options| {
        options.checkpoint_every = Some(Duration::from_millis(50));
    })
}

fn result(job: &Job) -> FitResult {
    serde_json::from_value(job.summary.clone().unwrap_or(Value::Null))
        .unwrap_or_else(|error| panic!("{error}: {job:?}"))
}

#[tokio::test(flavor = "multi_thread")]
async fn a_fit_runs_to_its_result() {
    let place = Place::fresh(|_| {}).await;
    let pool = start(&place);
    let id = submit(&place, &request(16)).await;
    let job = place.until(id, |job| job.status.is_ended()).await;
    assert_eq!(job.status, Status::Succeeded, "{job:?}");
    let found = result(&job);
    assert_eq!((found.targets.len(), found.models.len(), found.unmet.len()), (1, 1, 1));
    assert!(found.models[0].certified && job.files.is_empty() && job.checkpoint.is_none());
    assert!(
        job.progress.and_then(JobProgress::fit).is_some_and(|progress| progress.misfit.is_some()),
        "{:?}",
        job.progress
    );
    pool.shutdown(Duration::ZERO).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_running_fit_is_cancelled() {
    let place = Place::fresh(|_| {}).await;
    let pool = start(&place);
    let id = submit(&place, &request(2000)).await;
    place
        .until(id, |job| {
            job.progress.and_then(JobProgress::fit).is_some_and(|at| at.stage == FitStage::Search && at.evaluations > 2)
        })
        .await;
    place.store.cancel(id).await.unwrap();
    assert_eq!(place.until(id, |job| job.status.is_ended()).await.status, Status::Cancelled);
    pool.shutdown(Duration::ZERO).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_fit_continues_on_another_worker() {
    let place = Place::fresh(|_| {}).await;
    let fit = request(60);
    let alone = submit(&place, &fit).await;
    let pool = start(&place);
    let whole = result(&place.until(alone, |job| job.status.is_ended()).await);
    let id = submit(&place, &fit).await;
    place.until(id, |job| job.checkpoint.is_some()).await;
    pool.shutdown(Duration::ZERO).await;
    let stopped = place.store.get(id).await.unwrap().unwrap();
    assert_eq!(stopped.status, Status::Queued, "released, not failed");
    let pool = start(&place);
    let job = place.until(id, |job| job.status.is_ended()).await;
    assert_eq!((job.status, job.attempts), (Status::Succeeded, 2));
    assert_eq!(result(&job), whole);
    pool.shutdown(Duration::ZERO).await;
}
