//! A connection that must make progress while it has bytes to send.
//!
//! Only the time counts during which the connection is blocked, so a fast client or one without
//! pending bytes is never cut off. Bytes count once the operating system has accepted them. It must
//! therefore not buffer many more than the client has received; see [`UNSENT`].

use crate::clock::Stopwatch;
use std::io::{self, IoSlice};
use std::pin::Pin;
use std::task::{Context, Poll, ready};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::TcpStream;
use tokio::time::{Sleep, sleep};

/// Bytes per second that a client must receive while the connection is blocked.
const RATE: u64 = 1024;
/// Maximum bytes that the operating system buffers in addition to those in flight. Bounds the
/// memory of a slow connection and makes its progress visible.
const UNSENT: u32 = 128 << 10;

/// A connection whose client must receive bytes at a minimum rate.
#[derive(Debug)]
pub(super) struct Paced {
    stream: TcpStream,
    /// Maximum time for which the connection is blocked per `least` bytes.
    time: Duration,
    least: u64,
    /// Bytes sent and time blocked since the last `least` bytes were sent.
    sent: u64,
    blocked: Duration,
    waiting: Option<Waiting>,
}

/// The connection is blocked.
#[derive(Debug)]
struct Waiting {
    since: Stopwatch,
    limit: Pin<Box<Sleep>>,
}

impl Paced {
    /// Cuts the connection off when it was blocked for `time` while its client received less than 1
    /// KiB per second.
    pub(super) fn new(stream: TcpStream, time: Duration) -> Self {
        limit_unsent(&stream);
        let least = u64::try_from(time.as_millis()).unwrap_or(u64::MAX).saturating_mul(RATE) / 1000;
        Self { stream, time, least, sent: 0, blocked: Duration::ZERO, waiting: None }
    }

    /// Counts the result of a write. Fails if the connection was blocked too long.
    fn count(&mut self, cx: &mut Context<'_>, written: Poll<io::Result<usize>>) -> Poll<io::Result<usize>> {
        match written {
            Poll::Ready(Ok(bytes)) => {
                self.sent += bytes as u64;
                if let Some(waiting) = self.waiting.take() {
                    self.blocked += waiting.since.elapsed();
                }
                if self.sent >= self.least {
                    (self.sent, self.blocked) = (0, Duration::ZERO);
                }
                written
            }
            Poll::Ready(Err(_)) => written,
            Poll::Pending => {
                let left = self.time.saturating_sub(self.blocked);
                let waiting = self
                    .waiting
                    .get_or_insert_with(|| Waiting { since: Stopwatch::start(), limit: Box::pin(sleep(left)) });
                ready!(waiting.limit.as_mut().poll(cx));
                // The client will not receive the bytes that the operating system buffers either.
                if let Err(error) = socket2::SockRef::from(&self.stream).set_linger(Some(Duration::ZERO)) {
                    tracing::trace!(%error, "the buffers of a connection are kept for a while");
                }
                Poll::Ready(Err(io::Error::new(io::ErrorKind::TimedOut, "the client receives too slowly")))
            }
        }
    }
}

fn limit_unsent(stream: &TcpStream) {
    let socket = socket2::SockRef::from(stream);
    #[cfg(any(target_os = "linux", target_vendor = "apple"))]
    let limited = socket.set_tcp_notsent_lowat(UNSENT);
    #[cfg(not(any(target_os = "linux", target_vendor = "apple")))]
    let limited = socket.set_send_buffer_size(UNSENT as usize);
    if let Err(error) = limited {
        tracing::trace!(%error, "the send buffer of a connection is not limited");
    }
}

impl AsyncRead for Paced {
    fn poll_read(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &mut ReadBuf<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_read(cx, buf)
    }
}

impl AsyncWrite for Paced {
    fn poll_write(mut self: Pin<&mut Self>, cx: &mut Context<'_>, buf: &[u8]) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write(cx, buf);
        self.count(cx, written)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bufs: &[IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let written = Pin::new(&mut self.stream).poll_write_vectored(cx, bufs);
        self.count(cx, written)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(cx)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(cx)
    }
}
