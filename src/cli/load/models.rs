//! Results of the models of a run, from the records of the service.
//!
//! The models are found by the label of the run. A model whose acceptance was lost is therefore
//! counted, too.

use super::calls;
use super::errors::Lost;
use super::target::Target;
use super::times::{Times, add, histogram};
use crate::cli::exit::Failure;
use crate::cli::remote::client::{self, Model, RemoteFile};
use jiff::Timestamp;
use reqwest::Method;
use serde::{Deserialize, Serialize};
use std::collections::HashSet;
use std::sync::Arc;
use std::time::Duration;

/// Interval between two reads of the models.
const LOOK: Duration = Duration::from_secs(1);
/// Maximum number of requests for a page.
const TRIES: u32 = 5;

/// A page of records.
#[derive(Debug, Deserialize)]
struct Page {
    models: Vec<Listed>,
    next: Option<String>,
}

/// The record of a model.
#[derive(Clone, Debug, Deserialize)]
struct Listed {
    #[serde(flatten)]
    model: Model,
    created_at: Timestamp,
    started_at: Option<Timestamp>,
    finished_at: Option<Timestamp>,
}

/// Results of the models of a run, without those that were requested during the warm-up. Times are
/// by the clock of the service.
#[derive(Debug, Default, Serialize)]
pub(super) struct Models {
    /// Models that the service knows.
    pub(super) models: u64,
    pub(super) succeeded: u64,
    /// Ended without success.
    pub(super) failed: u64,
    /// Not ended yet.
    pub(super) unended: u64,
    /// Accepted, but unknown to the service.
    pub(super) missing: u64,
    /// Created by requests whose response was lost.
    pub(super) unanswered: u64,
    /// Size of all files.
    pub(super) bytes: u64,
    /// Models that ended per second, between the first creation and the last end. Includes models
    /// of the warm-up that ended in this time, because the workers grew them, too.
    pub(super) per_second: f64,
    /// From created to started.
    pub(super) queue_wait: Times,
    /// From created to ended.
    pub(super) end_to_end: Times,
}

impl Models {
    /// Counts these records. `counted` and `uncounted` are the models whose acceptance was
    /// received.
    fn of(listed: &[Listed], counted: &HashSet<Arc<str>>, uncounted: &HashSet<Arc<str>>) -> Self {
        let mut models = Self { missing: counted.len() as u64, ..Self::default() };
        let (mut waits, mut ends) = (Vec::new(), Vec::new());
        let (mut first, mut last) = (Timestamp::MAX, Timestamp::MIN);
        for listed in listed.iter().filter(|listed| !uncounted.contains(&*listed.model.id)) {
            models.models += 1;
            if counted.contains(&*listed.model.id) {
                models.missing -= 1;
            } else {
                models.unanswered += 1;
            }
            match listed.model.status.as_str() {
                "succeeded" => models.succeeded += 1,
                _ if listed.model.is_ended() => models.failed += 1,
                _ => models.unended += 1,
            }
            models.bytes += listed.model.files.iter().map(|file: &RemoteFile| file.bytes).sum::<u64>();
            waits.extend(listed.started_at.map(|at| at.duration_since(listed.created_at)));
            ends.extend(listed.finished_at.map(|at| at.duration_since(listed.created_at)));
            first = first.min(listed.created_at);
            last = last.max(listed.finished_at.unwrap_or(Timestamp::MIN));
        }
        if last > first {
            let within = listed.iter().filter_map(|listed| listed.finished_at).filter(|at| (first..=last).contains(at));
            models.per_second = within.count() as f64 / last.duration_since(first).as_secs_f64();
        }
        [models.queue_wait, models.end_to_end] = [waits, ends].map(|times| {
            let mut all = histogram(3);
            for time in times {
                // The clock of another process may be slightly behind.
                add(&mut all, Duration::try_from(time).unwrap_or_default());
            }
            Times::of(&all)
        });
        models
    }
}

