//! Options of `workers`.

use super::remote::RemoteArgs;
use clap::builder::{FalseyValueParser, NonEmptyStringValueParser};
use clap::{Args, ValueEnum};

/// Options of `workers`.
#[derive(Clone, Debug, Args)]
pub(in crate::cli) struct WorkersArgs {
    /// What to do
    #[arg(value_name = "ACTION", value_enum, default_value_t = WorkersAction::List)]
    pub(in crate::cli) action: WorkersAction,
    /// Name of the worker, as listed [default: all workers, to pause or resume them]
    #[arg(value_name = "NAME", value_parser = NonEmptyStringValueParser::new())]
    pub(in crate::cli) name: Option<String>,
    #[command(flatten)]
    pub(in crate::cli) service: RemoteArgs,
    /// Print the answer of the service as JSON
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(in crate::cli) json: bool,
}

/// What to do with workers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(in crate::cli) enum WorkersAction {
    /// List them with their state
    List,
    /// Start no more models; those that grow go on
    Pause,
    /// Start models again
    Resume,
    /// Start no more models and report once the last has ended, before the worker is stopped
    Drain,
}
