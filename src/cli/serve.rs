//! `oviduct serve`: serves until it is asked to stop.

use super::args::ServeArgs;
use super::exit::{Ended, Failure};
use super::service::Service;
use super::{interrupt, term};
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
    let listener = TcpListener::bind(args.addr).await.with_context(|| format!("--addr {}", args.addr))?;
    let mut service = Service::start(&args.service, listener).await?;
    term::print(&format!("http://{}", service.address()))?;
    let failed = tokio::select! {
        failed = service.failed() => Some(failed),
        () = interrupt::asked_to_stop() => None,
    };
    if failed.is_none() {
        tracing::info!(grace = ?args.service.grace, "stopping; asked again, it stops at once");
    }
    tokio::select! {
        stopped = service.stop(failed) => stopped,
        () = interrupt::asked_to_stop() => Err(Failure::Interrupted),
    }
}
