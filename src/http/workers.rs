//! `/workers`: lists the workers of the installation with their devices and models; pauses, resumes
//! and drains them.

use super::AppState;
use super::access::{Caller, audited};
use super::wire::extract::PathTexts;
use super::wire::problem::{Kind, Problem};
use super::wire::responses::{StoresUnavailable, WorkerMissing};
use crate::jobs::{Instruction, JobId, WorkerCondition, WorkerInfo, WorkerKind, WorkerState};
use axum::Json;
use axum::extract::State;
use jiff::Timestamp;
use serde::Serialize;
use sha2::{Digest, Sha256};
use utoipa::ToSchema;
use uuid::Uuid;

/// A worker.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct Worker {
    /// Name, unique in the installation; without the scope `admin` a pseudonym.
    pub id: String,
    /// Host name; without the scope `admin` a pseudonym.
    pub host: String,
    /// Backend of the worker.
    #[schema(value_type = crate::generate::Backend)]
    pub backend: WorkerKind,
    /// Name of the device.
    pub device: String,
    /// Id of the oldest model or fit that the worker runs; null if it runs none.
    pub job: Option<Uuid>,
    /// Ids of the models or fits that the worker runs, oldest first: one, or the models of a GPU
    /// batch.
    pub jobs: Vec<Uuid>,
    /// Number of models and fits that the worker has ended.
    #[schema(minimum = 0)]
    pub jobs_done: u64,
    /// Time of the last heartbeat.
    #[schema(value_type = String, format = DateTime)]
    pub heartbeat_at: Timestamp,
    /// State of the worker, without a pause of all workers.
    pub state: WorkerState,
    /// Pause of this worker alone; null if the worker is active.
    pub pause: Option<Pause>,
    /// Condition that keeps the worker from starting models; null if there is none.
    pub condition: Option<WorkerCondition>,
}

/// Pause of one worker or of all workers.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub struct Pause {
    /// Start of the pause.
    #[schema(value_type = String, format = DateTime)]
    pub since: Timestamp,
    /// Name of the caller that requested the pause; null if unknown, and for callers without the
    /// scope `admin`.
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
            condition: worker.condition,
        }
    }
}

/// Workers that sent a heartbeat within the last five minutes.
#[derive(Clone, Debug, Serialize, ToSchema)]
pub struct WorkerList {
    /// Pause of all workers; null while active workers start models.
    pub pause: Option<Pause>,
    /// The workers.
    pub workers: Vec<Worker>,
}

/// List the workers that sent a heartbeat within the last five minutes.
///
/// Without the scope `admin`, the response names only jobs of the caller, does not name who paused
/// a worker, and contains pseudonyms instead of the names of workers and hosts.
#[utoipa::path(
    get, path = "/workers", operation_id = "list_workers", tag = "service",
    responses((status = 200, description = "The workers", body = WorkerList), StoresUnavailable)
)]
pub(super) async fn list(State(state): State<AppState>, caller: Caller) -> Result<Json<WorkerList>, Problem> {
    let mut pause = state.store.paused().await?;
    let mut workers = state.store.workers().await?;
    if caller.only().is_some() {
        let pauses = workers.iter_mut().map(|worker| &mut worker.pause).chain([&mut pause]);
        pauses.flatten().for_each(|pause| pause.by = None);
        for worker in &mut workers {
            worker.jobs = visible(&state, &caller, &worker.jobs).await?;
            worker.id = pseudonym("worker", &worker.id);
            worker.host = pseudonym("host", &worker.host);
        }
    }
    Ok(Json(WorkerList { pause: pause.map(Into::into), workers: workers.into_iter().map(Into::into).collect() }))
}

/// A name that tells workers or hosts apart, and stays the same, but does not show the host or the
/// process id.
fn pseudonym(kind: &str, name: &str) -> String {
    let hash = hex::encode(Sha256::digest(format!("oviduct {kind} {name}")));
    format!("{kind}-{}", &hash[..12])
}

/// The subset of `jobs` that the caller may see.
async fn visible(state: &AppState, caller: &Caller, jobs: &[JobId]) -> Result<Vec<JobId>, Problem> {
    let mut visible = Vec::new();
    for &id in jobs {
        visible.extend(caller.job(state.store.get(id).await?).map(|job| job.id));
    }
    Ok(visible)
}

/// Pause all workers, including workers that start later.
///
/// Paused workers start no models. Running models continue, and the service accepts and queues
/// requests. The pause holds across restarts until `POST /workers/resume`.
#[utoipa::path(
    post, path = "/workers/pause", operation_id = "pause_workers", tag = "service",
    responses((status = 200, description = "The workers", body = WorkerList), StoresUnavailable)
)]
pub(super) async fn pause_all(State(state): State<AppState>, caller: Caller) -> Result<Json<WorkerList>, Problem> {
    set_paused(&state, &caller, true).await?;
    list(State(state), caller).await
}

/// End the pause of all workers; individual pauses of workers remain.
///
/// The response contains the state of each worker.
#[utoipa::path(
    post, path = "/workers/resume", operation_id = "resume_workers", tag = "service",
    responses((status = 200, description = "The workers", body = WorkerList), StoresUnavailable)
)]
pub(super) async fn resume_all(State(state): State<AppState>, caller: Caller) -> Result<Json<WorkerList>, Problem> {
    set_paused(&state, &caller, false).await?;
    list(State(state), caller).await
}

/// Pause a worker: it starts no models, and its running models continue.
///
/// The pause holds until the worker is resumed, even if the worker is restarted under the same
/// name.
#[utoipa::path(
    post, path = "/workers/{id}/pause", operation_id = "pause_worker", tag = "service",
    params(("id" = String, Path, description = "Name of the worker")),
    responses((status = 200, description = "The worker", body = Worker), WorkerMissing, StoresUnavailable)
)]
pub(super) async fn pause(
    State(state): State<AppState>,
    caller: Caller,
    texts: PathTexts,
) -> Result<Json<Worker>, Problem> {
    instruct(&state, &caller, texts.get("id"), Instruction::Pause).await
}

/// Resume a paused or drained worker, so that it starts models again.
///
/// While all workers are paused, the worker still starts no models.
#[utoipa::path(
    post, path = "/workers/{id}/resume", operation_id = "resume_worker", tag = "service",
    params(("id" = String, Path, description = "Name of the worker")),
    responses((status = 200, description = "The worker", body = Worker), WorkerMissing, StoresUnavailable)
)]
pub(super) async fn resume(
    State(state): State<AppState>,
    caller: Caller,
    texts: PathTexts,
) -> Result<Json<Worker>, Problem> {
    instruct(&state, &caller, texts.get("id"), Instruction::Resume).await
}

/// Drain a worker: it starts no models, completes its running models, and is then `drained`.
///
/// A drained worker can be stopped without interrupting a model. It idles until it is stopped or
/// resumed.
#[utoipa::path(
    post, path = "/workers/{id}/drain", operation_id = "drain_worker", tag = "service",
    params(("id" = String, Path, description = "Name of the worker")),
    responses((status = 200, description = "The worker", body = Worker), WorkerMissing, StoresUnavailable)
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
