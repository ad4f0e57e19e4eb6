//! Assembly and shutdown of a process: job store, artifact store, workers and, for `serve`, the
//! router with its listeners.

pub(super) mod connections;
pub(super) mod keys;
pub(super) mod run;
pub(super) mod scrub;
mod upkeep;

use crate::cli::args::{DatabaseArgs, GpuUse, ProcessArgs, ServeArgs};
use crate::cli::exit::Failure;
use crate::cli::{gpu, term};
use crate::http::{AccessOptions, AppState, Limits, WithoutKeys, execute_operations, router, watch_router};
use crate::jobs::artifacts::Artifacts;
use crate::jobs::fault::Faults;
use crate::jobs::keys::{KeyLimits, NewKey, NoOwner, Scope, Secret};
use crate::jobs::sweep::Retention;
use crate::jobs::{Database, MAX_LEASE, Quota, Store, StoreOptions};
use crate::metrics::Metrics;
use crate::status::{Condition, Status};
use crate::worker::{ALIVE_HEARTBEATS, BatchGenerator, PoolOptions, WorkerPool, generate_on_cpu, lower_priority};
use anyhow::Context;
use axum::Router;
use connections::Connections;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;
use tokio::net::TcpListener;
use tokio::task::{JoinHandle, JoinSet};
use tokio_util::sync::CancellationToken;
use upkeep::{Locations, UpkeepContext};

/// Minimum time to send the last responses during a shutdown, even with a shorter `--grace`.
const LAST_ANSWERS: Duration = Duration::from_secs(5);

/// The stores and the workers of this process.
pub(in crate::cli) struct Runtime {
    store: Store,
    artifacts: Artifacts,
    pool: WorkerPool,
    metrics: Metrics,
    status: Status,
    grace: Duration,
}

/// The open stores of a process.
struct Stores {
    jobs: Store,
    artifacts: Artifacts,
    locations: Locations,
}

/// A running service.
pub struct Service {
    address: SocketAddr,
    runtime: Runtime,
    upkeep: JoinSet<()>,
    server: JoinHandle<()>,
    shutdown: CancellationToken,
    /// Ends the listener of probes, which responds longer than the other listener.
    probes_shutdown: CancellationToken,
    drain_delay: Duration,
}

/// Returns the database that the options select.
///
/// # Errors
/// [`Failure::Usage`].
pub(in crate::cli) fn database(args: &DatabaseArgs) -> Result<Database, Failure> {
    match &args.database {
        Some(url) => Database::parse(url).map_err(|fault| Failure::usage(format!("--database: {fault}"))),
        None => Ok(Database::Sqlite(args.data.join("oviduct.db"))),
    }
}

/// Returns the location of a database for messages, without credentials.
pub(in crate::cli) fn location(database: &Database) -> String {
    match database {
        Database::Sqlite(path) => path.display().to_string(),
        Database::Postgres(url) => reqwest::Url::parse(url).map_or_else(
            |_| "on PostgreSQL".to_owned(),
            |url| {
                let port = url.port().map(|port| format!(":{port}")).unwrap_or_default();
                format!("postgres://{}{port}{}", url.host_str().unwrap_or_default(), url.path())
            },
        ),
    }
}

impl Stores {
    /// Opens both stores and updates the database schema.
    ///
    /// # Errors
    /// [`Failure::Usage`] for an unknown kind of store; [`Failure::Failed`] if a store cannot be
    /// opened.
    async fn open(args: &ProcessArgs, queue_limit: Option<u64>) -> Result<Self, Failure> {
        let database = database(&args.database)?;
        let defaults = StoreOptions::default();
        let options = StoreOptions {
            max_attempts: args.max_attempts,
            queue_limit: queue_limit.unwrap_or(defaults.queue_limit),
            connections: args.database_connections,
            readers: args.database_readers,
            ..defaults
        };
        let jobs = database
            .open(options)
            .await
            .with_context(|| format!("the job store {} could not be opened", location(&database)))?;
        let (artifacts, place) = artifacts(args.artifacts.as_deref(), &args.database.data)?;
        Ok(Self { jobs, artifacts, locations: Locations { jobs: location(&database), artifacts: place } })
    }
}

