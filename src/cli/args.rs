//! What can be said on the command line.
//!
//! Environment variables are not written here: [`super::config`] gives every option with a long name its
//! `OVIDUCT_…` variable, so that none can be forgotten.

use super::units;
use crate::generate::{Backend, Output};
use crate::jobs::Priority;
use clap::builder::FalseyValueParser;
use clap::{Args, Parser, Subcommand, ValueEnum};
use std::net::SocketAddr;
use std::path::PathBuf;
use std::time::Duration;

/// Grows 3D models of folded tubular organs, and serves them over HTTP.
///
/// Without a command it serves. Every option can also be set by a variable (OVIDUCT_ and the option's name in
/// capitals) or in the file named by --config; the command line wins over variables, and these over the file.
/// Exit codes: 0 done, 1 failed, 2 wrong usage or an invalid spec, 130 interrupted.
#[derive(Debug, Parser)]
#[command(name = "oviduct", version, arg_required_else_help = false)]
pub(super) struct Cli {
    #[command(flatten)]
    pub(super) global: Global,
    #[command(subcommand)]
    pub(super) command: Command,
}

/// Options of every command.
#[derive(Debug, Args)]
pub(super) struct Global {
    /// TOML file of options: global ones at the top, those of a command in a table of its name
    #[arg(long, global = true, value_name = "FILE")]
    pub(super) config: Option<PathBuf>,
    /// What to log to stderr, such as `info` or `warn,oviduct=debug` [default: info to serve, else warn]
    #[arg(long, global = true, value_name = "FILTER")]
    pub(super) log: Option<String>,
    /// How to write the log
    #[arg(long, global = true, value_enum, default_value_t = LogFormat::Text)]
    pub(super) log_format: LogFormat,
    /// OpenTelemetry collector that traces go to over HTTP, such as http://localhost:4318 [default: none; to serve and
    /// for workers, what OTEL_EXPORTER_OTLP_ENDPOINT says]
    #[arg(long, global = true, value_name = "URL")]
    pub(super) otlp_endpoint: Option<String>,
}

/// Form of the log.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum LogFormat {
    /// Lines for people.
    Text,
    /// One JSON object a line.
    Json,
}

/// The commands.
#[derive(Debug, Subcommand)]
pub(super) enum Command {
    /// Serve models over HTTP, and grow them in the same process (what is done without a command)
    Serve(ServeArgs),
    /// Grow one model here and now, without a service
    Generate(GenerateArgs),
    /// Serve on an embedded store, request one model over HTTP, show its progress, save it to ./demo
    Demo(DemoArgs),
    /// Ask a running service for a model
    Submit(SubmitArgs),
    /// Certify the surface in any glb, gltf, obj, stl or ply file
    Check(CheckArgs),
    /// Put load on a running service, and say how fast models come
    Load(LoadArgs),
    /// Measure how fast this machine grows models
    Bench(BenchArgs),
    /// List what can be grown
    Presets(PresetsArgs),
    /// Print the JSON Schema of the spec
    Schema,
    /// Print the OpenAPI description of the service
    Openapi,
    /// Grow models for a service elsewhere that shares the database and the artifacts
    Worker(WorkerArgs),
    /// Bring the tables of the database up to date (what serve and worker do on start) and end
    Migrate(DatabaseArgs),
    /// Ask a service whether it is alive (exit code 0 or 1); for container health checks
    #[command(hide = true)]
    Healthcheck(HealthcheckArgs),
}

/// Options of `serve`.
#[derive(Clone, Debug, Args)]
pub(super) struct ServeArgs {
    /// Address to listen on
    #[arg(long, value_name = "HOST:PORT", default_value = "127.0.0.1:8080")]
    pub(super) addr: SocketAddr,
    /// Listen on an address that is not loopback although there is no authentication
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(super) insecure_no_auth: bool,
    #[command(flatten)]
    pub(super) service: ServiceArgs,
}

/// Options of `worker`.
#[derive(Clone, Debug, Args)]
pub(super) struct WorkerArgs {
    /// Address to answer /healthz, /readyz and /metrics at [default: none]
    #[arg(long, value_name = "HOST:PORT")]
    pub(super) metrics_addr: Option<SocketAddr>,
    #[command(flatten)]
    pub(super) service: ServiceArgs,
}

/// Where the jobs are.
#[derive(Clone, Debug, Args)]
pub(super) struct DatabaseArgs {
    /// Folder of the database, the artifacts and files on their way, where these are not named
    #[arg(long, value_name = "DIR", default_value = "data")]
    pub(super) data: PathBuf,
    /// Database of jobs: `postgres://USER:PASSWORD@HOST/NAME`, `sqlite:PATH` or a path [default: DATA/oviduct.db]
    #[arg(long, value_name = "URL")]
    pub(super) database: Option<String>,
}

