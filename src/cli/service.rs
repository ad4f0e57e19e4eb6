//! A service in this process: job store, artifacts, workers and router put together, and taken apart in order.

use super::args::{DatabaseArgs, ServiceArgs};
use super::connections::{self, Connections};
use super::exit::Failure;
use super::gpu;
use super::upkeep::{self, Ground, Upkeep};
use crate::clock::Clock;
use crate::http::{AppState, Limits, router};
use crate::jobs::artifacts::Artifacts;
use crate::jobs::fault::Faults;
use crate::jobs::sweep::Retention;
use crate::jobs::{Database, Store, StoreOptions};
use crate::metrics::Metrics;
use crate::worker::{BatchGenerator, PoolOptions, WorkerPool, generate_on_cpu};
use anyhow::Context;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;
use tokio::net::TcpListener;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

/// The stores, and the workers of this process over them.
pub(super) struct Works {
    store: Arc<dyn Store>,
    artifacts: Artifacts,
    pool: WorkerPool,
    upkeep: Upkeep,
    metrics: Metrics,
    grace: Duration,
}

/// Whether works without a worker are of use.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Hands {
    /// They are: others work.
    Optional,
    /// They are not.
    Needed,
}

/// A running service.
pub(super) struct Service {
    address: SocketAddr,
    works: Works,
    server: JoinHandle<()>,
    shutdown: CancellationToken,
}

/// The database that the options name.
///
/// # Errors
/// [`Failure::Usage`].
pub(super) fn database(args: &DatabaseArgs) -> Result<Database, Failure> {
    match &args.database {
        Some(url) => Database::parse(url).map_err(|fault| Failure::usage(format!("--database: {fault}"))),
        None => Ok(Database::Sqlite(args.data.join("oviduct.db"))),
    }
}

impl Works {
    /// Opens the stores, takes over what a process before left, starts workers.
    ///
    /// # Errors
    /// [`Failure::Usage`] for stores that there are not, and where hands are needed and there are none; else where something
    /// cannot be opened.
    pub(super) async fn start(args: &ServiceArgs, hands: Hands) -> Result<Self, Failure> {
        if args.heartbeat.is_zero() || args.lease < 2 * args.heartbeat {
            return Err(Failure::usage("--lease must be at least twice --heartbeat, and this more than 0"));
        }
        let database = database(&args.database)?;
        let found = gpu::generators(args.gpu).await;
        if let (Hands::Needed, 0, Err(why)) = (hands, args.cpu_workers, &found) {
            return Err(Failure::usage(format!("--cpu-workers 0 leaves nothing that could work: {why}")));
        }
        let data = &args.database.data;
        let clock = Clock::System;
        let options =
            StoreOptions { clock: clock.clone(), max_attempts: args.max_attempts, queue_limit: args.queue_limit };
        let store = database.open(options).await.context("the job store could not be opened")?;
        let (artifacts, shared) = artifacts(args)?;
        // What others share, others may just be writing.
        let orphans = if shared || database.is_shared() { upkeep::ORPHAN_AGE } else { Duration::ZERO };
        let metrics = Metrics::default();
        let limits = &args.upkeep;
        let ground = Ground {
            store: Arc::clone(&store),
            artifacts: artifacts.clone(),
            clock: clock.clone(),
            metrics: metrics.clone(),
        };
        let upkeep = Upkeep::start(ground, Retention { age: limits.keep, bytes: limits.keep_bytes }, orphans);

        let no_gpu = found.as_ref().err().cloned();
        let gpus: Vec<Arc<dyn BatchGenerator>> =
            found.into_iter().flatten().map(|gpu| Arc::new(gpu) as Arc<dyn BatchGenerator>).collect();
        let defaults = PoolOptions::new(data.join("scratch"));
        let options = PoolOptions {
            workers: args.cpu_workers,
            threads: args.cpu_threads.map_or(defaults.threads, |threads| threads as usize),
            batch: args.gpu_batch,
            no_gpu,
            heartbeat: args.heartbeat,
            lease: args.lease,
            memory_limit_bytes: args.memory_limit,
            job_timeout: limits.job_timeout,
            checkpoint_every: Some(limits.checkpoint_every).filter(|every| !every.is_zero()),
            metrics: metrics.clone(),
            faults: Faults::from_env().map_err(|error| Failure::usage(error.to_string()))?,
            ..defaults
        };
        let pool = WorkerPool::start_with_gpus(
            Arc::clone(&store),
            artifacts.clone(),
            Arc::new(generate_on_cpu),
            gpus,
            options,
            clock,
        )
        .context("the workers could not be started")?;
        Ok(Self { store, artifacts, pool, upkeep, metrics, grace: args.grace })
    }

    /// What a router over these works shares.
    pub(super) fn state(&self, limits: Limits, shutdown: &CancellationToken) -> AppState {
        AppState::new(Arc::clone(&self.store), self.artifacts.clone(), limits, shutdown.clone())
            .with_metrics(self.metrics.clone())
    }

    /// Lets running models end within the grace, gives the others back to the queue, closes the store once `last`
    /// is done.
    pub(super) async fn stop<T>(self, last: impl Future<Output = T>) -> T {
        self.pool.shutdown(self.grace).await;
        let ended = last.await;
        drop(self.upkeep);
        self.store.close().await;
        ended
    }
}

