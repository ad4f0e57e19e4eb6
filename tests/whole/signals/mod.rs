//! Signals: a command can be stopped as soon as it has visible effects, and a service shuts down in
//! order.
#![cfg(unix)]
#![allow(clippy::unwrap_used, missing_docs, reason = "a test fails by it")]

use oviduct::clock::Stopwatch;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

fn oviduct(folder: &Path, arguments: &[&str]) -> Child {
    let mut command = Command::new(env!("CARGO_BIN_EXE_oviduct"));
    command.current_dir(folder).env_clear().args(arguments);
    command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap()
}

fn terminate(child: &Child) {
    let sent = Command::new("kill").args(["-TERM", &child.id().to_string()]).status().unwrap();
    assert!(sent.success());
}

fn entries(folder: &Path) -> usize {
    std::fs::read_dir(folder).into_iter().flatten().count()
}

/// Waits until `seen` returns true. Polls without sleeping, because the condition may hold for only
/// a few microseconds.
fn until(child: &mut Child, seen: impl Fn() -> bool) {
    while !seen() {
        assert!(child.try_wait().unwrap().is_none(), "the process ended");
    }
}

#[test]
fn a_generation_can_be_stopped_as_soon_as_its_directory_exists() {
    for _ in 0..10 {
        let at = tempfile::tempdir().unwrap();
        let out = at.path().join("out");
        // This model would take hours.
        let endless = "steps=100000;solver={\"search\":\"all_pairs\",\"record_every\":100}";
        let mut child = oviduct(at.path(), &["generate", "--backend", "cpu", "--out", "out", "--set", endless]);
        until(&mut child, || entries(&out) > 0);
        terminate(&child);
        assert_eq!(child.wait().unwrap().code(), Some(130));
        assert_eq!(entries(&out), 0, "an incomplete file is left");
    }
}

#[test]
fn a_service_can_be_stopped_as_soon_as_it_answers() {
    for _ in 0..10 {
        let at = tempfile::tempdir().unwrap();
        let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        let address = format!("127.0.0.1:{port}");
        let mut child = oviduct(at.path(), &["serve", "--addr", &address, "--gpu", "off"]);
        until(&mut child, || {
            let Ok(mut stream) = TcpStream::connect(&address) else { return false };
            // The socket listens before the service responds.
            stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
            let asked = stream.write_all(b"GET /readyz HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n\r\n");
            let mut answer = String::new();
            asked.is_ok() && stream.read_to_string(&mut answer).is_ok() && answer.starts_with("HTTP/1.1 200")
        });
        terminate(&child);
        assert_eq!(child.wait().unwrap().code(), Some(0));
    }
}

#[test]
fn a_service_can_be_stopped_as_soon_as_it_prints_its_address() {
    let at = tempfile::tempdir().unwrap();
    let mut child = oviduct(at.path(), &["serve", "--addr", "127.0.0.1:0", "--gpu", "off"]);
    let mut line = String::new();
    BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
    terminate(&child);
    assert_eq!(child.wait().unwrap().code(), Some(0), "{line}");
}

#[test]
fn a_worker_process_without_workers_is_refused() {
    let at = tempfile::tempdir().unwrap();
    let database = "postgres://nobody@127.0.0.1:1/none";
    let worker = ["worker", "--database", database, "--cpu-workers", "0", "--gpu", "off"];
    let output = oviduct(at.path(), &worker).wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(2));
}

/// A service without workers, and its address.
fn service(at: &Path, options: &[&str]) -> (Child, String) {
    let line = ["serve", "--addr", "127.0.0.1:0", "--gpu", "off", "--cpu-workers", "0"];
    let mut child = oviduct(at, &[&line, options].concat());
    let mut url = String::new();
    BufReader::new(child.stdout.take().unwrap()).read_line(&mut url).unwrap();
    (child, url.trim().strip_prefix("http://").unwrap().to_owned())
}

/// Status line of the response; `None` without a connection.
fn status(address: &str, path: &str) -> Option<String> {
    let mut stream = TcpStream::connect(address).ok()?;
    stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
    stream.write_all(format!("GET {path} HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n\r\n").as_bytes()).ok()?;
    let mut line = String::new();
    BufReader::new(stream).read_line(&mut line).ok()?;
    Some(line)
}

#[test]
fn readiness_fails_before_the_listener_closes() {
    let at = tempfile::tempdir().unwrap();
    let (mut child, address) = service(at.path(), &["--drain-delay", "3s"]);
    assert!(status(&address, "/readyz").unwrap().contains("200"));
    terminate(&child);
    let stopped = Stopwatch::start();
    until(&mut child, || status(&address, "/readyz").is_some_and(|line| line.contains("503")));
    // The service is not ready but still serves requests.
    let served = status(&address, "/models");
    assert!(stopped.elapsed() > Duration::from_secs(3) || served.is_some_and(|line| line.contains("200")));
    assert_eq!(child.wait().unwrap().code(), Some(0));
    assert!(stopped.elapsed() >= Duration::from_secs(3), "{:?}", stopped.elapsed());
}

#[test]
fn open_requests_have_the_grace_on_a_process_without_workers() {
    let at = tempfile::tempdir().unwrap();
    let (mut child, address) = service(at.path(), &["--grace", "60s"]);
    let mut stream = TcpStream::connect(&address).unwrap();
    let body = r#"{"preset": "pig", "seed": 7}"#;
    let (first, rest) = body.split_at(5);
    let head = "POST /models HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\ncontent-type: application/json\r\n";
    stream.write_all(format!("{head}content-length: {}\r\n\r\n{first}", body.len()).as_bytes()).unwrap();
    std::thread::sleep(Duration::from_millis(500));
    terminate(&child);
    // Longer than the five seconds that the service grants last responses without `--grace`.
    std::thread::sleep(Duration::from_millis(6500));
    assert!(child.try_wait().unwrap().is_none(), "the request was cut off");
    stream.write_all(rest.as_bytes()).unwrap();
    let mut answer = String::new();
    stream.read_to_string(&mut answer).unwrap();
    assert!(answer.starts_with("HTTP/1.1 202"), "{answer}");
    assert_eq!(child.wait().unwrap().code(), Some(0));
}
