//! API keys: creating, listing, rotating and revoking them while a service runs; the first API key
//! of a service on a public address.
#![cfg(unix)]

use super::{Server, code, folder, free_port, get, json, oviduct, run, said, signal, until};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::process::{Child, Stdio};

/// Status code of the response to `GET path` with an API key.
fn status_with(address: &str, path: &str, key: &str) -> u16 {
    let mut stream = TcpStream::connect(address).expect("connected");
    let request =
        format!("GET {path} HTTP/1.1\r\nhost: localhost\r\nauthorization: Bearer {key}\r\nconnection: close\r\n\r\n");
    stream.write_all(request.as_bytes()).expect("sent");
    let mut answer = String::new();
    stream.read_to_string(&mut answer).expect("answered");
    answer.split(' ').nth(1).and_then(|status| status.parse().ok()).expect("a status")
}

#[test]
fn keys_are_managed_while_a_service_runs() {
    let at = folder();
    let server = Server::start(at.path());
    let address = server.url.strip_prefix("http://").expect("a URL").to_owned();
    assert!(get(&address, "/models").starts_with("HTTP/1.1 200"), "without keys, this machine is served");

    let add = ["keys", "add", "--owner", "lab", "--scopes", "read,submit", "--expires", "30d", "--rate", "50"];
    let made = run(at.path(), &add);
    assert_eq!(code(&made), 0, "{}", said(&made));
    let key = String::from_utf8(made.stdout.clone()).expect("text").trim().to_owned();
    assert!(key.starts_with("oviduct_") && key.lines().count() == 1, "{key}");
    assert!(!said(&made).contains(&key), "the secret goes to stdout only");
    assert!(said(&made).contains("action=\"key added\" key=\""), "{}", said(&made));
    until("the key is asked for", || get(&address, "/models").starts_with("HTTP/1.1 401"));
    assert_eq!(status_with(&address, "/models", &key), 200);
    assert_eq!(status_with(&address, "/metrics", &key), 403);
    assert!(get(&address, "/healthz").starts_with("HTTP/1.1 200"));

    let list = json(&run(at.path(), &["keys", "list", "--json"]));
    assert_eq!((&list[0]["owner"], &list[0]["state"]), (&"lab".into(), &"active".into()));
    assert_eq!(list[0]["limits"]["requests_per_second"], 50.0);
    let prefix = list[0]["prefix"].as_str().expect("a prefix").to_owned();
    assert_eq!(prefix, key[8..16]);
    let table = String::from_utf8(run(at.path(), &["keys", "list"]).stdout).expect("text");
    assert!(table.contains(&prefix) && table.contains("read,submit") && !table.contains(&key[17..]), "{table}");

    let rotated = json(&run(at.path(), &["keys", "rotate", &prefix, "--json"]));
    let second = rotated["key"].as_str().expect("a key").to_owned();
    assert_eq!((&rotated["owner"], &rotated["scopes"]), (&list[0]["owner"], &list[0]["scopes"]));
    assert_eq!(rotated["expires_at"], list[0]["expires_at"]);
    until("the new key works", || status_with(&address, "/models", &second) == 200);
    until("the old key has ended", || status_with(&address, "/models", &key) == 401);

    assert_eq!(code(&run(at.path(), &["keys", "revoke", &second])), 0, "a whole key names itself too");
    until("it is revoked", || status_with(&address, "/models", &second) == 401);
    for (arguments, complaint) in [
        (&["keys", "revoke", "00000000"][..], "no key of this prefix"),
        (&["keys", "rotate", &prefix], "has ended"),
        (&["keys", "add", "--owner", "two words", "--scopes", "read"], "an owner is"),
        (&["keys", "add", "--owner", "lab", "--scopes", "root"], "a scope is read, submit or admin"),
        (&["keys", "add", "--owner", "lab", "--scopes", "read", "--expires", "0d"], "must be more than 0"),
        (&["keys", "add", "--owner", "lab"], "--scopes"),
    ] {
        let output = run(at.path(), arguments);
        assert_eq!(code(&output), 2, "{arguments:?}");
        assert!(said(&output).contains(complaint), "{}", said(&output));
    }
    drop(server);
    // Neither the database nor any other file of the service contains a secret.
    let mut known = false;
    for entry in std::fs::read_dir(at.path().join("data")).expect("the data") {
        let path = entry.expect("the data").path();
        let bytes = if path.is_file() { std::fs::read(&path).expect("it can be read") } else { Vec::new() };
        let has = |text: &[u8]| bytes.windows(text.len()).any(|window| window == text);
        for secret in [&key, &second] {
            assert!(!has(&secret.as_bytes()[17..]), "{path:?}");
        }
        known |= has(prefix.as_bytes());
    }
    assert!(known, "the prefixes of the keys are nowhere");
}