/// What a service in this process is made of.
#[derive(Clone, Debug, Args)]
pub(super) struct ServiceArgs {
    #[command(flatten)]
    pub(super) database: DatabaseArgs,
    /// Where finished files go: `s3://BUCKET/PREFIX` with the usual AWS_… variables, `file:PATH` or a path [default: DATA/artifacts]
    #[arg(long, value_name = "URL")]
    pub(super) artifacts: Option<String>,
    /// Models grown at the same time; each may use every core [0: grow none here]
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub(super) cpu_workers: u32,
    /// Threads of each of them; most models a second come of as many workers as cores with a thread each [default: all
    /// cores]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub(super) cpu_threads: Option<u32>,
    #[command(flatten)]
    pub(super) gpu: GpuArgs,
    /// Most models that a GPU grows together
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..), default_value_t = 16)]
    pub(super) gpu_batch: u32,
    /// Time between a worker's signs of life
    #[arg(long, value_name = "TIME", value_parser = units::duration, default_value = "2s")]
    pub(super) heartbeat: Duration,
    /// Time without a sign of life after which a job is given to another worker
    #[arg(long, value_name = "TIME", value_parser = units::duration, default_value = "8s")]
    pub(super) lease: Duration,
    /// Attempts after which a job fails
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..), default_value_t = 5)]
    pub(super) max_attempts: u32,
    /// Time that running jobs are given to end on shutdown before they go back to the queue
    #[arg(long, value_name = "TIME", value_parser = units::duration, default_value = "30s")]
    pub(super) grace: Duration,
    /// Queued jobs beyond which new ones are refused
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..), default_value_t = 10_000)]
    pub(super) queue_limit: u64,
    /// Memory that one model may need, such as 2GB [default: no limit]
    #[arg(long, value_name = "SIZE", value_parser = units::bytes)]
    pub(super) memory_limit: Option<u64>,
    #[command(flatten)]
    pub(super) upkeep: UpkeepArgs,
}

/// Limits and care of a service.
#[derive(Clone, Debug, Args)]
pub(super) struct UpkeepArgs {
    /// Time between checkpoints of a running simulation, from which another attempt goes on [0: none]
    #[arg(long, value_name = "TIME", value_parser = units::duration, default_value = "30s")]
    pub(super) checkpoint_every: Duration,
    /// Time that an attempt at a model may take; one that takes longer fails [default: no limit]
    #[arg(long, value_name = "TIME", value_parser = units::duration)]
    pub(super) job_timeout: Option<Duration>,
    /// Time after its end that a model is kept, such as 30d [default: for good]
    #[arg(long, value_name = "AGE", value_parser = units::duration)]
    pub(super) keep: Option<Duration>,
    /// Bytes of all files; over it the models that ended first are removed [default: no limit]
    #[arg(long, value_name = "SIZE", value_parser = units::bytes)]
    pub(super) keep_bytes: Option<u64>,
    /// Most models of a batch
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..), default_value_t = 1000)]
    pub(super) batch_limit: u32,
    /// Most connections at a time; others wait to be accepted [default: three quarters of the files that the process may open]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(16..))]
    pub(super) connections: Option<u32>,
    /// Send downloads on to S3 by signed addresses (307) instead of passing the bytes through
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(super) redirect_downloads: bool,
}

/// Which GPUs to use.
#[derive(Clone, Copy, Debug, Args)]
pub(super) struct GpuArgs {
    /// Whether to use GPUs
    #[arg(long, value_name = "WHEN", value_enum, default_value_t = GpuUse::Auto)]
    pub(super) gpu: GpuUse,
    /// Use adapters that compute on the CPU too (Mesa's llvmpipe): slow, for tests
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(super) allow_software_adapter: bool,
}

/// Whether to use GPUs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum GpuUse {
    /// Those that there are.
    Auto,
    /// None.
    Off,
}

/// What to grow.
#[derive(Clone, Debug, Args)]
pub(super) struct ModelArgs {
    /// What to start from; see `oviduct presets`
    #[arg(long, value_name = "NAME", default_value = "pig")]
    pub(super) preset: String,
    /// Seed, 0 to 2^53 - 1 [default: drawn]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(0..1 << 53))]
    pub(super) seed: Option<u64>,
    /// JSON file with a merge patch on the preset; `-` reads stdin
    #[arg(long, value_name = "FILE")]
    pub(super) spec: Option<PathBuf>,
    /// One value of the spec, as JSON or a plain word, such as collision.gap_um=30; may be repeated
    #[arg(long, value_name = "A.B=V", value_delimiter = ';')]
    pub(super) set: Vec<String>,
    /// What shall compute it
    #[arg(long, value_parser = kebab::<Backend>, default_value = "auto")]
    pub(super) backend: Backend,
    /// Formats of the model, separated by commas; sections.bin and report.json are always written
    #[arg(long, value_name = "LIST", value_delimiter = ',', value_parser = kebab::<Output>, default_value = "glb")]
    pub(super) outputs: Vec<Output>,
}

