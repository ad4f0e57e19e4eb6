//! Problems (RFC 9457): every error response of the service is one.
//!
//! A handler returns a [`Problem`]. The envelope around the router writes the body, because only
//! the envelope knows request id and path. `type` is `urn:oviduct:problem:{slug}`; slugs are
//! stable.

use super::faults::{Faults, RequestFault};
use axum::http::{HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use serde_json::{Map, Value};
use utoipa::ToSchema;

/// Maximum integer of a structured field (RFC 9651).
const INTEGER_MAX: u64 = 999_999_999_999_999;
/// `RateLimit` and `RateLimit-Policy` (draft-ietf-httpapi-ratelimit-headers-10).
pub(in crate::http) const RATE_LIMIT: HeaderName = HeaderName::from_static("ratelimit");
/// See [`RATE_LIMIT`].
pub(in crate::http) const RATE_LIMIT_POLICY: HeaderName = HeaderName::from_static("ratelimit-policy");

/// Prefix of every `type`.
pub(in crate::http) const TYPE_PREFIX: &str = "urn:oviduct:problem:";

macro_rules! kinds {
    ($($(#[$doc:meta])* $name:ident = $slug:literal, $status:ident, $title:literal;)*) => {
        /// Kinds of problems, each with its slug (the last part of `type`), status and title.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        pub(in crate::http) enum Kind { $($(#[$doc])* $name,)* }

        impl Kind {
            /// Every kind.
            pub(in crate::http) const ALL: &'static [Self] = &[$(Self::$name,)*];

            /// Slug, status and title.
            const fn facts(self) -> (&'static str, StatusCode, &'static str) {
                match self { $(Self::$name => ($slug, StatusCode::$status, $title),)* }
            }
        }
    };
}

kinds! {
    /// The request is malformed, and no other kind describes how.
    BadRequest = "bad-request", BAD_REQUEST, "The request is malformed";
    /// The body is not JSON; `line` and `column` say where.
    InvalidJson = "invalid-json", BAD_REQUEST, "The body is not valid JSON";
    /// The request has no valid key or ticket.
    Unauthorized = "unauthorized", UNAUTHORIZED, "A key is required";
    /// The scopes of the key do not include the request.
    Forbidden = "forbidden", FORBIDDEN, "The key does not allow this";
    /// A page of this origin may not send requests.
    ForbiddenOrigin = "forbidden-origin", FORBIDDEN, "The origin is not allowed";
    /// The service does not answer to this name.
    UnknownHost = "unknown-host", MISDIRECTED_REQUEST, "The service does not answer to this host name";
    /// No resource has this path.
    NotFound = "not-found", NOT_FOUND, "There is no resource at this path";
    /// No model has this id.
    ModelNotFound = "model-not-found", NOT_FOUND, "There is no such model";
    /// No batch has this id.
    BatchNotFound = "batch-not-found", NOT_FOUND, "There is no such batch";
    /// No fit has this id.
    FitNotFound = "fit-not-found", NOT_FOUND, "There is no such fit";
    /// No operation has this id.
    OperationNotFound = "operation-not-found", NOT_FOUND, "There is no such operation";
    /// The model has no such file (yet).
    FileNotFound = "file-not-found", NOT_FOUND, "The model has no such file";
    /// The model has no such section (yet).
    SectionNotFound = "section-not-found", NOT_FOUND, "The model has no such section";
    /// The plane does not intersect the model.
    CutNotFound = "cut-not-found", NOT_FOUND, "The plane does not meet the model";
    /// The lumen has no way that touches nothing.
    WayNotFound = "way-not-found", NOT_FOUND, "No way through the lumen was found";
    /// No preset has this name.
    PresetNotFound = "preset-not-found", NOT_FOUND, "There is no such preset";
    /// No live worker has this name.
    WorkerNotFound = "worker-not-found", NOT_FOUND, "There is no such worker";
    /// The resource does not support this method; `Allow` lists those it supports.
    MethodNotAllowed = "method-not-allowed", METHOD_NOT_ALLOWED, "The method is not allowed here";
    /// No representation matches `Accept`.
    NotAcceptable = "not-acceptable", NOT_ACCEPTABLE, "No representation matches the Accept header";
    /// Only a failed model can be retried.
    NotFailed = "not-failed", CONFLICT, "The model has not failed";
    /// The body did not arrive in time.
    RequestTimeout = "request-timeout", REQUEST_TIMEOUT, "The request body did not arrive in time";
    /// The body exceeds the limit.
    PayloadTooLarge = "payload-too-large", PAYLOAD_TOO_LARGE, "The body is too large";
    /// The body is not declared as JSON.
    UnsupportedMediaType = "unsupported-media-type", UNSUPPORTED_MEDIA_TYPE, "The media type is not supported";
    /// The range lies outside the file.
    RangeNotSatisfiable = "range-not-satisfiable", RANGE_NOT_SATISFIABLE, "The range lies outside the file";
    /// Members, parameters or headers are invalid; `errors` lists them.
    InvalidRequest = "invalid-request", UNPROCESSABLE_ENTITY, "The request is not valid";
    /// The predicted cost exceeds a limit; see `prediction` and `limit`.
    CostLimit = "cost-limit", UNPROCESSABLE_ENTITY, "The predicted cost exceeds a limit";
    /// The surface is too large to be cut by the service.
    SurfaceTooLarge = "surface-too-large", UNPROCESSABLE_ENTITY, "The surface is too large to be cut by the service";
    /// A GPU was requested, but no GPU worker has sent a heartbeat within five minutes.
    GpuUnavailable = "gpu-unavailable", UNPROCESSABLE_ENTITY, "No GPU worker is available";
    /// The idempotency key was used with another body before.
    IdempotencyConflict = "idempotency-key-reused", UNPROCESSABLE_ENTITY, "The idempotency key was used for another request";
    /// The queue has reached its limit.
    QueueFull = "queue-full", TOO_MANY_REQUESTS, "The queue is full";
    /// The owner of the key has used up its quota; `limit` is the limit.
    QuotaExceeded = "quota-exceeded", TOO_MANY_REQUESTS, "The quota is used up";
    /// The key has sent too many requests.
    RateLimited = "rate-limited", TOO_MANY_REQUESTS, "Too many requests";
    /// The service failed.
    Internal = "internal", INTERNAL_SERVER_ERROR, "The service failed";
    /// The body has a transfer coding other than `chunked`.
    TransferCoding = "transfer-coding-unsupported", NOT_IMPLEMENTED, "The transfer coding is not supported";
    /// The job store is unavailable.
    StoreUnavailable = "store-unavailable", SERVICE_UNAVAILABLE, "The job store is unavailable";
    /// The artifact store is unavailable.
    StorageUnavailable = "storage-unavailable", SERVICE_UNAVAILABLE, "The artifact store is unavailable";
    /// The bodies of other requests take the memory for bodies, or many batches are being checked.
    TooManyBodies = "too-many-bodies", SERVICE_UNAVAILABLE, "Too many request bodies are being processed";
    /// The limit of open event streams is reached.
    TooManyStreams = "too-many-streams", SERVICE_UNAVAILABLE, "Too many event streams are open";
    /// The limit of concurrent downloads is reached.
    TooManyDownloads = "too-many-downloads", SERVICE_UNAVAILABLE, "Too many downloads are running";
    /// The limit of concurrently drawn pictures is reached.
    TooManyPictures = "too-many-pictures", SERVICE_UNAVAILABLE, "Too many pictures are being drawn";
    /// The process does not accept requests; `condition` is the reason.
    NotReady = "not-ready", SERVICE_UNAVAILABLE, "The process is not ready";
    /// Workers of this process did not stop when requested; `workers` lists them.
    WorkersStuck = "workers-stuck", SERVICE_UNAVAILABLE, "Workers are stuck";
}

impl Kind {
    /// Stable name, in kebab-case.
    pub(in crate::http) fn slug(self) -> &'static str {
        self.facts().0
    }

    /// Status of the response.
    pub(in crate::http) fn status(self) -> StatusCode {
        self.facts().1
    }

    /// Title, the same for every problem of the kind.
    pub(in crate::http) fn title(self) -> &'static str {
        self.facts().2
    }

    /// The kind for an error response of axum.
    pub(super) fn for_status(status: StatusCode) -> Self {
        match status {
            StatusCode::NOT_FOUND => Self::NotFound,
            StatusCode::METHOD_NOT_ALLOWED => Self::MethodNotAllowed,
            StatusCode::PAYLOAD_TOO_LARGE => Self::PayloadTooLarge,
            StatusCode::UNSUPPORTED_MEDIA_TYPE => Self::UnsupportedMediaType,
            StatusCode::UNPROCESSABLE_ENTITY => Self::InvalidRequest,
            s if s.is_client_error() => Self::BadRequest,
            _ => Self::Internal,
        }
    }
}

/// A problem before the envelope writes it.
#[derive(Clone, Debug, PartialEq)]
pub(in crate::http) struct Problem {
    kind: Kind,
    detail: String,
    errors: Vec<RequestFault>,
    members: Map<String, Value>,
    headers: Vec<(HeaderName, HeaderValue)>,
}

impl Problem {
    /// A problem of `kind`. `detail` is a sentence for people.
    pub(in crate::http) fn new(kind: Kind, detail: impl Into<String>) -> Self {
        Self { kind, detail: detail.into(), errors: Vec::new(), members: Map::new(), headers: Vec::new() }
    }

    /// The problem of a request with these faults. `errors` lists the first ones; the others are
    /// counted.
    #[must_use]
    pub(in crate::http) fn invalid(faults: impl Into<Faults>) -> Self {
        let faults = faults.into();
        let listed = faults.listed.len();
        let detail = match listed + faults.left_out {
            1 => "One value is invalid; see errors.".to_owned(),
            n if n > listed => format!("{n} values are invalid; errors lists the first {listed}."),
            n => format!("{n} values are invalid; see errors."),
        };
        Self::new(Kind::InvalidRequest, detail).with_errors(faults)
    }

    /// Returns the problem of a request with faults, if there are any.
    pub(in crate::http) fn check(faults: Faults) -> Result<(), Self> {
        if faults.is_empty() { Ok(()) } else { Err(Self::invalid(faults)) }
    }

    /// Replaces the detail.
    #[must_use]
    pub(in crate::http) fn with_detail(self, detail: impl Into<String>) -> Self {
        Self { detail: detail.into(), ..self }
    }

    /// Sets the faults.
    #[must_use]
    pub(in crate::http) fn with_errors(self, faults: impl Into<Faults>) -> Self {
        let Faults { listed: errors, left_out } = faults.into();
        let problem = Self { errors, ..self };
        if left_out > 0 { problem.with("errors_left_out", left_out) } else { problem }
    }

    /// Adds an extension member.
    #[must_use]
    pub(in crate::http) fn with(mut self, name: &str, value: impl Into<Value>) -> Self {
        self.members.insert(name.to_owned(), value.into());
        self
    }

    /// Adds a header to the response, unless its value contains a character that headers cannot.
    #[must_use]
    pub(in crate::http) fn with_header(mut self, name: HeaderName, value: impl TryInto<HeaderValue>) -> Self {
        self.headers.extend(value.try_into().ok().map(|value| (name, value)));
        self
    }

    /// The kind.
    #[must_use]
    pub(in crate::http) fn kind(&self) -> Kind {
        self.kind
    }

    /// The body for the request `request_id` to `instance`.
    #[must_use]
    pub(in crate::http) fn body(&self, instance: &str, request_id: &str) -> ProblemBody {
        ProblemBody {
            r#type: format!("{TYPE_PREFIX}{}", self.kind.slug()),
            title: self.kind.title().to_owned(),
            status: self.kind.status().as_u16(),
            detail: self.detail.clone(),
            instance: instance.to_owned(),
            request_id: request_id.to_owned(),
            errors: self.errors.clone(),
            members: self.members.clone(),
        }
    }
}

impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        let mut response = self.kind.status().into_response();
        for (name, value) in &self.headers {
            response.headers_mut().insert(name.clone(), value.clone());
        }
        response.headers_mut().insert(header::CONTENT_TYPE, MEDIA_TYPE);
        response.extensions_mut().insert(self);
        response
    }
}