#[test]
fn keys_of_a_database_that_does_not_exist_need_create() {
    let at = folder();
    let add = ["keys", "add", "--owner", "lab", "--scopes", "read"];
    for arguments in [&add[..], &["keys", "list"], &["keys", "revoke", "00000000"], &["keys", "rotate", "00000000"]] {
        let output = run(at.path(), arguments);
        assert_eq!(code(&output), 2, "{arguments:?}: {}", said(&output));
        assert!(said(&output).contains("there is no database at data/oviduct.db"), "{}", said(&output));
        assert!(!at.path().join("data").exists(), "{arguments:?} created it");
    }
    assert_eq!(code(&run(at.path(), &[&add[..], &["--create"]].concat())), 0);
    assert_eq!(code(&run(at.path(), &add)), 0, "it exists now");
    assert_eq!(json(&run(at.path(), &["keys", "list", "--json"])).as_array().map(Vec::len), Some(2));
}

#[test]
fn a_service_that_others_can_reach_starts_with_a_key() {
    let at = folder();
    let port = free_port();
    let start = |options: &[&str]| {
        let mut command = oviduct(at.path());
        command
            .args(["serve", "--addr", &format!("0.0.0.0:{port}"), "--cpu-workers", "0", "--gpu", "off"])
            .args(options);
        command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("it starts")
    };
    let lines_of = |child: &mut Child, count: usize| -> Vec<String> {
        let mut out = BufReader::new(child.stdout.take().expect("piped"));
        (0..count)
            .map(|_| {
                let mut line = String::new();
                out.read_line(&mut line).expect("a line");
                line.trim().to_owned()
            })
            .collect()
    };
    let address = format!("127.0.0.1:{port}");
    let mut first = start(&[]);
    let lines = lines_of(&mut first, 2);
    let key = lines[0].strip_prefix("first admin key, shown only this once: ").expect("a key").to_owned();
    assert!(lines[1].starts_with("http://"), "{lines:?}");
    assert!(get(&address, "/models").starts_with("HTTP/1.1 401"));
    assert_eq!((status_with(&address, "/models", &key), status_with(&address, "/metrics", &key)), (200, 200));
    signal(&first, "-TERM");
    let ended = first.wait_with_output().expect("it ends");
    assert!(!said(&ended).contains(&key[17..]), "a secret is in the log");
    assert!(said(&ended).contains("key added") && said(&ended).contains(&key[8..16]), "{}", said(&ended));
    // The second start finds an existing API key and creates none.
    let mut second = start(&[]);
    assert!(lines_of(&mut second, 1)[0].starts_with("http://"));
    assert_eq!(status_with(&address, "/models", &key), 200);
    signal(&second, "-TERM");
    assert!(second.wait().expect("it ends").success());
}

/// The log has one line for each creation, cancellation and deletion, whatever the request
/// contains.
#[test]
fn changes_are_in_the_log() {
    let at = folder();
    let mut command = oviduct(at.path());
    command.args(["serve", "--addr", "127.0.0.1:0", "--cpu-workers", "0", "--gpu", "off"]);
    command.args(["--log", "error,oviduct::audit=info"]);
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("it starts");
    let mut url = String::new();
    BufReader::new(child.stdout.take().expect("piped")).read_line(&mut url).expect("it prints its address");
    let address = url.trim().strip_prefix("http://").expect("a URL").to_owned();
    let send = |line: &str, body: &str| {
        let mut stream = TcpStream::connect(&address).expect("connected");
        let length = body.len();
        let request = format!(
            "{line} HTTP/1.1\r\nhost: localhost\r\nconnection: close\r\ncontent-type: application/json\r\n\
             content-length: {length}\r\n\r\n{body}"
        );
        stream.write_all(request.as_bytes()).expect("sent");
        let mut answer = String::new();
        stream.read_to_string(&mut answer).expect("answered");
        assert!(answer.starts_with("HTTP/1.1 2"), "{line}: {answer}");
        answer
    };
    let made = send("POST /models", r#"{ "seed": 1, "labels": { "a": "x" } }"#);
    let id = made.split("\"id\":\"").nth(1).and_then(|rest| rest.get(..36)).expect("an id").to_owned();
    send(&format!("POST /models/{id}/cancel"), "");
    send("DELETE /models?label=a:x%0AFORGED", "");
    send(&format!("DELETE /models/{id}"), "");
    signal(&child, "-TERM");
    let log = said(&child.wait_with_output().expect("it ends"));
    let lines: Vec<&str> = log.lines().collect();
    let expected = [
        ("model created", id.as_str()),
        ("model cancelled", &id),
        ("models deleted", "0 models of label=\"a:x\\nFORGED\""),
        ("model deleted", &id),
    ];
    assert_eq!(lines.len(), expected.len(), "{log}");
    for (line, (action, subject)) in lines.iter().zip(expected) {
        let whole = line.contains("oviduct::audit") && line.contains(&format!("action=\"{action}\""));
        assert!(whole && line.contains(subject), "{line}");
    }
}
