//! The command line: commands, options, their defaults and help texts.
//!
//! Environment variables are not declared here: [`super::config`] gives every long option its
//! `OVIDUCT_…` variable.

mod database;
mod fit;
mod gpu;
mod keys;
mod limits;
mod load;
mod model;
mod remote;
mod surfaces;
mod workers;

pub(super) use database::DatabaseArgs;
pub(super) use fit::FitArgs;
pub use gpu::{GpuArgs, GpuUse};
pub(super) use keys::{Keys, KeysAddArgs, KeysListArgs, KeysRevokeArgs, KeysRotateArgs};
pub(super) use limits::LimitArgs;
pub(super) use load::LoadArgs;
pub(super) use model::ModelArgs;
pub use model::SpecArgs;
pub(super) use remote::RemoteArgs;
pub(super) use surfaces::{
    CheckArgs, ConvertArgs, CutArgs, LayerArgs, MeasureArgs, RenderArgs, ReportArgs, SectionArgs,
};
pub(super) use workers::{WorkersAction, WorkersArgs};

use super::units;
use crate::generate::Backend;
use crate::http::Origin;
use crate::jobs::Priority;
use clap::builder::FalseyValueParser;
use clap::{Args, Parser, Subcommand, ValueEnum};
use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

/// Grows 3D models of folded tubular organs and serves them over HTTP.
///
/// Without a command, oviduct runs `serve`. Every option can also be set by an environment variable
/// (OVIDUCT_ followed by the option's name in capitals, with `_` for `-`) or in the file given by
/// --config. The command line overrides variables, and variables override the file. Exit codes: 0
/// success, 1 failure, 2 invalid usage or an invalid spec, 130 interrupted.
#[derive(Debug, Parser)]
#[command(name = "oviduct", version, arg_required_else_help = false, override_usage = "oviduct [OPTIONS] [COMMAND]")]
pub(super) struct Cli {
    #[command(flatten)]
    pub(super) global: Global,
    #[command(subcommand)]
    pub(super) command: Command,
}

/// Options of every command.
#[derive(Debug, Args)]
#[command(next_help_heading = "Global options")]
pub(super) struct Global {
    /// TOML file with options: global options at the top level, a command's options in a table with
    /// the command's name
    #[arg(long, global = true, value_name = "FILE")]
    pub(super) config: Option<PathBuf>,
    /// Log filter for stderr, such as `info` or `warn,oviduct=debug` [default: info for serve and
    /// worker, warn for other commands]
    #[arg(long, global = true, value_name = "FILTER")]
    pub(super) log: Option<String>,
    /// Log format
    #[arg(long, global = true, value_enum, default_value_t = LogFormat::Text)]
    pub(super) log_format: LogFormat,
    /// URL of the OpenTelemetry collector that receives traces over HTTP, such as
    /// http://localhost:4318 [default: none; serve and worker use OTEL_EXPORTER_OTLP_ENDPOINT]
    #[arg(long, global = true, value_name = "URL")]
    pub(super) otlp_endpoint: Option<String>,
}

/// Log format.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum LogFormat {
    /// Plain text, one line per event.
    Text,
    /// One JSON object per line.
    Json,
}

