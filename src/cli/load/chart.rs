//! The plot of a load: latency over time, and latency by percentile.

use super::super::plot::{self, Axes, Line, Panel, Scale, SeriesLabelPosition};
use super::record::Numbers;
use super::times::Times;
use hdrhistogram::Histogram;

/// Draws both as SVG.
///
/// # Errors
/// If the plot cannot be drawn.
pub(super) fn draw(numbers: &Numbers) -> anyhow::Result<String> {
    plot::draw_all(&[over_time(numbers), by_percentile(numbers)])
}

/// Milliseconds, above 0 for the logarithmic axis.
fn ms(seconds: f64) -> f64 {
    1e3 * seconds.max(1e-6)
}

fn over_time(numbers: &Numbers) -> Panel {
    let of = |label: &str, time: fn(&Times) -> f64| {
        let seconds = numbers.seconds.iter().enumerate().filter(|(_, latency)| !latency.is_empty());
        let points = seconds.map(|(second, latency)| (second as f64, ms(time(&Times::of(latency))))).collect();
        Line { label: label.to_owned(), points }
    };
    Panel {
        axes: Axes {
            title: "Latency of all calls, from their planned start".to_owned(),
            x: "planned start, s after the warm-up",
            y: "latency, ms",
            x_tick: plot::whole,
            names: SeriesLabelPosition::UpperRight,
        },
        lines: vec![of("p50", |t| t.p50), of("p99", |t| t.p99), of("max", |t| t.max)],
        scale: Scale::Logarithmic,
    }
}

fn by_percentile(numbers: &Numbers) -> Panel {
    let lines = numbers.calls.iter().map(|(call, tally)| {
        let points = nines(&tally.latency).map(|(nines, seconds)| (nines, ms(seconds))).collect();
        Line { label: call.name().to_owned(), points }
    });
    Panel {
        axes: Axes {
            title: "Latency by percentile".to_owned(),
            x: "calls that took no longer",
            y: "latency, ms",
            x_tick: percent,
            names: SeriesLabelPosition::UpperLeft,
        },
        lines: lines.collect(),
        scale: Scale::Logarithmic,
    }
}

/// Latencies in seconds by the number of nines: 1 is 90 %, 2 is 99 %. It ends where there is no call beyond.
fn nines(latency: &Histogram<u64>) -> impl Iterator<Item = (f64, f64)> {
    let most = (latency.len().max(1) as f64).log10();
    let steps = (10.0 * most).floor() as u32;
    (0..=steps).map(move |step| f64::from(step) / 10.0).filter(|_| !latency.is_empty()).map(|nines| {
        let share = 1.0 - 10f64.powf(-nines);
        (nines, 1e-6 * latency.value_at_quantile(share) as f64)
    })
}

/// The share that a number of nines stands for.
fn percent(nines: f64) -> String {
    let digits = (nines - 2.0).ceil().max(0.0) as usize;
    format!("{:.digits$} %", 100.0 * (1.0 - 10f64.powf(-nines)))
}

#[cfg(test)]
mod tests {
    use super::super::mix::Call;
    use super::super::record::{Outcome, Record, Timed};
    use super::*;
    use std::time::Duration;

    #[test]
    fn both_panels_have_their_curves() {
        let record = Record::new(Duration::ZERO);
        for ms in 0..3000 {
            let planned = Duration::from_millis(ms);
            let call = if ms % 2 == 0 { Call::Submit } else { Call::List };
            let timed = Timed { call, planned, sent: planned, ended: planned * 2 };
            record.ended(timed, Outcome::Answered(1));
        }
        let svg = draw(&record.numbers()).expect("drawn");
        for text in ["p50", "p99", "max", "submit", "list", "by percentile", "90 %", "99 %"] {
            assert!(svg.contains(text), "{text}");
        }
        assert_eq!(svg.matches("<svg").count(), 1);
        assert!(!svg.contains("NaN") && !svg.contains("get"));
    }

    #[test]
    fn a_run_without_answers_has_a_plot_too() {
        let svg = draw(&Record::new(Duration::ZERO).numbers()).expect("drawn");
        assert!(svg.contains("<svg") && !svg.contains("NaN"));
    }

    #[test]
    fn nines_are_shown_as_percentages() {
        assert_eq!([0.0, 1.0, 2.0, 3.0, 4.0].map(percent), ["0 %", "90 %", "99 %", "99.9 %", "99.99 %"]);
    }
}
