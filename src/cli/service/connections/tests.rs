//! Connections as clients see them: which are closed, which wait, and which are never cut off.

use super::*;
use axum::body::{Body, Bytes};
use axum::routing::get;
use futures_util::StreamExt;
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::sync::OwnedSemaphorePermit;
use tokio::task::JoinHandle;
use tokio::time::sleep;

/// Longest wait for something that must happen.
const SOON: Duration = Duration::from_secs(50);
/// Time that does not run out within a test.
const LONG: Duration = Duration::from_secs(600);
const PERMITS: usize = 9;
const SHORT: Duration = Duration::from_millis(200);
const ASK: &[u8] = b"GET /plain HTTP/1.1\r\nhost: here\r\n\r\n";

/// Three words, with pauses that are longer than the time for a head.
async fn slow() -> Body {
    let words = futures_util::stream::iter(["one", "two", "three"]).then(async |word| {
        sleep(SHORT * 2).await;
        Ok::<_, std::convert::Infallible>(Bytes::from_static(word.as_bytes()))
    });
    Body::from_stream(words)
}

/// A body that never ends and holds a permit.
fn endless(permit: OwnedSemaphorePermit) -> Body {
    Body::from_stream(futures_util::stream::repeat_with(move || {
        let _ = &permit;
        Ok::<_, std::convert::Infallible>(Bytes::from_static(&[b'x'; 8192]))
    }))
}

struct Running {
    address: SocketAddr,
    shutdown: CancellationToken,
    server: JoinHandle<()>,
    /// Each endless body holds one of these permits.
    permits: Arc<Semaphore>,
}

