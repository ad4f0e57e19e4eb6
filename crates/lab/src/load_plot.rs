//! `oviduct-lab plot`: latencies of a load test, over time and by percentile, from the report that
//! `oviduct load --json` prints.

use crate::plot::{self, Axes, Line, Panel, Scale, SeriesLabelPosition};
use anyhow::Context;
use clap::Args;
use oviduct::cli::{Ended, Failure};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Options of `plot`.
#[derive(Clone, Debug, Args)]
pub(crate) struct PlotArgs {
    /// Report of `oviduct load --json`
    #[arg(value_name = "REPORT")]
    report: PathBuf,
    /// SVG file to write
    #[arg(long, value_name = "FILE", required = true)]
    out: PathBuf,
}

/// The members of the report that the plot shows. Times are in seconds.
#[derive(Debug, Deserialize)]
struct Report {
    calls: BTreeMap<String, Calls>,
    timeline: Vec<Second>,
}

#[derive(Debug, Deserialize)]
struct Calls {
    answered: u64,
    errors: Errors,
    latency: Latency,
}

#[derive(Debug, Deserialize)]
struct Errors {
    timeout: u64,
}

#[derive(Debug, Deserialize)]
struct Second {
    second: u64,
    latency: Latency,
}

/// Percentiles of latencies.
#[derive(Clone, Copy, Debug, Deserialize)]
struct Latency {
    p50: f64,
    p90: f64,
    p99: f64,
    p999: f64,
    max: f64,
}

pub(crate) fn run(args: &PlotArgs) -> Ended {
    let shown = args.report.display();
    let text = std::fs::read(&args.report).with_context(|| shown.to_string())?;
    let report = serde_json::from_slice(&text)
        .map_err(|error| Failure::usage(format!("{shown} is not a report of `oviduct load --json`: {error}")))?;
    std::fs::write(&args.out, draw(&report)?).with_context(|| format!("--out {}", args.out.display()))?;
    Ok(())
}

/// Draws both panels as SVG.
fn draw(report: &Report) -> anyhow::Result<String> {
    plot::draw_all(&[over_time(&report.timeline), by_percentile(&report.calls)])
}

/// Returns milliseconds, above 0 for the logarithmic axis.
fn ms(seconds: f64) -> f64 {
    1e3 * seconds.max(1e-6)
}

fn over_time(timeline: &[Second]) -> Panel {
    let line = |label: &str, time: fn(&Latency) -> f64| Line {
        label: label.to_owned(),
        points: timeline.iter().map(|at| (at.second as f64, ms(time(&at.latency)))).collect(),
    };
    Panel {
        axes: Axes {
            title: "Latency of all calls, from their planned start".to_owned(),
            x: "planned start, s after the warm-up",
            y: "latency, ms",
            x_tick: plot::whole,
            names: SeriesLabelPosition::UpperRight,
        },
        lines: vec![line("p50", |t| t.p50), line("p99", |t| t.p99), line("max", |t| t.max)],
        scale: Scale::Logarithmic,
    }
}

fn by_percentile(calls: &BTreeMap<String, Calls>) -> Panel {
    let lines = calls.iter().map(|(name, calls)| (name, percentiles(calls))).filter(|(_, points)| !points.is_empty());
    Panel {
        axes: Axes {
            title: "Latency by percentile".to_owned(),
            x: "calls that took no longer",
            y: "latency, ms",
            x_tick: percent,
            names: SeriesLabelPosition::UpperLeft,
        },
        lines: lines.map(|(name, points)| Line { label: name.clone(), points }).collect(),
        scale: Scale::Logarithmic,
    }
}

/// Returns latencies in milliseconds by the number of nines: 1 is 90 %, 2 is 99 %. The maximum of n
/// calls is the last point, at log10(n); percentiles beyond it are left out.
fn percentiles(calls: &Calls) -> Vec<(f64, f64)> {
    // Calls that timed out have a latency too.
    let count = calls.answered + calls.errors.timeout;
    if count == 0 {
        return Vec::new();
    }
    let Latency { p50, p90, p99, p999, max } = calls.latency;
    let last = (count as f64).log10();
    let points = [(2f64.log10(), p50), (1.0, p90), (2.0, p99), (3.0, p999)].into_iter().filter(|(at, _)| *at < last);
    points.chain([(last, max)]).map(|(at, seconds)| (at, ms(seconds))).collect()
}

/// Formats the percentage that a number of nines stands for.
fn percent(nines: f64) -> String {
    let digits = (nines - 2.0).ceil().max(0.0) as usize;
    format!("{:.digits$} %", 100.0 * (1.0 - 10f64.powf(-nines)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::{Value, json};

    fn report(answered: u64, timeline: &Value) -> Report {
        let latency = json!({ "mean": 0.002, "p50": 0.001, "p90": 0.002, "p99": 0.005, "p999": 0.009, "max": 0.02 });
        let calls = |answered| json!({ "answered": answered, "errors": { "timeout": 0 }, "latency": latency });
        let calls = json!({ "submit": calls(answered), "get": calls(0) });
        serde_json::from_value(json!({ "mode": "open", "calls": calls, "timeline": timeline })).unwrap()
    }

    #[test]
    fn both_panels_have_their_curves() {
        let latency = json!({ "p50": 0.001, "p90": 0.002, "p99": 0.005, "p999": 0.009, "max": 0.02 });
        let timeline = json!([{ "second": 0, "latency": latency }, { "second": 2, "latency": latency }]);
        let svg = draw(&report(1500, &timeline)).unwrap();
        for text in ["p50", "p99", "max", "submit", "by percentile", "90 %", "99 %"] {
            assert!(svg.contains(text), "{text}");
        }
        assert_eq!(svg.matches("<svg").count(), 1);
        // No call of the kind `get` was answered.
        assert!(!svg.contains("NaN") && !svg.contains("get"));
    }

    #[test]
    fn a_run_without_answers_has_a_plot_too() {
        let svg = draw(&report(0, &json!([]))).unwrap();
        assert!(svg.contains("<svg") && !svg.contains("NaN"));
    }

    #[test]
    fn percentiles_end_with_the_maximum() {
        let points = |answered| percentiles(&report(answered, &json!([])).calls["submit"]);
        assert_eq!(points(1), [(0.0, 20.0)]);
        assert_eq!(points(100), [(2f64.log10(), 1.0), (1.0, 2.0), (2.0, 20.0)]);
        assert_eq!(points(100_000).len(), 5);
    }

    #[test]
    fn nines_are_shown_as_percentages() {
        assert_eq!([0.0, 1.0, 2.0, 3.0, 4.0].map(percent), ["0 %", "90 %", "99 %", "99.9 %", "99.99 %"]);
    }
}
