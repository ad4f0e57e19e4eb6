//! Tests of the `oviduct` command: arguments, exit codes, stdout and stderr.

#[allow(dead_code, unreachable_pub, reason = "shared with tests that need more of it")]
#[path = "common/postgres.rs"]
mod cluster;
#[allow(unreachable_pub, reason = "a module of its own")]
#[path = "cli/collector.rs"]
mod collector;
#[path = "cli/compare.rs"]
mod compare;
#[path = "cli/convert.rs"]
mod convert;
#[path = "cli/cut.rs"]
mod cut;
#[path = "cli/fit.rs"]
mod fit;
#[path = "cli/folder.rs"]
mod folders;
#[path = "cli/keys.rs"]
mod keys;
#[path = "cli/load.rs"]
mod load;
#[path = "cli/measure.rs"]
mod measure;
#[path = "cli/orphans.rs"]
mod orphans;
#[path = "cli/render.rs"]
mod render;
#[path = "cli/scrub.rs"]
mod scrub;
#[path = "cli/signals.rs"]
mod signals;
#[path = "cli/units.rs"]
mod units;
#[path = "cli/workers.rs"]
mod workers;

use serde_json::Value;
use sha2::{Digest, Sha256};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::thread::sleep;
use std::time::Duration;

/// A model that even an unoptimized build grows in about two seconds.
const TINY: [&str; 4] = ["--set", "steps=60", "--set", "particles.total={\"keys\":[[0,300],[1,420]]}"];

/// Settings that make a model take hours.
const ENDLESS: [&str; 4] = ["--set", "steps=100000", "--set", "solver={\"search\":\"all_pairs\",\"record_every\":100}"];

fn oviduct(folder: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_oviduct"));
    command.current_dir(folder).env_clear();
    command
}

fn run(folder: &Path, arguments: &[&str]) -> Output {
    oviduct(folder).args(arguments).output().expect("the command runs")
}

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Lines on stderr that do not report the progress of a model.
fn complaints(output: &Output) -> Vec<String> {
    let stages = ["queued", "running", "simulate", "mesh", "certify", "measure", "export", "store"];
    let is_progress = |line: &str| stages.iter().any(|stage| line.starts_with(stage)) && line.contains(" %");
    said(output).lines().filter(|line| !is_progress(line)).map(str::to_owned).collect()
}

fn code(output: &Output) -> i32 {
    output.status.code().expect("it was not killed")
}

fn json(output: &Output) -> Value {
    assert_eq!(code(output), 0, "{}", said(output));
    serde_json::from_slice(&output.stdout).expect("stdout is one JSON value")
}

/// A port on which no process listens.
fn free_port() -> u16 {
    TcpListener::bind("127.0.0.1:0").expect("a port").local_addr().expect("bound").port()
}

/// The complete response to a GET request.
fn get(address: &str, path: &str) -> String {
    let mut stream = TcpStream::connect(address).expect("connected");
    let request = format!("GET {path} HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\n\r\n");
    stream.write_all(request.as_bytes()).expect("sent");
    let mut answer = String::new();
    stream.read_to_string(&mut answer).expect("answered");
    answer
}

/// Waits until `holds` returns true.
fn until(what: &str, holds: impl Fn() -> bool) {
    for _ in 0..1200 {
        if holds() {
            return;
        }
        sleep(Duration::from_millis(50));
    }
    panic!("not within a minute: {what}");
}

fn folder() -> tempfile::TempDir {
    tempfile::tempdir().expect("a directory")
}

fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).expect("the directory exists");
    let mut names: Vec<_> = entries.map(|e| e.expect("read").file_name().into_string().expect("UTF-8")).collect();
    names.sort();
    names
}

