//! Output of commands: results go to stdout, everything else to stderr. Progress is a bar if stderr
//! is a terminal, otherwise a few lines.

use crate::lock::Mutex;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::{IsTerminal, Write};
use std::sync::Arc;

/// Writes a line of results to stdout.
///
/// # Errors
/// If stdout cannot be written to.
pub fn print(line: &str) -> std::io::Result<()> {
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
/// If stdout cannot be written to.
pub fn print_json<T: serde::Serialize>(value: &T) -> std::io::Result<()> {
    print(&serde_json::to_string_pretty(value).map_err(std::io::Error::from)?)
}

/// Writes a line to stderr. An error is ignored because there is nowhere to report it.
pub fn note(line: &str) {
    let _ = writeln!(std::io::stderr().lock(), "{line}");
}

/// Progress of one model on stderr. Clones show the same one.
#[derive(Clone, Debug)]
pub struct Bar(Display);

#[derive(Clone, Debug)]
enum Display {
    /// On a terminal.
    Bar(ProgressBar),
    /// Elsewhere: a line for each new stage and for every tenth of the work.
    Lines(Arc<Mutex<Reported>>),
}

/// Length of the bar. Fractions are shown in thousandths.
const PARTS: u64 = 1000;
/// Fraction of the work between two lines, in percent.
const LINE_EVERY: u64 = 10;

impl Bar {
    /// Shows progress on stderr.
    #[must_use]
    pub fn on_stderr() -> Self {
        if !std::io::stderr().is_terminal() {
            return Self(Display::Lines(Arc::default()));
        }
        let style = ProgressStyle::with_template("{prefix:<9} [{bar:40}] {percent:>3}% {elapsed_precise} {msg}")
            .expect("the template is well formed")
            .progress_chars("=> ");
        let bar = ProgressBar::with_draw_target(Some(PARTS), ProgressDrawTarget::stderr());
        bar.set_style(style);
        Self(Display::Bar(bar))
    }

    /// Shows a stage, the fraction of the whole work that is done (0 to 1), and details.
    pub fn show(&self, stage: &str, fraction: f64, message: String) {
        match &self.0 {
            Display::Bar(bar) => {
                bar.set_prefix(stage.to_owned());
                bar.set_position((fraction.clamp(0.0, 1.0) * PARTS as f64) as u64);
                bar.set_message(message);
            }
            Display::Lines(reported) => {
                let line = reported.lock().line(stage, fraction, &message);
                if let Some(line) = line {
                    note(&line);
                }
            }
        }
    }

    /// Shows a remark on the connection without changing the fraction.
    pub(super) fn remark(&self, message: &str) {
        match &self.0 {
            Display::Bar(bar) => bar.set_message(message.to_owned()),
            Display::Lines(reported) => {
                let mut reported = reported.lock();
                if reported.remark.as_deref() != Some(message) {
                    reported.remark = Some(message.to_owned());
                    note(message);
                }
            }
        }
    }

    /// Removes the bar from the terminal.
    pub fn clear(&self) {
        if let Display::Bar(bar) = &self.0 {
            bar.finish_and_clear();
        }
    }
}

/// Progress that the lines have reported.
#[derive(Debug, Default)]
struct Reported {
    stage: String,
    /// In steps of [`LINE_EVERY`] percent.
    tenth: u64,
    remark: Option<String>,
}

impl Reported {
    /// Returns the line for this progress; `None` if it is too close to the last line.
    fn line(&mut self, stage: &str, fraction: f64, message: &str) -> Option<String> {
        let percent = (fraction.clamp(0.0, 1.0) * 100.0) as u64;
        let tenth = percent / LINE_EVERY;
        if stage == self.stage && tenth <= self.tenth {
            return None;
        }
        stage.clone_into(&mut self.stage);
        (self.tenth, self.remark) = (tenth, None);
        Some(if message.is_empty() {
            format!("{stage} {percent} %")
        } else {
            format!("{stage} {percent} %: {message}")
        })
    }
}

/// Returns the peak memory of this process in bytes; known on Linux only.
pub(super) fn peak_rss_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    let kib: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    Some(kib * 1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[cfg(target_os = "linux")]
    fn peak_memory_is_known() {
        let before = peak_rss_bytes().expect("known on Linux");
        let block = vec![1u8; 64 << 20];
        assert!(block.iter().map(|b| u64::from(*b)).sum::<u64>() > 0);
        assert!(peak_rss_bytes().expect("known on Linux") >= before.max(64 << 20));
    }

    #[test]
    fn lines_report_each_stage_and_every_tenth() {
        let mut reported = Reported::default();
        let lines: Vec<String> =
            (0..=700).filter_map(|n| reported.line("simulate", f64::from(n) / 1000.0, &format!("step {n}"))).collect();
        assert_eq!(lines.len(), 8, "{lines:?}");
        assert_eq!((&*lines[0], &*lines[7]), ("simulate 0 %: step 0", "simulate 70 %: step 700"));
        assert_eq!(reported.line("mesh", 0.7, "").as_deref(), Some("mesh 70 %"));
        assert_eq!(reported.line("mesh", 0.7, ""), None);
    }
}
