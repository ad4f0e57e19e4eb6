//! Signals that come early: whoever could see that a command is at work can stop it in good order.
#![cfg(unix)]
#![allow(clippy::unwrap_used, missing_docs, reason = "a test: what fails, fails here")]

use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

fn oviduct(folder: &Path, arguments: &[&str]) -> Child {
    let mut command = Command::new(env!("CARGO_BIN_EXE_oviduct"));
    command.current_dir(folder).env_clear().env("XDG_RUNTIME_DIR", folder).args(arguments);
    command.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap()
}

fn terminate(child: &Child) {
    let sent = Command::new("kill").args(["-TERM", &child.id().to_string()]).status().unwrap();
    assert!(sent.success());
}

fn entries(folder: &Path) -> usize {
    std::fs::read_dir(folder).into_iter().flatten().count()
}

/// Looks every now and then, without a rest: what is to be met lasts for microseconds.
fn until(child: &mut Child, seen: impl Fn() -> bool) {
    while !seen() {
        assert!(child.try_wait().unwrap().is_none(), "it ended by itself");
    }
}

#[test]
fn a_generation_is_stopped_as_soon_as_its_folder_is_there() {
    for _ in 0..10 {
        let at = tempfile::tempdir().unwrap();
        let out = at.path().join("out");
        let mut child = oviduct(at.path(), &["generate", "--backend", "cpu", "--out", "out"]);
        until(&mut child, || entries(&out) > 0);
        terminate(&child);
        assert_eq!(child.wait().unwrap().code(), Some(130));
        assert_eq!(entries(&out), 0, "a part stays");
    }
}

#[test]
fn a_service_is_stopped_as_soon_as_it_answers() {
    for _ in 0..10 {
        let at = tempfile::tempdir().unwrap();
        let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
        let address = format!("127.0.0.1:{port}");
        let mut child = oviduct(at.path(), &["serve", "--addr", &address, "--gpu", "off"]);
        until(&mut child, || {
            let Ok(mut stream) = TcpStream::connect(&address) else { return false };
            // The listener is there before the service.
            stream.set_read_timeout(Some(Duration::from_secs(20))).unwrap();
            let asked = stream.write_all(b"GET /readyz HTTP/1.1\r\nhost: x\r\nconnection: close\r\n\r\n");
            let mut answer = String::new();
            asked.is_ok() && stream.read_to_string(&mut answer).is_ok() && answer.starts_with("HTTP/1.1 200")
        });
        terminate(&child);
        assert_eq!(child.wait().unwrap().code(), Some(0));
    }
}

/// Its port is told when it can be used.
#[test]
fn a_service_is_stopped_as_soon_as_it_tells_its_address() {
    let at = tempfile::tempdir().unwrap();
    let mut child = oviduct(at.path(), &["serve", "--addr", "127.0.0.1:0", "--gpu", "off"]);
    let mut line = String::new();
    BufReader::new(child.stdout.take().unwrap()).read_line(&mut line).unwrap();
    terminate(&child);
    assert_eq!(child.wait().unwrap().code(), Some(0), "{line}");
}

#[test]
fn a_worker_without_anything_to_work_with_is_refused() {
    let at = tempfile::tempdir().unwrap();
    let database = "postgres://nobody@127.0.0.1:1/none";
    let worker = ["worker", "--database", database, "--cpu-workers", "0", "--gpu", "off"];
    let output = oviduct(at.path(), &worker).wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(2));
}