async fn page(target: &Target, query: &str) -> Result<Page, Failure> {
    let request = target.client.request(Method::GET, &target.listing(query)).timeout(target.timeout);
    Ok(client::accept(request.send().await?).await?.json().await?)
}

/// Looks for succeeded models at intervals, so that calls have files to download. Runs forever.
pub(super) async fn scout(target: Arc<Target>) {
    loop {
        // The next request may succeed.
        if let Ok(page) = page(&target, "status=succeeded&limit=100").await {
            for Listed { model, .. } in page.models {
                target.known.end(&model.id, calls::largest(&model));
            }
        }
        tokio::time::sleep(LOOK).await;
    }
}

/// Waits until no model of the run is queued or running. Retries after errors, so that the service
/// may restart.
pub(super) async fn wait(target: &Target) {
    loop {
        // In this order: a model that leaves the queue in between is found running or has ended.
        let queued = page(target, "status=queued&limit=1").await;
        let running = page(target, "status=running&limit=1").await;
        if let (Ok(queued), Ok(running)) = (queued, running)
            && queued.models.is_empty()
            && running.models.is_empty()
        {
            return;
        }
        tokio::time::sleep(LOOK).await;
    }
}

/// Reads the records of all models of the run.
///
/// # Errors
/// If the service does not respond for several seconds.
pub(super) async fn read(target: &Target) -> Result<Models, Lost> {
    let (mut listed, mut query) = (Vec::new(), "limit=100".to_owned());
    loop {
        let Page { models, next } = patiently(target, &query).await?;
        listed.extend(models);
        match next {
            Some(next) => query = format!("limit=100&cursor={next}"),
            None => break,
        }
    }
    let (counted, uncounted) = target.known.ids();
    Ok(Models::of(&listed, &counted, &uncounted))
}

/// Requests a page, with retries. Without an accepted model there are none: the service may never
/// have existed.
async fn patiently(target: &Target, query: &str) -> Result<Page, Failure> {
    for _ in 1..if target.known.is_empty() { 1 } else { TRIES } {
        if let Ok(page) = page(target, query).await {
            return Ok(page);
        }
        tokio::time::sleep(LOOK).await;
    }
    page(target, query).await
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn models_are_counted_by_their_records() {
        let at = |second: u32| format!("2026-11-21T09:00:{second:02}Z");
        let listed: Vec<Listed> = serde_json::from_value(json!([
            { "id": "a", "status": "succeeded", "created_at": at(0), "started_at": at(1), "finished_at": at(3),
              "files": [{ "name": "model.glb", "bytes": 5, "sha256": "", "href": "/f" }] },
            { "id": "b", "status": "failed", "created_at": at(2), "started_at": at(6), "finished_at": at(10) },
            { "id": "c", "status": "running", "created_at": at(3), "started_at": at(5), "finished_at": null },
            { "id": "d", "status": "cancelled", "created_at": at(4), "started_at": null, "finished_at": at(8) },
            { "id": "warm", "status": "succeeded", "created_at": at(0), "started_at": at(0), "finished_at": at(2) },
            { "id": "late", "status": "succeeded", "created_at": at(0), "started_at": at(0), "finished_at": at(59) },
        ]))
        .expect("records");
        let ids = |ids: &[&str]| ids.iter().map(|id| Arc::from(*id)).collect();
        let models = Models::of(&listed, &ids(&["a", "b", "c", "gone"]), &ids(&["warm", "late"]));
        assert_eq!((models.models, models.succeeded, models.failed, models.unended), (4, 1, 2, 1));
        assert_eq!((models.missing, models.unanswered, models.bytes), (1, 1, 5));
        assert!((models.per_second - 0.4).abs() < 1e-9, "{}", models.per_second);
        assert!((models.queue_wait.max - 4.0).abs() < 0.01 && (models.end_to_end.max - 8.0).abs() < 0.01, "{models:?}");
        assert!((models.queue_wait.p50 - 2.0).abs() < 0.01, "{models:?}");
    }
}
