//! A finished figure: files, caption and numbers.

use super::args::FigureNumber;
use clap::ValueEnum;
use oviduct::clock::Clock;
use serde_json::{Value, json};

/// A figure.
pub(super) struct Figure {
    /// FigureNumber in the paper.
    pub(super) number: &'static str,
    /// Title in a few words.
    pub(super) title: &'static str,
    /// Each file's name and content, PNG or SVG.
    pub(super) files: Vec<(String, Vec<u8>)>,
    /// Caption in sentences, with the differences from the paper.
    pub(super) caption: Vec<String>,
    /// Numbers of the figure for `figures.json`.
    pub(super) numbers: Value,
}

impl Figure {
    /// Returns the entry in `figures.json`.
    pub(super) fn document(&self) -> Value {
        let files: Vec<&str> = self.files.iter().map(|(name, _)| name.as_str()).collect();
        json!({ "title": self.title, "files": files, "caption": self.caption.join(" "), "numbers": self.numbers })
    }
}

/// Returns the number of a figure as text.
pub(super) fn name(number: FigureNumber) -> String {
    number.to_possible_value().map(|value| value.get_name().to_owned()).unwrap_or_default()
}

/// Returns the date for captions. No other result depends on it.
pub(super) fn today() -> String {
    Clock::System.now().strftime("%Y-%m-%d").to_string()
}

/// Formats a count with thousands separators.
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
