//! Options of processes with workers: `serve` and `worker`.

use super::limits::LimitArgs;
use super::shared::{DatabaseArgs, GpuArgs};
use crate::cli::units;
use crate::http::Origin;
use clap::builder::FalseyValueParser;
use clap::{Args, Parser};
use std::net::SocketAddr;
use std::time::Duration;

/// Options of `serve`.
#[derive(Clone, Debug, Args)]
pub struct ServeArgs {
    /// Address to listen on
    #[arg(long, value_name = "HOST:PORT", default_value = "127.0.0.1:8080")]
    pub(in crate::cli) addr: SocketAddr,
    /// While there are no API keys, serve everyone without authentication, even on a non-loopback
    /// address, instead of creating a first admin key
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(in crate::cli) insecure_no_auth: bool,
    /// Average number of requests per second for API keys without their own limit [0: no limit]
    #[arg(long, value_name = "N", value_parser = units::rate, default_value = "0")]
    pub(in crate::cli) key_rate: f64,
    /// Maximum number of queued and running models per owner, for API keys without their own limit;
    /// a fit counts as one model per minute of its predicted time [default: no limit]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub(in crate::cli) key_models: Option<u64>,
    /// Maximum total size of an owner's files, such as 50GB, for API keys without their own limit;
    /// an owner at the limit cannot request models [default: no limit]
    #[arg(long, value_name = "SIZE", value_parser = units::bytes)]
    pub(in crate::cli) key_bytes: Option<u64>,
    /// Second address for /healthz, /readyz and /metrics, with a separate limit on connections
    /// [default: --addr only]
    #[arg(long, value_name = "HOST:PORT")]
    pub(in crate::cli) metrics_addr: Option<SocketAddr>,
    /// Time after SIGTERM during which the service still accepts requests while /readyz responds
    /// with 503, so that load balancers remove this process first
    #[arg(long, value_name = "TIME", value_parser = units::duration, default_value = "0s")]
    pub(in crate::cli) drain_delay: Duration,
    #[allow(rustdoc::bare_urls, reason = "the help shows this text unchanged")]
    /// Origin whose pages may call the service, such as https://lab.example:8443; may be repeated.
    /// `*` allows every origin, which is safe only if the service has API keys or nothing to hide
    /// [default: no other origin]
    #[arg(long = "cors-origin", value_name = "ORIGIN", value_delimiter = ',')]
    pub(in crate::cli) cors_origins: Vec<Origin>,
    /// Maximum number of queued models; further requests are refused (429)
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..), default_value_t = 10_000)]
    pub(in crate::cli) queue_limit: u64,
    /// Maximum number of models in a batch
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..), default_value_t = 1000)]
    pub(in crate::cli) batch_limit: u32,
    /// Queue models with backend `gpu` even while no GPU worker is alive; for GPU workers that
    /// start on demand
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(in crate::cli) expect_gpu_workers: bool,
    /// Redirect downloads to signed S3 URLs (307) instead of streaming the files through this
    /// process
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(in crate::cli) redirect_downloads: bool,
    /// Delete models this long after their end, such as 30d [default: keep forever]
    #[arg(long, value_name = "AGE", value_parser = units::positive_duration)]
    pub(in crate::cli) keep: Option<Duration>,
    /// Maximum total size of all files, such as 500GB; above it, the models that ended first are
    /// deleted [default: no limit]
    #[arg(long, value_name = "SIZE", value_parser = units::bytes)]
    pub(in crate::cli) keep_bytes: Option<u64>,
    /// Accept the stores and the clock as they are: delete orphans even if the job store is new or
    /// older than the artifact store, and count all time for --keep. Give it once, after checking
    /// --database, --artifacts and the time
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(in crate::cli) sweep_now: bool,
    #[command(flatten)]
    pub(in crate::cli) limits: LimitArgs,
    #[command(flatten)]
    pub(in crate::cli) process: ProcessArgs,
}

impl ServeArgs {
    /// Returns the defaults, overridden by `options`. Ignores environment variables and files.
    ///
    /// # Errors
    /// If an option is invalid.
    pub fn with(options: &[&str]) -> Result<Self, clap::Error> {
        #[derive(Parser)]
        struct Line {
            #[command(flatten)]
            args: ServeArgs,
        }
        Ok(Line::try_parse_from(["serve"].iter().chain(options))?.args)
    }
}

