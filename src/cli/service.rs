//! A service in this process: job store, artifacts, workers and router put together, and taken apart in order.

use super::args::ServiceArgs;
use super::exit::Failure;
use super::gpu;
use crate::clock::Clock;
use crate::http::{AppState, Limits, router};
use crate::jobs::artifacts::Artifacts;
use crate::jobs::fault::Faults;
use crate::jobs::sqlite::SqliteStore;
use crate::jobs::{Store, StoreOptions};
use crate::worker::{BatchGenerator, PoolOptions, WorkerPool, generate_on_cpu};
use anyhow::Context;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;
use tokio::net::TcpListener;
use tokio::task::JoinHandle;
use tokio_util::sync::CancellationToken;

/// A running service.
pub(super) struct Service {
    address: SocketAddr,
    store: SqliteStore,
    pool: WorkerPool,
    server: JoinHandle<std::io::Result<()>>,
    shutdown: CancellationToken,
    grace: Duration,
}

impl Service {
    /// Opens the stores, takes over what a process before left, starts workers, and serves on `listener`.
    ///
    /// # Errors
    /// [`Failure::Usage`] for stores that there are not; else where something cannot be opened.
    pub(super) async fn start(args: &ServiceArgs, listener: TcpListener) -> Result<Self, Failure> {
        if args.heartbeat.is_zero() || args.lease < 2 * args.heartbeat {
            return Err(Failure::usage("--lease must be at least twice --heartbeat, and this more than 0"));
        }
        let database = local_path("--database", args.database.as_deref(), "sqlite", &args.data, "oviduct.db")?;
        let files = local_path("--artifacts", args.artifacts.as_deref(), "file", &args.data, "artifacts")?;

        let clock = Clock::System;
        let options =
            StoreOptions { clock: clock.clone(), max_attempts: args.max_attempts, queue_limit: args.queue_limit };
        let store = SqliteStore::open(&database, options).await.context("the job store could not be opened")?;
        let artifacts = Artifacts::local(&files).context("the artifact store could not be opened")?;
        let left = store.recover().await.context("what the last process left could not be taken over")?;
        if !left.is_empty() {
            tracing::warn!(jobs = left.len(), "jobs of a process that ended without notice were taken over");
        }
        let shared: Arc<dyn Store> = Arc::new(store.clone());
        sweep(shared.clone(), artifacts.clone(), &clock);

        let found = gpu::generators(args.gpu).await;
        let no_gpu = found.as_ref().err().cloned();
        let gpus: Vec<Arc<dyn BatchGenerator>> =
            found.into_iter().flatten().map(|gpu| Arc::new(gpu) as Arc<dyn BatchGenerator>).collect();
        let options = PoolOptions {
            workers: args.cpu_workers,
            batch: args.gpu_batch,
            no_gpu,
            heartbeat: args.heartbeat,
            lease: args.lease,
            memory_limit_bytes: args.memory_limit,
            faults: Faults::from_env().map_err(|error| Failure::usage(error.to_string()))?,
            ..PoolOptions::new(args.data.join("scratch"))
        };
        let pool = WorkerPool::start_with_gpus(
            shared.clone(),
            artifacts.clone(),
            Arc::new(generate_on_cpu),
            gpus,
            options,
            clock.clone(),
        )
        .context("the workers could not be started")?;

        let address = listener.local_addr().context("the listening socket has no address")?;
        let shutdown = CancellationToken::new();
        let state = AppState::new(shared, artifacts, clock, Limits::default(), shutdown.clone());
        let serving = axum::serve(listener, router(state)).with_graceful_shutdown(shutdown.clone().cancelled_owned());
        let server = tokio::spawn(serving.into_future());
        Ok(Self { address, store, pool, server, shutdown, grace: args.grace })
    }

    /// Where it listens.
    pub(super) fn address(&self) -> SocketAddr {
        self.address
    }

    /// Comes back only where the server ends although nobody asked it to.
    pub(super) async fn failed(&mut self) -> anyhow::Error {
        match (&mut self.server).await {
            Ok(Ok(())) => anyhow::anyhow!("the server ended unasked"),
            Ok(Err(error)) => anyhow::anyhow!(error).context("the server failed"),
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
        self.pool.shutdown(self.grace).await;
        let ended = match failed {
            Some(error) => Err(error.into()),
            // Requests have had the grace too; those that still hang are cut off with the runtime.
            None => match tokio::time::timeout(LAST_REQUESTS, &mut self.server).await {
                Ok(Ok(served)) => served.context("the server failed").map_err(Failure::from),
                Ok(Err(panic)) => Err(anyhow::anyhow!(panic).context("the server panicked").into()),
                Err(_) => {
                    tracing::warn!("some requests did not end and were cut off");
                    Ok(())
                }
            },
        };
        self.store.close().await;
        ended
    }
}

/// Time for the last answers to leave once the workers have stopped.
const LAST_REQUESTS: Duration = Duration::from_secs(5);

/// Removes, in the background, files that attempts of earlier processes left; no record names them.
///
/// The store is this process's alone, so whatever is older than its start and not named is nobody's.
fn sweep(store: Arc<dyn Store>, artifacts: Artifacts, clock: &Clock) {
    let now = clock.now();
    tokio::spawn(async move {
        match artifacts.sweep_orphans(store.as_ref(), now, Duration::ZERO).await {
            Ok(0) => {}
            Ok(files) => tracing::info!(files, "files that no model names were removed"),
            Err(error) => tracing::warn!(%error, "files that no model names could not be removed"),
        }
    });
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
        let path = |url| local_path("--database", url, "sqlite", Path::new("d"), "x.db").map_err(|f| f.report().1);
        assert_eq!(path(None), Ok("d/x.db".into()));
        assert_eq!(path(Some("a/b.db")), Ok("a/b.db".into()));
        assert_eq!(path(Some("sqlite:a/b.db")), Ok("a/b.db".into()));
        assert_eq!(path(Some("sqlite:///a/b.db")), Ok("/a/b.db".into()));
        assert_eq!(path(Some("C:\\b.db")), Ok("C:\\b.db".into()));
        for wrong in ["postgres://h/d", "sqlite:", "", "s3://bucket"] {
            assert!(path(Some(wrong)).is_err(), "{wrong}");
        }
    }
}