#[test]
fn help_goes_to_stdout_and_usage_errors_to_stderr() {
    let at = folder();
    for arguments in [["--help"], ["--version"]] {
        let output = run(at.path(), &arguments);
        assert_eq!(code(&output), 0);
        assert!(String::from_utf8_lossy(&output.stdout).contains("oviduct"));
    }
    // The default command is `serve`.
    let help = run(at.path(), &["--help"]);
    assert!(String::from_utf8_lossy(&help.stdout).contains("Usage: oviduct [OPTIONS] [COMMAND]\n"));
    for arguments in [&["serve", "--nonsense"][..], &["nonsense"], &["generate"], &["check"], &["--addr", "nowhere"]] {
        let output = run(at.path(), arguments);
        assert_eq!((code(&output), output.stdout.len()), (2, 0), "{arguments:?}");
        assert!(!output.stderr.is_empty(), "{arguments:?}");
    }
}

#[test]
fn options_override_variables_and_variables_override_the_file() {
    let at = folder();
    let path = at.path().join("oviduct.toml");
    std::fs::write(&path, "[serve]\naddr = \"203.0.113.1:1\"\n").expect("written");
    // None of these addresses belongs to this machine, so binding fails. The error names the
    // address that the command used.
    let refused = |command: &mut Command, address: &str| {
        let output = command.output().expect("the command runs");
        assert_eq!(code(&output), 1, "{}", said(&output));
        assert!(said(&output).contains(&format!("--addr {address}")), "{}", said(&output));
    };
    refused(oviduct(at.path()).args(["--config", "oviduct.toml"]), "203.0.113.1:1");
    refused(oviduct(at.path()).env("OVIDUCT_CONFIG", &path), "203.0.113.1:1");
    refused(
        oviduct(at.path()).args(["serve", "--config=oviduct.toml"]).env("OVIDUCT_ADDR", "203.0.113.2:1"),
        "203.0.113.2:1",
    );
    refused(
        oviduct(at.path())
            .args(["--config", "oviduct.toml", "--addr", "203.0.113.3:1"])
            .env("OVIDUCT_ADDR", "203.0.113.2:1"),
        "203.0.113.3:1",
    );
    std::fs::write(&path, "[serve]\nport = 1\n[generate]\nadr = \"x\"\n").expect("written");
    let output = run(at.path(), &["presets", "--config", "oviduct.toml"]);
    assert_eq!(code(&output), 2);
    assert!(said(&output).contains("serve.port") && said(&output).contains("generate.adr"), "{}", said(&output));
    assert_eq!(code(&run(at.path(), &["presets", "--config", "missing.toml"])), 2);
}

#[test]
fn unsupported_stores_are_refused_by_name() {
    let at = folder();
    for (option, url, named) in [
        ("--database", "mysql://u:secret@h/d", "unsupported scheme `mysql:`"),
        ("--artifacts", "gs://bucket", "gs://bucket"),
    ] {
        let output = run(at.path(), &["serve", "--addr", "127.0.0.1:0", option, url]);
        assert_eq!(code(&output), 2, "{}", said(&output));
        assert!(said(&output).contains(named) && !said(&output).contains("secret"), "{}", said(&output));
    }
    // A worker needs a database that it can share with a service, so it refuses SQLite.
    assert_eq!(code(&run(at.path(), &["worker"])), 2);
    assert_eq!(code(&run(at.path(), &["worker", "--database", "jobs.db"])), 2);
}

#[test]
fn presets_schema_and_openapi_are_printed() {
    let at = folder();
    let presets = json(&run(at.path(), &["presets", "--json"]));
    let names: Vec<_> = presets.as_array().expect("an array").iter().map(|p| p["name"].clone()).collect();
    assert_eq!(
        names,
        [
            "pig",
            "human",
            "cow",
            "pig-luteal",
            "cow-luteal",
            "mouse",
            "utero-tubal-junction",
            "infundibulum",
            "ureter",
            "oesophagus",
            "small-intestine",
            "colon",
            "paper"
        ]
    );
    let listed = run(at.path(), &["presets"]);
    assert!(String::from_utf8_lossy(&listed.stdout).starts_with("pig (default): "));
    let schema = json(&run(at.path(), &["schema"]));
    assert_eq!(schema["properties"]["collision"]["properties"]["gap_um"]["x-unit"], "µm");
    let openapi = run(at.path(), &["openapi"]);
    assert!(String::from_utf8_lossy(&openapi.stdout).contains("\nopenapi: "));
    // A closed stdout is not an error.
    let mut child = oviduct(at.path()).arg("openapi").stdout(Stdio::piped()).spawn().expect("it starts");
    drop(child.stdout.take());
    assert_eq!(child.wait().expect("it ends").code(), Some(0));
}

