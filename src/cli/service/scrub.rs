//! `oviduct scrub`: compares the artifact store with the records, without a service.

use super::{artifacts, artifacts_path, database, is_bucket, location};
use crate::cli::args::ScrubArgs;
use crate::cli::exit::{Ended, Failure};
use crate::cli::term;
use crate::jobs::scrub::{Difference, Scrubbed, scrub};
use crate::jobs::{Database, JobId};
use anyhow::Context;
use serde::Serialize;

/// Result of `oviduct scrub --json`.
#[derive(Default, Serialize)]
struct ScrubReport {
    /// True if there is no difference.
    ok: bool,
    files: u64,
    bytes: u64,
    missing: Vec<Differing>,
    damaged: Vec<Differing>,
    unknown: Vec<String>,
}

/// A file that differs from its record.
#[derive(Serialize)]
struct Differing {
    name: String,
    key: String,
    models: Vec<JobId>,
    #[serde(skip_serializing_if = "Option::is_none")]
    detail: Option<String>,
}

pub(in crate::cli) async fn run(args: ScrubArgs) -> Ended {
    let database = database(&args.database)?;
    // Opening would create what does not exist, and then report that everything is missing.
    if let Database::Sqlite(path) = &database
        && !path.exists()
    {
        let message = format!("the job store {} does not exist; check --database and --data", path.display());
        return Err(Failure::Failed(anyhow::anyhow!(message)));
    }
    let url = args.artifacts.as_deref();
    if !is_bucket(url) {
        let path = artifacts_path(url, &args.database.data)?;
        if !path.is_dir() {
            let message = format!("the artifact store {} does not exist; check --artifacts and --data", path.display());
            return Err(Failure::Failed(anyhow::anyhow!(message)));
        }
    }
    let (artifacts, place) = artifacts(url, &args.database.data)?;
    let opened = database.open_beside_service().await;
    let store = opened.with_context(|| format!("the job store {} could not be opened", location(&database)))?;
    let mut report = ScrubReport::default();
    let mut printed = Ok(());
    let scrubbed = scrub(&store, &artifacts, |difference| {
        if !args.json && printed.is_ok() {
            printed = term::print(&line(&difference));
        }
        report.add(difference);
    });
    let scrubbed = scrubbed.await.with_context(|| format!("the artifact store {place} could not be compared"))?;
    store.close().await;
    printed?;
    let is_ok = report.end(scrubbed);
    if args.json {
        term::print_json(&report)?;
    } else {
        term::print(&report.summary())?;
    }
    if is_ok { Ok(()) } else { Err(Failure::Negative) }
}

impl ScrubReport {
    fn add(&mut self, difference: Difference) {
        match difference {
            Difference::Missing { name, key, jobs } => {
                self.missing.push(Differing { name, key, models: jobs, detail: None });
            }
            Difference::Damaged { name, key, jobs, detail } => {
                self.damaged.push(Differing { name, key, models: jobs, detail: Some(detail) });
            }
            Difference::Unknown { key } => self.unknown.push(key),
        }
    }

    /// Completes the report. Returns true if there is no difference.
    fn end(&mut self, scrubbed: Scrubbed) -> bool {
        (self.files, self.bytes) = (scrubbed.files, scrubbed.bytes);
        self.ok = self.missing.is_empty() && self.damaged.is_empty() && self.unknown.is_empty();
        self.ok
    }

    fn summary(&self) -> String {
        format!(
            "{} files with records ({} bytes): {} missing, {} damaged; {} files without a record",
            self.files,
            self.bytes,
            self.missing.len(),
            self.damaged.len(),
            self.unknown.len()
        )
    }
}

fn line(difference: &Difference) -> String {
    let of = |jobs: &[JobId]| jobs.iter().map(JobId::to_string).collect::<Vec<_>>().join(", ");
    match difference {
        Difference::Missing { name, key, jobs } => format!("missing  {name} at {key} (models {})", of(jobs)),
        Difference::Damaged { name, key, jobs, detail } => {
            format!("damaged  {name} at {key} (models {}): {detail}", of(jobs))
        }
        Difference::Unknown { key } => format!("unknown  {key}"),
    }
}
