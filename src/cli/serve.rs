//! `oviduct serve`: serves until it is asked to stop.

use super::args::ServeArgs;
use super::exit::{Ended, Failure};
use super::interrupt::Signals;
use super::service::Service;
use super::term;
use anyhow::Context;
use tokio::net::TcpListener;

pub(super) async fn run(args: ServeArgs) -> Ended {
    if !args.addr.ip().is_loopback() && !args.insecure_no_auth {
        return Err(Failure::usage(format!(
            "--addr {}: whoever reaches this address could use the service, for there is no authentication yet; \
             give --insecure-no-auth if that is meant",
            args.addr
        )));
    }
    // Before anybody can know that it is there.
    let mut signals = Signals::listen();
    let listener = TcpListener::bind(args.addr).await.with_context(|| format!("--addr {}", args.addr))?;
    let mut service = tokio::select! {
        started = Service::start(&args.service, listener) => started?,
        () = signals.asked_to_stop() => return Ok(()),
    };
    term::print(&format!("http://{}", service.address()))?;
    let failed = tokio::select! {
        failed = service.failed() => Some(failed),
        () = signals.asked_to_stop() => None,
    };
    if failed.is_none() {
        tracing::info!(grace = ?args.service.grace, "stopping; asked again, it stops at once");
    }
    tokio::select! {
        stopped = service.stop(failed) => stopped,
        () = signals.asked_to_stop() => Err(Failure::Interrupted),
    }
}
