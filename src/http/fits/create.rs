//! `POST /fits` and `POST /fits/validate`: from a request to a queued fit.

use super::fit::{Fit, FitDetail, FitValidation};
use super::request::{CheckedFit, FitRequest};
use crate::fit::FitSpec;
use crate::generate::{Backend, Cost, Outputs};
use crate::http::AppState;
use crate::http::access::Caller;
use crate::http::health::check_storage;
use crate::http::models::create::{earlier, key_of, queue, set_location, too_much};
use crate::http::models::read::retry_after;
use crate::http::pictures::draw::turn;
use crate::http::wire::blocking::blocking;
use crate::http::wire::json::{JsonBody, LargeJsonBody};
use crate::http::wire::problem::{Kind, Problem};
use crate::http::wire::responses::{FitNotReadyOrUnavailable, FitProblems, FitUnavailable, QueueFull};
use crate::jobs::{JobKind, NewJob, Submitted};
use crate::spec::Fault;
use crate::trace;
use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode, header};
use axum::response::{IntoResponse, Response};

/// Predicted time of a fit, in seconds of one core, that counts as one model against the quota.
const SECONDS_PER_MODEL: f64 = 60.0;

/// Reads and checks a body. Tracing images takes seconds.
async fn check(state: &AppState, caller: &Caller, body: JsonBody) -> Result<CheckedFit, Problem> {
    // Tracing uses all cores, like drawing a picture, so both take turns.
    let turn = if body.get("images").is_some() { Some(turn(state, caller).await?) } else { None };
    let (body, memory) = body.into_parts();
    let read = blocking("Checking the request", (turn, memory), move || CheckedFit::read(body));
    let checked = read.await?.map_err(Problem::invalid)?;
    for spec in checked.fit.extremes() {
        let cost = Cost::new(&spec, &Outputs::none());
        state.limits.cost.check(&cost).map_err(|over| too_much(&cost, &over))?;
    }
    let seconds = checked.fit.predicted_seconds();
    let limit = state.limits.fit_time.as_secs_f64();
    if seconds > limit {
        let detail = format!(
            "the fit would take about {seconds:.0} seconds of a core; the limit is {limit}; reduce \
                /evaluations, /seeds or the size of the model"
        );
        let fault = Fault::new("/evaluations", &detail);
        return Err(Problem::new(Kind::CostLimit, detail).with_errors([fault]));
    }
    Ok(checked)
}

/// Request a fit.
///
/// A fit searches for parameters whose models have the measures in `targets` and `images`. The
/// service queues the fit, and a CPU worker runs it beside models, which take precedence. Follow
/// the fit with `GET /fits/{id}` or its events.
#[utoipa::path(
    post, path = "/fits", operation_id = "create_fit", tag = "fits",
    params(
        ("idempotency-key" = Option<String>, Header, min_length = 1, max_length = 255, pattern = "^[!-~]+$", description = "1 to 255 visible ASCII characters. The same key with the same body returns the same fit"),
    ),
    request_body(content = FitRequest, content_type = "application/json"),
    responses(
        (status = 202, description = "Accepted", body = Fit, headers(
            ("location" = String, description = "The fit, relative to this URL"),
            ("retry-after" = u32, description = "Seconds to wait before the next request"),
            ("idempotency-replayed" = String, description = "`true` if the key returned a fit that it had created before"))),
        FitProblems, QueueFull, FitNotReadyOrUnavailable,
    )
)]
pub(in crate::http) async fn create(
    State(state): State<AppState>,
    caller: Caller,
    headers: HeaderMap,
    LargeJsonBody(body): LargeJsonBody,
) -> Result<Response, Problem> {
    // A separator that no key of a client contains: keys of fits and of models are independent.
    let key = key_of(&headers, &body)?.map(|(key, body)| (format!("\u{1e}{key}"), body));
    let checked = check(&state, &caller, body).await.and_then(|checked| check_storage(&state).map(|()| checked));
    let submitted = match checked {
        Ok(checked) => {
            let new = NewJob { idempotency: key, ..new_job(&caller, checked) };
            queue(&state, &caller, "fit created", new).await?
        }
        // A repeated request gets its fit, even if limits or storage have changed in the meantime.
        Err(refusal) => Submitted::Replayed(earlier(&state, caller.owner(), key).await.ok_or(refusal)?),
    };
    let job = submitted.job();
    let fit = Fit::of(job, &state.job_context([job]).await, FitDetail::Full);
    let mut response = (StatusCode::ACCEPTED, Json(fit)).into_response();
    let headers = response.headers_mut();
    set_location(headers, &format!("fits/{}", job.id), matches!(submitted, Submitted::Replayed(_)));
    headers.insert(header::RETRY_AFTER, retry_after(job));
    Ok(response)
}

/// Number of models as which a fit counts against the quota of its owner: one for each minute that
/// it is predicted to take on one core.
fn weight(fit: &FitSpec) -> u32 {
    (fit.predicted_seconds() / SECONDS_PER_MODEL).ceil().max(1.0) as u32
}

/// The job of a checked request.
fn new_job(caller: &Caller, CheckedFit { fit, labels, priority }: CheckedFit) -> NewJob {
    NewJob {
        kind: JobKind::Fit,
        preset: fit.preset().name.clone(),
        seed: fit.seed(),
        spec: fit.to_json().into(),
        outputs: Vec::new().into(),
        backend: Backend::Cpu,
        labels,
        priority,
        digest: fit.digest(),
        engine: crate::ENGINE_VERSION.to_owned(),
        reuse: false,
        missing: Vec::new(),
        batch_key: None,
        short: false,
        idempotency: None,
        owner: caller.owner().map(str::to_owned),
        quota: caller.quota(),
        weight: weight(&fit),
        trace: trace::current(),
        retry_of: None,
    }
}

/// Check a request for a fit, without queueing anything.
///
/// The response contains the targets measured in images, and the parameters that would be varied.
#[utoipa::path(
    post, path = "/fits/validate", operation_id = "validate_fit", tag = "fits",
    request_body(content = FitRequest, content_type = "application/json"),
    responses(
        (status = 200, description = "The request is valid", body = FitValidation),
        FitProblems, FitUnavailable,
    )
)]
pub(in crate::http) async fn validate(
    State(state): State<AppState>,
    caller: Caller,
    LargeJsonBody(body): LargeJsonBody,
) -> Result<Json<FitValidation>, Problem> {
    let CheckedFit { fit, .. } = check(&state, &caller, body).await?;
    let (request, digest, seconds) = (fit.to_json(), fit.digest(), fit.predicted_seconds());
    Ok(Json(FitValidation { request, digest, seconds, counts_as: weight(&fit) }))
}
