//! The sender of a request, and the resources that the sender may see.

use crate::http::wire::problem::{Kind, Problem};
use crate::jobs::keys::{Key, KeyLimits, Scope};
use crate::jobs::{Batch, Job, JobKind, Quota};
use axum::extract::FromRequestParts;
use axum::http::request::Parts;
use std::sync::Arc;

/// The sender of a request. Handlers take the caller as an argument; the rule of the route provides
/// it.
#[derive(Clone, Debug)]
pub(in crate::http) enum Caller {
    /// Anyone, because the service has no keys.
    Anyone,
    /// The holder of this key, or of a ticket that was requested with it.
    Key(Arc<Key>),
}

impl Caller {
    /// Owner of the jobs that the caller submits.
    pub(in crate::http) fn owner(&self) -> Option<&str> {
        match self {
            Self::Anyone => None,
            Self::Key(key) => Some(key.owner.name()),
        }
    }

    /// The only owner whose resources the caller sees; `None` if the caller sees all.
    pub(in crate::http) fn only(&self) -> Option<&str> {
        match self {
            Self::Key(key) if !key.scopes.allow(Scope::Admin) => Some(key.owner.name()),
            Self::Anyone | Self::Key(_) => None,
        }
    }

    /// True if the caller sees the resources of `owner`.
    pub(in crate::http) fn sees(&self, owner: Option<&str>) -> bool {
        self.only().is_none_or(|only| owner == Some(only))
    }

    /// The job, if the caller sees it.
    pub(in crate::http) fn job(&self, job: Option<Job>) -> Option<Job> {
        job.filter(|job| self.sees(job.owner.as_deref()))
    }

    /// The job, if it grows a model that the caller sees.
    pub(in crate::http) fn model(&self, job: Option<Job>) -> Option<Job> {
        self.job(job).filter(|job| job.kind == JobKind::Model)
    }

    /// The job, if it is a fit that the caller sees.
    pub(in crate::http) fn fit(&self, job: Option<Job>) -> Option<Job> {
        self.job(job).filter(|job| job.kind == JobKind::Fit)
    }

    /// The batch, if the caller sees it.
    pub(in crate::http) fn batch(&self, batch: Option<Batch>) -> Option<Batch> {
        batch.filter(|batch| self.sees(batch.owner.as_deref()))
    }

    /// Adds the limits of the service where the key has no limit of its own.
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

    /// Quota of the owner.
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
        // A defect of the router. Refusing is safe.
        parts.extensions.get::<Self>().cloned().ok_or_else(|| {
            tracing::error!(path = parts.uri.path(), "a route is not behind the check of keys");
            Problem::new(Kind::Internal, "The service failed. Its log has this request id.")
        })
    }
}
