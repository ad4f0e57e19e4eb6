//! Enforces the import rules of ARCHITECTURE.md that neither Cargo nor the compiler enforces: the
//! order of modules, names that only some files may contain, and no circles between files.
//!
//! The tests read the sources as text, without comments, strings and test modules.

#[path = "architecture/circles.rs"]
mod circles;
#[path = "architecture/source.rs"]
mod source;

use circles::{arrows, circles};
use source::{Source, sources, strip, words};
use std::collections::BTreeSet;
use std::path::Path;

/// Groups of modules, lowest first. A module imports only from earlier groups, not from its own.
/// The crates are read as one, because a path such as `crate::model` is the same in each of them.
const ORDER: &[&[&str]] = &[
    // oviduct-base
    &["lock"],
    &["clock", "random", "vectorize"],
    &["model"],
    &["geometry"],
    &["tissue"],
    &["spec"],
    &["sim", "mesh", "measure", "export", "render"],
    &["generate", "preview", "report"],
    &["fit", "way"],
    // oviduct
    &["metrics", "panics", "status", "tls", "trace"],
    &["availability"],
    &["jobs"],
    &["worker", "http"],
    &["cli", "fuzzing"],
    // oviduct-lab, which names the service as `oviduct`
    &["plot"],
    &["bench", "load_plot"],
    &["figures"],
];

/// Imports that are forbidden although the target is in an earlier group.
const FORBIDDEN: &[(&str, &str)] = &[("jobs", "sim"), ("jobs", "mesh"), ("jobs", "measure"), ("jobs", "export")];

/// External crates, and the only places that may name them.
const NAMES: &[(&str, &[&str])] = &[
    ("spade", &["geometry/triangulate"]),
    ("wgpu", &["sim/gpu"]),
    ("object_store", &["jobs/artifacts"]),
    ("sqlx", &["jobs/sqlite", "jobs/postgres", "jobs/sql"]),
    ("deadpool", &["jobs/sqlite", "jobs/postgres"]),
    ("axum", &["http", "cli"]),
    ("anyhow", &["cli", "plot", "load_plot", "bench", "figures"]),
];

/// Beginnings of SQL statements. Only the job store may contain them.
const SQL: [&str; 6] = ["SELECT ", "INSERT INTO ", "DELETE FROM ", "UPDATE jobs", "CREATE TABLE ", "PRAGMA "];

/// First name of the path after `::`, or first names of all paths of a group in braces.
fn heads(after: &str) -> Vec<&str> {
    let Some(after) = after.strip_prefix("::") else { return Vec::new() };
    let Some(group) = after.strip_prefix('{') else {
        return words(after).next().map(|(_, word)| word).into_iter().collect();
    };
    let (mut depth, mut start, mut parts) = (0, 0, Vec::new());
    for (i, c) in group.char_indices() {
        match c {
            '{' => depth += 1,
            '}' if depth > 0 => depth -= 1,
            ',' | '}' if depth == 0 => {
                parts.extend(words(&group[start..i]).next().map(|(_, word)| word));
                start = i + 1;
                if c == '}' {
                    break;
                }
            }
            _ => {}
        }
    }
    parts
}

/// Top-level modules that a file names by `crate::`, or by as many `super::` as lead to the root.
fn imports(source: &Source) -> BTreeSet<String> {
    let code = &source.code;
    let mut found = BTreeSet::new();
    let mut chain: (usize, usize) = (0, 0);
    for (at, word) in words(code) {
        let after = &code[at + word.len()..];
        let supers = match word {
            "super" if chain.1 + 2 == at && code[..at].ends_with("::") => chain.0 + 1,
            "super" => 1,
            _ => 0,
        };
        chain = (supers, at + word.len());
        let is_root = word == "crate" || (supers > 0 && supers == source.module_path().len());
        if is_root {
            found.extend(heads(after).into_iter().filter(|head| group(head).is_some()).map(str::to_owned));
        }
    }
    found
}

fn group(module: &str) -> Option<usize> {
    ORDER.iter().position(|group| group.contains(&module))
}