/// Options of `worker`.
#[derive(Clone, Debug, Args)]
pub(in crate::cli) struct WorkerArgs {
    /// Address for /healthz, /readyz and /metrics [default: none]
    #[arg(long, value_name = "HOST:PORT")]
    pub(in crate::cli) metrics_addr: Option<SocketAddr>,
    #[command(flatten)]
    pub(in crate::cli) process: ProcessArgs,
}

/// Options of processes with workers: `serve` and `worker`.
#[derive(Clone, Debug, Args)]
pub(in crate::cli) struct ProcessArgs {
    #[command(flatten)]
    pub(in crate::cli) database: DatabaseArgs,
    /// Maximum number of connections to PostgreSQL, not counting the one for notifications
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(2..), default_value_t = 12)]
    pub(in crate::cli) database_connections: u32,
    /// Maximum number of connections that read an SQLite database
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..), default_value_t = 4)]
    pub(in crate::cli) database_readers: u32,
    /// Artifact store for finished files: `s3://BUCKET/PREFIX` with the usual AWS_… variables,
    /// `file:PATH` or a path [default: DATA/artifacts]
    #[arg(long, value_name = "URL")]
    pub(in crate::cli) artifacts: Option<String>,
    /// Number of CPU workers; each grows one model at a time, and beside it one short model and one fit
    /// [0: none]
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub(in crate::cli) cpu_workers: u32,
    /// Threads per CPU worker. For maximum throughput, run one single-threaded worker per core
    /// [default: all cores]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub(in crate::cli) cpu_threads: Option<u32>,
    /// Niceness of the threads of workers, pictures and other computations (Linux), so that HTTP
    /// requests take precedence [0: no precedence]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(0..=19), default_value_t = 10)]
    pub(in crate::cli) worker_nice: u8,
    #[command(flatten)]
    pub(in crate::cli) gpu: GpuArgs,
    /// Maximum number of models in a GPU batch, which the GPU simulates together
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..), default_value_t = 16)]
    pub(in crate::cli) gpu_batch: u32,
    /// Interval between a worker's heartbeats
    #[arg(long, value_name = "TIME", value_parser = units::positive_duration, default_value = "2s")]
    pub(in crate::cli) heartbeat: Duration,
    /// Time without a heartbeat after which another worker may claim the job; at least two
    /// heartbeats, at most 10 minutes
    #[arg(long, value_name = "TIME", value_parser = units::positive_duration, default_value = "8s")]
    pub(in crate::cli) lease: Duration,
    /// Fail a job after this many counted attempts; released attempts do not count
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..), default_value_t = 5)]
    pub(in crate::cli) max_attempts: u32,
    /// Interval between checkpoints of a running simulation; the next attempt resumes from the last
    /// one [0: no checkpoints]
    #[arg(long, value_name = "TIME", value_parser = units::duration_or_zero, default_value = "30s")]
    pub(in crate::cli) checkpoint_every: Duration,
    /// Maximum duration of an attempt; a job that takes longer fails [default: 10 minutes plus 20
    /// times the time predicted for one core]
    #[arg(long, value_name = "TIME", value_parser = units::positive_duration)]
    pub(in crate::cli) job_timeout: Option<Duration>,
    /// Memory limit of one job, such as 2GB; `serve` with workers refuses (422) models that are
    /// predicted to need more [default: no limit]
    #[arg(long, value_name = "SIZE", value_parser = units::bytes_with_unit)]
    pub(in crate::cli) memory_limit: Option<u64>,
    /// Time for running jobs and open downloads to finish during a shutdown; after it, jobs are
    /// released to the queue and downloads are cut off
    #[arg(long, value_name = "TIME", value_parser = units::duration, default_value = "30s")]
    pub(in crate::cli) grace: Duration,
    /// Maximum number of open connections; further ones wait to be accepted [default: 10000, or
    /// three quarters of the process's file descriptors if that is less]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(16..))]
    pub(in crate::cli) connections: Option<u32>,
    /// Time without progress after which a connection is closed because the client does not read
    /// the response
    #[arg(long, value_name = "TIME", value_parser = units::positive_duration, default_value = "60s")]
    pub(in crate::cli) write_timeout: Duration,
}
