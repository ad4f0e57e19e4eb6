//! The report of a load test as text.

use super::models::Models;
use super::record::Tally;
use super::report::{Mode, Report};
use super::times::Times;
use crate::cli::units::show_bytes;

/// Returns the lines of the report.
pub(super) fn lines(report: &Report) -> Vec<String> {
    let mut lines = vec![head(report)];
    lines.push(row(
        ["call", "answered", "per s", "p50 ms", "p90 ms", "p99 ms", "p99.9 ms", "max ms"].map(str::to_owned)
    ));
    for (call, calls) in &report.calls {
        let Times { p50, p90, p99, p999, max, .. } = Times::of(&calls.latency);
        let [p50, p90, p99, p999, max] = [p50, p90, p99, p999, max].map(|seconds| format!("{:.1}", 1e3 * seconds));
        let (name, per_second) = (call.name().to_owned(), format!("{:.2}", calls.per_second));
        lines.push(row([name, calls.answered.to_string(), per_second, p50, p90, p99, p999, max]));
    }
    for (call, calls) in &report.calls {
        let apart = apart(calls);
        if !apart.is_empty() {
            lines.push(format!("{}: of {} calls {apart}", call.name(), calls.due));
        }
    }
    if report.errors.total > 0 {
        lines.push(format!("errors: {}", report.errors.counts()));
        lines.extend(report.errors.examples().map(|example| format!("  {example}")));
    }
    if matches!(report.run.mode, Mode::Open { .. }) {
        lines.push(format!("calls were sent after their planned start by {}", times(&report.lag)));
    }
    let streams = &report.streams;
    if streams.held > 0 {
        lines.push(format!(
            "{} streams followed {} models to their ends: {} told, {} not; {} connections were lost on the way",
            streams.held,
            streams.followed,
            streams.told,
            streams.untold + streams.errors.total,
            streams.cut
        ));
    }
    match (&report.models, &report.models_unread) {
        (Some(models), _) => lines.extend(of_models(models)),
        (None, why) => lines.push(format!("the models could not be read: {}", why.as_deref().unwrap_or("no answer"))),
    }
    if let Some(efficiency) = &report.efficiency {
        lines.push(format!(
            "efficiency {:.1} %: the generator alone grew {:.3} models per second on all cores of this machine ({} models)",
            1e2 * efficiency.ratio,
            efficiency.direct_per_second,
            efficiency.sample
        ));
    }
    lines
}

fn head(report: &Report) -> String {
    let mode = match &report.run.mode {
        Mode::Open { rate, arrivals, max_in_flight } => {
            let arrivals = format!("{arrivals:?}").to_lowercase();
            format!("open loop at {rate}/s ({arrivals} arrivals), at most {max_in_flight} calls in flight")
        }
        Mode::Closed { concurrency } => format!("closed loop, {concurrency} at a time"),
        Mode::Direct { concurrency } => format!("without a service, {concurrency} at a time"),
    };
    let interrupted = if report.run.interrupted { ", interrupted" } else { "" };
    format!(
        "{mode}: {:.1} s after a warm-up of {:.1} s, seed {}{interrupted}",
        report.run.seconds, report.run.warm_up, report.run.seed
    )
}

fn row(cells: [String; 8]) -> String {
    let [first, others @ ..] = cells;
    let others: String = others.iter().map(|cell| format!(" {cell:>9}")).collect();
    format!("{first:<9}{others}")
}

/// Returns the numbers of calls without a valid response.
fn apart(calls: &Tally) -> String {
    let counts = [
        (calls.errors.total, "met an error"),
        (calls.refused, "were answered 429"),
        (calls.dropped, "were dropped, because too many were in flight"),
        (calls.skipped, "were skipped, because the run had no model for them yet"),
        (calls.unfinished, "were in flight at the end"),
    ];
    let counts: Vec<String> =
        counts.iter().filter(|(count, _)| *count > 0).map(|(count, what)| format!("{count} {what}")).collect();
    counts.join(", ")
}

fn of_models(models: &Models) -> Vec<String> {
    let mut lines = vec![format!(
        "models: {}, of which {} succeeded, {} failed, {} have not ended, {} are missing; {:.3} per second, {}",
        models.models,
        models.succeeded,
        models.failed,
        models.unended,
        models.missing,
        models.per_second,
        show_bytes(models.bytes)
    )];
    if models.models > models.unended {
        lines.push(format!("in the queue for {}", times(&models.queue_wait)));
        lines.push(format!("ended after      {}", times(&models.end_to_end)));
    }
    lines
}

fn times(times: &Times) -> String {
    format!("p50 {:.3} s, p90 {:.3} s, p99 {:.3} s, max {:.3} s", times.p50, times.p90, times.p99, times.max)
}
