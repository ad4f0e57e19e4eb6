//! The terminal: results go to stdout, everything else to stderr, and progress bars only where stderr is a terminal.

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::{IsTerminal, Write};

/// Writes a line of results to stdout.
///
/// # Errors
/// Where stdout cannot be written to.
pub(super) fn print(line: &str) -> std::io::Result<()> {
    let mut out = std::io::stdout().lock();
    out.write_all(line.as_bytes())?;
    if !line.ends_with('\n') {
        out.write_all(b"\n")?;
    }
    out.flush()
}

/// Writes a value to stdout as indented JSON.
///
/// # Errors
/// Where stdout cannot be written to.
pub(super) fn print_json<T: serde::Serialize>(value: &T) -> std::io::Result<()> {
    print(&serde_json::to_string_pretty(value).map_err(std::io::Error::from)?)
}

/// Says something on stderr; nothing is lost where that is impossible.
pub(super) fn note(line: &str) {
    let _ = writeln!(std::io::stderr().lock(), "{line}");
}

/// Progress of one model.
#[derive(Clone, Debug)]
pub(super) struct Bar(ProgressBar);

/// Parts of the bar: fractions are shown in thousandths.
const PARTS: u64 = 1000;

impl Bar {
    /// An empty bar; invisible unless stderr is a terminal.
    pub(super) fn new() -> Self {
        if !std::io::stderr().is_terminal() {
            return Self(ProgressBar::hidden());
        }
        let style = ProgressStyle::with_template("{prefix:<9} [{bar:40}] {percent:>3}% {elapsed_precise} {msg}")
            .expect("the template is well formed")
            .progress_chars("=> ");
        let bar = ProgressBar::with_draw_target(Some(PARTS), ProgressDrawTarget::stderr());
        bar.set_style(style);
        Self(bar)
    }

    /// Shows where the model stands.
    pub(super) fn show(&self, stage: &str, fraction: f64, message: String) {
        self.0.set_prefix(stage.to_owned());
        self.0.set_position((fraction.clamp(0.0, 1.0) * PARTS as f64) as u64);
        self.0.set_message(message);
    }

    /// Shows a word about the connection or the queue, leaving the bar where it is.
    pub(super) fn remark(&self, message: &str) {
        self.0.set_message(message.to_owned());
    }

    /// Takes the bar away.
    pub(super) fn clear(&self) {
        self.0.finish_and_clear();
    }
}

/// Largest amount of memory that this process has held, in bytes; known on Linux only.
pub(super) fn peak_rss_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kib: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kib * 1024)
}

#[cfg(test)]
mod tests {
    #[test]
    #[cfg(target_os = "linux")]
    fn peak_memory_is_known() {
        let before = super::peak_rss_bytes().expect("Linux tells");
        let block = vec![1u8; 64 << 20];
        assert!(block.iter().map(|b| u64::from(*b)).sum::<u64>() > 0);
        assert!(super::peak_rss_bytes().expect("Linux tells") >= before.max(64 << 20));
    }
}