impl Runtime {
    /// Opens the stores and starts the workers of a process that does nothing else, without upkeep.
    ///
    /// # Errors
    /// [`Failure::Usage`] for invalid options, or if there are no workers; [`Failure::Failed`] if
    /// something cannot be opened.
    pub(in crate::cli) async fn start(args: &ProcessArgs) -> Result<Self, Failure> {
        let gpus = find_gpus(args).await?;
        if let (Err(reason), 0) = (&gpus, args.cpu_workers) {
            return Err(Failure::usage(format!("--cpu-workers 0 leaves this process without a worker: {reason}")));
        }
        let stores = Stores::open(args, None).await?;
        Self::over(stores, args, gpus, Metrics::default())
    }

    fn over(stores: Stores, args: &ProcessArgs, gpus: Gpus, metrics: Metrics) -> Result<Self, Failure> {
        let status = Status::default();
        let defaults = PoolOptions::new(args.database.data.join("scratch"));
        let options = PoolOptions {
            workers: args.cpu_workers,
            threads: args.cpu_threads.map_or(defaults.threads, |threads| threads as usize),
            nice: args.worker_nice,
            batch: args.gpu_batch,
            no_gpu: gpus.as_ref().err().cloned(),
            heartbeat: args.heartbeat,
            lease: args.lease,
            memory_limit_bytes: args.memory_limit,
            job_timeout: args.job_timeout,
            checkpoint_every: Some(args.checkpoint_every).filter(|every| !every.is_zero()),
            metrics: metrics.clone(),
            status: status.clone(),
            faults: Faults::from_env().map_err(|error| Failure::usage(error.to_string()))?,
            ..defaults
        };
        let pool = WorkerPool::start(
            stores.jobs.clone(),
            stores.artifacts.clone(),
            Arc::new(generate_on_cpu),
            gpus.unwrap_or_default(),
            options,
        )
        .context("the workers could not be started")?;
        Ok(Self { store: stores.jobs, artifacts: stores.artifacts, pool, metrics, status, grace: args.grace })
    }

    /// Returns the state that the handlers of a router share.
    pub(in crate::cli) fn state(&self, limits: Limits, shutdown: &CancellationToken) -> AppState {
        AppState::new(self.store.clone(), self.artifacts.clone(), limits, shutdown.clone())
            .with_metrics(self.metrics.clone())
            .with_status(self.status.clone())
    }

    /// Makes `/readyz` respond with 503.
    pub(in crate::cli) fn drain(&self) {
        self.status.set(Condition::Draining, "The process is shutting down.");
    }

    /// Stops claiming, gives running models `--grace` to finish and releases the others to the
    /// queue. Runs `requests` at the same time, and closes the store when both are done.
    pub(in crate::cli) async fn stop<T>(self, requests: impl Future<Output = T>) -> T {
        let ((), ended) = tokio::join!(self.pool.shutdown(self.grace), requests);
        self.store.close().await;
        ended
    }
}

/// Generators for the GPUs that workers use, or the reason why there are none.
type Gpus = Result<Vec<Arc<dyn BatchGenerator>>, String>;

/// Returns the GPUs that the options allow.
///
/// # Errors
/// [`Failure::Usage`] for leases that are too short or too long, and for a GPU that does not exist.
async fn find_gpus(args: &ProcessArgs) -> Result<Gpus, Failure> {
    if args.lease < 2 * args.heartbeat {
        return Err(Failure::usage("--lease must be at least twice --heartbeat"));
    }
    if args.lease > MAX_LEASE {
        return Err(Failure::usage(format!("--lease must be at most {} s", MAX_LEASE.as_secs())));
    }
    match gpu::generators(&args.gpu).await {
        Err(reason) if matches!(args.gpu.gpu, GpuUse::One(_)) => Err(Failure::usage(format!("--gpu: {reason}"))),
        found => Ok(found),
    }
}