impl Service {
    /// Starts the works, and serves on `listener`.
    ///
    /// # Errors
    /// As [`Works::start`].
    pub(super) async fn start(args: &ServiceArgs, listener: TcpListener) -> Result<Self, Failure> {
        let works = Works::start(args, Hands::Optional).await?;
        let address = listener.local_addr().context("the listening socket has no address")?;
        let shutdown = CancellationToken::new();
        let connections = Connections::new(args.upkeep.connections, connections::WRITE_TIME).with_grace(args.grace);
        let defaults = Limits::default();
        let limits = Limits {
            // What is held open leaves places for who asks and goes, such as a health check.
            streams: defaults.streams.min(connections.most / 2),
            held: defaults.held.min(connections.most / 4),
            downloads: connections::downloads(),
            batch: args.upkeep.batch_limit as usize,
            keep: args.upkeep.keep,
            redirect_downloads: args.upkeep.redirect_downloads,
            ..defaults
        };
        let state = works.state(limits, &shutdown);
        let server = tokio::spawn(connections::serve(listener, router(state), connections, shutdown.clone()));
        Ok(Self { address, works, server, shutdown })
    }

    /// Where it listens.
    pub(super) fn address(&self) -> SocketAddr {
        self.address
    }

    /// Comes back only where the server ends although nobody asked it to.
    pub(super) async fn failed(&mut self) -> anyhow::Error {
        match (&mut self.server).await {
            Ok(()) => anyhow::anyhow!("the server ended unasked"),
            Err(panic) => anyhow::anyhow!(panic).context("the server panicked"),
        }
    }

    /// Takes no more requests and ends event streams, lets running models end within the grace and gives the others
    /// back to the queue, closes the store. `failed` is what [`Service::failed`] said, where it did.
    ///
    /// # Errors
    /// `failed`, or that of the server.
    pub(super) async fn stop(mut self, failed: Option<anyhow::Error>) -> Result<(), Failure> {
        self.shutdown.cancel();
        let requests = async {
            match failed {
                Some(error) => Err(error.into()),
                // Requests have had the grace too; those that still hang are cut off with the runtime.
                None => match tokio::time::timeout(LAST_REQUESTS, &mut self.server).await {
                    Ok(Ok(())) => Ok(()),
                    Ok(Err(panic)) => Err(anyhow::anyhow!(panic).context("the server panicked").into()),
                    Err(_) => {
                        tracing::warn!("some requests did not end and were cut off");
                        Ok(())
                    }
                },
            }
        };
        self.works.stop(requests).await
    }
}

/// Time for the last answers to leave once the workers have stopped.
const LAST_REQUESTS: Duration = Duration::from_secs(5);

/// The artifact store that the options name, and whether other processes may be writing to it.
///
/// # Errors
/// [`Failure::Usage`] for one that there is not; else where it cannot be opened.
fn artifacts(args: &ServiceArgs) -> Result<(Artifacts, bool), Failure> {
    match args.artifacts.as_deref().filter(|url| url.starts_with("s3:")) {
        Some(url) => match Artifacts::s3(url, std::env::vars()) {
            Ok(artifacts) => Ok((artifacts, true)),
            Err(error) => Err(Failure::usage(format!("--artifacts: {error}"))),
        },
        None => {
            let data = &args.database.data;
            let files = local_path("--artifacts", args.artifacts.as_deref(), "file", data, "artifacts")?;
            let artifacts = Artifacts::local(&files).context("the artifact store could not be opened")?;
            Ok((artifacts, false))
        }
    }
}

/// The path in `scheme:PATH`, `scheme://PATH` or a plain path; `data/name` where none is given.
fn local_path(option: &str, url: Option<&str>, scheme: &str, data: &Path, name: &str) -> Result<PathBuf, Failure> {
    let Some(url) = url else { return Ok(data.join(name)) };
    let path = match url.split_once(':') {
        Some((given, rest)) if given == scheme => rest.strip_prefix("//").unwrap_or(rest),
        Some((given, _)) if given.len() > 1 && given.bytes().all(|b| b.is_ascii_alphanumeric()) => {
            return Err(Failure::usage(format!("{option} {url}: only {scheme}:PATH is there yet, not {given}:")));
        }
        _ => url,
    };
    if path.is_empty() {
        return Err(Failure::usage(format!("{option} {url}: names no path")));
    }
    Ok(PathBuf::from(path))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_of_stores() {
        let path = |url| local_path("--artifacts", url, "file", Path::new("d"), "files").map_err(|f| f.report().1);
        assert_eq!(path(None), Ok("d/files".into()));
        assert_eq!(path(Some("a/b")), Ok("a/b".into()));
        assert_eq!(path(Some("file:a/b")), Ok("a/b".into()));
        assert_eq!(path(Some("file:///a/b")), Ok("/a/b".into()));
        assert_eq!(path(Some("C:\\b")), Ok("C:\\b".into()));
        for wrong in ["sqlite:a", "file:", "", "s3://bucket"] {
            assert!(path(Some(wrong)).is_err(), "{wrong}");
        }
    }
}
