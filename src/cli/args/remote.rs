//! Options of the commands `submit`, `demo` and `workers`, which talk to a service.

use super::shared::{ModelArgs, RemoteArgs};
use crate::jobs::Priority;
use clap::builder::{FalseyValueParser, NonEmptyStringValueParser};
use clap::{Args, ValueEnum};
use std::path::PathBuf;

/// Seed of `demo`, the same as of the pictures in the README.
const DEMO_SEED: &str = "7";

/// Options of `demo`.
#[derive(Clone, Debug, Args)]
#[command(mut_arg("seed", |seed| seed.help("Seed of the random numbers, 0 to 2^53 - 1").default_value(DEMO_SEED)))]
pub(in crate::cli) struct DemoArgs {
    #[command(flatten)]
    pub(in crate::cli) model: ModelArgs,
    /// Replace the files of another model in ./demo: those that its manifest.json names are removed
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(in crate::cli) force: bool,
    /// Exit when the model is saved: code 0 if it is certified, 1 if not
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(in crate::cli) exit: bool,
}

/// Options of `submit`.
#[derive(Clone, Debug, Args)]
pub(in crate::cli) struct SubmitArgs {
    #[command(flatten)]
    pub(in crate::cli) service: RemoteArgs,
    #[command(flatten)]
    pub(in crate::cli) model: ModelArgs,
    /// Label as NAME:VALUE; may be repeated
    #[arg(long, value_name = "NAME:VALUE", value_delimiter = ',')]
    pub(in crate::cli) label: Vec<String>,
    /// Priority, -100 to 100; workers claim queued models of higher priority first
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(i64).range(Priority::MIN..=Priority::MAX), default_value_t = 0, allow_hyphen_values = true)]
    pub(in crate::cli) priority: i64,
    /// Grow the model again even if the service already has it
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(in crate::cli) no_reuse: bool,
    /// Idempotency key: a repeated request with the same key returns the same model [default:
    /// random]
    #[arg(long, value_name = "KEY")]
    pub(in crate::cli) idempotency_key: Option<String>,
    /// Wait until the model ends and show its progress
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(in crate::cli) wait: bool,
    /// Directory for the model's files; implies --wait
    #[arg(long, value_name = "DIR")]
    pub(in crate::cli) out: Option<PathBuf>,
    /// Replace the files of another model in --out: those that its manifest.json names are removed
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(in crate::cli) force: bool,
    /// Print the model as JSON
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(in crate::cli) json: bool,
}

/// Options of `workers`.
#[derive(Clone, Debug, Args)]
pub(in crate::cli) struct WorkersArgs {
    /// Action
    #[arg(value_name = "ACTION", value_enum, default_value_t = WorkersAction::List)]
    pub(in crate::cli) action: WorkersAction,
    /// Name of the worker, as listed; without a name, pause and resume apply to all workers
    #[arg(value_name = "NAME", value_parser = NonEmptyStringValueParser::new())]
    pub(in crate::cli) name: Option<String>,
    #[command(flatten)]
    pub(in crate::cli) service: RemoteArgs,
    /// Print the response of the service as JSON
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(in crate::cli) json: bool,
}

/// Actions on workers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(in crate::cli) enum WorkersAction {
    /// List the workers with their state
    List,
    /// Claim no more jobs; running models continue
    Pause,
    /// Claim jobs again
    Resume,
    /// Claim no more jobs, and become `drained` when the last running one has ended, so that the
    /// worker can be stopped
    Drain,
}
