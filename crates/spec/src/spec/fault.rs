//! Faults of a JSON document: their place and a hint for the correction.

use serde_json::Value;

/// A fault of a JSON document, such as a specification or the body of a request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Fault {
    /// JSON pointer (RFC 6901) into the document, such as `/collision/gap_um`; empty for the whole.
    pub pointer: String,
    /// Description of the fault, with the bound and its unit if there is one.
    pub detail: String,
}

impl Fault {
    /// Creates a fault at a pointer.
    pub fn new(pointer: impl Into<String>, detail: impl Into<String>) -> Self {
        Self { pointer: pointer.into(), detail: detail.into() }
    }

    /// The same fault of a document that contains this one at the pointer `at`, such as `/spec`.
    #[must_use]
    pub fn within(self, at: &str) -> Self {
        Self { pointer: format!("{at}{}", self.pointer), ..self }
    }
}

impl std::fmt::Display for Fault {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let place = if self.pointer.is_empty() { "/" } else { &self.pointer };
        write!(f, "{place}: {}", self.detail)
    }
}

/// Pointer of member `name` of the value at `at`.
pub(super) fn child(at: &str, name: &str) -> String {
    format!("{at}/{}", name.replace('~', "~0").replace('/', "~1"))
}

/// Short description of a value for a message.
pub(super) fn describe(value: &Value) -> String {
    match value {
        Value::Null => "null".to_owned(),
        Value::Bool(b) => b.to_string(),
        Value::Number(n) => format!("the number {n}"),
        Value::String(s) => format!("the string \"{}\"", shorten(s)),
        Value::Array(_) => "an array".to_owned(),
        Value::Object(_) => "an object".to_owned(),
    }
}

/// First characters of a text from a request.
#[must_use]
pub fn shorten(text: &str) -> String {
    const MAX_CHARS: usize = 40;
    match text.char_indices().nth(MAX_CHARS) {
        Some((end, _)) => format!("{}…", &text[..end]),
        None => text.to_owned(),
    }
}

/// The name most similar to `wrong`, if it is similar enough to be the intended one.
#[must_use]
pub fn nearest<'a>(wrong: &str, names: impl Iterator<Item = &'a str>) -> Option<&'a str> {
    const MAX_BYTES: usize = 64;
    if wrong.len() > MAX_BYTES {
        return None;
    }
    // At least half of the characters must agree. Otherwise any two short names would be similar.
    let length = wrong.chars().count();
    let limit = (length / 3).max(2).min(length / 2);
    names.map(|name| (levenshtein_distance(wrong, name), name)).filter(|(d, _)| *d <= limit).min().map(|(_, name)| name)
}

fn levenshtein_distance(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, x) in a.chars().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, y) in b.iter().enumerate() {
            let change = diagonal + usize::from(x != *y);
            diagonal = row[j + 1];
            row[j + 1] = change.min(diagonal + 1).min(row[j] + 1);
        }
    }
    row[b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_are_levenshtein() {
        for (a, b, d) in [("", "", 0), ("a", "", 1), ("kitten", "sitting", 3), ("gap_um", "gap_mm", 1), ("ab", "ba", 2)]
        {
            assert_eq!(levenshtein_distance(a, b), d, "{a} {b}");
            assert_eq!(levenshtein_distance(b, a), d, "{b} {a}");
        }
    }

    #[test]
    fn only_near_names_are_suggested() {
        let names = || ["strength", "tissue_um", "gap_um"].into_iter();
        assert_eq!(nearest("gap", names()), None);
        assert_eq!(nearest("gap_mm", names()), Some("gap_um"));
        assert_eq!(nearest("strenght", names()), Some("strength"));
        assert_eq!(nearest(&"x".repeat(10_000), names()), None);
        let short = || ["z", "steps"].into_iter();
        assert_eq!(nearest("k0", short()), None);
        assert_eq!(nearest("k", short()), None);
        assert_eq!(nearest("zz", short()), Some("z"));
        assert_eq!(nearest("setps", short()), Some("steps"));
    }

    #[test]
    fn pointers_are_escaped_and_texts_shortened() {
        assert_eq!(child("/a", "b/c~d"), "/a/b~1c~0d");
        assert_eq!(shorten(&"ä".repeat(50)).chars().count(), 41);
    }
}