/// The commands.
#[derive(Debug, Subcommand)]
pub(super) enum Command {
    /// Serve models over HTTP and grow them in the same process (the default command)
    Serve(ServeArgs),
    /// Grow one model in this process, without a service
    Generate(GenerateArgs),
    /// Start a service with its own database, request one model over HTTP, show its progress and
    /// save it to ./demo
    Demo(DemoArgs),
    /// Request a model from a running service
    Submit(SubmitArgs),
    /// Certify the surface in a glb, gltf, obj, stl, ply or vtp file from any source
    Check(CheckArgs),
    /// Convert the surface in a glb, gltf, obj, stl, ply or vtp file to another of these formats or
    /// to another unit
    Convert(ConvertArgs),
    /// Draw the surfaces in glb, gltf, obj, stl, ply, vtp or sections.bin files as PNG pictures
    Render(RenderArgs),
    /// Grow models of several seeds and compare their morphometry with published anatomy
    Compare(CompareArgs),
    /// Search for parameters whose models reproduce given measures, such as those of micrographs
    Fit(FitArgs),
    /// Write a model's report as one HTML page: morphometry next to published anatomy, pictures,
    /// certificate, parameters
    Report(ReportArgs),
    /// Draw a section of a sections.bin file as a stained slide or as a label image
    Section(SectionArgs),
    /// Cut a surface with a plane into rings of tissue, lumen, islands and pockets; write them as
    /// JSON, a drawing or a stained picture
    Cut(CutArgs),
    /// Measure the section in an image: a mask or a label image
    Measure(MeasureArgs),
    /// Send many requests to a running service and report throughput, latencies and errors
    Load(LoadArgs),
    /// List the presets
    Presets(PresetsArgs),
    /// Print the JSON Schema of the spec
    Schema,
    /// Print the OpenAPI description of the service
    Openapi,
    /// Grow models for services that use the same PostgreSQL database and artifact store
    Worker(WorkerArgs),
    /// Create, list, revoke and rotate API keys; a running service applies changes within a second
    #[command(subcommand)]
    Keys(Keys),
    /// List the workers of a service; pause, resume or drain them
    Workers(WorkersArgs),
    /// Update the database schema and exit (serve and worker also do this when they start)
    Migrate(DatabaseArgs),
    /// Check that a service is alive (exit code 0 or 1); for container health checks
    #[command(hide = true)]
    Healthcheck(HealthcheckArgs),
}

impl Command {
    /// Returns true if the command may open a GPU.
    pub(super) fn may_use_gpu(&self) -> bool {
        let gpu = match self {
            Self::Serve(args) => args.process.gpu.gpu,
            Self::Worker(args) => args.process.gpu.gpu,
            Self::Generate(args) if matches!(args.model.backend, Backend::Auto | Backend::Gpu) => args.gpu.gpu,
            Self::Demo(_) => GpuUse::Auto,
            _ => GpuUse::Off,
        };
        gpu == GpuUse::Auto
    }
}

/// Options of `serve`.
#[derive(Clone, Debug, Args)]
pub struct ServeArgs {
    /// Address to listen on
    #[arg(long, value_name = "HOST:PORT", default_value = "127.0.0.1:8080")]
    pub(super) addr: SocketAddr,
    /// While there are no API keys, serve everyone without authentication, even on a non-loopback
    /// address, instead of creating a first admin key
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(super) insecure_no_auth: bool,
    /// Average number of requests per second for API keys without their own limit [0: no limit]
    #[arg(long, value_name = "N", value_parser = units::rate, default_value = "0")]
    pub(super) key_rate: f64,
    /// Maximum number of queued and running models per owner, for API keys without their own limit
    /// [default: no limit]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..))]
    pub(super) key_models: Option<u64>,
    /// Maximum total size of an owner's files, such as 50GB, for API keys without their own limit;
    /// an owner at the limit cannot request models [default: no limit]
    #[arg(long, value_name = "SIZE", value_parser = units::bytes)]
    pub(super) key_bytes: Option<u64>,
    /// Second address for /healthz, /readyz and /metrics, with a separate limit on connections
    /// [default: --addr only]
    #[arg(long, value_name = "HOST:PORT")]
    pub(super) metrics_addr: Option<SocketAddr>,
    /// Time after SIGTERM during which the service still accepts requests while /readyz responds
    /// with 503, so that load balancers remove this process first
    #[arg(long, value_name = "TIME", value_parser = units::duration, default_value = "0s")]
    pub(super) drain_delay: Duration,
    /// Origin whose pages may call the service, such as https://lab.example:8443; may be repeated.
    /// `*` allows every origin, which is safe only if the service has API keys or nothing to hide
    /// [default: no other origin]
    #[arg(long = "cors-origin", value_name = "ORIGIN", value_delimiter = ',')]
    pub(super) cors_origins: Vec<Origin>,
    /// Maximum number of queued models; further requests are refused (429)
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..), default_value_t = 10_000)]
    pub(super) queue_limit: u64,
    /// Maximum number of models in a batch
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..), default_value_t = 1000)]
    pub(super) batch_limit: u32,
    /// Queue models with backend `gpu` even while no GPU worker is alive; for GPU workers that
    /// start on demand
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(super) expect_gpu_workers: bool,
    /// Redirect downloads to signed S3 URLs (307) instead of streaming the files through this
    /// process
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(super) redirect_downloads: bool,
    /// Delete models this long after their end, such as 30d [default: keep forever]
    #[arg(long, value_name = "AGE", value_parser = units::positive_duration)]
    pub(super) keep: Option<Duration>,
    /// Maximum total size of all files, such as 500GB; above it, the models that ended first are
    /// deleted [default: no limit]
    #[arg(long, value_name = "SIZE", value_parser = units::bytes)]
    pub(super) keep_bytes: Option<u64>,
    #[command(flatten)]
    pub(super) limits: LimitArgs,
    #[command(flatten)]
    pub(super) process: ProcessArgs,
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
pub(super) struct WorkerArgs {
    /// Address for /healthz, /readyz and /metrics [default: none]
    #[arg(long, value_name = "HOST:PORT")]
    pub(super) metrics_addr: Option<SocketAddr>,
    #[command(flatten)]
    pub(super) process: ProcessArgs,
}

