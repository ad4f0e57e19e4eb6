//! `oviduct serve`: serves until it is asked to stop.

use super::args::ServeArgs;
use super::exit::{Ended, Failure};
use super::interrupt::Signals;
use super::service::Service;
use super::term;
use crate::http::Origin;
use anyhow::Context;
use std::net::SocketAddr;
use tokio::net::TcpListener;

pub(super) async fn run(args: ServeArgs) -> Ended {
    if args.cors_origins.iter().any(Origin::is_any) {
        tracing::warn!(
            "--cors-origin *: any page that a user of this service visits can call it from the user's browser"
        );
    }
    // Before the address is known to anyone who could send a signal.
    let mut signals = Signals::listen();
    let listener = bind("--addr", args.addr).await?;
    let probes = match args.metrics_addr {
        Some(address) => Some(bind("--metrics-addr", address).await?),
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

async fn bind(option: &str, address: SocketAddr) -> anyhow::Result<TcpListener> {
    TcpListener::bind(address).await.with_context(|| format!("{option} {address}"))
}
