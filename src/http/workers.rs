//! `/workers`: lists the workers of the installation with their devices and models; pauses, resumes
//! and drains them.

use super::AppState;
use super::access::{Caller, audited};
use super::wire::extract::PathTexts;
use super::wire::problem::{Kind, Problem};
use super::wire::responses::{StoreAway, WorkerMissing};
use crate::jobs::{Instruction, JobId, WorkerInfo, WorkerKind, WorkerState};
use axum::Json;
use axum::extract::State;
use jiff::Timestamp;
use serde::Serialize;
use utoipa::ToSchema;
use uuid::Uuid;

/// A worker.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct Worker {
    /// Name, unique in the installation.
    pub id: String,
    /// Host name.
    pub host: String,
    /// Backend.
    #[schema(value_type = crate::generate::Backend)]
    pub backend: WorkerKind,
    /// Name of the device.
    pub device: String,
    /// Id of the oldest model that it grows.
    pub job: Option<Uuid>,
    /// Ids of the models that it grows, oldest first: one, or those of a GPU batch.
    pub jobs: Vec<Uuid>,
    /// Number of models it has finished.
    #[schema(minimum = 0)]
    pub jobs_done: u64,
    /// Last heartbeat.
    #[schema(value_type = String, format = DateTime)]
    pub heartbeat_at: Timestamp,
    /// Whether it starts models, unless all workers are paused.
    pub state: WorkerState,
    /// Its own pause; null if it is active.
    pub pause: Option<Pause>,
}

/// A pause of a worker or of all.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub struct Pause {
    /// When it began.
    #[schema(value_type = String, format = DateTime)]
    pub since: Timestamp,
    /// Who asked for it; null if unknown, and for callers without the scope `admin`.
    pub by: Option<String>,
}

impl From<crate::jobs::Pause> for Pause {
    fn from(pause: crate::jobs::Pause) -> Self {
        Self { since: pause.since, by: pause.by }
    }
}

impl From<WorkerInfo> for Worker {
    fn from(worker: WorkerInfo) -> Self {
        Self {
            state: worker.state(),
            id: worker.id,
            host: worker.host,
            backend: worker.kind,
            device: worker.device,
            job: worker.jobs.first().map(|id| id.0),
            jobs: worker.jobs.iter().map(|id| id.0).collect(),
            jobs_done: worker.jobs_done,
            heartbeat_at: worker.heartbeat_at,
            pause: worker.pause.map(Into::into),
        }
    }
}

/// Workers that sent a heartbeat within the last minutes.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct WorkerList {
    /// The pause of all workers; null while those that are active start models.
    pub pause: Option<Pause>,
    /// The workers.
    pub workers: Vec<Worker>,
}

/// List the workers that sent a heartbeat within the last minutes.
///
/// Without the scope `admin`, only models of the caller are named, and nobody who paused a worker.
#[utoipa::path(
    get, path = "/workers", operation_id = "list_workers", tag = "service",
    responses((status = 200, description = "The workers", body = WorkerList), StoreAway)
)]
pub(super) async fn list(State(state): State<AppState>, caller: Caller) -> Result<Json<WorkerList>, Problem> {
    let mut pause = state.store.paused().await?;
    let mut workers = state.store.workers().await?;
    if caller.only().is_some() {
        let pauses = workers.iter_mut().map(|worker| &mut worker.pause).chain([&mut pause]);
        pauses.flatten().for_each(|pause| pause.by = None);
        for worker in &mut workers {
            worker.jobs = visible(&state, &caller, &worker.jobs).await?;
        }
    }
    Ok(Json(WorkerList { pause: pause.map(Into::into), workers: workers.into_iter().map(Into::into).collect() }))
}

/// The subset of `jobs` that the caller may see.
async fn visible(state: &AppState, caller: &Caller, jobs: &[JobId]) -> Result<Vec<JobId>, Problem> {
    let mut visible = Vec::new();
    for &id in jobs {
        visible.extend(caller.job(state.store.get(id).await?).map(|job| job.id));
    }
    Ok(visible)
}

/// Pause all workers, also those that start later.
///
/// They start no more models. The models that they grow go on, and requests are accepted and queued. The pause holds across
/// restarts until `POST /workers/resume`.
#[utoipa::path(
    post, path = "/workers/pause", operation_id = "pause_workers", tag = "service",
    responses((status = 200, description = "The workers", body = WorkerList), StoreAway)
)]
pub(super) async fn pause_all(State(state): State<AppState>, caller: Caller) -> Result<Json<WorkerList>, Problem> {
    set_paused(&state, &caller, true).await?;
    list(State(state), caller).await
}

