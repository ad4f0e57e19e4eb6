//! The command line: parses options, connects the modules below, reports results and errors.
//!
//! Results go to stdout; logs, progress and errors to stderr. Exit codes: 0 success, 1 failure, 2
//! invalid usage or an invalid spec, 130 interrupted.

mod args;
mod config;
mod exit;
pub mod gpu;
mod interrupt;
pub mod load;
mod local;
pub mod model;
mod remote;
mod scratch;
mod service;
mod telemetry;
pub mod term;
pub mod units;

// Parts that the program `oviduct-lab` (crates/lab) uses too.
pub use args::{GpuArgs, GpuUse, ServeArgs, SpecArgs};
pub use config::with_variables;
pub use exit::{Ended, Failure, exit_code};
pub use interrupt::Signals;
pub use local::{generate, render};
pub use remote::{Client, Key};
pub use scratch::Scratch;
pub use service::Service;

use crate::spec;
use args::{Cli, Command};
use local::{check, compare, convert, cut, fit, measure, report, section};
use remote::{demo, submit, workers};
use service::{keys, run as process, scrub};
use std::ffi::OsString;
use std::process::ExitCode;
use std::time::Duration;
use telemetry::Telemetry;

/// Time for running threads to finish after a command has ended.
const SHUTDOWN: Duration = Duration::from_secs(2);

/// Runs the command given by the arguments (without the name of the program); returns the exit
/// code.
#[must_use]
pub fn run(args: impl IntoIterator<Item = OsString>) -> ExitCode {
    let cli = match config::parse(args) {
        Ok(config::Parsed::Run(cli)) => *cli,
        Ok(config::Parsed::Say(message)) => {
            let code = if message.use_stderr() { 2 } else { 0 };
            // If it cannot be printed, the exit code is all that is left.
            let _ = message.print();
            return ExitCode::from(code);
        }
        Err(failure) => return exit_code(&Err(failure)),
    };
    if cli.command.may_use_gpu() {
        gpu::without_device_select();
    }
    exit_code(&start(cli))
}

fn start(cli: Cli) -> Ended {
    let serves = matches!(cli.command, Command::Serve(_) | Command::Worker(_));
    let filter = match cli.command {
        _ if serves => "info",
        Command::Keys(_) => "warn,oviduct::audit=info",
        _ => "warn",
    };
    let telemetry = Telemetry::start(&cli.global, filter, serves)?;
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    let ended = runtime.block_on(dispatch(cli.command));
    runtime.shutdown_timeout(SHUTDOWN);
    telemetry.stop();
    ended
}

async fn dispatch(command: Command) -> Ended {
    match command {
        Command::Serve(args) => process::serve(args).await,
        Command::Generate(args) => generate::run(args).await,
        Command::Demo(args) => demo::run(args).await,
        Command::Submit(args) => submit::run(args).await,
        Command::Load(args) => load::run(args).await,
        Command::Check(args) => check::run(args).await,
        Command::Convert(args) => convert::run(args).await,
        Command::Render(args) => render::run(args).await,
        Command::Report(args) => report::run(args).await,
        Command::Fit(args) => fit::run(args).await,
        Command::Compare(args) => compare::run(args).await,
        Command::Section(args) => section::run(args).await,
        Command::Cut(args) => cut::run(args).await,
        Command::Measure(args) => measure::run(args).await,
        Command::Presets { json } => print_presets(json),
        Command::Worker(args) => process::work(args).await,
        Command::Keys(args) => keys::run(args).await,
        Command::Workers(args) => workers::run(args).await,
        Command::Migrate(args) => process::migrate(args).await,
        Command::Scrub(args) => scrub::run(args).await,
        Command::Schema => Ok(term::print_json(&spec::schema())?),
        Command::Openapi => Ok(term::print(&crate::http::openapi_yaml())?),
        Command::Healthcheck { url } => Client::new(&url, None)?.get("/healthz").await.map(|_| ()),
    }
}

/// Lists the presets.
fn print_presets(json: bool) -> Ended {
    if json {
        let all: Vec<_> = spec::presets().iter().map(spec::Preset::details).collect();
        return Ok(term::print_json(&all)?);
    }
    for preset in spec::presets() {
        let default = if preset.name == spec::DEFAULT_PRESET { " (default)" } else { "" };
        term::print(&format!("{}{default}: {}\n    {}", preset.name, preset.title, preset.description))?;
    }
    Ok(())
}
