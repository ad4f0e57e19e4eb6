//! The command line: parses options, connects the modules below, reports results and errors.
//!
//! Results go to stdout; logs, progress and errors to stderr. Exit codes: 0 success, 1 failure, 2 invalid usage or an
//! invalid spec, 130 interrupted.

mod args;
mod check;
mod client;
mod compare;
mod config;
mod connections;
mod convert;
mod cut;
mod demo;
mod exit;
mod first_key;
mod fit;
pub mod generate;
pub mod gpu;
mod interrupt;
mod keys;
mod layers;
pub mod load;
mod measure;
mod migrate;
pub mod model;
mod print;
pub mod render;
mod report;
mod restart;
mod scratch;
mod secret;
mod section;
mod serve;
mod service;
mod sse;
mod submit;
mod telemetry;
pub mod term;
pub mod units;
mod upkeep;
mod worker;
mod workers;

// Parts that the program `oviduct-lab` (crates/lab) uses too.
pub use args::{GpuArgs, GpuUse, ServeArgs, SpecArgs};
pub use client::Client;
pub use config::with_variables;
pub use exit::{Ended, Failure, exit_code};
pub use interrupt::Signals;
pub use restart::without_device_select;
pub use scratch::Scratch;
pub use secret::Key;
pub use service::Service;

use args::{Cli, Command};
use std::ffi::OsString;
use std::process::ExitCode;
use std::time::Duration;
use telemetry::Telemetry;

/// Time for running threads to finish after a command has ended.
const SHUTDOWN: Duration = Duration::from_secs(2);

/// Runs the command given by the arguments (without the name of the program); returns the exit code.
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
        without_device_select();
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
        Command::Serve(args) => serve::run(args).await,
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
        Command::Presets(args) => print::presets(&args),
        Command::Worker(args) => worker::run(args).await,
        Command::Keys(args) => keys::run(args).await,
        Command::Workers(args) => workers::run(args).await,
        Command::Migrate(args) => migrate::run(args).await,
        Command::Schema => print::schema(),
        Command::Openapi => print::openapi(),
        Command::Healthcheck(args) => client::Client::new(&args.url, None)?.get("/healthz").await.map(|_| ()),
    }
}
