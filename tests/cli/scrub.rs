//! `oviduct scrub`, while a service runs and without one.

use super::{Server, TINY, code, folder, json, run, said};
use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};

/// Path of the pack with the files of a model.
fn pack(at: &Path, model: &str) -> PathBuf {
    at.join(format!("data/artifacts/models/{model}/1/pack"))
}

/// Sends a request over a connection of its own. Returns the head and the body of the response.
fn get(url: &str, path: &str) -> (String, Vec<u8>) {
    let mut socket = TcpStream::connect(url.trim_start_matches("http://")).expect("connected");
    write!(socket, "GET {path} HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n\r\n").expect("sent");
    let mut bytes = Vec::new();
    // Fails if the service resets the connection.
    let _ = socket.read_to_end(&mut bytes);
    let end = bytes.windows(4).position(|four| four == b"\r\n\r\n").expect("a head") + 4;
    let body = bytes.split_off(end);
    (String::from_utf8(bytes).expect("text"), body)
}

/// `Content-Length` of a response.
fn announced(head: &str) -> usize {
    let length = head.lines().find_map(|line| line.strip_prefix("content-length: ")).expect("a length");
    length.parse().expect("a number")
}

#[test]
fn differences_are_listed_and_nothing_is_changed() {
    let at = folder();
    let server = Server::start_with(at.path(), &["--gpu", "off"]);
    let [model, other] = ["1", "2"].map(|seed| {
        let asked = [&["submit", "--url", &server.url, "--wait", "--json", "--seed", seed][..], &TINY].concat();
        json(&run(at.path(), &asked))["id"].as_str().expect("an id").to_owned()
    });
    // The service has the database open.
    let whole = json(&run(at.path(), &["scrub", "--json"]));
    assert_eq!(whole["ok"], true, "{whole}");
    let output = run(at.path(), &["scrub"]);
    let line = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(code(&output) == 0 && line.contains(": 0 missing, 0 damaged; 0 files without a record"), "{line}");
    let path = format!("/models/{model}/files/report.json");
    let (head, body) = get(&server.url, &path);
    assert_eq!(announced(&head), body.len());

    let damaged = pack(at.path(), &model);
    let mut bytes = std::fs::read(&damaged).expect("read");
    // The report comes last.
    *bytes.last_mut().expect("not empty") ^= 1;
    std::fs::write(&damaged, &bytes).expect("written");
    let (head, body) = get(&server.url, &path);
    assert!(head.starts_with("HTTP/1.1 200") && announced(&head) > body.len(), "{head}");
    drop(server);
    std::fs::remove_file(pack(at.path(), &other)).expect("removed");
    std::fs::write(damaged.with_file_name("other.glb#3"), "half an upload").expect("written");
    let output = run(at.path(), &["scrub"]);
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert_eq!((code(&output), text.lines().count()), (1, 9), "{text}{}", said(&output));
    for expected in [
        "missing  model.glb at models/",
        "missing  sections.bin at models/",
        "missing  model.lod2.glb at models/",
        "missing  report.json at models/",
        "damaged  report.json at models/",
        "unknown  models/",
        "other.glb#3",
        "6 missing, 1 damaged; 1 ",
    ] {
        assert!(text.contains(expected), "{expected}: {text}");
    }
    let output = run(at.path(), &["scrub", "--json"]);
    assert_eq!(code(&output), 1);
    let found: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
    assert_eq!((&found["ok"], &found["files"]), (&false.into(), &whole["files"]));
    assert!(found["missing"][0]["models"][0] == *other && found["damaged"][0]["models"][0] == *model, "{found}");
    assert_eq!(found["damaged"][0]["name"], "report.json");
    assert!(found["damaged"][0]["detail"].as_str().expect("a reason").contains("SHA-256"), "{found}");
    assert_eq!(std::fs::read(&damaged).expect("read"), bytes);
}

#[test]
fn stores_that_do_not_exist_are_not_created() {
    let at = folder();
    for (arguments, reason) in [
        (&["scrub"][..], "data/oviduct.db does not exist"),
        (&["scrub", "--database", "mistyped.db"], "mistyped.db does not exist"),
        (&["scrub", "--database", "mysql://a/b"], "unsupported scheme"),
    ] {
        let output = run(at.path(), arguments);
        assert!(code(&output) > 0 && said(&output).contains(reason), "{}", said(&output));
    }
    assert_eq!(code(&run(at.path(), &["migrate"])), 0);
    let output = run(at.path(), &["scrub", "--artifacts", "mistyped"]);
    assert_eq!(code(&output), 1);
    assert!(said(&output).contains("mistyped does not exist"), "{}", said(&output));
    assert!(!at.path().join("mistyped").exists() && !at.path().join("mistyped.db").exists());
}