#[test]
fn every_fault_of_a_spec_is_named_and_no_file_is_left() {
    let at = folder();
    std::fs::write(at.path().join("spec.json"), r#"{"collision":{"gap_um":-1},"steps":"many"}"#).expect("written");
    let arguments = ["generate", "--out", "out", "--spec", "spec.json", "--set", "colour=red"];
    let output = run(at.path(), &arguments);
    assert_eq!(code(&output), 2, "{}", said(&output));
    for place in ["/spec/collision/gap_um: ", "/spec/steps: ", "/spec/colour: "] {
        assert!(said(&output).lines().any(|line| line.starts_with(&format!("error: {place}"))), "{}", said(&output));
    }
    assert_eq!(names(at.path()), ["spec.json"]);
    let output = run(at.path(), &["generate", "--out", "out", "--preset", "whale"]);
    assert_eq!(code(&output), 2);
    assert!(
        said(&output).contains("pig, human, cow, pig-luteal, cow-luteal, mouse, utero-tubal-junction, infundibulum, ureter, oesophagus, small-intestine, colon, paper"),
        "{}",
        said(&output)
    );
    for file in ["missing.json", "-"] {
        assert_eq!(code(&run(at.path(), &["generate", "--out", "out", "--spec", file])), 2, "{file}");
    }
}

#[test]
fn a_model_that_grew_poorly_is_reported_with_warnings() {
    let at = folder();
    let crowded = "particles.total={\"keys\":[[0,300],[1,2000]]}";
    let patch = ["--set", "steps=60", "--set", "collision.clearance_um=0.05", "--set", crowded];
    let arguments = [&["generate", "--out", "a", "--seed", "3", "--backend", "cpu", "--json"][..], &patch].concat();
    let output = run(at.path(), &arguments);
    let warnings = &json(&output)["warnings"];
    let codes: Vec<&Value> = warnings.as_array().expect("an array").iter().map(|warning| &warning["code"]).collect();
    assert_eq!(codes, ["splits-missing", "small-gap", "particles-short"]);
    for (line, warning) in complaints(&output).iter().zip(warnings.as_array().expect("an array")) {
        assert_eq!(line, &format!("warning: {}", warning["detail"].as_str().expect("text")));
    }
    assert_eq!(complaints(&output).len(), codes.len());
    let report = std::fs::read(at.path().join("a/report.json")).expect("a report");
    let report: Value = serde_json::from_slice(&report).expect("JSON");
    assert_eq!(&report["summary"]["warnings"], warnings);
}

#[test]
fn a_generated_model_passes_check_and_a_broken_file_fails() {
    let at = folder();
    let mut arguments = vec!["generate", "--out", "a/out", "--seed", "7", "--outputs", "glb,obj", "--json"];
    arguments.extend(TINY);
    let output = run(at.path(), &arguments);
    let told = json(&output);
    // The command lists adapters without XDG_RUNTIME_DIR, for which Mesa's layers would print a
    // warning.
    assert_eq!(complaints(&output), Vec::<String>::new());
    let progress = said(&output);
    assert!(progress.contains("simulate 0 %") && progress.contains("certify "), "{progress}");
    assert!(progress.lines().count() < 20, "{progress}");
    let has = |value: &Value, members: &[&str]| {
        for member in members {
            assert!(value.get(*member).is_some(), "{member} is missing in {value}");
        }
    };
    has(&told, &["digest", "preset", "seed", "engine", "backend", "sections", "sections_added", "particles"]);
    has(&told, &["vertices", "triangles", "seconds", "peak_rss_bytes", "files", "certificate", "summary"]);
    has(&told["backend"], &["requested", "used", "device", "fallback"]);
    has(&told["particles"], &["start", "end"]);
    has(&told["seconds"], &["simulate", "mesh", "certify", "export", "total"]);
    let proof = &told["certificate"];
    has(proof, &["passed", "closed", "manifold", "oriented", "euler", "section_crossings", "triangle_intersections"]);
    has(proof, &["min_gap_um", "min_edge_um", "min_angle_deg"]);
    assert_eq!((&proof["passed"], &proof["euler"]), (&Value::from(true), &Value::from(0)));
    assert_eq!(told["particles"]["start"], 300);

    let out = at.path().join("a/out");
    assert_eq!(names(&out), ["manifest.json", "model.glb", "model.obj", "report.json", "sections.bin"]);
    for file in told["files"].as_array().expect("an array") {
        let bytes = std::fs::read(out.join(file["name"].as_str().expect("a name"))).expect("the file exists");
        assert_eq!(file["bytes"], bytes.len());
        assert_eq!(file["sha256"], hex::encode(Sha256::digest(&bytes)));
    }

    let checked = json(&run(at.path(), &["check", "--json", "--euler", "0", "a/out/model.glb", "a/out/model.obj"]));
    for file in checked.as_array().expect("an array") {
        assert_eq!(file["certificate"]["passed"], true, "{file}");
        assert_eq!(file["certificate"]["triangles"], told["triangles"]);
    }
    assert_eq!(code(&run(at.path(), &["check", "--euler", "2", "a/out/model.obj"])), 1);

    let obj = std::fs::read_to_string(out.join("model.obj")).expect("the file exists");
    let mut faces = 0;
    let holed: Vec<&str> = obj
        .lines()
        .filter(|line| {
            !line.starts_with("f ") || {
                faces += 1;
                faces != 5
            }
        })
        .collect();
    std::fs::write(at.path().join("hole.obj"), holed.join("\n")).expect("written");
    let output = run(at.path(), &["check", "a/out/model.glb", "hole.obj", "missing.obj"]);
    assert_eq!(code(&output), 1);
    let lines = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(lines.contains("a/out/model.glb: passed") && lines.contains("hole.obj: FAILED"), "{lines}");
    assert!(lines.contains("\nmissing.obj: cannot be read: No such file"), "{lines}");
}

#[cfg(unix)]
fn signal(child: &Child, name: &str) {
    let sent = Command::new("kill").args([name, &child.id().to_string()]).status().expect("kill runs");
    assert!(sent.success());
}

#[test]
#[cfg(unix)]
fn an_interrupt_stops_a_generation_and_removes_its_files() {
    let at = folder();
    let mut child = oviduct(at.path()).args(["generate", "--out", "out"]).args(ENDLESS).spawn().expect("it starts");
    let out = at.path().join("out");
    while !out.is_dir() || names(&out).is_empty() {
        assert!(child.try_wait().expect("asked").is_none(), "it ended too early");
        sleep(Duration::from_millis(5));
    }
    signal(&child, "-INT");
    assert_eq!(child.wait().expect("it ends").code(), Some(130));
    assert_eq!(names(&out), Vec::<String>::new());
}

/// A server on a free port, killed when dropped.
struct Server {
    child: Child,
    url: String,
}

impl Server {
    fn start(at: &Path) -> Self {
        Self::start_with(at, &[])
    }

    fn start_with(at: &Path, options: &[&str]) -> Self {
        let mut child = oviduct(at)
            .args(["serve", "--addr", "127.0.0.1:0", "--log", "warn"])
            .args(options)
            .stdout(Stdio::piped())
            .spawn()
            .expect("it starts");
        let mut url = String::new();
        BufReader::new(child.stdout.take().expect("piped")).read_line(&mut url).expect("it prints its address");
        assert!(url.starts_with("http://127.0.0.1:"), "{url}");
        Self { child, url: url.trim().to_owned() }
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

#[test]
#[cfg(unix)]
fn submit_over_http_and_a_graceful_shutdown() {
    let at = folder();
    let mut server = Server::start(at.path());
    let url = server.url.clone();
    assert_eq!(code(&run(at.path(), &["healthcheck", "--url", &url])), 0);

    let mut arguments = vec!["submit", "--url", &url, "--seed", "7", "--label", "study:A3", "--outputs", "glb,obj"];
    arguments.extend(TINY);
    let mut waiting = arguments.clone();
    waiting.extend(["--out", "got", "--json"]);
    let model = json(&run(at.path(), &waiting));
    assert_eq!((&model["status"], &model["labels"]["study"]), (&"succeeded".into(), &"A3".into()));
    assert_eq!(
        names(&at.path().join("got")),
        ["manifest.json", "model.glb", "model.obj", "report.json", "sections.bin"]
    );
    // The folder is known by its manifest, so another model is not mixed with this one.
    let other = [&["submit", "--url", &url, "--seed", "9", "--out", "got"][..], &TINY].concat();
    let refused = run(at.path(), &other);
    assert!(code(&refused) == 2 && said(&refused).contains("preset pig, seed 7"), "{}", said(&refused));
    assert_eq!(
        get(url.trim_start_matches("http://"), "/models").matches("\"seed\":9").count(),
        0,
        "none was requested"
    );
    assert_eq!(get(url.trim_start_matches("http://"), "/models").matches("\"seed\":7").count(), 1);
    assert_eq!(code(&run(at.path(), &["check", "got/model.glb", "--euler", "0"])), 0);

    // The priority can be set by an option, a variable or the configuration file, and is validated.
    let asked = [&["submit", "--url", &url, "--seed", "8", "--json"][..], &TINY].concat();
    assert_eq!(json(&run(at.path(), &[&asked[..], &["--priority", "-5"]].concat()))["priority"], -5);
    let asked_by = |command: &mut Command| json(&command.args(&asked).output().expect("the command runs"));
    assert_eq!(asked_by(oviduct(at.path()).env("OVIDUCT_PRIORITY", "-100"))["priority"], -100);
    std::fs::write(at.path().join("oviduct.toml"), "[submit]\npriority = -7\n").expect("written");
    assert_eq!(asked_by(oviduct(at.path()).args(["--config", "oviduct.toml"]))["priority"], -7);
    assert_eq!(code(&run(at.path(), &[&asked[..], &["--priority", "101"]].concat())), 2);

    // An equal model is reused. A different model is only submitted.
    arguments.push("--wait");
    let output = run(at.path(), &arguments);
    assert_eq!(code(&output), 0);
    let line = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(line.ends_with(" succeeded\n"), "{line}");
    let output = run(at.path(), &[&["submit", "--url", &url, "--seed", "9"][..], &TINY].concat());
    assert_eq!((code(&output), output.stdout.len()), (0, 37), "an id");

    let output = run(at.path(), &["submit", "--url", &url, "--set", "collision.gap_um=-1", "--set", "colour=red"]);
    assert_eq!(code(&output), 2, "{}", said(&output));
    assert!(said(&output).contains("/spec/collision/gap_um: ") && said(&output).contains("/spec/colour: "));

    signal(&server.child, "-TERM");
    assert_eq!(server.child.wait().expect("it ends").code(), Some(0));
    assert_eq!(code(&run(at.path(), &["healthcheck", "--url", &url])), 1);
    assert_eq!(code(&run(at.path(), &["submit", "--url", &url])), 1);
}

#[test]
#[cfg(unix)]
fn a_service_and_a_worker_share_a_database() {
    let at = folder();
    let database = cluster::Cluster::shared().database();
    // Two connections suffice for a worker.
    let options = ["--database", database.as_str(), "--database-connections", "2"];
    assert_eq!(code(&run(at.path(), &["migrate", "--database", &database])), 0);
    // Only `serve` deletes orphans, so the worker must keep this file.
    let orphan = at.path().join("data/artifacts/models/00000000-0000-7000-8000-000000000000/1/model.glb");
    std::fs::create_dir_all(orphan.parent().expect("a directory")).expect("created");
    std::fs::File::create(&orphan).expect("created").set_modified(std::time::UNIX_EPOCH).expect("set");
    let port = free_port();
    let address = format!("127.0.0.1:{port}");
    let mut worker =
        oviduct(at.path()).args(["worker", "--metrics-addr", &address]).args(options).spawn().expect("it starts");
    let url = format!("http://{address}");
    until("the worker is alive", || code(&run(at.path(), &["healthcheck", "--url", &url])) == 0);
    sleep(Duration::from_secs(1));
    assert!(orphan.exists());
    let server = Server::start_with(at.path(), &[&options[..], &["--cpu-workers", "0", "--sweep-now"]].concat());
    until("the orphan is deleted", || !orphan.exists());
    let mut arguments = vec!["submit", "--url", &server.url, "--seed", "7", "--wait", "--json"];
    arguments.extend(TINY);
    let model = json(&run(at.path(), &arguments));
    assert_eq!((&model["status"], &model["attempts"]), (&"succeeded".into(), &1.into()));
    signal(&worker, "-TERM");
    assert_eq!(worker.wait().expect("it ends").code(), Some(0));
}

#[test]
fn a_job_store_that_cannot_be_opened_is_named_and_ends_the_process() {
    let at = folder();
    std::fs::write(
        at.path().join("junk.db"),
        "this is not a database, although it is long enough to be one".repeat(99),
    )
    .expect("written");
    for command in [&["serve", "--addr", "127.0.0.1:0"][..], &["migrate"]] {
        let output = run(at.path(), &[command, &["--database", "junk.db"]].concat());
        assert_eq!(code(&output), 1, "{}", said(&output));
        assert!(said(&output).contains("junk.db"), "{}", said(&output));
        assert_eq!(output.stdout.len(), 0);
    }
    let output = run(at.path(), &["migrate", "--database", "postgres://nobody:secret@127.0.0.1:1/none"]);
    assert_eq!(code(&output), 1);
    assert!(said(&output).contains("127.0.0.1:1") && !said(&output).contains("secret"), "{}", said(&output));
}

#[test]
fn a_gpu_that_does_not_exist_stops_the_service() {
    let at = folder();
    let output = run(at.path(), &["serve", "--gpu", "no such card"]);
    assert_eq!(code(&output), 2, "{}", said(&output));
    assert!(said(&output).contains("--gpu: "), "{}", said(&output));
}

#[test]
fn faults_are_armed_by_name_in_builds_of_tests() {
    let at = folder();
    let mut command = oviduct(at.path());
    command.args(["serve", "--addr", "127.0.0.1:0", "--gpu", "off"]).env("OVIDUCT_FAULT", "nowhere");
    let output = command.output().expect("the command runs");
    assert_eq!(code(&output), 2, "{}", said(&output));
    assert!(said(&output).contains("OVIDUCT_FAULT") && said(&output).contains("after-claim"), "{}", said(&output));
}

#[test]
fn probes_and_metrics_have_a_separate_address() {
    let at = folder();
    let probes = format!("127.0.0.1:{}", free_port());
    let _server = Server::start_with(at.path(), &["--gpu", "off", "--metrics-addr", &probes]);
    for (path, status) in [("/readyz", 200), ("/healthz", 200), ("/metrics", 200), ("/models", 404)] {
        let answer = get(&probes, path);
        assert!(answer.starts_with(&format!("HTTP/1.1 {status} ")), "{path}: {answer}");
    }
}

#[test]
#[cfg(unix)]
fn the_demo_saves_a_certified_model() {
    let at = folder();
    let mut arguments = vec!["demo", "--exit"];
    arguments.extend(TINY);
    let output = run(at.path(), &arguments);
    assert_eq!(code(&output), 0, "{}", said(&output));
    let printed = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(printed.contains("seed 7") && printed.contains("certified: "), "{printed}");
    // Progress appears as lines because stderr is not a terminal.
    assert!(said(&output).lines().any(|line| line.contains(" %")), "{}", said(&output));
    assert_eq!(complaints(&output), Vec::<String>::new());
    let levels = ["model.lod0.glb", "model.lod1.glb", "model.lod2.glb"];
    let files = [["data", "manifest.json", "model.glb"].as_slice(), &levels, &["report.json", "sections.bin"]].concat();
    assert_eq!(names(&at.path().join("demo")), files);
    assert_eq!(code(&run(at.path(), &["check", "demo/model.glb", "demo/model.lod2.glb", "--euler", "0"])), 0);
}

#[test]
#[cfg(unix)]
fn traces_go_to_a_collector() {
    let at = folder();
    let collector = collector::Collector::start();
    let mut server = Server::start_with(at.path(), &["--otlp-endpoint", &collector.url]);
    let mut arguments = vec!["submit", "--url", &server.url, "--seed", "7", "--wait", "--json"];
    arguments.extend(TINY);
    let model = json(&run(at.path(), &arguments));
    signal(&server.child, "-TERM");
    assert_eq!(server.child.wait().expect("it ends").code(), Some(0));

    let arrived = collector.arrived();
    assert!(!arrived.services.is_empty() && arrived.services.iter().all(|name| name == "oviduct"));
    let attempts: Vec<_> = arrived.named("attempt").collect();
    assert_eq!(attempts.len(), 1, "{:?}", arrived.spans);
    let job = attempts[0].attributes.iter().find(|attribute| attribute.key == "job").expect("the job is named");
    assert!(format!("{:?}", job.value).contains(model["id"].as_str().expect("an id")), "{job:?}");
    let parent = arrived.named("request").find(|request| request.span_id == attempts[0].parent_span_id);
    assert_eq!(parent.expect("the request for the model").trace_id, attempts[0].trace_id);
    for stage in ["simulate", "mesh", "certify", "measure", "export", "store"] {
        let spans: Vec<_> = arrived.named(stage).collect();
        assert_eq!(spans.len(), 1, "{stage}");
        assert_eq!((&spans[0].trace_id, &spans[0].parent_span_id), (&attempts[0].trace_id, &attempts[0].span_id));
        assert!(spans[0].start_time_unix_nano <= spans[0].end_time_unix_nano, "{stage}");
    }
    assert!(arrived.named("request").count() >= 2, "the request for the model, and those that followed it");

    let bad = run(at.path(), &["serve", "--otlp-endpoint", "collector:4318"]);
    assert_eq!(code(&bad), 2, "{}", said(&bad));
    assert!(said(&bad).contains("--otlp-endpoint collector:4318"), "{}", said(&bad));
}

#[test]
fn generate_and_report_write_the_same_page() {
    let at = folder();
    let mut arguments = vec!["generate", "--out", "a", "--seed", "7", "--report", "--json"];
    arguments.extend(TINY);
    assert_eq!(json(&run(at.path(), &arguments))["page"], "report.html");
    let page = std::fs::read_to_string(at.path().join("a/report.html")).expect("a page");
    assert!(page.starts_with("<!DOCTYPE html>") && page.contains("Beside published anatomy"), "{}", page.len());
    let output = run(at.path(), &["report", "a", "--out", "b/page.html"]);
    assert_eq!(code(&output), 0, "{}", said(&output));
    assert_eq!(std::fs::read_to_string(at.path().join("b/page.html")).expect("a page"), page);
    let output = run(at.path(), &["report", "nowhere"]);
    assert_eq!(code(&output), 1);
    assert!(said(&output).contains("report.json"), "{}", said(&output));
}

#[test]
fn compare_refuses_unknown_presets_and_invalid_seeds() {
    let at = folder();
    for (arguments, told) in
        [(["compare", "--preset", "pig,whale"], "whale"), (["compare", "--seeds", "2..1"], "1..20")]
    {
        let output = run(at.path(), &arguments);
        assert_eq!(code(&output), 2, "{}", said(&output));
        assert!(said(&output).contains(told), "{}", said(&output));
    }
}
