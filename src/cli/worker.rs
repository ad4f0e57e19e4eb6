//! `oviduct worker`: grows models for services on other machines until it is asked to stop.

use super::args::WorkerArgs;
use super::exit::{Ended, Failure};
use super::interrupt::Signals;
use super::service::{Runtime, WorkerRequirement, database, process_limits, serve_probes};
use crate::http::watch_router;
use anyhow::Context;
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;

pub(super) async fn run(args: WorkerArgs) -> Ended {
    if !database(&args.process.database)?.is_shared() {
        return Err(Failure::usage(
            "--database must be a postgres://… URL shared with a service; an SQLite file belongs to one process",
        ));
    }
    let mut signals = Signals::listen();
    let runtime = tokio::select! {
        started = Runtime::start(&args.process, WorkerRequirement::Required) => started?,
        () = signals.asked_to_stop() => return Ok(()),
    };
    let shutdown = CancellationToken::new();
    if let Some(address) = args.metrics_addr {
        let listener = TcpListener::bind(address).await.with_context(|| format!("--metrics-addr {address}"))?;
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
