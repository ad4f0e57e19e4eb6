//! Who sends a request.

use crate::http::wire::problem::{Kind, Problem};
use crate::jobs::keys::{Key, KeyLimits, Scope};
use crate::jobs::{Batch, Job, JobKind, Quota};
use axum::extract::FromRequestParts;
use axum::http::request::Parts;
use std::sync::Arc;

/// Who sends a request. Handlers take it as an argument; the rule of the route provides it.
#[derive(Clone, Debug)]
pub(in crate::http) enum Caller {
    /// Anyone: the service has no keys.
    Anyone,
    /// Who has this key, or a ticket made with it.
    Key(Arc<Key>),
}

impl Caller {
    /// Who owns what it submits.
    pub(in crate::http) fn owner(&self) -> Option<&str> {
        match self {
            Self::Anyone => None,
            Self::Key(key) => Some(key.owner.name()),
        }
    }

    /// Whose models it sees: those of one owner, or with `None` all.
    pub(in crate::http) fn only(&self) -> Option<&str> {
        match self {
            Self::Key(key) if !key.scopes.allow(Scope::Admin) => Some(key.owner.name()),
            Self::Anyone | Self::Key(_) => None,
        }
    }

    /// Whether it sees what `owner` has.
    pub(in crate::http) fn sees(&self, owner: Option<&str>) -> bool {
        self.only().is_none_or(|only| owner == Some(only))
    }

    /// The job, if it sees it.
    pub(in crate::http) fn job(&self, job: Option<Job>) -> Option<Job> {
        job.filter(|job| self.sees(job.owner.as_deref()))
    }

    /// The model, if the job makes one and it sees it.
    pub(in crate::http) fn model(&self, job: Option<Job>) -> Option<Job> {
        self.job(job).filter(|job| job.kind == JobKind::Model)
    }

    /// The fit, if the job makes one and it sees it.
    pub(in crate::http) fn fit(&self, job: Option<Job>) -> Option<Job> {
        self.job(job).filter(|job| job.kind == JobKind::Fit)
    }

    /// The batch, if it sees it.
    pub(in crate::http) fn batch(&self, batch: Option<Batch>) -> Option<Batch> {
        batch.filter(|batch| self.sees(batch.owner.as_deref()))
    }

    /// With the limits of the service for what the key does not limit itself.
    pub(super) fn with_limits(self, limits: KeyLimits) -> Self {
        let Self::Key(key) = self else { return self };
        let own = key.limits;
        let quota = Quota {
            unfinished: own.quota.unfinished.or(limits.quota.unfinished),
            bytes: own.quota.bytes.or(limits.quota.bytes),
        };
        let limits = KeyLimits { rate: own.rate.or(limits.rate), quota };
        Self::Key(if limits == own { key } else { Arc::new(Key { limits, ..Key::clone(&key) }) })
    }

    /// What its owner may have.
    pub(in crate::http) fn quota(&self) -> Quota {
        match self {
            Self::Anyone => Quota::default(),
            Self::Key(key) => key.limits.quota,
        }
    }
}

impl<S: Send + Sync> FromRequestParts<S> for Caller {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, _: &S) -> Result<Self, Problem> {
        // A fault of the router; nothing is served then.
        parts.extensions.get::<Self>().cloned().ok_or_else(|| {
            tracing::error!(path = parts.uri.path(), "a route is not behind the check of keys");
            Problem::new(Kind::Internal, "The service failed. Its log has this request id.")
        })
    }
}
