//! `oviduct-lab`: benchmarks, the paper's figures and plots, which the released program does not
//! contain.

mod bench;
mod figures;
mod load_plot;
mod plot;

use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use oviduct::cli::{Ended, Failure, GpuUse, exit_code, gpu, with_variables};
use std::process::ExitCode;
use tracing_subscriber::EnvFilter;

/// The allocator of `oviduct`, so that measurements apply to it.
#[cfg(not(target_env = "msvc"))]
#[global_allocator]
static ALLOCATOR: tikv_jemallocator::Jemalloc = tikv_jemallocator::Jemalloc;

/// Measures oviduct, reproduces the figures of the paper and plots load tests.
///
/// Every option can also be set by an environment variable (OVIDUCT_ followed by the option's name
/// in capitals, with `_` for `-`). Exit codes: 0 success, 1 failure, 2 invalid usage or an invalid
/// spec, 130 interrupted.
#[derive(Debug, Parser)]
#[command(name = "oviduct-lab", version)]
struct Cli {
    /// Log filter for stderr, such as `info` or `warn,oviduct=debug`
    #[arg(long, global = true, value_name = "FILTER", default_value = "warn")]
    log: String,
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Measure how fast this machine grows models
    Bench(bench::BenchArgs),
    /// Reproduce Figures 4, 7, 8, 9, 10 and 11 of the paper with a new model and measurements on
    /// this machine
    Figures(figures::FiguresArgs),
    /// Draw the latencies in a report of `oviduct load --json`, over time and by percentile
    Plot(load_plot::PlotArgs),
}

impl Command {
    /// Returns true if the command may open a GPU.
    fn may_use_gpu(&self) -> bool {
        match self {
            Self::Bench(args) => args.gpu.gpu != GpuUse::Off,
            Self::Figures(args) => args.gpu.gpu != GpuUse::Off,
            Self::Plot(_) => false,
        }
    }
}

fn main() -> ExitCode {
    let matches = with_variables(Cli::command()).get_matches();
    let cli = Cli::from_arg_matches(&matches).unwrap_or_else(|error| error.exit());
    if cli.command.may_use_gpu() {
        gpu::without_device_select();
    }
    exit_code(&run(cli))
}

fn run(cli: Cli) -> Ended {
    let filter = EnvFilter::try_new(&cli.log).map_err(|error| Failure::usage(format!("--log {}: {error}", cli.log)))?;
    tracing_subscriber::fmt().with_env_filter(filter).with_writer(std::io::stderr).init();
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    let ended = runtime.block_on(async {
        match cli.command {
            Command::Bench(args) => bench::run(args).await,
            Command::Figures(args) => figures::run(args).await,
            Command::Plot(args) => load_plot::run(&args),
        }
    });
    // An interrupted command leaves threads behind that compute for minutes.
    runtime.shutdown_background();
    ended
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_definition_passes_the_checks_of_clap() {
        with_variables(Cli::command()).debug_assert();
    }
}