/// Options of processes with workers: `serve` and `worker`.
#[derive(Clone, Debug, Args)]
pub(super) struct ProcessArgs {
    #[command(flatten)]
    pub(super) database: DatabaseArgs,
    /// Maximum number of connections to PostgreSQL, not counting the one for notifications
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(2..), default_value_t = 12)]
    pub(super) database_connections: u32,
    /// Maximum number of connections that read an SQLite database
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..), default_value_t = 4)]
    pub(super) database_readers: u32,
    /// Artifact store for finished files: `s3://BUCKET/PREFIX` with the usual AWS_… variables,
    /// `file:PATH` or a path [default: DATA/artifacts]
    #[arg(long, value_name = "URL")]
    pub(super) artifacts: Option<String>,
    /// Number of CPU workers; each grows one model at a time [0: none]
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub(super) cpu_workers: u32,
    /// Threads per CPU worker. For maximum throughput, run one single-threaded worker per core
    /// [default: all cores]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub(super) cpu_threads: Option<u32>,
    /// Niceness of the worker threads (Linux), so that HTTP requests take precedence [0: no
    /// precedence]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(0..=19), default_value_t = 10)]
    pub(super) worker_nice: u8,
    #[command(flatten)]
    pub(super) gpu: GpuArgs,
    /// Maximum number of models in a GPU batch, which the GPU simulates together
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..), default_value_t = 16)]
    pub(super) gpu_batch: u32,
    /// Interval between a worker's heartbeats
    #[arg(long, value_name = "TIME", value_parser = units::positive_duration, default_value = "2s")]
    pub(super) heartbeat: Duration,
    /// Time without a heartbeat after which another worker may claim the job; at least two
    /// heartbeats
    #[arg(long, value_name = "TIME", value_parser = units::positive_duration, default_value = "8s")]
    pub(super) lease: Duration,
    /// Fail a job after this many counted attempts; released attempts do not count
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..), default_value_t = 5)]
    pub(super) max_attempts: u32,
    /// Interval between checkpoints of a running simulation; the next attempt resumes from the last
    /// one [0: no checkpoints]
    #[arg(long, value_name = "TIME", value_parser = units::duration_or_zero, default_value = "30s")]
    pub(super) checkpoint_every: Duration,
    /// Maximum duration of an attempt; a job that takes longer fails [default: 10 minutes plus 20
    /// times the time predicted for one core]
    #[arg(long, value_name = "TIME", value_parser = units::positive_duration)]
    pub(super) job_timeout: Option<Duration>,
    /// Memory limit of one job, such as 2GB [default: no limit]
    #[arg(long, value_name = "SIZE", value_parser = units::bytes)]
    pub(super) memory_limit: Option<u64>,
    /// Time for running jobs and open downloads to finish during a shutdown; after it, jobs are
    /// released to the queue and downloads are cut off
    #[arg(long, value_name = "TIME", value_parser = units::duration, default_value = "30s")]
    pub(super) grace: Duration,
    /// Maximum number of open connections; further ones wait to be accepted [default: 10000, or
    /// three quarters of the process's file descriptors if that is less]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(16..))]
    pub(super) connections: Option<u32>,
    /// Time without progress after which a connection is closed because the client does not read
    /// the response
    #[arg(long, value_name = "TIME", value_parser = units::positive_duration, default_value = "60s")]
    pub(super) write_timeout: Duration,
}

