//! Operations on many models: cancellations and deletions of all models that match a filter.
//!
//! | file | subject |
//! |---|---|
//! | `apply` | `POST /models/cancel`, `DELETE /models`, `POST /batches/{id}/cancel` |
//! | `read` | list, read and cancel operations |
//! | `operation` | bodies of responses |
//! | `run` | execution of operations in the background |

pub(super) mod apply;
mod operation;
pub(super) mod read;
mod run;

use super::wire::extract::{PathTexts, parse_id};
use super::wire::problem::{Kind, Problem};
use crate::jobs::{JobId, OperationId};
use axum::extract::FromRequestParts;
use axum::http::request::Parts;
pub use run::execute_operations;

/// The id in the path of an operation. The response is 404 if it is not a UUID.
pub(super) struct PathId(OperationId);

impl<S: Send + Sync> FromRequestParts<S> for PathId {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Problem> {
        let texts = PathTexts::from_request_parts(parts, state).await?;
        let text = texts.get("id");
        let JobId(id) = parse_id(text).ok_or_else(|| no_operation(text))?;
        Ok(Self(OperationId(id)))
    }
}

/// The problem of a missing operation.
fn no_operation(id: impl std::fmt::Display) -> Problem {
    let detail = format!("There is no operation {id}. It never existed, or it ended more than a week ago.");
    Problem::new(Kind::OperationNotFound, detail)
}