/// Violations of the rules in one file.
fn faults(source: &Source) -> Vec<String> {
    let mut faults = Vec::new();
    let path = source.module_path();
    let from = path.first().copied().unwrap_or("lib");
    let is_crate_root = from == "lib" || from == "main";
    if !is_crate_root && group(from).is_none() {
        faults.push(format!("{}: `{from}` has no place in ORDER", source.path));
    }
    for to in imports(source).iter().filter(|to| !is_crate_root && *to != from) {
        let pair = (from, to.as_str());
        if group(to) >= group(from) || FORBIDDEN.contains(&pair) {
            faults.push(format!("{}: `{from}` must not import from `{to}`", source.path));
        }
    }
    for (name, places) in NAMES {
        if names(source, name) && !places.iter().any(|place| source.is_in(place)) {
            faults.push(format!("{}: only {places:?} may name {name}", source.path));
        }
    }
    // Imports between crates are visible only under the names that `lib.rs` gives them.
    if !is_crate_root && from != "clock" && words(&source.code).any(|(_, word)| word.starts_with("oviduct_")) {
        faults.push(format!("{}: only lib.rs may name a crate of the workspace", source.path));
    }
    let strings = strip(&source.text, true);
    if let Some(sql) = SQL.iter().find(|sql| strings.contains(**sql))
        && !["jobs/sqlite", "jobs/postgres", "jobs/sql"].iter().any(|place| source.is_in(place))
    {
        faults.push(format!("{}: only the job stores may contain SQL ({sql}…)", source.path));
    }
    if !source.text.starts_with("//!") {
        faults.push(format!("{}: must open with `//!`: what it is for", source.path));
    }
    faults
}

#[test]
fn imports_and_names_keep_the_rules() {
    let sources = sources();
    assert!(sources.len() > 400, "found {} files only", sources.len());
    let faults: Vec<String> = sources.iter().flat_map(faults).collect();
    assert!(faults.is_empty(), "\n{}\n", faults.join("\n"));
}

/// True if a file names a crate.
fn names(source: &Source, name: &str) -> bool {
    words(&source.code).any(|(_, word)| word == name)
}

#[test]
fn every_permission_is_used() {
    let sources = sources();
    for (name, places) in NAMES {
        for place in *places {
            let used = sources.iter().any(|source| source.is_in(place) && names(source, name));
            assert!(used, "{place} may name {name} and does not");
        }
    }
}

#[test]
fn no_files_import_each_other_in_a_circle() {
    let arrows = arrows(&sources());
    assert!(arrows.len() > 200, "found {} arrows only", arrows.len());
    let circles = circles(&arrows);
    assert!(circles.is_empty(), "\n{circles:#?}");
}

/// Crates of the service. The engine must not depend on them, not even indirectly.
const SERVICE: [&str; 8] = ["axum", "hyper", "object_store", "opentelemetry", "reqwest", "sqlx", "tokio", "utoipa"];

