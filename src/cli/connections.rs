//! Serves connections: so many at a time, each with so much time for the head of a request.
//!
//! Nobody who connects and stays silent may keep others out. An answer may take any time: event streams and long
//! downloads are not cut.

use axum::Router;
use hyper_util::rt::{TokioExecutor, TokioIo, TokioTimer};
use hyper_util::server::conn::auto::Builder;
use hyper_util::service::TowerToHyperService;
use std::io;
use std::sync::Arc;
use std::time::Duration;
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::Semaphore;
use tokio::time::timeout;
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;

/// Time for the first byte of a connection to arrive: who connects commonly has something to ask.
const FIRST_TIME: Duration = Duration::from_secs(15);
/// Time for the head of a request to arrive, and for the next request on a connection to begin: longer than the minute
/// that balancers keep idle connections for, so that it is not the service that closes one just as it is used again.
const HEAD_TIME: Duration = Duration::from_secs(75);
/// Descriptors that a process may commonly have, where it cannot be asked.
const DESCRIPTORS: u64 = 1024;
/// Wait after an accept that failed, which it does as long as there are no descriptors left.
const WAIT: Duration = Duration::from_millis(200);

/// What connections are allowed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Connections {
    /// Most at a time; others wait to be accepted.
    pub(super) most: usize,
    /// Time for the first byte.
    pub(super) first_time: Duration,
    /// Time for the head of a request.
    pub(super) head_time: Duration,
}

impl Connections {
    /// With so many at a time; where it is not said, three quarters of the descriptors there may be, for files and
    /// databases need some too.
    pub(super) fn new(most: Option<u32>) -> Self {
        let most =
            most.map_or_else(|| usize::try_from(descriptors() / 4 * 3).unwrap_or(usize::MAX), |most| most as usize);
        Self { most: most.clamp(1, Semaphore::MAX_PERMITS), first_time: FIRST_TIME, head_time: HEAD_TIME }
    }
}

/// How many descriptors the process may have.
fn descriptors() -> u64 {
    let limits = std::fs::read_to_string("/proc/self/limits").unwrap_or_default();
    let soft = limits.lines().find_map(|line| line.strip_prefix("Max open files")?.split_whitespace().next());
    soft.and_then(|text| text.parse().ok()).unwrap_or(DESCRIPTORS)
}

/// Serves until `shutdown` is cancelled, and then until the last request is answered.
pub(super) async fn serve(listener: TcpListener, router: Router, limits: Connections, shutdown: CancellationToken) {
    let places = Arc::new(Semaphore::new(limits.most));
    let mut builder = Builder::new(TokioExecutor::new()).http1_only();
    builder.http1().timer(TokioTimer::new()).header_read_timeout(limits.head_time);
    let open = TaskTracker::new();
    loop {
        let next = async {
            let place = Arc::clone(&places).acquire_owned().await;
            (listener.accept().await, place)
        };
        let accepted = tokio::select! {
            accepted = next => accepted,
            () = shutdown.cancelled() => break,
        };
        match accepted {
            (Ok((stream, _)), Ok(place)) => {
                let (builder, router, shutdown) = (builder.clone(), router.clone(), shutdown.clone());
                open.spawn(async move {
                    if speaks(&stream, limits.first_time, &shutdown).await {
                        answer(builder, stream, router, shutdown).await;
                    }
                    drop(place);
                });
            }
            (Err(error), _) if is_of_one(&error) => {}
            (Err(error), _) => {
                tracing::error!(%error, "no connection could be accepted");
                tokio::time::sleep(WAIT).await;
            }
            (_, Err(_)) => break,
        }
    }
    drop(listener);
    open.close();
    open.wait().await;
}

/// Whether only the one connection failed.
fn is_of_one(error: &io::Error) -> bool {
    matches!(
        error.kind(),
        io::ErrorKind::ConnectionRefused | io::ErrorKind::ConnectionAborted | io::ErrorKind::ConnectionReset
    )
}

/// Whether something is sent in time.
async fn speaks(stream: &TcpStream, time: Duration, shutdown: &CancellationToken) -> bool {
    let mut byte = [0];
    tokio::select! {
        first = timeout(time, stream.peek(&mut byte)) => matches!(first, Ok(Ok(1..))),
        () = shutdown.cancelled() => false,
    }
}

/// Answers the requests of one connection.
async fn answer(builder: Builder<TokioExecutor>, stream: TcpStream, router: Router, shutdown: CancellationToken) {
    // Events are small, and shall not wait for more to be sent with them.
    if let Err(error) = stream.set_nodelay(true) {
        tracing::trace!(%error, "small answers may be slow");
    }
    let connection = builder.serve_connection(TokioIo::new(stream), TowerToHyperService::new(router));
    tokio::pin!(connection);
    let ended = tokio::select! {
        ended = &mut connection => ended,
        () = shutdown.cancelled() => {
            connection.as_mut().graceful_shutdown();
            connection.await
        }
    };
    if let Err(error) = ended {
        tracing::trace!(%error, "a connection broke off");
    }
}

#[cfg(test)]
mod tests;