/// `application/problem+json`.
pub(in crate::http) const MEDIA_TYPE: HeaderValue = HeaderValue::from_static("application/problem+json");

/// Body of an error response (RFC 9457, `application/problem+json`).
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
#[schema(as = Problem)]
pub(in crate::http) struct ProblemBody {
    /// `urn:oviduct:problem:` and a stable slug.
    pub r#type: String,
    /// Title, the same for every problem of the type.
    pub title: String,
    /// Status of the response.
    #[schema(minimum = 400, maximum = 599)]
    pub status: u16,
    /// What went wrong, for people.
    pub detail: String,
    /// Path of the request.
    pub instance: String,
    /// Id of the request, as in the header `x-request-id`. Quote it when you report a problem.
    pub request_id: String,
    /// The invalid values of the request.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    #[schema(required = false)]
    pub errors: Vec<RequestFault>,
    /// Members of some types: `line` and `column` (invalid-json), `prediction` and `limit`
    /// (cost-limit), `errors_left_out` (invalid-request), `condition` (not-ready), `workers`
    /// (workers-stuck).
    #[serde(flatten)]
    #[schema(ignore)]
    pub members: Map<String, Value>,
}

/// A failure of the job store. The message is logged and not sent to the client.
impl From<crate::jobs::StoreError> for Problem {
    fn from(error: crate::jobs::StoreError) -> Self {
        use crate::jobs::{Quantity, StoreError};
        match error {
            StoreError::IdempotencyConflict => Self::new(
                Kind::IdempotencyConflict,
                "The key was used before with another body. Use a new key, or send the same body.",
            )
            .with_errors([RequestFault::header("idempotency-key", "was used before with another body")]),
            StoreError::QueueFull { limit } => {
                Self::new(Kind::QueueFull, format!("The queue is at its limit of {limit} models. Try again later."))
                    .with("limit", limit)
                    .with_header(header::RETRY_AFTER, 10)
            }
            StoreError::QuotaExceeded { what, used, more, limit } => {
                let policy = match what {
                    Quantity::Unfinished => "models",
                    Quantity::Bytes => "bytes",
                    Quantity::Operations => "operations",
                };
                let counts = if more > 1 { format!(" The request counts as {more}.") } else { String::new() };
                let detail = format!("You have {used} {} of at most {limit}.{counts}", what.unit());
                let problem = Self::new(Kind::QuotaExceeded, detail);
                let fields = [
                    (header::RETRY_AFTER, "10".to_owned()),
                    (RATE_LIMIT, format!("\"{policy}\";r={}", limit.saturating_sub(used).min(INTEGER_MAX))),
                    (RATE_LIMIT_POLICY, format!("\"{policy}\";q={};qu=\"{policy}\"", limit.min(INTEGER_MAX))),
                ];
                let problem = problem.with("limit", limit);
                fields.into_iter().fold(problem, |problem, (name, value)| problem.with_header(name, value))
            }
            StoreError::Fenced => {
                tracing::error!("the job store fenced out a request, as it does with workers");
                Self::new(Kind::Internal, "The job store refused the change.")
            }
            StoreError::Database(message) => {
                tracing::error!(%message, "the job store failed");
                Self::new(Kind::StoreUnavailable, "The job store is unavailable. Try again later.")
                    .with_header(header::RETRY_AFTER, 5)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn slugs_are_distinct_kebab_case() {
        let slugs: BTreeSet<_> = Kind::ALL.iter().map(|k| k.slug()).collect();
        assert_eq!(slugs.len(), Kind::ALL.len());
        assert!(slugs.iter().all(|s| s.bytes().all(|b| b.is_ascii_lowercase() || b == b'-')));
    }

    #[test]
    fn every_kind_is_an_error_with_a_title() {
        for kind in Kind::ALL {
            assert!(kind.status().is_client_error() || kind.status().is_server_error());
            assert!(!kind.title().is_empty() && !kind.title().ends_with('.'));
        }
    }

    #[test]
    fn a_body_has_all_members() {
        let problem = Problem::invalid([crate::spec::Fault::new("/seed", "must be an integer")]).with("limit", 3);
        let body = serde_json::to_value(problem.body("/models", "r1")).unwrap();
        insta::assert_json_snapshot!(body);
    }
}
