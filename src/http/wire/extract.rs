//! Extractors whose rejections are problems.

use super::faults::{Faults, RequestFault};
use super::problem::{Kind, Problem};
use crate::http::access::TICKET;
use crate::jobs::{self, JobId};
use axum::extract::{FromRequestParts, Path, Query};
use axum::http::request::Parts;
use std::collections::BTreeSet;
use uuid::Uuid;

/// The id in the path of a model. The response is 404 if it is not a UUID.
pub(in crate::http) struct ModelId(pub(in crate::http) JobId);

impl<S: Send + Sync> FromRequestParts<S> for ModelId {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Problem> {
        let texts = PathTexts::from_request_parts(parts, state).await?;
        let text = texts.get("id");
        let id = parse_id(text).ok_or_else(|| no_model(text))?;
        tracing::Span::current().record("model", tracing::field::display(id));
        Ok(Self(id))
    }
}

/// The id in the path of a batch. The response is 404 if it is not a UUID.
pub(in crate::http) struct BatchId(pub(in crate::http) jobs::BatchId);

impl<S: Send + Sync> FromRequestParts<S> for BatchId {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Problem> {
        let texts = PathTexts::from_request_parts(parts, state).await?;
        let text = texts.get("id");
        let JobId(id) = parse_id(text).ok_or_else(|| no_batch(text))?;
        Ok(Self(jobs::BatchId(id)))
    }
}

/// The parameters of the path as text. The response is 404 if they are not UTF-8.
pub(in crate::http) struct PathTexts(Vec<(String, String)>);

impl PathTexts {
    /// The parameter `name`.
    pub(in crate::http) fn get(&self, name: &str) -> &str {
        self.0.iter().find(|(n, _)| n == name).map_or("", |(_, text)| text)
    }
}

impl<S: Send + Sync> FromRequestParts<S> for PathTexts {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, state: &S) -> Result<Self, Problem> {
        let path = Path::<Vec<(String, String)>>::from_request_parts(parts, state).await;
        path.map(|p| Self(p.0)).map_err(|_| Problem::new(Kind::NotFound, "The path is not UTF-8."))
    }
}

/// Query parameters in order, without the ticket.
pub(in crate::http) struct Parameters(pub(in crate::http) Vec<(String, String)>);

impl Parameters {
    /// The first value of this name.
    pub(in crate::http) fn get(&self, name: &str) -> Option<&str> {
        self.0.iter().find(|(known, _)| known == name).map(|(_, value)| value.as_str())
    }

    /// Faults of parameters that are not in `known`, or that occur more than once and are not in
    /// `repeatable`.
    pub(in crate::http) fn faults(&self, known: &[&str], repeatable: &[&str]) -> Faults {
        let mut faults = Faults::default();
        let mut seen = BTreeSet::new();
        for (name, _) in &self.0 {
            let again = !seen.insert(name);
            if !known.contains(&name.as_str()) {
                faults.push(RequestFault::parameter(
                    name,
                    format!("is unknown; the parameters are {}", known.join(", ")),
                ));
            } else if again && !repeatable.contains(&name.as_str()) {
                faults.push(RequestFault::parameter(name, "is given more than once"));
            }
        }
        faults
    }
}

impl<S: Send + Sync> FromRequestParts<S> for Parameters {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Problem> {
        Query::try_from_uri(&parts.uri)
            .map(|Query::<Vec<(String, String)>>(mut pairs)| {
                pairs.retain(|(name, _)| name != TICKET);
                Self(pairs)
            })
            .map_err(|_| Problem::new(Kind::BadRequest, "The query string is malformed."))
    }
}

/// Parses an id: a UUID in its hyphenated form.
pub(in crate::http) fn parse_id(text: &str) -> Option<JobId> {
    (text.len() == 36).then(|| Uuid::try_parse(text).ok()).flatten().map(JobId)
}

/// 404 for a batch.
pub(in crate::http) fn no_batch(id: impl std::fmt::Display) -> Problem {
    Problem::new(Kind::BatchNotFound, format!("There is no batch {id}. It never existed, or it was deleted."))
}

/// 404 for a model.
pub(in crate::http) fn no_model(id: impl std::fmt::Display) -> Problem {
    Problem::new(Kind::ModelNotFound, format!("There is no model {id}. It never existed, or it was deleted."))
}
