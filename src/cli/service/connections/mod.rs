//! Serves connections with limits on their number and on the time that a client may take.
//!
//! A silent or slow client must not keep others out. A request must arrive in time. A response may
//! take any time as long as the client receives it at a minimum rate (see `pace.rs`), so event
//! streams and long downloads are not cut off.

mod pace;
mod waiting;

use axum::Router;
use hyper_util::rt::{TokioExecutor, TokioIo, TokioTimer};
use hyper_util::server::conn::auto::Builder;
use hyper_util::service::TowerToHyperService;
use pace::Paced;
use std::convert::Infallible;
use std::io;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Duration;
use tokio::net::{TcpListener, TcpSocket, TcpStream};
use tokio::sync::Semaphore;
use tokio::time::timeout;
use tokio_util::sync::CancellationToken;
use tokio_util::task::TaskTracker;
use tower::ServiceExt;
use waiting::{ClientConnection, WaitingConnections};

/// Time for the first byte of a connection to arrive. Clients usually send a request at once.
const FIRST_TIME: Duration = Duration::from_secs(15);
/// Time for the head of a request to arrive, and for the next request on a connection to begin.
/// Load balancers keep idle connections for a minute; with a longer time the service does not close
/// a connection that is about to be reused.
const HEAD_TIME: Duration = Duration::from_secs(75);
/// Assumed number of descriptors of a process whose limit is unknown.
const DESCRIPTORS: u64 = 1024;
/// Default maximum of connections, whatever the number of descriptors.
const MOST: usize = 10_000;
/// Maximum of connections to an address for operators.
const PROBES: usize = 64;
/// Maximum bytes of a response that wait in this process, and of the head of a request. More than
/// the 64 KiB of the longest URI.
const BUFFER: usize = 72 << 10;
/// Pause after a failed accept, which fails while the process has no free descriptor.
const PAUSE: Duration = Duration::from_millis(200);

/// Maximum number of connections that wait to be accepted; Linux also limits it by
/// `net.core.somaxconn`. A client beyond the maximum tries again after a second.
const BACKLOG: u32 = 4096;

/// Listens at an address.
///
/// # Errors
/// Any error of the operating system.
pub(in crate::cli) fn listen(address: SocketAddr) -> io::Result<TcpListener> {
    let socket = if address.is_ipv4() { TcpSocket::new_v4() } else { TcpSocket::new_v6() }?;
    // On Windows, the option would let two processes use the address.
    #[cfg(not(windows))]
    socket.set_reuseaddr(true)?;
    socket.bind(address)?;
    socket.listen(BACKLOG)
}

/// Limits of connections.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::cli) struct Connections {
    /// Maximum at a time; further ones wait to be accepted.
    pub(in crate::cli) most: usize,
    /// Maximum at a time without a request, per address; further ones are closed.
    pub(in crate::cli) waiting: usize,
    /// Time for the first byte.
    pub(in crate::cli) first_time: Duration,
    /// Time for the head of a request.
    pub(in crate::cli) head_time: Duration,
    /// Maximum time for which a connection is blocked; see [`Paced::new`].
    pub(in crate::cli) write_time: Duration,
    /// Time after `shutdown` at which running requests are cut off; `None` for never.
    pub(in crate::cli) grace: Option<Duration>,
}

impl Connections {
    /// Allows `most` connections; by default three quarters of the descriptors of the process, but
    /// at most 10,000. Half of the other descriptors are for downloads ([`downloads`]), half for
    /// databases and files of workers.
    pub(in crate::cli) fn new(most: Option<u32>, write_time: Duration) -> Self {
        let default = || usize::try_from(descriptors() / 4 * 3).unwrap_or(usize::MAX).min(MOST);
        let most = most.map_or_else(default, |most| most as usize).clamp(1, Semaphore::MAX_PERMITS);
        Self { most, waiting: most.div_ceil(2), first_time: FIRST_TIME, head_time: HEAD_TIME, write_time, grace: None }
    }

    /// Limits of a separate address for probes and metrics, which other clients cannot exhaust.
    pub(in crate::cli) fn for_probes() -> Self {
        let time = FIRST_TIME;
        Self {
            most: PROBES,
            waiting: PROBES.div_ceil(2),
            first_time: time,
            head_time: HEAD_TIME,
            write_time: time,
            grace: None,
        }
    }

    /// Cuts off requests that still run `grace` after `shutdown`.
    #[must_use]
    pub(in crate::cli) fn with_grace(self, grace: Duration) -> Self {
        Self { grace: Some(grace), ..self }
    }
}

