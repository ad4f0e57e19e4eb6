//! The direction of imports: which module may import which, which may name which crate, and no circles between files.
//!
//! The source is scanned as text, without comments, strings and test modules; ARCHITECTURE.md lists the floors.

#[path = "architecture/circles.rs"]
mod circles;
#[path = "architecture/source.rs"]
mod source;

use circles::{Arrows, arrows, circles};
use source::{Source, sources, strip, words};
use std::collections::BTreeSet;

/// Modules of the library by floor, lowest first. A module imports from floors below its own.
const FLOORS: [&[&str]; 6] = [
    &[
        "clock",
        "metrics",
        "status",
        "availability",
        "random",
        "tls",
        "trace",
        "vectorize",
        "model",
        "geometry",
        "tissue",
    ],
    &["spec"],
    &["sim", "mesh", "measure", "export", "render"],
    &["generate", "fit", "jobs", "preview", "report"],
    &["worker", "http"],
    &["cli", "fuzzing"],
];

/// Imports within a floor that are intended. Floor 0 is plain data and arithmetic; its modules may import each other.
const ALLOWED: [(&str, &str); 3] = [("jobs", "generate"), ("jobs", "fit"), ("fit", "generate")];

/// Imports that are forbidden although the target lies on a lower floor.
const FORBIDDEN: [(&str, &str); 4] = [("jobs", "sim"), ("jobs", "mesh"), ("jobs", "measure"), ("jobs", "export")];

/// Crates that only some places may name.
const NAMES: [(&str, &[&str]); 11] = [
    ("cmaes", &["fit/search"]),
    ("meshopt", &["export/lod", "export/read/level"]),
    ("spade", &["geometry/triangulate"]),
    ("tiff", &["export/labels"]),
    ("quick_xml", &["export/vtp", "export/read/vtp"]),
    ("object_store", &["jobs/artifacts"]),
    ("sqlx", &["jobs/sqlite", "jobs/postgres", "jobs/sql"]),
    ("axum", &["http", "cli"]),
    ("wgpu", &["sim/gpu", "render"]),
    ("plotters", &["cli/plot", "report/plots"]),
    ("anyhow", &["cli", "main"]),
];

/// Arrows between files that may close a circle, and why each may.
const EXCUSED: [(&str, &str, &str); 0] = [];

/// Keywords that begin a statement of SQL; only the stores may contain them.
const SQL: [&str; 6] = ["SELECT ", "INSERT INTO ", "DELETE FROM ", "UPDATE jobs", "CREATE TABLE ", "PRAGMA "];

/// First parts of the paths that follow `::`: one name, or those of a group in braces.
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

/// Top modules that a file imports from, by `crate::` or by enough `super::`.
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
            found.extend(heads(after).into_iter().filter(|head| floor(head).is_some()).map(str::to_owned));
        }
    }
    found
}

fn floor(module: &str) -> Option<usize> {
    FLOORS.iter().position(|floor| floor.contains(&module))
}

/// What is wrong with the imports and names of one file.
fn faults(source: &Source) -> Vec<String> {
    let mut faults = Vec::new();
    let path = source.module_path();
    let from = path.first().copied().unwrap_or("lib");
    if from != "lib" && from != "main" {
        match floor(from) {
            None => faults.push(format!("src/{}: `{from}` has no floor", source.path)),
            Some(mine) => {
                for to in imports(source) {
                    let pair = (from, to.as_str());
                    let theirs = floor(&to).expect("imports gives known modules");
                    let fits = to == from || theirs < mine || mine == 0 && theirs == 0 || ALLOWED.contains(&pair);
                    if !fits || FORBIDDEN.contains(&pair) {
                        faults.push(format!("src/{}: `{from}` must not import from `{to}`", source.path));
                    }
                }
            }
        }
    }
    for (name, places) in NAMES {
        let named = words(&source.code).any(|(_, word)| word == name);
        if named && !places.iter().any(|place| source.is_in(place)) {
            faults.push(format!("src/{}: only {places:?} may name {name}", source.path));
        }
    }
    let strings = strip(&source.text, true);
    if let Some(sql) = SQL.iter().find(|sql| strings.contains(**sql))
        && !["jobs/sqlite", "jobs/postgres", "jobs/sql"].iter().any(|place| source.is_in(place))
    {
        faults.push(format!("src/{}: only the stores may hold SQL ({sql}…)", source.path));
    }
    if !source.text.starts_with("//!") {
        faults.push(format!("src/{}: must open with `//!`: what it is for", source.path));
    }
    faults
}

#[test]
fn arrows_point_down() {
    let sources = sources();
    assert!(sources.len() > 20, "found {} files only", sources.len());
    let faults: Vec<String> = sources.iter().flat_map(faults).collect();
    assert!(faults.is_empty(), "\n{}\n", faults.join("\n"));
}

