//! Connections from the outside: what is closed, what is waited for, what is never cut.

use super::*;
use axum::body::{Body, Bytes};
use axum::routing::get;
use futures_util::StreamExt;
use std::net::SocketAddr;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::task::JoinHandle;
use tokio::time::sleep;

/// Longest wait for something that shall come.
const SOON: Duration = Duration::from_secs(50);
/// Time that does not run out within a test.
const LONG: Duration = Duration::from_secs(600);
const SHORT: Duration = Duration::from_millis(200);
const ASK: &[u8] = b"GET /plain HTTP/1.1\r\nhost: here\r\n\r\n";

/// Three words, with more than the time for a head between them.
async fn slow() -> Body {
    let words = futures_util::stream::iter(["one", "two", "three"]).then(async |word| {
        sleep(SHORT * 2).await;
        Ok::<_, std::convert::Infallible>(Bytes::from_static(word.as_bytes()))
    });
    Body::from_stream(words)
}

struct Running {
    address: SocketAddr,
    shutdown: CancellationToken,
    server: JoinHandle<()>,
}

impl Running {
    async fn start(most: usize, [first_time, head_time]: [Duration; 2]) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let router = Router::new().route("/plain", get(async || "plain")).route("/slow", get(slow));
        let shutdown = CancellationToken::new();
        let server =
            tokio::spawn(serve(listener, router, Connections { most, first_time, head_time }, shutdown.clone()));
        Self { address, shutdown, server }
    }

    /// A connection on which this was sent.
    async fn connect(&self, sent: &[u8]) -> TcpStream {
        let mut stream = TcpStream::connect(self.address).await.unwrap();
        stream.write_all(sent).await.unwrap();
        stream
    }

    async fn stop(self) {
        self.shutdown.cancel();
        timeout(SOON, self.server).await.expect("it ends").unwrap();
    }
}

/// All that comes until the connection is closed.
async fn rest(stream: &mut TcpStream) -> String {
    let mut bytes = Vec::new();
    // One that was reset is closed, too.
    let _ = timeout(SOON, stream.read_to_end(&mut bytes)).await.expect("it is closed");
    String::from_utf8(bytes).unwrap()
}

/// What comes up to this word.
async fn until(stream: &mut TcpStream, word: &str) -> String {
    let mut text = String::new();
    while !text.contains(word) {
        let mut part = [0; 512];
        let n = timeout(SOON, stream.read(&mut part)).await.expect("it is answered").unwrap();
        assert!(n > 0, "closed after {text:?}");
        text.push_str(std::str::from_utf8(&part[..n]).unwrap());
    }
    text
}

#[tokio::test]
async fn who_is_silent_is_let_go() {
    let running = Running::start(9, [LONG, SHORT]).await;
    for sent in [&b"G"[..], b"GET /plain HTTP/1.1\r\nhost: he"] {
        let answer = rest(&mut running.connect(sent).await).await;
        assert!(!answer.contains("plain"), "{answer}");
    }
    // After an answer, too.
    let mut stream = running.connect(ASK).await;
    assert!(rest(&mut stream).await.ends_with("plain"));
    running.stop().await;
}

#[tokio::test]
async fn who_says_nothing_at_all_is_let_go() {
    let running = Running::start(9, [SHORT, LONG]).await;
    assert_eq!(rest(&mut running.connect(b"").await).await, "");
    // One that has begun may take its time.
    let mut stream = running.connect(&ASK[..9]).await;
    sleep(SHORT * 2).await;
    stream.write_all(&ASK[9..]).await.unwrap();
    assert!(until(&mut stream, "plain").await.starts_with("HTTP/1.1 200"));
    running.stop().await;
}

#[tokio::test]
async fn a_long_answer_is_not_cut() {
    let running = Running::start(9, [LONG, SHORT]).await;
    let mut stream = running.connect(b"GET /slow HTTP/1.1\r\nhost: here\r\nconnection: close\r\n\r\n").await;
    let answer = rest(&mut stream).await;
    assert!(answer.contains("one") && answer.contains("two") && answer.contains("three"), "{answer}");
    running.stop().await;
}

#[tokio::test]
async fn the_next_waits_for_a_place() {
    let running = Running::start(2, [LONG; 2]).await;
    let silent = [running.connect(b"").await, running.connect(b"").await];
    // So that they have been accepted before.
    sleep(SHORT).await;
    let mut third = running.connect(ASK).await;
    let mut byte = [0];
    assert!(timeout(SHORT, third.peek(&mut byte)).await.is_err(), "there is no place for it");
    drop(silent);
    assert!(until(&mut third, "plain").await.starts_with("HTTP/1.1 200"));
    running.stop().await;
}

#[tokio::test]
async fn the_last_requests_are_answered_and_idle_connections_closed() {
    let running = Running::start(9, [LONG; 2]).await;
    let mut idle = running.connect(ASK).await;
    until(&mut idle, "plain").await;
    let mut busy = running.connect(b"GET /slow HTTP/1.1\r\nhost: here\r\n\r\n").await;
    until(&mut busy, "one").await;
    running.shutdown.cancel();
    assert_eq!(rest(&mut idle).await, "");
    assert!(rest(&mut busy).await.contains("three"));
    let address = running.address;
    running.stop().await;
    assert!(TcpStream::connect(address).await.is_err());
}

/// Beyond what the service reads, the answer comes without a body; it is answered all the same.
#[tokio::test]
async fn heads_that_are_too_long_are_refused() {
    let running = Running::start(9, [LONG; 2]).await;
    let long = |line: &str| format!("{line}\r\n\r\n").into_bytes();
    let headers: String = (0..200).map(|n| format!("x-{n}: x\r\n")).collect();
    for (head, status) in [
        (long(&format!("GET /{} HTTP/1.1\r\nhost: here", "x".repeat(70_000))), "414"),
        (long(&format!("GET /plain HTTP/1.1\r\nhost: here\r\n{headers}x: y")), "431"),
        (long("nonsense"), "400"),
    ] {
        let answer = rest(&mut running.connect(&head).await).await;
        assert!(answer.starts_with(&format!("HTTP/1.1 {status}")), "{answer}");
    }
    running.stop().await;
}

#[test]
fn the_number_of_connections_follows_the_descriptors() {
    assert_eq!(Connections::new(Some(7)).most, 7);
    assert_eq!(Connections::new(None).most as u64, (descriptors() / 4 * 3).min(Semaphore::MAX_PERMITS as u64));
    assert!(descriptors() >= 64);
}
