//! Options of `serve` that limit requests: the predicted cost of a model, request bodies, event
//! streams, held responses, downloads and pictures.

use crate::cli::exit::Failure;
use crate::cli::units;
use crate::generate::CostLimits;
use clap::Args;
use std::time::Duration;

/// Limits of requests.
#[derive(Clone, Debug, Args)]
pub(in crate::cli) struct LimitArgs {
    /// Refuse a model (422) whose predicted time on its slowest backend exceeds this
    #[arg(long, value_name = "TIME", value_parser = units::positive_duration, default_value = "10m")]
    max_model_time: Duration,
    /// Refuse a model (422) whose predicted memory exceeds this
    #[arg(long, value_name = "SIZE", value_parser = units::positive_bytes, default_value = "4GiB")]
    max_model_memory: u64,
    /// Refuse a model (422) whose predicted number of vertices exceeds this
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u64).range(1..), default_value_t = 10_000_000)]
    max_model_vertices: u64,
    /// Refuse a model (422) whose files are predicted to exceed this total size
    #[arg(long, value_name = "SIZE", value_parser = units::positive_bytes, default_value = "4GiB")]
    max_model_size: u64,
    /// Refuse a fit (422) whose predicted time on one core exceeds this
    #[arg(long, value_name = "TIME", value_parser = units::positive_duration, default_value = "24h")]
    pub(in crate::cli) max_fit_time: Duration,
    /// Refuse a request (413) whose body exceeds this size
    #[arg(long, value_name = "SIZE", value_parser = units::positive_bytes, default_value = "1MiB")]
    pub(in crate::cli) max_body: u64,
    /// Maximum number of open event streams; further ones are refused (503) [default: 4096, or half
    /// of --connections if that is less]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    event_streams: Option<u32>,
    /// Maximum number of responses held by `Prefer: wait`; further ones are sent immediately
    /// [default: 256, or a quarter of --connections if that is less]
    #[arg(long, value_name = "N")]
    held_answers: Option<u32>,
    /// Maximum number of simultaneous downloads; further ones are refused (503) [default: 10000, or
    /// an eighth of the process's file descriptors if that is less]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub(in crate::cli) downloads: Option<u32>,
    /// Maximum number of pictures of models drawn at the same time; each uses all cores
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1024), default_value_t = 2)]
    pub(in crate::cli) pictures: u32,
}

impl LimitArgs {
    /// Limits of the predicted cost of a model, with workers that have this memory limit.
    pub(in crate::cli) fn cost(&self, memory_limit: Option<u64>) -> CostLimits {
        CostLimits {
            max_cost_seconds: self.max_model_time.as_secs_f64(),
            max_memory_bytes: memory_limit.map_or(self.max_model_memory, |limit| limit.min(self.max_model_memory)),
            max_vertices: self.max_model_vertices,
            max_output_bytes: self.max_model_size,
        }
    }

    /// Returns the limits on event streams and on held responses; `streams` and `held` are their
    /// defaults. Together they must leave connections for short requests, such as health checks.
    ///
    /// # Errors
    /// [`Failure::Usage`] if they leave no connection.
    pub(in crate::cli) fn holders(
        &self,
        connections: usize,
        streams: usize,
        held: usize,
    ) -> Result<(usize, usize), Failure> {
        let most = |given: Option<u32>, default: usize| given.map_or(default, |given| given as usize);
        let (streams, held) = (
            most(self.event_streams, streams.min(connections / 2)),
            most(self.held_answers, held.min(connections / 4)),
        );
        if streams.saturating_add(held) >= connections {
            return Err(Failure::usage(format!(
                "--event-streams {streams} and --held-answers {held} leave none of {connections} connections for other \
                 requests; raise --connections"
            )));
        }
        Ok((streams, held))
    }
}