/// The circles that no excuse breaks, one arrow a line.
fn unexcused(arrows: &Arrows, excuses: &[(&str, &str, &str)]) -> String {
    let excused = |from: &str, to: &str| excuses.iter().any(|(a, b, _)| (*a, *b) == (from, to));
    let left = arrows.iter().filter(|((from, to), _)| !excused(from, to));
    let left: Arrows = left.map(|(arrow, names)| (arrow.clone(), names.clone())).collect();
    let mut text = String::new();
    for (i, circle) in circles(&left).iter().enumerate() {
        text += &format!("circle {}:\n", i + 1);
        for ((from, to), names) in circle {
            let names: Vec<&str> = names.iter().map(String::as_str).collect();
            text += &format!("  src/{from} -> src/{to}: {}\n", names.join(", "));
        }
    }
    text
}

#[test]
fn no_files_import_each_other_in_a_circle() {
    let arrows = arrows(&sources());
    assert!(arrows.len() > 200, "found {} arrows only", arrows.len());
    let circles = unexcused(&arrows, &EXCUSED);
    assert!(circles.is_empty(), "\n{circles}");
}

#[test]
fn every_excuse_breaks_a_circle() {
    let circles = circles(&arrows(&sources()));
    for (from, to, reason) in EXCUSED {
        let arrow = (from.to_owned(), to.to_owned());
        assert!(circles.iter().any(|circle| circle.contains_key(&arrow)), "{from} -> {to} needs no excuse: {reason}");
    }
}

#[test]
fn every_module_has_a_floor() {
    let lib = Source::new("lib.rs", include_str!("../src/lib.rs"));
    let declared: BTreeSet<&str> =
        lib.code.lines().filter_map(|line| line.strip_prefix("pub mod ")?.strip_suffix(';')).collect();
    let placed: BTreeSet<&str> = FLOORS.iter().flat_map(|floor| floor.iter().copied()).collect();
    let homeless: Vec<_> = declared.difference(&placed).collect();
    assert!(declared.len() > 10 && homeless.is_empty(), "no floor for {homeless:?}");
}

#[test]
fn the_scanner_sees_what_it_should() {
    let bad = |path: &str, text: &str| faults(&Source::new(path, &format!("//! X.\n{text}"))).len();
    for (path, text) in [
        ("sim/a.rs", "use crate::{\n  model::{Ring, Section},\n  mesh::loft,\n};"),
        ("sim/a.rs", "use crate::jobs::Job;"),
        ("sim/mod.rs", "fn f() { crate::http::g() }"),
        ("sim/mod.rs", "use super::mesh;"),
        ("sim/cpu/a.rs", "use super::super::super::mesh::loft;"),
        ("jobs/a.rs", "use crate::sim::State;"),
        ("jobs/a.rs", "use crate::http::Problem;"),
        ("http/a.rs", "use crate::worker::WorkerPool;"),
        ("generate/a.rs", "use crate::jobs::Store;"),
        ("geometry/a.rs", "use spade::Triangulation;"),
        ("worker/a.rs", "use object_store::path::Path;"),
        ("worker/a.rs", "let q = \"SELECT 1\";"),
        ("worker/a.rs", "fn f() -> axum::Router {}"),
        ("elsewhere/a.rs", ""),
    ] {
        assert_eq!(bad(path, text), 1, "{path}: {text}");
    }
    for (path, text) in [
        ("sim/a.rs", "use crate::{model::Ring, spec::{self, Schedule}, random};"),
        ("sim/a.rs", "// use crate::jobs::Job;\nlet s = \"crate::jobs \\\" use crate::jobs::x\";"),
        ("sim/a.rs", "#[cfg(test)]\nmod tests {\n use crate::jobs::Job;\n}"),
        ("sim/a/tests.rs", "use crate::jobs::Job;"),
        ("sim/cpu/a.rs", "use super::super::mesh_of_the_simulation;"),
        ("sim/cpu/a.rs", "use super::mesh; let c = '\"'; let d = '\"';"),
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

#[test]
fn an_excuse_breaks_only_the_circle_that_it_names() {
    let source = |path, text| Source::new(path, text);
    let sources = [
        source("lib.rs", "mod a; mod b; mod c; mod d;"),
        source("a.rs", "use crate::b::B; struct A;"),
        source("b.rs", "use crate::a::A; struct B;"),
        source("c.rs", "use crate::d::D; struct C;"),
        source("d.rs", "use crate::c::C; struct D;"),
    ];
    let arrows = arrows(&sources);
    assert_eq!(unexcused(&arrows, &[]).matches("circle").count(), 2);
    let left = unexcused(&arrows, &[("a.rs", "b.rs", "a test")]);
    assert_eq!(left, "circle 1:\n  src/c.rs -> src/d.rs: D\n  src/d.rs -> src/c.rs: C\n");
}
