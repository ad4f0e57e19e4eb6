//! `oviduct serve`, `oviduct worker` and `oviduct migrate`.

use super::connections::listen;
use super::{Runtime, Service, database, location, process_limits, serve_probes};
use crate::cli::args::{DatabaseArgs, ServeArgs, WorkerArgs};
use crate::cli::exit::{Ended, Failure};
use crate::cli::interrupt::Signals;
use crate::cli::term;
use crate::http::{Origin, watch_router};
use anyhow::Context;
use std::net::SocketAddr;
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;

/// Serves until a signal asks it to stop.
pub(in crate::cli) async fn serve(args: ServeArgs) -> Ended {
    if args.cors_origins.iter().any(Origin::is_any) {
        tracing::warn!(
            "--cors-origin *: any page that a user of this service visits can call it from the user's browser"
        );
    }
    // Before the address is printed, since its reader may send a signal.
    let mut signals = Signals::listen();
    let listener = bind("--addr", args.addr)?;
    let probes = match args.metrics_addr {
        Some(address) => Some(bind("--metrics-addr", address)?),
        None => None,
    };
    let mut service = tokio::select! {
        started = Service::start(&args, listener, probes) => started?,
        () = signals.asked_to_stop() => return Ok(()),
    };
    term::print(&format!("http://{}", service.address()))?;
    let failed = tokio::select! {
        failed = service.failed() => Some(failed),
        () = signals.asked_to_stop() => None,
    };
    if failed.is_none() {
        tracing::info!(
            drain_delay = ?args.drain_delay, grace = ?args.process.grace, "shutting down; a second signal stops at once"
        );
    }
    tokio::select! {
        stopped = service.stop(failed) => stopped,
        () = signals.asked_to_stop() => Err(Failure::Interrupted),
    }
}

/// Listens at the address of an option.
fn bind(option: &str, address: SocketAddr) -> anyhow::Result<TcpListener> {
    listen(address).with_context(|| format!("{option} {address}"))
}

/// Grows models for services on other machines until a signal asks it to stop.
pub(in crate::cli) async fn work(args: WorkerArgs) -> Ended {
    if !database(&args.process.database)?.is_shared() {
        return Err(Failure::usage(
            "--database must be a postgres://… URL shared with a service; an SQLite file belongs to one process",
        ));
    }
    let mut signals = Signals::listen();
    let runtime = tokio::select! {
        started = Runtime::start(&args.process) => started?,
        () = signals.asked_to_stop() => return Ok(()),
    };
    let shutdown = CancellationToken::new();
    if let Some(address) = args.metrics_addr {
        let listener = bind("--metrics-addr", address)?;
        serve_probes(listener, watch_router(runtime.state(process_limits(&args.process), &shutdown)), &shutdown);
    }
    tracing::info!(workers = args.process.cpu_workers, "started");
    signals.asked_to_stop().await;
    tracing::info!(grace = ?args.process.grace, "shutting down; a second signal stops at once");
    runtime.drain();
    tokio::select! {
        () = runtime.stop(async {}) => {
            shutdown.cancel();
            Ok(())
        }
        () = signals.asked_to_stop() => Err(Failure::Interrupted),
    }
}

/// Updates the database schema.
pub(in crate::cli) async fn migrate(args: DatabaseArgs) -> Ended {
    let database = database(&args)?;
    let migrated = database.migrate().await;
    Ok(migrated.with_context(|| format!("the schema of the job store {} could not be updated", location(&database)))?)
}
