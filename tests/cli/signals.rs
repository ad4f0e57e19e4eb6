//! Signals that stop a service.
#![cfg(unix)]

use super::{Server, code, folder, run, signal};
use std::io::{BufRead, BufReader};
use std::process::{Command, Stdio};
use std::thread::sleep;
use std::time::Duration;

#[test]
fn a_closed_terminal_stops_a_service_gracefully_except_under_nohup() {
    let at = folder();
    let mut server = Server::start_with(at.path(), &["--cpu-workers", "0", "--gpu", "off"]);
    signal(&server.child, "-HUP");
    assert_eq!(server.child.wait().expect("it ends").code(), Some(0));

    // As `nohup` does, the parent ignores the signal.
    let mut command = Command::new("sh");
    command.args([
        "-c",
        "trap '' HUP; exec \"$@\"",
        "sh",
        env!("CARGO_BIN_EXE_oviduct"),
        "serve",
        "--addr",
        "127.0.0.1:0",
    ]);
    command.args(["--cpu-workers", "0", "--gpu", "off", "--log", "warn"]).current_dir(at.path());
    let mut child = command.stdout(Stdio::piped()).spawn().expect("it starts");
    let mut url = String::new();
    BufReader::new(child.stdout.take().expect("piped")).read_line(&mut url).expect("it prints its address");
    signal(&child, "-HUP");
    sleep(Duration::from_millis(500));
    assert_eq!(code(&run(at.path(), &["healthcheck", "--url", url.trim()])), 0, "it ignores the signal");
    signal(&child, "-TERM");
    assert_eq!(child.wait().expect("it ends").code(), Some(0));
}
