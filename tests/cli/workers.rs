//! `oviduct workers` with a running service.

use super::{Server, TINY, code, folder, json, run, said, until};
use serde_json::Value;
use std::path::Path;

fn workers(at: &Path, url: &str, arguments: &[&str]) -> Value {
    json(&run(at, &[&["workers"], arguments, &["--json", "--url", url]].concat()))
}

#[test]
fn workers_are_paused_drained_and_resumed() {
    let at = folder();
    let data = ["--gpu", "off"];
    let server = Server::start_with(at.path(), &data);
    let url = server.url.clone();
    let listed = |url: &str| workers(at.path(), url, &[]);
    until("the worker is listed", || listed(&url)["workers"][0]["id"].is_string());
    let name = listed(&url)["workers"][0]["id"].as_str().expect("a name").to_owned();
    assert_eq!(workers(at.path(), &url, &["drain", &name])["state"], "drained");
    assert!(workers(at.path(), &url, &["pause"])["pause"]["since"].is_string());
    let model = |url: &str| json(&run(at.path(), &[&["submit", "--url", url, "--json"][..], &TINY].concat()));
    assert_eq!(model(&url)["status"], "queued");

    // The pause of all workers survives a restart of the service.
    drop(server);
    let server = Server::start_with(at.path(), &data);
    let url = server.url.clone();
    until("the worker is listed", || {
        listed(&url)["workers"].as_array().is_some_and(|workers| workers.iter().any(|worker| worker["id"] != *name))
    });
    let shown = run(at.path(), &["workers", "--url", &url]);
    let lines = String::from_utf8_lossy(&shown.stdout).into_owned();
    assert!(lines.starts_with("all workers are paused since ") && lines.contains("  active  cpu ("), "{lines}");
    std::thread::sleep(std::time::Duration::from_secs(2));
    assert!(has(&url, "queued"), "no worker starts it");
    assert_eq!(workers(at.path(), &url, &["resume"])["pause"], Value::Null);
    until("it is grown", || has(&url, "succeeded"));

    for (arguments, exit) in [
        (&["drain"][..], 2),
        (&["list", "x"], 2),
        (&["pause", ".."], 2),
        (&["stop"], 2),
        (&["drain", "nobody"], 1),
        (&["pause", "a/../b"], 1),
    ] {
        let output = run(at.path(), &[&["workers"], arguments, &["--url", &url]].concat());
        assert_eq!(code(&output), exit, "{arguments:?}: {}", said(&output));
        assert!(!said(&output).is_empty(), "{arguments:?}");
    }
    assert_eq!(listed(&url)["pause"], Value::Null);
}

/// True if the service has a model with this status.
fn has(url: &str, status: &str) -> bool {
    let address = url.strip_prefix("http://").expect("an address");
    super::get(address, &format!("/models?status={status}")).contains("\"id\":\"")
}