/// Options of `generate`.
#[derive(Clone, Debug, Args)]
pub(super) struct GenerateArgs {
    #[command(flatten)]
    pub(super) model: ModelArgs,
    /// Folder for the files; made where it is missing
    #[arg(long, value_name = "DIR", required = true)]
    pub(super) out: PathBuf,
    #[command(flatten)]
    pub(super) gpu: GpuArgs,
    /// Memory that the model may need, such as 2GB [default: no limit]
    #[arg(long, value_name = "SIZE", value_parser = units::bytes)]
    pub(super) memory_limit: Option<u64>,
    /// Print one JSON object
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(super) json: bool,
}

/// Options of `demo`.
#[derive(Clone, Debug, Args)]
pub(super) struct DemoArgs {
    #[command(flatten)]
    pub(super) model: ModelArgs,
    /// End once the model is saved, with 0 where it is certified and 1 where not
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(super) exit: bool,
}

/// Options of `submit`.
#[derive(Clone, Debug, Args)]
pub(super) struct SubmitArgs {
    /// Address of the service
    #[arg(long, value_name = "URL", default_value = "http://127.0.0.1:8080")]
    pub(super) url: String,
    #[command(flatten)]
    pub(super) model: ModelArgs,
    /// Label as NAME:VALUE; may be repeated
    #[arg(long, value_name = "NAME:VALUE", value_delimiter = ',')]
    pub(super) label: Vec<String>,
    /// How urgent it is, -100 to 100: of what waits, the higher is begun first
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(i64).range(Priority::MIN..=Priority::MAX), default_value_t = 0, allow_hyphen_values = true)]
    pub(super) priority: i64,
    /// Grow it anew even where the service has the same model already
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(super) no_reuse: bool,
    /// Key under which a repeated request gives the same model [default: drawn]
    #[arg(long, value_name = "KEY")]
    pub(super) idempotency_key: Option<String>,
    /// Wait until the model ends, with a progress bar
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(super) wait: bool,
    /// Folder to save its files in (waits for them)
    #[arg(long, value_name = "DIR")]
    pub(super) out: Option<PathBuf>,
    /// Print the model as JSON
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(super) json: bool,
}

/// Options of `load`.
#[derive(Clone, Debug, Args)]
pub(super) struct LoadArgs {
    /// Address of the service
    #[arg(long, value_name = "URL", default_value = "http://127.0.0.1:8080")]
    pub(super) url: String,
    /// Models in all; their seeds follow each other from --seed on
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..), default_value_t = 100)]
    pub(super) models: u64,
    /// Models asked for at a time
    #[arg(long, value_name = "C", value_parser = clap::value_parser!(u32).range(1..), default_value_t = 4)]
    pub(super) concurrency: u32,
    #[command(flatten)]
    pub(super) model: ModelArgs,
    /// Grow them here by the generator alone, as so many workers would: what a service is compared with
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(super) direct: bool,
    /// Print one JSON object
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(super) json: bool,
}

/// Options of `check`.
#[derive(Clone, Debug, Args)]
pub(super) struct CheckArgs {
    /// Files to certify
    #[arg(value_name = "FILE", required = true)]
    pub(super) files: Vec<PathBuf>,
    /// Euler number that every component must have
    #[arg(long, value_name = "N", allow_hyphen_values = true)]
    pub(super) euler: Option<i64>,
    /// Print a JSON array with the certificate of each file
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(super) json: bool,
}

/// Options of `bench`.
#[derive(Clone, Debug, Args)]
pub(super) struct BenchArgs {
    /// What to measure
    #[arg(value_name = "WHAT", value_enum)]
    pub(super) what: Bench,
    /// Measure less often: within half a minute
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(super) quick: bool,
    /// Print one JSON object
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(super) json: bool,
    /// Folder for the results as JSON and text, and for plots
    #[arg(long, value_name = "DIR")]
    pub(super) out: Option<PathBuf>,
    #[command(flatten)]
    pub(super) gpu: GpuArgs,
}

/// What can be measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum Bench {
    /// The paper's comparison: all pairs, lists, one core and many
    Paper,
    /// Time per step by threads and particles
    Scaling,
    /// Models a second on the GPU, by the size of the batch
    Batch,
    /// Models a second through HTTP, against the same workers calling the generator directly
    Overhead,
}

/// Options of `presets`.
#[derive(Clone, Debug, Args)]
pub(super) struct PresetsArgs {
    /// Print a JSON array of all presets, whole
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

/// Reads a value by the name that it has in JSON, so that the command line and the wire never differ.
fn kebab<T: serde::de::DeserializeOwned>(text: &str) -> Result<T, String> {
    serde_json::from_value(serde_json::Value::from(text)).map_err(|error| error.to_string())
}
