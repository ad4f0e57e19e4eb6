//! The direction of the arrows: which module may import which, and who may name which crate.
//!
//! The source is scanned as text, with comments, strings and test modules taken out; see `house` in ARCHITECTURE.md.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// Modules of the library by floor, lowest first. A module imports from floors below its own.
const FLOORS: [&[&str]; 6] = [
    &["clock", "metrics", "status", "random", "tls", "trace", "model", "geometry"],
    &["spec"],
    &["sim", "mesh", "measure", "export", "render"],
    &["generate", "jobs"],
    &["worker", "http"],
    &["cli"],
];

/// Imports within a floor that are meant. Floor 0 is plain data and arithmetic, and free within itself.
const ALLOWED: [(&str, &str); 1] = [("jobs", "generate")];

/// Imports that are forbidden although the target lies on a lower floor.
const FORBIDDEN: [(&str, &str); 4] = [("jobs", "sim"), ("jobs", "mesh"), ("jobs", "measure"), ("jobs", "export")];

/// Crates that only some places may name.
const NAMES: [(&str, &[&str]); 7] = [
    ("spade", &["geometry/triangulate"]),
    ("object_store", &["jobs/artifacts"]),
    ("sqlx", &["jobs/sqlite", "jobs/postgres", "jobs/sql"]),
    ("axum", &["http", "cli"]),
    ("wgpu", &["sim/gpu", "render"]),
    ("plotters", &["cli/bench"]),
    ("anyhow", &["cli", "main"]),
];

/// Words of SQL that begin a statement; only the stores may hold them.
const SQL: [&str; 6] = ["SELECT ", "INSERT INTO ", "DELETE FROM ", "UPDATE jobs", "CREATE TABLE ", "PRAGMA "];

struct Source {
    /// Path below `src`, with `/`.
    path: String,
    /// As it stands.
    text: String,
    /// Without comments, strings and test modules.
    code: String,
}

impl Source {
    fn new(path: &str, text: &str) -> Self {
        let mut code = strip(text, false);
        if path.ends_with("tests.rs") || path.contains("/tests/") {
            code.clear();
        } else if let Some(at) = code.find("#[cfg(test)]\nmod ") {
            code.truncate(at);
        }
        Self { path: path.to_owned(), text: text.to_owned(), code }
    }

    /// The top module that the file belongs to.
    fn module(&self) -> &str {
        self.path.split('/').next().unwrap_or_default().trim_end_matches(".rs")
    }

    /// How many `super` lead from the file to the root of the crate.
    fn depth(&self) -> usize {
        let stem = self.path.trim_end_matches(".rs").trim_end_matches("/mod");
        stem.split('/').count()
    }

    fn is_in(&self, place: &str) -> bool {
        let rest = self.path.strip_prefix(place);
        rest.is_some_and(|rest| rest.starts_with('/') || rest == ".rs")
    }
}

/// Takes out comments, and the insides of strings (or everything else where `keep_strings`).
fn strip(text: &str, keep_strings: bool) -> String {
    let (mut out, mut rest) = (String::new(), text);
    while let Some(c) = rest.chars().next() {
        let skip = if rest.starts_with("//") {
            rest.find('\n').unwrap_or(rest.len())
        } else if rest.starts_with("/*") {
            rest.find("*/").map_or(rest.len(), |end| end + 2)
        } else if rest.starts_with("r#\"") {
            let end = rest.find("\"#").map_or(rest.len(), |end| end + 2);
            if keep_strings {
                out.push_str(&rest[..end]);
            }
            end
        } else if c == '"' {
            let mut end = 1;
            while end < rest.len() && !rest[end..].starts_with('"') {
                end += if rest[end..].starts_with('\\') { 2 } else { 1 };
                while !rest.is_char_boundary(end.min(rest.len())) {
                    end += 1;
                }
            }
            let end = (end + 1).min(rest.len());
            if keep_strings {
                out.push_str(&rest[..end]);
            } else {
                out.push_str("\"\"");
            }
            end
        } else if rest.starts_with("'\"'") {
            3
        } else if rest.starts_with("'\\\"'") {
            4
        } else {
            if !keep_strings {
                out.push(c);
            }
            c.len_utf8()
        };
        rest = &rest[skip..];
    }
    out
}

/// Words of a text with where they begin.
fn words(code: &str) -> impl Iterator<Item = (usize, &str)> {
    let is_word = |c: char| c.is_alphanumeric() || c == '_';
    let mut at = 0;
    std::iter::from_fn(move || {
        let start = at + code[at..].find(is_word)?;
        let end = code[start..].find(|c| !is_word(c)).map_or(code.len(), |n| start + n);
        at = end;
        Some((start, &code[start..end]))
    })
}

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
        let is_root = word == "crate" || (supers > 0 && supers == source.depth());
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
    let from = source.module();
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

fn sources() -> Vec<Source> {
    fn walk(dir: &Path, found: &mut Vec<PathBuf>) {
        for entry in std::fs::read_dir(dir).expect("src can be read") {
            let path = entry.expect("src can be read").path();
            if path.is_dir() {
                walk(&path, found);
            } else if path.extension().is_some_and(|e| e == "rs") {
                found.push(path);
            }
        }
    }
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut paths = Vec::new();
    walk(&root, &mut paths);
    paths.sort();
    paths
        .iter()
        .map(|path| {
            let short = path.strip_prefix(&root).expect("below src").to_str().expect("UTF-8").replace('\\', "/");
            Source::new(&short, &std::fs::read_to_string(path).expect("src can be read"))
        })
        .collect()
}

#[test]
fn arrows_point_down() {
    let sources = sources();
    assert!(sources.len() > 20, "found {} files only", sources.len());
    let faults: Vec<String> = sources.iter().flat_map(faults).collect();
    assert!(faults.is_empty(), "\n{}\n", faults.join("\n"));
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