/// Options of `generate`.
#[derive(Clone, Debug, Args)]
pub(super) struct GenerateArgs {
    #[command(flatten)]
    pub(super) model: ModelArgs,
    /// Directory for the files; created if it does not exist
    #[arg(long, value_name = "DIR", required = true)]
    pub(super) out: PathBuf,
    #[command(flatten)]
    pub(super) gpu: GpuArgs,
    /// Memory limit of the model, such as 2GB [default: no limit]
    #[arg(long, value_name = "SIZE", value_parser = units::bytes)]
    pub(super) memory_limit: Option<u64>,
    /// Also write report.html, the report as a web page
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(super) report: bool,
    /// Print one JSON object
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(super) json: bool,
}

/// Options of `compare`.
#[derive(Clone, Debug, Args)]
pub(super) struct CompareArgs {
    /// Presets, separated by commas
    #[arg(long = "preset", value_name = "LIST", value_delimiter = ',', default_value = "pig,human,cow")]
    pub(super) presets: Vec<String>,
    /// First and last seed, such as 1..20
    #[arg(long, value_name = "FIRST..LAST", value_parser = units::seeds, default_value = "1..20")]
    pub(super) seeds: std::ops::RangeInclusive<u64>,
    /// Print JSON with the means of every model instead of tables
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(super) json: bool,
}

/// Seed of `demo`, the same as of the pictures in the README.
const DEMO_SEED: &str = "7";

/// Options of `demo`.
#[derive(Clone, Debug, Args)]
#[command(mut_arg("seed", |seed| seed.help("Seed of the random numbers, 0 to 2^53 - 1").default_value(DEMO_SEED)))]
pub(super) struct DemoArgs {
    #[command(flatten)]
    pub(super) model: ModelArgs,
    /// Exit when the model is saved: code 0 if it is certified, 1 if not
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(super) exit: bool,
}

/// Options of `submit`.
#[derive(Clone, Debug, Args)]
pub(super) struct SubmitArgs {
    #[command(flatten)]
    pub(super) service: RemoteArgs,
    #[command(flatten)]
    pub(super) model: ModelArgs,
    /// Label as NAME:VALUE; may be repeated
    #[arg(long, value_name = "NAME:VALUE", value_delimiter = ',')]
    pub(super) label: Vec<String>,
    /// Priority, -100 to 100; workers claim queued models of higher priority first
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(i64).range(Priority::MIN..=Priority::MAX), default_value_t = 0, allow_hyphen_values = true)]
    pub(super) priority: i64,
    /// Grow the model again even if the service already has it
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(super) no_reuse: bool,
    /// Idempotency key: a repeated request with the same key returns the same model [default:
    /// random]
    #[arg(long, value_name = "KEY")]
    pub(super) idempotency_key: Option<String>,
    /// Wait until the model ends and show its progress
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(super) wait: bool,
    /// Directory for the model's files; implies --wait
    #[arg(long, value_name = "DIR")]
    pub(super) out: Option<PathBuf>,
    /// Print the model as JSON
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(super) json: bool,
}

/// Options of `presets`.
#[derive(Clone, Debug, Args)]
pub(super) struct PresetsArgs {
    /// Print a JSON array with all values of all presets
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(super) json: bool,
}

/// Options of `healthcheck`.
#[derive(Clone, Debug, Args)]
pub(super) struct HealthcheckArgs {
    /// Address of the service
    #[arg(long, value_name = "URL", default_value = "http://127.0.0.1:8080")]
    pub(super) url: String,
}