impl Service {
    /// Opens the stores, starts upkeep and workers, and serves on `listener`. Also serves probes
    /// and metrics on `probes`.
    ///
    /// # Errors
    /// [`Failure::Usage`] for invalid options; [`Failure::Failed`] if something cannot be opened.
    pub async fn start(args: &ServeArgs, listener: TcpListener, probes: Option<TcpListener>) -> Result<Self, Failure> {
        let address = listener.local_addr().context("the listening socket has no address")?;
        // Computations for requests take turns with the workers. Fails if the process has used the
        // pool before, as tests do.
        let nice = args.process.worker_nice;
        let _ = rayon::ThreadPoolBuilder::new().start_handler(move |_| lower_priority(nice)).build_global();
        let gpus = find_gpus(&args.process).await?;
        let stores = Stores::open(&args.process, Some(args.queue_limit)).await?;
        let metrics = Metrics::default();
        let context = UpkeepContext {
            store: stores.jobs.clone(),
            artifacts: stores.artifacts.clone(),
            metrics: metrics.clone(),
            locations: stores.locations.clone(),
        };
        let retention = Retention { age: args.keep, bytes: args.keep_bytes };
        let mut upkeep = upkeep::start(context, retention, args.sweep_now);
        let access = access(args, address, &stores.jobs).await?;
        let has_workers = args.process.cpu_workers > 0 || gpus.is_ok();
        let runtime = Runtime::over(stores, &args.process, gpus, metrics)?;

        let connections = connections(&args.process);
        let shutdown = CancellationToken::new();
        let probes_shutdown = CancellationToken::new();
        let state = runtime.state(limits(args, connections.most, has_workers)?, &shutdown).with_access(access);
        upkeep.spawn(execute_operations(state.clone()));
        if let Some(listener) = probes {
            serve_probes(listener, watch_router(state.clone()), &probes_shutdown);
        }
        let server = tokio::spawn(connections::serve(listener, router(state), connections, shutdown.clone()));
        Ok(Self { address, runtime, upkeep, server, shutdown, probes_shutdown, drain_delay: args.drain_delay })
    }

    /// Returns the address of the listener.
    #[must_use]
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Waits for a failure of the server; returns only if the server ends without being stopped.
    pub(in crate::cli) async fn failed(&mut self) -> anyhow::Error {
        match (&mut self.server).await {
            Ok(()) => anyhow::anyhow!("the server ended unexpectedly"),
            Err(panic) => anyhow::anyhow!(panic).context("the server panicked"),
        }
    }

    /// Stops in this order: `/readyz` fails and workers stop claiming; after `--drain-delay` no
    /// more connections are accepted and event streams end; running models and open downloads get
    /// `--grace` to finish; the store is closed. `failed` is the result of `Service::failed`, if
    /// it returned.
    ///
    /// # Errors
    /// `failed`, or a panic of the server.
    pub async fn stop(self, failed: Option<anyhow::Error>) -> Result<(), Failure> {
        let Self { runtime, upkeep, server, shutdown, probes_shutdown, drain_delay, .. } = self;
        runtime.drain();
        drop(upkeep);
        let requests = async {
            if let Some(error) = failed {
                return Err(error.into());
            }
            tokio::time::sleep(drain_delay).await;
            shutdown.cancel();
            // The server cuts off requests that take longer than `--grace`.
            server.await.map_err(|panic| anyhow::anyhow!(panic).context("the server panicked").into())
        };
        let ended = runtime.stop(requests).await;
        probes_shutdown.cancel();
        ended
    }
}

/// Serves probes and metrics on a separate listener until `shutdown` is cancelled.
pub(in crate::cli) fn serve_probes(listener: TcpListener, router: Router, shutdown: &CancellationToken) {
    tokio::spawn(connections::serve(listener, router, Connections::for_probes(), shutdown.clone()));
}

/// Returns the access options for this address. Creates and prints the first admin key if the
/// address requires one.
async fn access(args: &ServeArgs, address: SocketAddr, store: &Store) -> Result<AccessOptions, Failure> {
    let without_keys = match (args.insecure_no_auth, address.ip().is_loopback()) {
        (true, _) => WithoutKeys::Anyone,
        (false, true) => WithoutKeys::Loopback,
        (false, false) => WithoutKeys::Nobody,
    };
    if without_keys == WithoutKeys::Nobody
        && let Some(secret) = make_first_key(store).await?
    {
        term::print(&format!("first admin key, shown only this once: {}", secret.reveal()))?;
    }
    let quota = Quota { unfinished: args.key_models, bytes: args.key_bytes };
    let limits = KeyLimits { rate: Some(args.key_rate).filter(|rate| *rate > 0.0), quota };
    Ok(AccessOptions { without_keys, limits, ..AccessOptions::default() })
}