/// Returns the maximum number of downloads at a time. Each holds a descriptor in addition to that
/// of its connection.
pub(in crate::cli) fn downloads() -> usize {
    usize::try_from(descriptors() / 8).unwrap_or(usize::MAX).clamp(1, MOST)
}

/// Returns the maximum number of descriptors of the process.
pub(in crate::cli) fn descriptors() -> u64 {
    let limits = std::fs::read_to_string("/proc/self/limits").unwrap_or_default();
    let soft = limits.lines().find_map(|line| line.strip_prefix("Max open files")?.split_whitespace().next());
    soft.and_then(|text| text.parse().ok()).unwrap_or(DESCRIPTORS)
}

/// Serves until `shutdown` is cancelled, and then until the last response is sent or the grace is
/// over.
pub(in crate::cli) async fn serve(
    listener: TcpListener,
    router: Router,
    limits: Connections,
    shutdown: CancellationToken,
) {
    let places = Arc::new(Semaphore::new(limits.most));
    let mut builder = Builder::new(TokioExecutor::new()).http1_only();
    builder.http1().timer(TokioTimer::new()).header_read_timeout(limits.head_time).max_buf_size(BUFFER);
    let (open, waiting) = (TaskTracker::new(), WaitingConnections::new(limits.waiting));
    let cut_off = CancellationToken::new();
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
            (Ok((stream, address)), Ok(place)) => {
                let Some(client) = waiting.open(address.ip()) else {
                    tracing::debug!(%address, "closed a connection: too many of its address have no request");
                    continue;
                };
                let (builder, router, shutdown) = (builder.clone(), router.clone(), shutdown.clone());
                let connection = async move {
                    if speaks(&stream, limits.first_time, &shutdown).await {
                        answer(builder, stream, limits.write_time, router, client, shutdown).await;
                    }
                    drop(place);
                };
                let cut_off = cut_off.clone();
                open.spawn(async move { cut_off.run_until_cancelled(connection).await });
            }
            (Err(error), _) if is_of_one(&error) => {}
            (Err(error), _) => {
                tracing::error!(%error, "no connection can be accepted");
                tokio::time::sleep(PAUSE).await;
            }
            (_, Err(_)) => break,
        }
    }
    drop(listener);
    open.close();
    let Some(grace) = limits.grace else { return open.wait().await };
    if timeout(grace, open.wait()).await.is_err() {
        tracing::warn!(connections = open.len(), ?grace, "requests that have not ended are cut off");
        cut_off.cancel();
        open.wait().await;
    }
}

/// Returns true if the error concerns one connection only.
fn is_of_one(error: &io::Error) -> bool {
    matches!(
        error.kind(),
        io::ErrorKind::ConnectionRefused | io::ErrorKind::ConnectionAborted | io::ErrorKind::ConnectionReset
    )
}

/// Returns true if the client sends something in time.
async fn speaks(stream: &TcpStream, time: Duration, shutdown: &CancellationToken) -> bool {
    let mut byte = [0];
    tokio::select! {
        first = timeout(time, stream.peek(&mut byte)) => matches!(first, Ok(Ok(1..))),
        () = shutdown.cancelled() => false,
    }
}

/// Responds to the requests of one connection.
async fn answer(
    builder: Builder<TokioExecutor>,
    stream: TcpStream,
    write_time: Duration,
    router: Router,
    client: Arc<ClientConnection>,
    shutdown: CancellationToken,
) {
    // Events are small and must not wait for more data.
    if let Err(error) = stream.set_nodelay(true) {
        tracing::trace!(%error, "small responses may be slow");
    }
    let stream = TokioIo::new(Paced::new(stream, write_time));
    let of_requests = Arc::clone(&client);
    let service = tower::service_fn(move |request| {
        of_requests.begin_request();
        let (router, client) = (router.clone(), Arc::clone(&of_requests));
        async move {
            let response = router.oneshot(request).await?;
            Ok::<_, Infallible>(client.until_sent(response))
        }
    });
    let connection = builder.serve_connection(stream, TowerToHyperService::new(service));
    tokio::pin!(connection);
    let ended = tokio::select! {
        ended = &mut connection => ended,
        () = async { tokio::select! { () = shutdown.cancelled() => {} () = client.is_surplus() => {} } } => {
            connection.as_mut().graceful_shutdown();
            connection.await
        }
    };
    if let Err(error) = ended {
        tracing::trace!(%error, "a connection ended with an error");
    }
}

#[cfg(test)]
mod tests;
