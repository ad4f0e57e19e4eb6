//! Options of `load`.

use super::shared::{ModelArgs, RemoteArgs};
use crate::cli::load::{Arrivals, Mix, Rate};
use crate::cli::units;
use clap::Args;
use clap::builder::FalseyValueParser;
use std::time::Duration;

/// Options of `load`.
#[derive(Clone, Debug, Args)]
pub(in crate::cli) struct LoadArgs {
    #[command(flatten)]
    pub(in crate::cli) service: RemoteArgs,
    /// Open loop: send calls at this rate, such as 200/s or 12000/min, without waiting for earlier
    /// responses. Latency counts from the planned start of a call [default: closed loop]
    #[arg(long, value_name = "RATE", conflicts_with_all = ["concurrency", "models", "direct"])]
    pub(in crate::cli) rate: Option<Rate>,
    /// Distribution of the open loop's calls over time
    #[arg(long, value_enum, requires = "rate", default_value_t = Arrivals::Poisson)]
    pub(in crate::cli) arrivals: Arrivals,
    /// Open loop: maximum number of calls in flight; further ones are dropped and counted
    #[arg(long, value_name = "N", requires = "rate", value_parser = clap::value_parser!(u32).range(1..), default_value_t = 500)]
    pub(in crate::cli) max_in_flight: u32,
    /// Closed loop: number of users; each requests a model or makes a call of the mix, waits for
    /// its end and continues with the next one
    #[arg(long, value_name = "C", value_parser = clap::value_parser!(u32).range(1..), default_value_t = 4)]
    pub(in crate::cli) concurrency: u32,
    /// Closed loop: number of models, with consecutive seeds that start with --seed [default: 100,
    /// or as many as fit in --duration]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..1 << 40), conflicts_with = "mix")]
    pub(in crate::cli) models: Option<u64>,
    /// Calls with their weights, such as submit=1,get=3; calls that read a model, file or event
    /// stream choose among the models of this run [default:
    /// submit=8,get=4,list=2,download=1,events=1 in the open loop, whole models in the closed loop]
    #[arg(long, value_name = "LIST", conflicts_with = "direct")]
    pub(in crate::cli) mix: Option<Mix>,
    /// Length of the run after the warm-up [default: 60s; with --models, until all models have
    /// ended]
    #[arg(long, value_name = "TIME", value_parser = units::positive_duration, conflicts_with = "direct")]
    pub(in crate::cli) duration: Option<Duration>,
    /// Time at the start that is excluded from the results [default: 5s in the open loop, else 0s]
    #[arg(long, value_name = "TIME", value_parser = units::duration_or_zero, conflicts_with = "direct")]
    pub(in crate::cli) warm_up: Option<Duration>,
    /// Number of event streams held open during the run; each follows a model of this run to its
    /// end, then the next one
    #[arg(long, value_name = "N", conflicts_with = "direct", default_value_t = 0)]
    pub(in crate::cli) streams: u32,
    /// Maximum time to wait at the end for accepted models [0: do not wait]. Calls that users of
    /// the closed loop have in flight are aborted after this time, or after --timeout if that is
    /// longer
    #[arg(long, value_name = "TIME", value_parser = units::duration_or_zero, default_value = "5m")]
    pub(in crate::cli) wait: Duration,
    /// Open loop and mixes: time after which a call without a response counts as an error
    #[arg(long, value_name = "TIME", value_parser = units::positive_duration, default_value = "30s")]
    pub(in crate::cli) timeout: Duration,
    #[command(flatten)]
    pub(in crate::cli) model: ModelArgs,
    /// Grow the models in this process without a service, C at a time, as a baseline for comparison
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(in crate::cli) direct: bool,
    /// After the run, grow a few models on all cores of this machine without the service, and
    /// compare models per second
    #[arg(long, value_parser = FalseyValueParser::new(), conflicts_with = "direct")]
    pub(in crate::cli) efficiency: bool,
    /// Print one JSON object
    #[arg(long, value_parser = FalseyValueParser::new())]
    pub(in crate::cli) json: bool,
}
