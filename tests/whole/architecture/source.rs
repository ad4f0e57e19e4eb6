//! Source files as text, without comments, strings and code that only tests compile.

use std::path::Path;

pub(crate) struct Source {
    /// Path relative to the `src` of its crate, with `/`.
    pub(crate) path: String,
    /// The file, unchanged.
    pub(crate) text: String,
    /// Without comments, the contents of strings, and items under `#[cfg(test)]`.
    pub(crate) code: String,
}

impl Source {
    pub(crate) fn new(path: &str, text: &str) -> Self {
        let is_test = path.ends_with("tests.rs") || path.contains("/tests/");
        let code = if is_test { String::new() } else { without_tests(&strip(text, false)) };
        Self { path: path.to_owned(), text: text.to_owned(), code }
    }

    /// Names of the modules from the root of the crate to this file; empty for `lib.rs`.
    pub(crate) fn module_path(&self) -> Vec<&str> {
        let stem = self.path.trim_end_matches(".rs").trim_end_matches("/mod");
        if stem == "lib" { Vec::new() } else { stem.split('/').collect() }
    }

    pub(crate) fn is_in(&self, place: &str) -> bool {
        let rest = self.path.strip_prefix(place);
        rest.is_some_and(|rest| rest.starts_with('/') || rest == ".rs")
    }
}

/// All files below `src` and `crates/*/src`, sorted by path.
///
/// No module imports from `lib.rs` or `main.rs`, so only those of the root package are included.
pub(crate) fn sources() -> Vec<Source> {
    fn walk(root: &Path, dir: &Path, found: &mut Vec<Source>) {
        for entry in std::fs::read_dir(dir).expect("a folder of sources can be read") {
            let path = entry.expect("a folder of sources can be read").path();
            if path.is_dir() {
                walk(root, &path, found);
            } else if path.extension().is_some_and(|e| e == "rs") {
                let short = path.strip_prefix(root).expect("below src").to_str().expect("UTF-8").replace('\\', "/");
                found.push(Source::new(&short, &std::fs::read_to_string(&path).expect("UTF-8")));
            }
        }
    }
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut found = Vec::new();
    for entry in std::fs::read_dir(root.join("crates")).expect("crates can be read") {
        let src = entry.expect("crates can be read").path().join("src");
        walk(&src, &src, &mut found);
    }
    found.retain(|source| source.path != "lib.rs" && source.path != "main.rs");
    let src = root.join("src");
    walk(&src, &src, &mut found);
    found.sort_by(|a, b| a.path.cmp(&b.path));
    found
}

/// Removes comments and the contents of strings and character literals. With `keep_strings`, keeps
/// only the strings.
pub(crate) fn strip(text: &str, keep_strings: bool) -> String {
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
        } else if let Some(length) = char_literal(rest) {
            length
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

/// Length of the character literal at the beginning of the text. `None` for a lifetime and for
/// anything else.
fn char_literal(text: &str) -> Option<usize> {
    let inner = text.strip_prefix('\'')?;
    let first = inner.chars().next()?;
    let escape = if first == '\\' { 1 + inner[1..].chars().next()?.len_utf8() } else { first.len_utf8() };
    if first == '\\' {
        // `'\''` and `'\u{…}'`.
        return Some(1 + escape + inner[escape..].find('\'')? + 1);
    }
    inner[escape..].starts_with('\'').then_some(escape + 2)
}

/// Removes each item under `#[cfg(test)]`, up to its closing brace, or its semicolon if it has no
/// body.
fn without_tests(code: &str) -> String {
    const MARK: &str = "#[cfg(test)]";
    let (mut out, mut rest) = (String::new(), code);
    while let Some(at) = rest.find(MARK) {
        out.push_str(&rest[..at]);
        rest = &rest[at + MARK.len()..];
        let mut depth = 0;
        let end = rest.char_indices().find_map(|(i, c)| {
            match c {
                '{' => depth += 1,
                '}' => depth -= 1,
                _ => {}
            }
            (depth == 0 && matches!(c, '}' | ';')).then_some(i + 1)
        });
        rest = &rest[end.unwrap_or(rest.len())..];
    }
    out + rest
}

/// Identifiers and keywords of a text, with their positions.
pub(crate) fn words(code: &str) -> impl Iterator<Item = (usize, &str)> {
    let is_word = |c: char| c.is_alphanumeric() || c == '_';
    let mut at = 0;
    std::iter::from_fn(move || {
        let start = at + code[at..].find(is_word)?;
        let end = code[start..].find(|c| !is_word(c)).map_or(code.len(), |n| start + n);
        at = end;
        Some((start, &code[start..end]))
    })
}
