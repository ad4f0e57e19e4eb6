//! `oviduct worker`: grows models for services on other machines until it is asked to stop.

use super::args::WorkerArgs;
use super::connections::{self, Connections};
use super::exit::{Ended, Failure};
use super::interrupt::Signals;
use super::service::{Hands, Works, database};
use crate::http::{Limits, watch_router};
use anyhow::Context;
use tokio::net::TcpListener;
use tokio_util::sync::CancellationToken;

pub(super) async fn run(args: WorkerArgs) -> Ended {
    if !database(&args.service.database)?.is_shared() {
        return Err(Failure::usage("--database must be a postgres://… that a service shares; a file is one process's"));
    }
    let mut signals = Signals::listen();
    let works = tokio::select! {
        started = Works::start(&args.service, Hands::Needed) => started?,
        () = signals.asked_to_stop() => return Ok(()),
    };
    let shutdown = CancellationToken::new();
    if let Some(address) = args.metrics_addr {
        let listener = TcpListener::bind(address).await.with_context(|| format!("--metrics-addr {address}"))?;
        let router = watch_router(works.state(Limits::default(), &shutdown));
        tokio::spawn(connections::serve(listener, router, Connections::for_probes(), shutdown.clone()));
    }
    tracing::info!(workers = args.service.cpu_workers, "working");
    signals.asked_to_stop().await;
    tracing::info!(grace = ?args.service.grace, "stopping; asked again, it stops at once");
    tokio::select! {
        () = works.stop(async { shutdown.cancel() }) => Ok(()),
        () = signals.asked_to_stop() => Err(Failure::Interrupted),
    }
}
