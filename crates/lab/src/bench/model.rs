//! `bench model`: seconds of each stage of whole models, on one core and on all, as `oviduct
//! generate` reports them. Another build of the program can run alternately, for comparison.

use super::machine::{self, median};
use super::report::Report;
use anyhow::{Context, ensure};
use oviduct::cli::term;
use oviduct::spec::preset;
use serde::{Deserialize, Serialize};
use serde_json::json;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

const SEED: u64 = 1;
const STAGES: [&str; 6] = ["simulate", "mesh", "certify", "measure", "export", "total"];
/// Formats that are written: the surface alone, and the default with its levels of detail.
const OUTPUTS: [&str; 2] = ["glb", "glb,lod"];
/// Backends for one core and for all cores.
const BACKENDS: [&str; 2] = ["cpu-single", "cpu"];

/// The programs, and the presets of the models that they grow.
#[derive(Clone, Debug)]
pub(super) struct Models {
    /// Program under test; by default, the one beside this program.
    pub(super) program: Option<PathBuf>,
    /// Program to compare with.
    pub(super) before: Option<PathBuf>,
    pub(super) presets: Vec<String>,
}

/// What is read from the report of a model.
#[derive(Clone, Debug, Deserialize, Serialize)]
struct Run {
    seconds: serde_json::Map<String, serde_json::Value>,
    peak_rss_bytes: u64,
}

impl Run {
    fn stage(&self, name: &str) -> f64 {
        self.seconds.get(name).and_then(serde_json::Value::as_f64).unwrap_or_default()
    }

    fn megabytes(&self) -> f64 {
        self.peak_rss_bytes as f64 / 1e6
    }
}

/// Runs of one model with the same outputs on the same backend.
#[derive(Debug, Serialize)]
struct Row<'a> {
    preset: &'a str,
    outputs: &'static str,
    backend: &'static str,
    runs: Vec<Run>,
    runs_before: Vec<Run>,
}

pub(super) fn run(quick: bool, models: &Models) -> anyhow::Result<Report> {
    let program = models.program.clone().map_or_else(beside_this, Ok)?;
    for name in &models.presets {
        ensure!(preset(name).is_some(), "--preset: there is no preset {name}; see `oviduct presets`");
    }
    let count = if quick { 1 } else { 5 };
    let backends = if quick || machine::threads() == 1 { &BACKENDS[..1] } else { &BACKENDS[..] };
    let mut rows = Vec::new();
    for preset in &models.presets {
        for outputs in OUTPUTS {
            for &backend in backends {
                let mut row = Row { preset, outputs, backend, runs: Vec::new(), runs_before: Vec::new() };
                for n in 1..=count {
                    term::note(&format!("{preset}, {outputs}, {backend}, run {n} of {count} …"));
                    row.runs.push(grow(&program, &row)?);
                    if let Some(before) = &models.before {
                        row.runs_before.push(grow(before, &row)?);
                    }
                }
                rows.push(row);
            }
        }
    }
    let json = json!({
        "bench": "model", "engine": oviduct::ENGINE_VERSION, "machine": machine::describe(), "seed": SEED,
        "program": program, "before": models.before, "rows": rows,
    });
    Ok(Report { lines: lines(&rows, count), json, files: Vec::new() })
}

/// The program `oviduct` in the directory of this one.
fn beside_this() -> anyhow::Result<PathBuf> {
    let this = std::env::current_exe().context("the path of this program is unknown")?;
    let program = this.with_file_name(format!("oviduct{}", std::env::consts::EXE_SUFFIX));
    ensure!(program.is_file(), "--program PATH is needed: there is no {}", program.display());
    Ok(program)
}

/// Grows one model in a directory that is then removed.
fn grow(program: &Path, row: &Row<'_>) -> anyhow::Result<Run> {
    let out = tempfile::tempdir()?;
    let mut command = Command::new(program);
    command.args(["generate", "--json", "--seed", &SEED.to_string(), "--preset", row.preset]);
    command.args(["--outputs", row.outputs, "--backend", row.backend, "--out"]).arg(out.path());
    let ran = command.stdin(Stdio::null()).output().with_context(|| format!("{} cannot be run", program.display()))?;
    ensure!(
        ran.status.success(),
        "{} failed ({}): {}",
        program.display(),
        ran.status,
        String::from_utf8_lossy(&ran.stderr).lines().last().unwrap_or_default()
    );
    serde_json::from_slice(&ran.stdout).with_context(|| format!("what {} printed", program.display()))
}

fn lines(rows: &[Row<'_>], count: usize) -> Vec<String> {
    let named: String = STAGES.iter().map(|name| format!("{name:>10}")).collect();
    let mut lines = vec![
        machine::line(),
        format!("seconds of each stage, {} (seed {SEED})", machine::runs(count)),
        format!("{:<8} {:<8} {:<11}{named}{:>10}", "preset", "outputs", "backend", "peak, MB"),
    ];
    for row in rows {
        let stages = STAGES.map(|name| format!("{:>10.2}", median_of(&row.runs, |run| run.stage(name)))).concat();
        let memory = median_of(&row.runs, Run::megabytes);
        lines.push(format!("{:<8} {:<8} {:<11}{stages}{memory:>10.0}", row.preset, row.outputs, row.backend));
        if !row.runs_before.is_empty() {
            let stages = STAGES.map(|name| format!("{:>10.2}", row.ratio(|run| run.stage(name)))).concat();
            let memory = row.ratio(Run::megabytes);
            lines.push(format!("{:<29}{stages}{memory:>10.2}", "  times the build before"));
        }
    }
    lines
}

fn median_of(runs: &[Run], value: impl Fn(&Run) -> f64) -> f64 {
    median(runs.iter().map(value).collect())
}

impl Row<'_> {
    /// The median of the ratios of a value in each run to that in the run of the build before.
    fn ratio(&self, value: impl Fn(&Run) -> f64) -> f64 {
        median(self.runs.iter().zip(&self.runs_before).map(|(run, before)| value(run) / value(before)).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn taking(seconds: f64) -> Run {
        let stages = STAGES.iter().map(|name| ((*name).to_owned(), json!(seconds)));
        Run { seconds: stages.collect(), peak_rss_bytes: 200_000_000 }
    }

    #[test]
    fn runs_are_compared_in_pairs() {
        let [runs, runs_before] = [[1.0, 4.0, 9.0], [2.0, 4.0, 6.0]].map(|all| all.map(taking).to_vec());
        let row = Row { preset: "pig", outputs: "glb", backend: "cpu-single", runs, runs_before };
        assert_eq!(row.ratio(|run| run.stage("mesh")), 1.0);
        let lines = lines(&[row], 3);
        assert!(lines[3].ends_with("      4.00       200"), "{}", lines[3]);
        assert!(lines[4].ends_with("      1.00      1.00"), "{}", lines[4]);
    }
}
