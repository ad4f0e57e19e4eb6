//! `oviduct load` with and without a reachable service.

use super::{Server, TINY, code, folder, free_port, json, oviduct, run, said, signal};
use serde_json::Value;
use std::process::Stdio;
use std::thread::sleep;
use std::time::Duration;

#[test]
fn a_closed_loop_counts_errors_and_continues() {
    let at = folder();
    let url = format!("http://127.0.0.1:{}", free_port());
    let load = ["load", "--url", &url, "--models", "5", "--concurrency", "2"];
    let output = run(at.path(), &[&load[..], &["--json"]].concat());
    assert_eq!(code(&output), 1, "{}", said(&output));
    let report: Value = serde_json::from_slice(&output.stdout).expect("a report");
    assert_eq!((&report["calls"]["submit"]["due"], &report["models"]), (&5.into(), &Value::Null), "{report}");
    assert_eq!((&report["errors"]["total"], &report["errors"]["connection"]), (&5.into(), &5.into()), "{report}");
    let output = run(at.path(), &load);
    assert_eq!(code(&output), 1);
    assert!(String::from_utf8_lossy(&output.stdout).contains("errors: connection 5"), "{output:?}");

    let server = Server::start_with(at.path(), &["--gpu", "off"]);
    let load = ["load", "--url", &server.url, "--models", "2", "--concurrency", "2", "--json"];
    let report = json(&run(at.path(), &[&load[..], &TINY].concat()));
    assert_eq!((&report["models"]["succeeded"], &report["errors"]["total"]), (&2.into(), &0.into()), "{report}");
    assert_eq!((&report["calls"]["model"]["answered"], &report["mode"]), (&2.into(), &"closed".into()), "{report}");
    // A spec that the service refuses for every seed is a usage error.
    assert_eq!(code(&run(at.path(), &[&load[..], &["--set", "steps=-1"]].concat())), 2);
}

#[test]
fn an_open_loop_measures_all_calls_and_holds_streams() {
    let at = folder();
    let server = Server::start_with(at.path(), &["--gpu", "off"]);
    let options =
        ["load", "--url", &server.url, "--rate", "10/s", "--duration", "5s", "--warm-up", "1s", "--seed", "5"];
    let more = ["--mix", "submit=1,get=4,list=2,download=2,events=1", "--streams", "3", "--json"];
    let report = json(&run(at.path(), &[&options[..], &more, &TINY, &["--efficiency"]].concat()));
    assert_eq!((&report["mode"], &report["seconds"]), (&"open".into(), &5.0.into()), "{report}");
    let mut due = 0;
    for call in ["submit", "get", "list", "download", "events"] {
        let of = &report["calls"][call];
        due += of["due"].as_u64().expect("a number");
        // A slow machine may finish no model in time, so there may be no file to download.
        let made = of["answered"].as_u64() > Some(0) && of["latency"]["p99"].as_f64() > Some(0.0);
        assert!(made || call == "download" && of["skipped"] == of["due"], "{call}: {report}");
    }
    // The expected number is 50, with a standard deviation of 7.
    assert!((20..=80).contains(&due), "{report}");
    let (models, streams) = (&report["models"], &report["streams"]);
    assert_eq!(models["succeeded"], report["calls"]["submit"]["answered"], "{report}");
    assert!(models["bytes"].as_u64() > Some(0) && models["end_to_end"]["p50"].as_f64() > Some(0.0), "{report}");
    assert!(streams["followed"].as_u64() > Some(0), "{report}");
    assert_eq!((&streams["told"], &streams["untold"]), (&streams["followed"], &0.into()), "{report}");
    assert!(report["efficiency"]["ratio"].as_f64() > Some(0.0), "{report}");
}

#[test]
#[cfg(unix)]
fn an_interrupted_load_reports_its_partial_results() {
    let at = folder();
    let url = format!("http://127.0.0.1:{}", free_port());
    let load = ["load", "--url", &url, "--rate", "50", "--warm-up", "0", "--duration", "5m", "--json"];
    let child = oviduct(at.path()).args(load).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("it starts");
    sleep(Duration::from_secs(3));
    signal(&child, "-INT");
    let output = child.wait_with_output().expect("it ends");
    assert_eq!(code(&output), 130, "{}", said(&output));
    let report: Value = serde_json::from_slice(&output.stdout).expect("a report");
    assert_eq!(report["interrupted"], true);
    assert!(report["errors"]["connection"].as_u64() > Some(10), "{report}");
}

#[test]
fn a_key_is_never_shown() {
    let at = folder();
    let url = format!("http://127.0.0.1:{}", free_port());
    let secret = "hunter2-0123456789";
    for arguments in [
        &["submit", "--url", &url, "--log", "trace"][..],
        &["load", "--url", &url, "--models", "1", "--json", "--log", "trace"],
    ] {
        let output = oviduct(at.path()).args(arguments).env("OVIDUCT_KEY", secret).output().expect("the command runs");
        assert_eq!(code(&output), 1, "{}", said(&output));
        let shown = said(&output) + &String::from_utf8_lossy(&output.stdout);
        // The log contains the request path but not the API key.
        assert!(shown.contains("127.0.0.1") && !shown.contains("hunter2"), "{shown}");
    }
    for wrong in ["", "hunter2\u{7f}"] {
        let output = run(at.path(), &["submit", "--url", &url, "--key", wrong]);
        assert_eq!(code(&output), 2);
        assert!(said(&output).contains("--key") && !said(&output).contains("hunter2"), "{}", said(&output));
    }
    let help = run(at.path(), &["submit", "--help"]);
    assert!(String::from_utf8_lossy(&help.stdout).contains("OVIDUCT_KEY"));
}
