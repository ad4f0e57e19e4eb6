//! A figure as it is made: its files, its caption and its numbers.

use super::args::Number;
use oviduct::clock::Clock;
use serde_json::{Value, json};

/// A figure.
pub(super) struct Made {
    /// Its number in the paper.
    pub(super) number: &'static str,
    /// What it shows, in a few words.
    pub(super) title: &'static str,
    /// Each file's name and content, PNG or SVG.
    pub(super) files: Vec<(String, Vec<u8>)>,
    /// What it shows and how it differs from the paper's, in sentences.
    pub(super) caption: Vec<String>,
    /// The numbers behind it.
    pub(super) numbers: Value,
}

impl Made {
    /// What `figures.json` says of it.
    pub(super) fn document(&self) -> Value {
        let files: Vec<&str> = self.files.iter().map(|(name, _)| name.as_str()).collect();
        json!({ "title": self.title, "files": files, "caption": self.caption.join(" "), "numbers": self.numbers })
    }
}

/// The number of a figure as text.
pub(super) fn name(number: Number) -> &'static str {
    match number {
        Number::Four => "4",
        Number::Seven => "7",
        Number::Eight => "8",
        Number::Nine => "9",
        Number::Ten => "10",
        Number::Eleven => "11",
    }
}

/// The date for captions; no other result depends on it.
pub(super) fn today() -> String {
    Clock::System.now().strftime("%Y-%m-%d").to_string()
}

/// A count with its thousands apart.
pub(super) fn grouped(count: u64) -> String {
    let digits = count.to_string();
    let mut text = String::new();
    for (i, digit) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            text.push(',');
        }
        text.push(digit);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn thousands_are_apart() {
        assert_eq!([0, 999, 1000, 790_211, 1_514_538].map(grouped), ["0", "999", "1,000", "790,211", "1,514,538"]);
    }
}