#[test]
fn the_engine_does_not_depend_on_the_service() {
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let args = ["tree", "--locked", "--offline", "-p", "oviduct-engine", "-e", "normal", "--prefix", "none"];
    let output = std::process::Command::new(cargo).args(args).output().expect("cargo runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let tree = String::from_utf8(output.stdout).expect("UTF-8");
    let crates: BTreeSet<&str> = tree.lines().filter_map(|line| line.split(' ').next()).collect();
    assert!(crates.contains("oviduct-base") && crates.contains("wgpu"), "{tree}");
    let found: Vec<_> = SERVICE.iter().filter(|name| crates.contains(*name)).collect();
    assert!(found.is_empty(), "the engine depends on {found:?}");
}

/// Every crate inherits its version, which is part of digests, and its lints. `tests/profile.toml`
/// compiles every crate with assertions.
#[test]
fn every_crate_is_part_of_the_workspace_and_of_the_test_profile() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let read = |path: &Path| -> toml::Table { std::fs::read_to_string(path).expect("there").parse().expect("TOML") };
    let profile = read(&root.join("tests/profile.toml"));
    let fuzz = std::fs::read_to_string(root.join("fuzz/Cargo.toml")).expect("there");
    let mut members = vec![root.to_owned()];
    members.extend(std::fs::read_dir(root.join("crates")).expect("there").map(|entry| entry.expect("there").path()));
    assert!(members.len() > 5, "{members:?}");
    for member in members {
        let manifest = read(&member.join("Cargo.toml"));
        let package = &manifest["package"];
        let name = package["name"].as_str().expect("a name");
        for key in ["version", "edition", "rust-version", "license", "publish"] {
            assert_eq!(package[key]["workspace"].as_bool(), Some(true), "{name}: {key}");
        }
        assert_eq!(manifest["lints"]["workspace"].as_bool(), Some(true), "{name}: lints");
        let settings = &profile["profile"]["release"]["package"][name];
        for key in ["debug-assertions", "overflow-checks"] {
            assert_eq!(settings[key].as_bool(), Some(true), "tests/profile.toml, {name}: {key}");
        }
        // The fuzzers do not build the lab.
        if name != "oviduct-lab" {
            assert!(fuzz.contains(&format!("\n{name} = {{")), "fuzz/Cargo.toml has no profile of {name}");
        }
    }
    assert_eq!(oviduct::ENGINE_VERSION, env!("CARGO_PKG_VERSION"));
}

#[test]
fn the_scanner_sees_what_it_should() {
    let bad = |path: &str, text: &str| faults(&Source::new(path, &format!("//! X.\n{text}"))).len();
    for (path, text) in [
        ("mesh/a.rs", "use crate::{\n  model::{Ring, Section},\n  measure::certificate,\n};"),
        ("mesh/mod.rs", "fn f() { crate::measure::g() }"),
        ("mesh/mod.rs", "use super::measure;"),
        ("mesh/cpu/a.rs", "use super::super::super::measure::loft;"),
        ("jobs/a.rs", "use crate::sim::State;"),
        ("jobs/a.rs", "use crate::http::Problem;"),
        ("http/a.rs", "use crate::worker::WorkerPool;"),
        ("generate/a.rs", "use crate::fit::Fit;"),
        ("render/a.rs", "fn f(d: &wgpu::Device) {}"),
        ("jobs/a.rs", "use oviduct_sim::sim::State;"),
        ("worker/a.rs", "use object_store::path::Path;"),
        ("worker/a.rs", "let q = \"SELECT 1\";"),
        ("worker/a.rs", "fn f() -> axum::Router {}"),
        ("elsewhere/a.rs", ""),
    ] {
        assert_eq!(bad(path, text), 1, "{path}: {text}");
    }
    for (path, text) in [
        ("sim/a.rs", "use crate::{model::Ring, spec::{self, Schedule}, random};"),
        ("mesh/a.rs", "// use crate::measure::A;\nlet s = \"crate::measure \\\" use crate::measure::x\";"),
        ("mesh/a.rs", "#[cfg(test)]\nmod tests {\n use crate::measure::A;\n}"),
        ("mesh/a/tests.rs", "use crate::measure::A;"),
        ("mesh/cpu/a.rs", "use super::super::measure_of_the_mesh;"),
        ("mesh/cpu/a.rs", "use super::measure; let c = '\"'; let d = '\"';"),
        ("jobs/a.rs", "use crate::generate::Backend;"),
        ("jobs/sqlite/a.rs", "use sqlx::Row; let q = r#\"SELECT 1\"#;"),
        ("geometry/triangulate.rs", "use spade::Triangulation;"),
        ("cli/a.rs", "use crate::{http, worker}; use axum::Router;"),
    ] {
        assert_eq!(bad(path, text), 0, "{path}: {text}");
    }
    assert_eq!(faults(&Source::new("sim/a.rs", "fn f() {}")).len(), 1, "no header");
}

