//! Real fits on a worker: completed, cancelled, and resumed after a shutdown.

use crate::scripted::{Place, scripted};
use oviduct::fit::{FitResult, FitSpec, FitStage};
use oviduct::generate::Backend;
use oviduct::jobs::{Job, JobId, JobKind, JobProgress, NewJob, Status};
use oviduct::spec::{ModelSpec, preset};
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
    submit_of(place, fit, None).await
}

async fn submit_of(place: &Place, fit: &FitSpec, owner: Option<&str>) -> JobId {
    let new = NewJob {
        owner: owner.map(str::to_owned),
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

fn is_searching(job: &Job) -> bool {
    job.progress.and_then(JobProgress::fit).is_some_and(|at| at.stage == FitStage::Search && at.evaluations > 2)
}

#[tokio::test(flavor = "multi_thread")]
async fn models_do_not_wait_for_a_fit() {
    let place = Place::fresh(|_| {}).await;
    let pool = start(&place);
    let fit = submit(&place, &request(2000)).await;
    place.until(fit, is_searching).await;
    let spec = ModelSpec::resolve(preset("paper").unwrap(), &request(1).to_json()["spec"]).unwrap();
    for seed in 0..3 {
        let new = NewJob { spec: spec.to_json().into(), outputs: Vec::new().into(), ..scripted("model", seed) };
        let model = place.store.submit(new).await.unwrap().job().id;
        let model = place.until(model, |job| job.status.is_ended()).await;
        assert_eq!(model.status, Status::Succeeded, "{model:?}");
    }
    let running = place.store.get(fit).await.unwrap().unwrap();
    assert_eq!((running.status, running.attempts), (Status::Running, 1));
    // The fit goes on after the models.
    let before = running.progress.and_then(JobProgress::fit).unwrap().evaluations;
    place.until(fit, |job| job.progress.and_then(JobProgress::fit).unwrap().evaluations > before + 2).await;
    place.store.cancel(fit).await.unwrap();
    pool.shutdown(Duration::ZERO).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn models_beside_a_fit_grow_in_the_order_of_their_claims() {
    let place = Place::fresh(|_| {}).await;
    let pool = start(&place);
    let fit = submit(&place, &request(2000)).await;
    place.until(fit, is_searching).await;
    let body = json!({ "steps": 1500, "particles": { "total": { "keys": [[0, 260], [1, 1500]] } } });
    let spec = ModelSpec::resolve(preset("paper").unwrap(), &body).unwrap();
    let mut models = Vec::new();
    for seed in 0..12 {
        let new = NewJob { spec: spec.json(), outputs: Vec::new().into(), ..scripted("model", seed) };
        models.push(place.store.submit(new).await.unwrap().job().id);
    }
    let mut ends = Vec::new();
    for model in models {
        let ended = place.until(model, |job| job.status.is_ended()).await;
        assert_eq!((ended.status, ended.attempts), (Status::Succeeded, 1), "{ended:?}");
        ends.push(ended.finished_at);
    }
    assert!(ends.is_sorted(), "no model takes the threads of one that was claimed earlier: {ends:?}");
    place.store.cancel(fit).await.unwrap();
    pool.shutdown(Duration::ZERO).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_fit_does_not_wait_for_the_end_of_a_fit_of_another_owner() {
    let place = Place::fresh(|_| {}).await;
    let pool = place.start_with(place.store.clone(), Arc::new(generate_on_cpu), |options| {
        options.checkpoint_every = Some(Duration::from_millis(50));
        options.fit_turn = Duration::from_millis(300);
        options.poll = Duration::from_millis(20);
    });
    let long = submit_of(&place, &request(2000), Some("a")).await;
    place.until(long, is_searching).await;
    let short = submit_of(&place, &request(16), Some("b")).await;
    let short = place.until(short, |job| job.status.is_ended()).await;
    assert_eq!(short.status, Status::Succeeded, "{short:?}");
    let evaluated = |job: &Job| job.progress.and_then(JobProgress::fit).map_or(0, |at| at.evaluations);
    let going = place.until(long, |job| job.attempts > 1 && evaluated(job) > 20).await;
    assert!(!going.status.is_ended(), "{going:?}");
    place.store.cancel(long).await.unwrap();
    pool.shutdown(Duration::ZERO).await;
}
