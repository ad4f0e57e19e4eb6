//! Fits: searches for parameters whose models have given measures.
//!
//! | file | subject |
//! |---|---|
//! | `request` | the body of a request |
//! | `create` | `POST /fits`, `POST /fits/validate` |
//! | `read` | list, read, cancel, delete |
//! | `fit` | bodies of responses |

pub(super) mod create;
mod fit;
pub(super) mod read;
mod request;

use crate::http::wire::extract::{PathTexts, parse_id};
use crate::http::wire::problem::{Kind, Problem};
use crate::jobs::JobId;
use axum::extract::FromRequestParts;
use axum::http::request::Parts;
pub(super) use fit::{Fit, FitDetail};

/// Id of a fit in the path; 404 if it is not a UUID.
pub(super) struct FitId(pub(super) JobId);

impl<S: Send + Sync> FromRequestParts<S> for FitId {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Problem> {
        let texts = PathTexts::from_request_parts(parts, state).await?;
        let text = texts.get("id");
        parse_id(text).map(Self).ok_or_else(|| no_fit(text))
    }
}

/// The problem of a missing fit.
pub(super) fn no_fit(id: impl std::fmt::Display) -> Problem {
    Problem::new(Kind::FitNotFound, format!("There is no fit {id}. It never existed, or it was deleted."))
}