/// Adds an admin key if the store has no keys; returns its secret.
///
/// # Errors
/// If the store fails.
async fn make_first_key(store: &Store) -> anyhow::Result<Option<Secret>> {
    let secret = Secret::generate();
    let new = NewKey {
        prefix: secret.prefix().to_owned(),
        hash: secret.hash(),
        owner: "admin".parse().map_err(|error: NoOwner| anyhow::anyhow!(error))?,
        scopes: [Scope::Admin].into_iter().collect(),
        limits: KeyLimits::default(),
        expires_at: None,
    };
    let added = store.add_first_key(new).await.context("the first key could not be stored")?;
    Ok(added.map(|key| {
        key.audit_added();
        secret
    }))
}

/// Returns the limits on connections that the options set.
fn connections(args: &ProcessArgs) -> Connections {
    Connections::new(args.connections, args.write_timeout).with_grace(args.grace.max(LAST_ANSWERS))
}

/// Returns the limits of every process with workers.
pub(in crate::cli) fn process_limits(args: &ProcessArgs) -> Limits {
    Limits { worker_memory: ALIVE_HEARTBEATS * args.heartbeat, ..Limits::default() }
}

/// Returns the limits on requests that the options set, for a service with this many connections.
/// With workers, a model that exceeds their memory limit is refused instead of failing later.
///
/// # Errors
/// [`Failure::Usage`] for limits that contradict each other.
fn limits(args: &ServeArgs, connections: usize, has_workers: bool) -> Result<Limits, Failure> {
    let defaults = process_limits(&args.process);
    let (streams, held) = args.limits.holders(connections, defaults.streams, defaults.held)?;
    let body_bytes = usize::try_from(args.limits.max_body).unwrap_or(usize::MAX);
    Ok(Limits {
        streams,
        held,
        downloads: args.limits.downloads.map_or_else(connections::downloads, |given| given as usize),
        pictures: args.limits.pictures as usize,
        body_bytes,
        // Half of it is the share of an owner, which must have room for the text of a body and as
        // much memory for its values, more than once.
        body_memory: defaults.body_memory.max(body_bytes.saturating_mul(8)),
        cost: args.limits.cost(args.process.memory_limit.filter(|_| has_workers)),
        fit_time: args.limits.max_fit_time,
        batch: args.batch_limit as usize,
        keep: args.keep,
        redirect_downloads: args.redirect_downloads,
        gpu_expected: args.expect_gpu_workers,
        cors_origins: args.cors_origins.clone(),
        ..defaults
    })
}

/// Returns the artifact store that the options select, and its location for messages.
///
/// # Errors
/// [`Failure::Usage`] for an unknown kind of store; [`Failure::Failed`] if the store cannot be
/// opened.
fn artifacts(url: Option<&str>, data: &Path) -> Result<(Artifacts, String), Failure> {
    match url.filter(|_| is_bucket(url)) {
        Some(url) => match Artifacts::s3(url, std::env::vars()) {
            Ok(artifacts) => Ok((artifacts, url.to_owned())),
            Err(error) => Err(Failure::usage(format!("--artifacts: {error}"))),
        },
        None => {
            let path = artifacts_path(url, data)?;
            let artifacts = Artifacts::local(&path)
                .with_context(|| format!("the artifact store at {} could not be opened", path.display()))?;
            Ok((artifacts, path.display().to_string()))
        }
    }
}

/// True if the artifact store is a bucket.
fn is_bucket(url: Option<&str>) -> bool {
    url.is_some_and(|url| url.starts_with("s3:"))
}

