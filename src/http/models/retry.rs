//! `POST /models/{id}/retry`: grows a failed model again, as a new model.

use super::create::{CheckedModel, check_limits, created, earlier, key_of, new_job, queue};
use super::files::find_model;
use super::model::{LinkBase, Model};
use super::request::ModelRequest;
use super::specs::Resolved;
use crate::http::AppState;
use crate::http::access::Caller;
use crate::http::health::check_storage;
use crate::http::wire::extract::ModelId;
use crate::http::wire::problem::{Kind, Problem};
use crate::http::wire::responses::{ModelMissing, NotFailed, NotReadyOrUnavailable, QueueFull, RetryProblems};
use crate::jobs::{Job, NewJob, Quota, Status, Submitted};
use crate::spec::{ModelSpec, preset};
use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::Response;
use serde_json::json;

/// Grow a failed model again, as a new model with the same request.
///
/// An ended model never changes, so the retry is a separate model. Its `retry_of` names the failed
/// model, and it belongs to the same batch. A finished model with the same digest is reused as by
/// `POST /models`.
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
        ModelMissing, NotFailed, RetryProblems, QueueFull, NotReadyOrUnavailable,
    )
)]
pub(in crate::http) async fn retry(
    State(state): State<AppState>,
    caller: Caller,
    ModelId(id): ModelId,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let key = key_of(&headers, &json!({ "retry_of": id }))?;
    let failed = find_model(&state, &caller, id).await?;
    if failed.status != Status::Failed {
        let status = failed.status.name();
        let detail = format!("The status of the model is {status}. Only a failed model can be retried.");
        return Err(Problem::new(Kind::NotFailed, detail));
    }
    // The new model belongs to the owner of the failed one. If an admin retries it, no quota
    // applies, and the idempotency key contains the admin's name: it must not match a key of the
    // owner.
    let owner = failed.owner.clone();
    let (quota, key) = match caller.owner() {
        by if by == owner.as_deref() => (caller.quota(), key),
        by => (Quota::default(), key.map(|(key, body)| (format!("{key}\u{1f}{}", by.unwrap_or_default()), body))),
    };
    let checked = check_again(&state, &failed).await.and_then(|checked| check_storage(&state).map(|()| checked));
    let submitted = match checked {
        Ok(CheckedModel { request, spec, cost }) => {
            let new = new_job(&caller, request, &spec, &cost);
            let new = NewJob { idempotency: key, owner, quota, retry_of: Some(id), ..new };
            queue(&state, &caller, "model retried", new).await?
        }
        Err(refusal) => Submitted::Replayed(earlier(&state, owner.as_deref(), key).await.ok_or(refusal)?),
    };
    created(&state, &submitted, submitted.job(), LinkBase::Model).await
}

/// Checks the request of a failed model like a new one, because limits may have changed.
async fn check_again(state: &AppState, failed: &Job) -> Result<CheckedModel, Problem> {
    // The preset has values for parameters that are newer than the model.
    let spec = match preset(&failed.preset) {
        Some(preset) => ModelSpec::resolve(preset, &failed.spec),
        None => ModelSpec::from_json(&failed.spec),
    };
    let spec = spec.map_err(|faults| {
        let detail = "The spec of the model is not valid in this version of the service; see errors.";
        Problem::new(Kind::InvalidRequest, detail)
            .with_errors(faults.into_iter().map(|fault| fault.within("/spec")).collect::<Vec<_>>())
    })?;
    let request = ModelRequest {
        preset: failed.preset.clone(),
        seed: Some(failed.seed),
        spec: failed.spec.value().clone(),
        outputs: failed.outputs.clone(),
        backend: failed.backend.requested,
        labels: failed.labels.clone(),
        priority: failed.priority,
        reuse: true,
    };
    check_limits(state, request, &Resolved::new(spec)).await
}
