//! Options of `workers`.

use super::remote::RemoteArgs;
use clap::builder::{FalseyValueParser, NonEmptyStringValueParser};
use clap::{Args, ValueEnum};

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
