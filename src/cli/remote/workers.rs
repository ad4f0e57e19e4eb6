//! `oviduct workers`: lists the workers of a service; pauses, resumes or drains them.

use super::client::Client;
use crate::cli::args::{WorkersAction, WorkersArgs};
use crate::cli::exit::{Ended, Failure};
use crate::cli::term;
use anyhow::Context;
use serde::Deserialize;
use serde_json::Value;

/// Members of `GET /workers` that are shown.
#[derive(Debug, Deserialize)]
struct WorkerList {
    pause: Option<Pause>,
    workers: Vec<Worker>,
}

#[derive(Debug, Deserialize)]
struct Worker {
    id: String,
    backend: String,
    device: String,
    jobs: Vec<String>,
    jobs_done: u64,
    state: String,
    /// Absent in responses of older services.
    #[serde(default)]
    condition: Option<String>,
}

#[derive(Debug, Deserialize)]
struct Pause {
    since: String,
    by: Option<String>,
}

pub(in crate::cli) async fn run(args: WorkersArgs) -> Ended {
    let path = path(args.action, args.name.as_deref())?;
    let client = Client::new(&args.service.url, args.service.key.as_ref())?;
    let answer = match args.action {
        WorkersAction::List => client.get("/workers").await?,
        _ => client.post(&path).await?,
    };
    let answer: Value = answer.json().await.context("the service's answer is not JSON")?;
    if args.json {
        return Ok(term::print_json(&answer)?);
    }
    let lines = if args.name.is_some() {
        vec![Worker::deserialize(&answer).context("the service's answer is not a worker")?.line()]
    } else {
        WorkerList::deserialize(&answer).context("the service's answer is no list of workers")?.lines()
    };
    Ok(lines.iter().try_for_each(|line| term::print(line))?)
}

/// Returns the segments of the path to post to.
///
/// # Errors
/// [`Failure::Usage`] if the action needs a name or takes none.
fn path(action: WorkersAction, name: Option<&str>) -> Result<Vec<&str>, Failure> {
    let verb = match action {
        WorkersAction::List => "list",
        WorkersAction::Pause => "pause",
        WorkersAction::Resume => "resume",
        WorkersAction::Drain => "drain",
    };
    match name {
        // As segments of a path these names would select another resource.
        Some(name @ ("." | "..")) => Err(Failure::usage(format!("NAME: there is no worker {name}"))),
        Some(_) if action == WorkersAction::List => Err(Failure::usage("NAME: list takes no name")),
        None if action == WorkersAction::Drain => Err(Failure::usage("NAME: drain needs the name of a worker")),
        Some(name) => Ok(vec!["workers", name, verb]),
        None => Ok(vec!["workers", verb]),
    }
}

impl Worker {
    fn line(&self) -> String {
        let Self { id, backend, device, state, jobs, jobs_done, condition } = self;
        let condition = condition.as_ref().map(|name| format!(", unable to claim: {name}")).unwrap_or_default();
        format!("{id}  {state}{condition}  {backend} ({device})  {} running, {jobs_done} ended", jobs.len())
    }
}

impl WorkerList {
    fn lines(&self) -> Vec<String> {
        let pause = self.pause.as_ref().map(|Pause { since, by }| {
            let by = by.as_ref().map(|by| format!(" by {by}")).unwrap_or_default();
            format!("all workers are paused since {since}{by}")
        });
        pause.into_iter().chain(self.workers.iter().map(Worker::line)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn actions_are_paths() {
        let path = |action, name| path(action, name).map_err(|failure| failure.report().0);
        assert_eq!(path(WorkersAction::Pause, None), Ok(vec!["workers", "pause"]));
        assert_eq!(path(WorkersAction::Resume, Some("a b/c")), Ok(vec!["workers", "a b/c", "resume"]));
        assert_eq!(path(WorkersAction::Drain, Some("w")), Ok(vec!["workers", "w", "drain"]));
        let wrong = [
            (WorkersAction::Drain, None),
            (WorkersAction::List, Some("w")),
            (WorkersAction::Pause, Some("..")),
            (WorkersAction::Pause, Some(".")),
        ];
        for (action, name) in wrong {
            assert_eq!(path(action, name), Err(2), "{action:?} {name:?}");
        }
    }

    #[test]
    fn a_list_is_a_line_for_each_worker() {
        let list = json!({
            "pause": { "since": "2026-01-02T03:04:05Z", "by": "ada" },
            "workers": [{ "id": "h-1-0", "host": "h", "backend": "cpu", "device": "8 threads", "job": "x", "jobs": ["x"],
                "jobs_done": 7, "heartbeat_at": "2026-01-02T03:04:05Z", "state": "draining", "pause": null },
                { "id": "h-1-1", "backend": "gpu", "device": "H200", "jobs": [], "jobs_done": 0, "state": "active",
                "condition": "storage" }],
        });
        assert_eq!(
            WorkerList::deserialize(list).expect("a list").lines(),
            [
                "all workers are paused since 2026-01-02T03:04:05Z by ada",
                "h-1-0  draining  cpu (8 threads)  1 running, 7 ended",
                "h-1-1  active, unable to claim: storage  gpu (H200)  0 running, 0 ended"
            ]
        );
    }
}