#[test]
fn the_scanner_sees_circles_however_the_path_is_written() {
    let found = |files: &[(&str, &str)]| {
        let sources: Vec<Source> = files.iter().map(|(path, text)| Source::new(path, text)).collect();
        circles(&arrows(&sources)).iter().map(std::collections::BTreeMap::len).collect::<Vec<_>>()
    };
    let lib = ("lib.rs", "pub mod room;");
    let all_have = |expected: &[usize], cases: &[(&str, &str, &str, &str)]| {
        for (case, parent, a, b) in cases {
            let files = [lib, ("room/mod.rs", parent), ("room/a.rs", a), ("room/b.rs", b)];
            assert_eq!(found(&files), expected, "{case}");
        }
    };
    let circle = [
        ("crate", "mod a; mod b;", "use crate::room::b::B; struct A;", "use crate::room::a::A; struct B;"),
        ("super", "mod a; mod b;", "use super::b::B; struct A;", "fn f() { super::a::A::new() } struct B;"),
        ("group", "mod a; mod b;", "use super::{b::{self, B}}; struct A;", "use super::a::{A as C}; struct B;"),
        ("module", "mod a; mod b;", "use super::b; fn f() { b::g() }", "use super::a; fn g() { a::f() }"),
        ("facade", "mod a; mod b; pub use a::A; pub use b::B;", "use super::B; struct A;", "use super::A; struct B;"),
        (
            "glob facade",
            "mod a; mod b; pub use self::a::*; pub use b::*;",
            "use super::B; struct A;",
            "use super::A; struct B;",
        ),
        ("glob", "mod a; mod b;", "use super::b::*; struct A(B);", "use super::a::*; struct B(A);"),
        ("parent", "mod a; mod b; struct P; fn f() { a::f() }", "use super::P; pub fn f() {}", ""),
        ("used re-export", "mod a; mod b; pub use a::A; struct P(A);", "use super::P; pub struct A;", ""),
        (
            "macro",
            "mod a; mod b;",
            "macro_rules! m { () => { super::b::g() } } pub(super) use m;",
            "use super::a::m; fn g() {}",
        ),
    ];
    all_have(&[2], &circle);
    let no_circle = [
        ("one way", "mod a; mod b;", "use super::b::B; struct A;", "struct B;"),
        ("facade", "mod a; mod b; pub use a::A; pub use b::B;", "use super::B; struct A(B);", "struct B;"),
        (
            "facade above",
            "mod a; mod b; pub use a::{A, f}; struct P;",
            "use super::P; struct A; fn f() {}",
            "use super::{A, P};",
        ),
        ("parent above", "mod a; mod b; use a::A; struct P(A);", "struct A;", "use super::a::A;"),
        ("scope", "mod a; mod b;", "pub(in crate::room::b) struct A; use super::b::B;", "struct B;"),
        ("comment", "mod a; mod b;", "use super::b::B; struct A; // super::b", "// use super::a::A;\nstruct B;"),
        (
            "tests",
            "mod a; mod b;",
            "use super::b::B; struct A;",
            "struct B; #[cfg(test)] mod tests { use super::super::a::A; }",
        ),
        ("member", "mod a; mod b; pub use a::end; struct P; fn f(p: P) { p.end(); }", "use super::P; fn end() {}", ""),
        ("external", "mod a; mod b;", "use b::B; use std::a; struct A;", "use super::a::A;"),
        ("variant", "mod a; mod b;", "enum A { B }", "use super::a::A; fn f() { A::B; } struct B;"),
    ];
    all_have(&[], &no_circle);
    let three = |last: &str| {
        let c = format!("room/{last}.rs");
        let files = [
            lib,
            ("room.rs", "pub mod a; pub mod b; pub mod c;"),
            ("room/a.rs", "use super::b::B; pub struct A;"),
            ("room/b.rs", "use super::c; pub struct B(c::C);"),
            (c.as_str(), "pub struct C(super::a::A);"),
        ];
        found(&files)
    };
    assert_eq!(three("c"), [3], "three files");
    assert_eq!(three("d"), [0; 0], "no such file");
}
