//! `oviduct worker`: grows models for services on other machines until it is asked to stop.

use super::args::WorkerArgs;
use super::exit::{Ended, Failure};
use super::interrupt;
use super::service::{Works, database};

pub(super) async fn run(args: WorkerArgs) -> Ended {
    if !database(&args.service.database)?.is_shared() {
        return Err(Failure::usage("--database must be a postgres://… that a service shares; a file is one process's"));
    }
    if args.service.cpu_workers == 0 {
        return Err(Failure::usage("--cpu-workers 0 leaves nothing that could work"));
    }
    let works = Works::start(&args.service).await?;
    tracing::info!(workers = args.service.cpu_workers, "working");
    interrupt::asked_to_stop().await;
    tracing::info!(grace = ?args.service.grace, "stopping; asked again, it stops at once");
    tokio::select! {
        () = works.stop(std::future::ready(())) => Ok(()),
        () = interrupt::asked_to_stop() => Err(Failure::Interrupted),
    }
}