impl Running {
    async fn start(most: usize, [first_time, head_time]: [Duration; 2]) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        Self::over(listener, Connections { most, waiting: most, first_time, head_time, write_time: LONG, grace: None })
    }

    fn over(listener: TcpListener, limits: Connections) -> Self {
        let address = listener.local_addr().unwrap();
        let permits = Arc::new(Semaphore::new(PERMITS));
        let of_bodies = Arc::clone(&permits);
        let router = Router::new()
            .route("/plain", get(async || "plain"))
            .route("/slow", get(slow))
            .route("/endless", get(async move || endless(of_bodies.acquire_owned().await.unwrap())));
        let shutdown = CancellationToken::new();
        let server = tokio::spawn(serve(listener, router, limits, shutdown.clone()));
        Self { address, shutdown, server, permits }
    }

    /// With these limits besides generous ones.
    async fn with(write_time: Duration, grace: Option<Duration>) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        Self::over(listener, Connections { most: 9, waiting: 9, first_time: LONG, head_time: LONG, write_time, grace })
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
async fn a_silent_client_is_disconnected() {
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
async fn a_client_that_sends_nothing_is_disconnected() {
    let running = Running::start(9, [SHORT, LONG]).await;
    assert_eq!(rest(&mut running.connect(b"").await).await, "");
    // A request that has begun to arrive has the time for a head.
    let mut stream = running.connect(&ASK[..9]).await;
    sleep(SHORT * 2).await;
    stream.write_all(&ASK[9..]).await.unwrap();
    assert!(until(&mut stream, "plain").await.starts_with("HTTP/1.1 200"));
    running.stop().await;
}

#[tokio::test]
async fn a_long_response_is_not_cut_off() {
    let running = Running::start(9, [LONG, SHORT]).await;
    let mut stream = running.connect(b"GET /slow HTTP/1.1\r\nhost: here\r\nconnection: close\r\n\r\n").await;
    let answer = rest(&mut stream).await;
    assert!(answer.contains("one") && answer.contains("two") && answer.contains("three"), "{answer}");
    running.stop().await;
}

/// One client cannot hold all connections without sending requests.
#[tokio::test]
async fn connections_of_one_address_without_a_request_are_limited() {
    let listener = TcpListener::bind("0.0.0.0:0").await.unwrap();
    let limits = Connections { most: 9, waiting: 2, first_time: LONG, head_time: LONG, write_time: LONG, grace: None };
    let mut running = Running::over(listener, limits);
    running.address.set_ip([127, 0, 0, 1].into());
    // Requests in progress do not count.
    let mut busy = Vec::new();
    for _ in 0..3 {
        busy.push(running.connect(b"GET /endless HTTP/1.1\r\nhost: here\r\n\r\n").await);
        until(busy.last_mut().unwrap(), "xxx").await;
    }
    let mut unfinished = running.connect(&ASK[..9]).await;
    let mut idle = running.connect(ASK).await;
    until(&mut idle, "plain").await;
    assert_eq!(rest(&mut running.connect(ASK).await).await, "", "two connections have no request");
    // Other addresses are served.
    let other = tokio::net::TcpSocket::new_v4().unwrap();
    other.bind("127.0.0.2:0".parse().unwrap()).unwrap();
    let mut other = other.connect(running.address).await.unwrap();
    other.write_all(ASK).await.unwrap();
    until(&mut other, "plain").await;
    // The idle connection sends another request, so a third connection may wait in the meantime.
    idle.write_all(b"GET /slow HTTP/1.1\r\nhost: here\r\n\r\n").await.unwrap();
    until(&mut idle, "one").await;
    let third = running.connect(&ASK[..9]).await;
    assert!(rest(&mut idle).await.contains("three"), "it is closed after its response");
    unfinished.write_all(&ASK[9..]).await.unwrap();
    until(&mut unfinished, "plain").await;
    drop((busy, third));
    running.stop().await;
}

#[tokio::test]
async fn a_connection_waits_while_there_are_too_many() {
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
async fn the_last_requests_are_answered_and_idle_connections_are_closed() {
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

/// The response has no body, since the request is refused before it is read whole.
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

/// Whether the server closes the connection soon. It may break off in the middle of a response.
async fn is_closed(stream: &mut TcpStream) -> bool {
    let reading = async {
        let mut read = 0;
        let mut part = vec![0; 64 << 10];
        // More than buffers hold comes only of a connection that goes on.
        while let Ok(n @ 1..) = stream.read(&mut part).await {
            read += n;
            if read > 256 << 20 {
                return false;
            }
        }
        true
    };
    timeout(SOON, reading).await.unwrap_or(false)
}

#[tokio::test]
async fn a_client_that_takes_too_few_bytes_is_cut_off() {
    let running = Running::with(Duration::from_secs(1), None).await;
    let ask = b"GET /endless HTTP/1.1\r\nhost: here\r\n\r\n";
    let mut stuck = running.connect(ask).await;
    let mut trickling = running.connect(ask).await;
    for stream in [&mut stuck, &mut trickling] {
        stream.readable().await.unwrap();
    }
    assert_eq!(running.permits.available_permits(), PERMITS - 2, "each response holds a permit");
    // While it is cut off, others are served.
    let mut other = running.connect(ASK).await;
    assert!(until(&mut other, "plain").await.starts_with("HTTP/1.1 200"));
    // Longer than the second; what is on its way still arrives, and then the connection is closed.
    for _ in 0..8 {
        assert!(trickling.read(&mut [0]).await.unwrap() > 0);
        sleep(Duration::from_millis(300)).await;
    }
    assert!(is_closed(&mut trickling).await, "a client that takes a few bytes a second");
    assert!(is_closed(&mut stuck).await, "a client that takes nothing");
    let freed = async {
        while running.permits.available_permits() < PERMITS {
            sleep(Duration::from_millis(5)).await;
        }
    };
    timeout(SOON, freed).await.expect("clients that were cut off hold nothing");
    running.stop().await;
}

#[tokio::test]
async fn a_client_that_reads_steadily_is_not_cut_off() {
    let running = Running::with(SHORT, None).await;
    let mut stream = running.connect(b"GET /endless HTTP/1.1\r\nhost: here\r\n\r\n").await;
    let mut part = vec![0; 4 << 20];
    for _ in 0..30 {
        assert!(stream.read(&mut part).await.unwrap() > 0);
        sleep(SHORT / 8).await;
    }
    drop(stream);
    running.stop().await;
}

#[tokio::test]
async fn requests_that_outlast_the_grace_are_cut_off() {
    let running = Running::with(LONG, Some(SHORT)).await;
    let mut stream = running.connect(b"GET /endless HTTP/1.1\r\nhost: here\r\n\r\n").await;
    until(&mut stream, "xxx").await;
    running.stop().await;
}

#[tokio::test]
async fn a_download_ends_within_the_grace() {
    let running = Running::with(LONG, Some(LONG)).await;
    let mut stream = running.connect(b"GET /slow HTTP/1.1\r\nhost: here\r\n\r\n").await;
    until(&mut stream, "one").await;
    running.shutdown.cancel();
    assert!(rest(&mut stream).await.contains("three"));
    running.stop().await;
}

#[test]
fn the_numbers_of_connections_and_downloads_follow_the_descriptors() {
    assert_eq!(Connections::new(Some(7), LONG).most, 7);
    assert_eq!(Connections::new(Some(20_000), LONG).most, 20_000);
    assert_eq!(Connections::new(None, LONG).most as u64, (descriptors() / 4 * 3).min(10_000));
    assert!(descriptors() >= 64 && downloads() as u64 <= descriptors() / 8);
}

#[tokio::test]
async fn many_connections_wait_to_be_accepted() {
    const MANY: usize = 600;
    let queue = std::fs::read_to_string("/proc/sys/net/core/somaxconn");
    let queue: usize = queue.map_or(MANY, |text| text.trim().parse().expect("a number"));
    let listener = listen((std::net::Ipv4Addr::LOCALHOST, 0).into()).expect("a port is free");
    let address = listener.local_addr().expect("it has an address");
    // A connection beyond the queue would need a second.
    let connect = |_| std::net::TcpStream::connect_timeout(&address, Duration::from_millis(700));
    let waiting: io::Result<Vec<_>> = (0..MANY.min(queue)).map(connect).collect();
    waiting.expect("all connections wait");
}
