//! Access rules of routes.

use super::bucket::add_headers;
use super::{Access, BEARER, Caller, TICKET};
use crate::http::wire::problem::{Kind, Problem};
use crate::http::wire::responses::add_problems;
use crate::jobs::keys::Scope;
use axum::extract::Request;
use axum::http::header;
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use std::sync::Arc;
use std::time::Duration;
use utoipa::openapi::path::Operation;
use utoipa::openapi::security::SecurityRequirement;
use utoipa_axum::router::OpenApiRouter;

/// What a caller needs for a route if the service has keys.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::http) enum Rule {
    /// Nothing.
    Open,
    /// A key with any scope.
    AnyKey,
    /// A key with the scope `read`.
    Read,
    /// A key with the scope `submit`.
    Submit,
    /// A key with the scope `admin`.
    Admin,
}

impl Rule {
    fn scope(self) -> Option<Scope> {
        match self {
            Self::Open | Self::AnyKey => None,
            Self::Read => Some(Scope::Read),
            Self::Submit => Some(Scope::Submit),
            Self::Admin => Some(Scope::Admin),
        }
    }

    /// Enforces this rule on the routes, and adds it to their descriptions.
    pub(in crate::http) fn guard<S>(self, mut routes: OpenApiRouter<S>) -> OpenApiRouter<S>
    where
        S: Clone + Send + Sync + 'static,
    {
        for item in routes.get_openapi_mut().paths.paths.values_mut() {
            item.get.iter_mut().for_each(|operation| self.describe(operation, true));
            let others = [&mut item.post, &mut item.put, &mut item.patch, &mut item.delete];
            others.into_iter().flatten().for_each(|operation| self.describe(operation, false));
        }
        routes.route_layer(axum::middleware::from_fn(move |request, next| self.enforce(request, next)))
    }

    /// Adds the security requirements and the refusals of this rule to an operation.
    ///
    /// Only a `GET` accepts tickets. Only other methods are refused to pages of other origins on a
    /// service without keys.
    fn describe(self, operation: &mut Operation, is_get: bool) {
        if self == Self::Open {
            operation.security = Some(Vec::new());
            return;
        }
        let scopes: Vec<&str> = self.scope().iter().map(|scope| scope.name()).collect();
        let ticket = is_get.then(|| SecurityRequirement::new(TICKET, scopes.clone()));
        operation.security = Some([SecurityRequirement::new(BEARER, scopes)].into_iter().chain(ticket).collect());
        let mut kinds = vec![Kind::Unauthorized, Kind::UnknownHost, Kind::RateLimited, Kind::StoreUnavailable];
        kinds.extend(self.scope().map(|_| Kind::Forbidden));
        kinds.extend((!is_get).then_some(Kind::ForbiddenOrigin));
        add_problems(&mut operation.responses.responses, &kinds);
    }

    /// Identifies the caller and runs the request if the rule permits it.
    async fn enforce(self, mut request: Request, next: Next) -> Response {
        if self == Self::Open {
            return next.run(request).await;
        }
        let Some(access) = request.extensions().get::<Arc<Access>>().cloned() else {
            tracing::error!(path = request.uri().path(), "keys cannot be checked");
            return Problem::new(Kind::Internal, "The service failed. Its log has this request id.").into_response();
        };
        let (caller, ticket) = match access.caller(request.method(), request.uri(), request.headers()).await {
            Ok(known) => known,
            Err(problem) => return problem.into_response(),
        };
        if let Caller::Key(key) = &caller {
            tracing::Span::current().record("key", &key.prefix);
        }
        let standing = access.count(&caller);
        let admitted = match &standing {
            Some(Err(standing)) => Err(too_fast(standing.wait())),
            _ => self.check(&caller),
        };
        // A refused request does not use its ticket up.
        let admitted = match (admitted, ticket) {
            (Ok(()), Some(ticket)) => access.use_ticket(&ticket, request.uri()).await,
            (admitted, _) => admitted,
        };
        let mut response = match admitted {
            Ok(()) => {
                request.extensions_mut().insert(caller);
                next.run(request).await
            }
            Err(problem) => problem.into_response(),
        };
        if let Some(Ok(standing) | Err(standing)) = standing {
            add_headers(response.headers_mut(), standing);
        }
        response
    }

    /// Refuses a caller without the scope of this rule.
    fn check(self, caller: &Caller) -> Result<(), Problem> {
        match (caller, self.scope()) {
            (Caller::Key(key), Some(scope)) if !key.scopes.allow(scope) => {
                Err(forbidden(scope, &key.scopes.to_string()))
            }
            _ => Ok(()),
        }
    }
}

fn too_fast(wait: Duration) -> Problem {
    let seconds = wait.as_secs_f64().ceil().max(1.0) as u64;
    Problem::new(Kind::RateLimited, format!("The key has sent too many requests. Try again in {seconds} s."))
        .with_header(header::RETRY_AFTER, seconds)
}

fn forbidden(needed: Scope, has: &str) -> Problem {
    let challenge = format!("Bearer realm=\"oviduct\", error=\"insufficient_scope\", scope=\"{needed}\"");
    let problem = Problem::new(Kind::Forbidden, format!("This needs the scope {needed}. The key has: {has}."));
    problem.with_header(header::WWW_AUTHENTICATE, challenge)
}
