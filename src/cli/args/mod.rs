//! The command line: commands, options, their defaults and help texts.
//!
//! Environment variables are not declared here: [`super::config`] gives every long option its
//! `OVIDUCT_…` variable.

mod fit;
mod keys;
mod limits;
mod load;
mod local;
mod measure;
mod process;
mod remote;
mod shared;

pub(super) use fit::FitArgs;
pub(super) use keys::{Keys, KeysAddArgs, KeysRotateArgs};
pub(super) use load::LoadArgs;
pub(super) use local::{
    CheckArgs, CompareArgs, ConvertArgs, CutArgs, GenerateArgs, LayerArgs, RenderArgs, ReportArgs, SectionArgs, Side,
};
pub(super) use measure::MeasureArgs;
pub use process::ServeArgs;
pub(super) use process::{ProcessArgs, WorkerArgs};
pub(super) use remote::{DemoArgs, SubmitArgs, WorkersAction, WorkersArgs};
pub(super) use shared::{DatabaseArgs, ModelArgs, ScrubArgs, UnitArgs};
pub use shared::{GpuArgs, GpuUse, SpecArgs};

use crate::generate::Backend;
use clap::builder::FalseyValueParser;
use clap::{Args, Parser, Subcommand, ValueEnum};
use std::path::PathBuf;

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
    /// Convert the surface in a glb, gltf, obj, stl, ply or vtp file to another of these formats,
    /// to 3mf, or to another unit or size
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
    /// Measure the sections in images: masks, label images or polygons
    Measure(MeasureArgs),
    /// Send many requests to a running service and report throughput, latencies and errors
    Load(LoadArgs),
    /// List the presets
    Presets {
        /// Print a JSON array with all values of all presets
        #[arg(long, value_parser = FalseyValueParser::new())]
        json: bool,
    },
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
    /// Compare all files of the artifact store with their records: missing, damaged and unknown
    /// files; changes nothing, and works while a service runs
    Scrub(ScrubArgs),
    /// Check that a service is alive (exit code 0 or 1); for container health checks
    #[command(hide = true)]
    Healthcheck {
        /// Address of the service
        #[arg(long, value_name = "URL", default_value = "http://127.0.0.1:8080")]
        url: String,
    },
}

impl Command {
    /// Returns true if the command may open a GPU.
    pub(super) fn may_use_gpu(&self) -> bool {
        match self {
            Self::Serve(args) => args.process.gpu.gpu != GpuUse::Off,
            Self::Worker(args) => args.process.gpu.gpu != GpuUse::Off,
            Self::Generate(args) if matches!(args.model.backend, Backend::Auto | Backend::Gpu) => {
                args.gpu.gpu != GpuUse::Off
            }
            Self::Demo(_) => true,
            _ => false,
        }
    }
}
