//! `POST /models/{id}/retry`: a failed model again.

use super::create::{Accepted, check_limits, created, earlier, key_of, new_job, queue};
use super::links::At;
use super::request::ModelRequest;
use crate::http::AppState;
use crate::http::access::Caller;
use crate::http::dto::Model;
use crate::http::wire::extract::{ModelId, no_model};
use crate::http::wire::faults::Fault;
use crate::http::wire::problem::{Kind, Problem};
use crate::http::wire::responses::{ModelMissing, NotFailed, QueueFull, RetryProblems, StoreAwayOrOpening};
use crate::jobs::{Job, NewJob, Quota, Status, Submitted};
use crate::spec::{ModelSpec, preset};
use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::Response;
use serde_json::json;

/// Grow a failed model again, as a new model with the same request.
///
/// An ended model never changes, so the retry is a model of its own: `retry_of` names the failed one, and it belongs to the
/// same batch. A finished model of the same digest is reused as by `POST /models`.
#[utoipa::path(
    post, path = "/models/{id}/retry", operation_id = "retry_model", tag = "models",
    params(
        ("id" = Uuid, Path, description = "Id of the failed model"),
        ("idempotency-key" = Option<String>, Header, min_length = 1, max_length = 255, pattern = "^[!-~]+$", description = "1 to 255 visible ASCII characters. The same key returns the same retry"),
    ),
    responses(
        (status = 202, description = "Queued", body = Model, headers(
            ("location" = String, description = "The new model, relative to this URL"),
            ("retry-after" = u32, description = "Seconds to wait before the next request"),
            ("idempotency-replayed" = String, description = "`true` if the key returned a model that it had created before"))),
        (status = 201, description = "A finished model with the same digest was reused", body = Model, headers(
            ("location" = String, description = "The new model, relative to this URL"))),
        (status = 200, description = "The key was used again, and its model has ended", body = Model, headers(
            ("location" = String, description = "The new model, relative to this URL"))),
        ModelMissing, NotFailed, RetryProblems, QueueFull, StoreAwayOrOpening,
    )
)]
pub(in crate::http) async fn retry(
    State(state): State<AppState>,
    caller: Caller,
    ModelId(id): ModelId,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let key = key_of(&headers, &json!({ "retry_of": id }))?;
    let failed = caller.model(state.store.get(id).await?).ok_or_else(|| no_model(id))?;
    if failed.status != Status::Failed {
        let status = failed.status.name();
        let detail = format!("The status of the model is {status}. Only a failed model can be retried.");
        return Err(Problem::new(Kind::NotFailed, detail));
    }
    // Of the same owner, whoever retries it. An admin's own quota and keys of idempotency are not those of the owner.
    let owner = failed.owner.clone();
    let (quota, key) = match caller.owner() {
        by if by == owner.as_deref() => (caller.quota(), key),
        by => (Quota::default(), key.map(|(key, body)| (format!("{key}\u{1f}{}", by.unwrap_or_default()), body))),
    };
    let submitted = match again(&state, &failed).await {
        Ok(Accepted { request, spec, .. }) => {
            let new = new_job(&caller, request, &spec);
            queue(&state, &caller, NewJob { idempotency: key, owner, quota, retry_of: Some(id), ..new }).await?
        }
        Err(refusal) => Submitted::Replayed(earlier(&state, owner.as_deref(), key).await.ok_or(refusal)?),
    };
    created(&state, &submitted, submitted.job(), At::Model)
}

/// The request of a failed model, checked as a new one is: limits may have changed since.
async fn again(state: &AppState, failed: &Job) -> Result<Accepted, Problem> {
    let fault = |f: &crate::spec::Fault| Fault::at(format!("/spec{}", f.pointer), &f.detail);
    // On its preset, which has values for parameters that are newer than the model.
    let spec = match preset(&failed.preset) {
        Some(preset) => ModelSpec::resolve(preset, &failed.spec),
        None => ModelSpec::from_json(&failed.spec),
    };
    let spec = spec.map_err(|faults| {
        let detail = "The spec of the model is not valid in this version of the service; see errors.";
        Problem::new(Kind::InvalidRequest, detail).with_errors(faults.iter().map(fault).collect())
    })?;
    let request = ModelRequest {
        preset: failed.preset.clone(),
        seed: Some(failed.seed),
        spec: failed.spec.clone(),
        outputs: failed.outputs.clone(),
        backend: failed.backend.requested,
        labels: failed.labels.clone(),
        priority: failed.priority,
        reuse: true,
    };
    check_limits(state, request, spec).await
}