/// Returns the path in `file:PATH`, `file://PATH` or a plain path; `data/artifacts` if none is
/// given.
fn artifacts_path(url: Option<&str>, data: &Path) -> Result<PathBuf, Failure> {
    let Some(url) = url else { return Ok(data.join("artifacts")) };
    let path = match url.split_once(':') {
        Some(("file", rest)) => rest.strip_prefix("//").unwrap_or(rest),
        // A single letter is a drive of Windows.
        Some((scheme, _)) if scheme.len() > 1 && scheme.bytes().all(|b| b.is_ascii_alphanumeric()) => {
            return Err(Failure::usage(format!(
                "--artifacts {url}: unsupported scheme `{scheme}:`: use file:PATH, a path or s3://BUCKET/PREFIX"
            )));
        }
        _ => url,
    };
    if path.is_empty() {
        return Err(Failure::usage(format!("--artifacts {url}: the path is empty")));
    }
    Ok(PathBuf::from(path))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn artifact_stores_are_paths_or_file_urls() {
        let path = |url| artifacts_path(url, Path::new("d")).map_err(|f| f.report().1);
        assert_eq!(path(None), Ok("d/artifacts".into()));
        assert_eq!(path(Some("a/b")), Ok("a/b".into()));
        assert_eq!(path(Some("file:a/b")), Ok("a/b".into()));
        assert_eq!(path(Some("file:///a/b")), Ok("/a/b".into()));
        assert_eq!(path(Some("C:\\b")), Ok("C:\\b".into()));
        for wrong in ["sqlite:a", "file:", "", "s3://bucket", "gs://bucket"] {
            assert!(path(Some(wrong)).is_err(), "{wrong}");
        }
    }

    #[test]
    fn locations_of_databases_have_no_credentials() {
        let shown = |url| location(&Database::parse(url).expect("valid"));
        assert_eq!(shown("a/b.db"), "a/b.db");
        assert_eq!(shown("postgres://u:secret@h:1/d?sslmode=require&password=secret"), "postgres://h:1/d");
        assert_eq!(shown("postgres://h/d"), "postgres://h/d");
    }

    fn limits_of(options: &[&str], connections: usize) -> Result<Limits, Failure> {
        limits(&ServeArgs::with(options).expect("valid"), connections, true)
    }

    #[test]
    fn options_of_serve_reach_the_limits() {
        let found = limits_of(&["--expect-gpu-workers", "--keep", "30d", "--batch-limit", "7"], 16).expect("valid");
        assert!(found.gpu_expected && !found.redirect_downloads);
        assert_eq!((found.keep, found.batch), (Some(Duration::from_secs(30 * 86_400)), 7));
        assert_eq!((found.streams, found.held), (8, 4));
        let defaults = limits_of(&[], 10_000).expect("valid");
        assert!(!defaults.gpu_expected);
        let expected = Limits::default();
        assert_eq!(defaults.cost, expected.cost);
        assert_eq!(
            (defaults.body_bytes, defaults.streams, defaults.held, defaults.worker_memory),
            (expected.body_bytes, expected.streams, expected.held, expected.worker_memory)
        );
    }

    #[test]
    fn limits_of_requests_are_options() {
        let options = ["--max-model-time", "90s", "--max-model-memory", "1GiB", "--max-model-vertices", "9"];
        let options = [&options[..], &["--max-model-size", "2kB", "--max-body", "64KiB", "--heartbeat", "1s"]].concat();
        let found = limits_of(&options, 16).expect("valid");
        let cost = crate::generate::CostLimits {
            max_cost_seconds: 90.0,
            max_memory_bytes: 1 << 30,
            max_vertices: 9,
            max_output_bytes: 2000,
        };
        assert_eq!(
            (found.cost.clone(), found.body_bytes, found.worker_memory),
            (cost, 65_536, Duration::from_secs(10))
        );
        assert_eq!(found.body_memory, Limits::default().body_memory);
        // The workers of this process would fail larger models.
        let options = [&options[..], &["--memory-limit", "512MiB"]].concat();
        let memory = |has_workers| {
            let limits = limits(&ServeArgs::with(&options).expect("valid"), 16, has_workers).expect("valid");
            limits.cost.max_memory_bytes
        };
        assert_eq!((memory(true), memory(false)), (512 << 20, 1 << 30));
        assert_eq!(limits_of(&["--memory-limit", "64GiB"], 16).expect("valid").cost, Limits::default().cost);
        assert_eq!(limits_of(&["--max-body", "1GiB"], 10_000).expect("valid").body_memory, 8 << 30);
        let options = ["--event-streams", "9000", "--held-answers", "0", "--downloads", "3"];
        let found = limits_of(&options, 10_000).expect("valid");
        assert_eq!((found.streams, found.held, found.downloads), (9000, 0, 3));
        // Health checks need connections too.
        let Err(Failure::Usage(lines)) = limits_of(&options, 9000) else { panic!("no connection is left") };
        assert!(lines[0].contains("--event-streams 9000") && lines[0].contains("--connections"), "{lines:?}");
        for zero in
            ["--memory-limit=2", "--max-model-time=0s", "--max-body=0", "--max-model-memory=0", "--event-streams=0"]
        {
            assert!(ServeArgs::with(&[zero]).is_err(), "{zero}");
        }
    }
}