/// End the pause of all workers. Those that are paused or drained one by one remain so.
///
/// The answer tells which those are.
#[utoipa::path(
    post, path = "/workers/resume", operation_id = "resume_workers", tag = "service",
    responses((status = 200, description = "The workers", body = WorkerList), StoreAway)
)]
pub(super) async fn resume_all(State(state): State<AppState>, caller: Caller) -> Result<Json<WorkerList>, Problem> {
    set_paused(&state, &caller, false).await?;
    list(State(state), caller).await
}

/// Pause a worker: it starts no more models; those that it grows go on.
///
/// The pause holds until the worker is resumed, also for a worker that is started again under the same name.
#[utoipa::path(
    post, path = "/workers/{id}/pause", operation_id = "pause_worker", tag = "service",
    params(("id" = String, Path, description = "Name of the worker")),
    responses((status = 200, description = "The worker", body = Worker), WorkerMissing, StoreAway)
)]
pub(super) async fn pause(
    State(state): State<AppState>,
    caller: Caller,
    texts: PathTexts,
) -> Result<Json<Worker>, Problem> {
    instruct(&state, &caller, texts.get("id"), Instruction::Pause).await
}

/// Let a worker that was paused or drained start models again.
///
/// While all workers are paused, it still starts none.
#[utoipa::path(
    post, path = "/workers/{id}/resume", operation_id = "resume_worker", tag = "service",
    params(("id" = String, Path, description = "Name of the worker")),
    responses((status = 200, description = "The worker", body = Worker), WorkerMissing, StoreAway)
)]
pub(super) async fn resume(
    State(state): State<AppState>,
    caller: Caller,
    texts: PathTexts,
) -> Result<Json<Worker>, Problem> {
    instruct(&state, &caller, texts.get("id"), Instruction::Resume).await
}

/// Drain a worker: it starts no more models, ends those that it grows, and is `drained` then.
///
/// A drained worker can be stopped without interrupting a model. It idles until it is stopped or resumed.
#[utoipa::path(
    post, path = "/workers/{id}/drain", operation_id = "drain_worker", tag = "service",
    params(("id" = String, Path, description = "Name of the worker")),
    responses((status = 200, description = "The worker", body = Worker), WorkerMissing, StoreAway)
)]
pub(super) async fn drain(
    State(state): State<AppState>,
    caller: Caller,
    texts: PathTexts,
) -> Result<Json<Worker>, Problem> {
    instruct(&state, &caller, texts.get("id"), Instruction::Drain).await
}

/// Pauses or resumes all workers.
async fn set_paused(state: &AppState, caller: &Caller, paused: bool) -> Result<(), Problem> {
    let (store, by) = (state.store.clone(), caller.owner().map(str::to_owned));
    let action = if paused { "workers paused" } else { "workers resumed" };
    let change = async move { store.set_paused(paused, by.as_deref()).await.map(Some) };
    audited(caller, action, "*", change).await?;
    Ok(())
}

/// Gives a worker an instruction. Returns its record.
async fn instruct(
    state: &AppState,
    caller: &Caller,
    name: &str,
    instruction: Instruction,
) -> Result<Json<Worker>, Problem> {
    let missing =
        || Problem::new(Kind::WorkerNotFound, format!("No worker {name} sent a heartbeat within five minutes."));
    // No name contains NUL, and PostgreSQL refuses it in a query.
    if name.contains('\0') {
        return Err(missing());
    }
    let action = match instruction {
        Instruction::Pause => "worker paused",
        Instruction::Resume => "worker resumed",
        Instruction::Drain => "worker drained",
    };
    let (store, worker, by) = (state.store.clone(), name.to_owned(), caller.owner().map(str::to_owned));
    let change = async move {
        let instructed = store.instruct(&worker, instruction, by.as_deref()).await?;
        Ok(instructed.then_some(()))
    };
    audited(caller, action, name.to_owned(), change).await?.ok_or_else(missing)?;
    let found = state.store.workers().await?.into_iter().find(|worker| worker.id == name);
    Ok(Json(found.ok_or_else(missing)?.into()))
}
