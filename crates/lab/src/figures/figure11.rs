//! Figure 11: total times of the versions of the simulation, compared with those in the paper.

use super::figure::{Figure, today};
use super::figure10::gpu;
use super::table;
use crate::bench::machine;
use crate::bench::paper::{Measured, PAPER};
use oviduct::cli::GpuUse;
use serde_json::json;

/// Names of the versions in the paper.
const NAMES: [&str; 3] = ["Single-core CPU", "Multi-core CPU", "GPU"];
/// Versions of oviduct in the same order: by the paper's method, and with neighbour lists.
const VERSIONS: [[Option<&str>; 2]; 3] =
    [[Some("paper-single"), Some("lists")], [Some("paper-multi"), Some("lists-multi")], [None, Some("gpu")]];

pub(super) fn draw(measured: &Measured, allowed: &GpuUse) -> Figure {
    let seconds = VERSIONS.map(|ids| ids.map(|id| measured.version(id?).map(|version| version.seconds)));
    let paper = PAPER.map(|(_, seconds)| Some(seconds));
    let columns = [paper, seconds.map(|row| row[0]), seconds.map(|row| row[1])];
    let time = |column: usize, row: usize| match (columns[column][row], column, row) {
        (Some(seconds), ..) => clock(seconds),
        (None, 2, 2) if *allowed == GpuUse::Auto => "no GPU".to_owned(),
        (None, 2, 2) => "not used".to_owned(),
        _ => "–".to_owned(),
    };
    let threads = machine::threads();
    let mut rows: Vec<Vec<String>> = (0..3)
        .map(|row| std::iter::once(NAMES[row].to_owned()).chain((0..3).map(|column| time(column, row))).collect())
        .collect();
    let ratios =
        [("Multi-core over single-core", [0, 1]), ("GPU over multi-core", [1, 2]), ("GPU over single-core", [0, 2])];
    let ratio = |column: usize, [slow, fast]: [usize; 2]| Some(columns[column][slow]? / columns[column][fast]?);
    for (name, pair) in ratios {
        let cells = (0..3).map(|column| ratio(column, pair).map_or_else(|| "–".to_owned(), times));
        rows.push(std::iter::once(name.to_owned()).chain(cells).collect());
    }
    let head = [
        vec!["Version".to_owned()],
        vec!["Paper, 2009".to_owned(), "Core 2 Quad Q6700,".to_owned(), "GeForce GTX 280".to_owned()],
        vec!["Its method here".to_owned(), "all pairs, scalar".to_owned(), "(sampled)".to_owned()],
        vec!["oviduct here".to_owned(), "lists, vectors".to_owned(), "(whole runs)".to_owned()],
    ];
    let svg = table::svg(&head, &rows, Some(3));
    let share = |id: &str| {
        let version = measured.version(id)?;
        let all = |particles: &[u32]| particles.iter().map(|&n| version.seconds_at(n)).sum::<f64>();
        Some(all(measured.particles.get(..measured.burn_in as usize)?) / all(&measured.particles))
    };
    let burn_in = ["paper-single", "lists"].map(|id| share(id).map_or(f64::NAN, |share| 100.0 * share));
    let caption = vec![
        format!(
            "Total times, hours:minutes:seconds, and how many times faster. Paper: its Figure 11, 2000 steps. Here: {}, all of them for multi-core, engine {}, {}.",
            machine::line(),
            oviduct::ENGINE_VERSION,
            today()
        ),
        format!(
            "Ours have {} steps: {} of burn-in come before the {} of the model, {:.1} % of the time of all pairs and {:.1} % of that with lists on one core.",
            measured.particles.len(),
            measured.burn_in,
            measured.particles.len() as u64 - u64::from(measured.burn_in),
            burn_in[0],
            burn_in[1]
        ),
        gpu(measured, allowed),
    ];
    let named = |column: usize| {
        json!({
            "single_seconds": columns[column][0], "multi_seconds": columns[column][1], "gpu_seconds": columns[column][2],
            "multi_over_single": ratio(column, [0, 1]), "gpu_over_multi": ratio(column, [1, 2]),
            "gpu_over_single": ratio(column, [0, 2]),
        })
    };
    let numbers = json!({
        "paper": named(0), "all_pairs": named(1), "lists": named(2), "threads": threads, "gpu": measured.gpu(),
        "burn_in_percent": { "all_pairs": burn_in[0], "lists": burn_in[1] },
    });
    let files = vec![("figure-11.svg".to_owned(), svg.into_bytes())];
    Figure { number: "11", title: "Total times", files, caption, numbers }
}

/// Formats seconds as hh:mm:ss.mmm, as in the paper.
fn clock(seconds: f64) -> String {
    let ms = (1e3 * seconds).round() as u64;
    format!("{:02}:{:02}:{:02}.{:03}", ms / 3_600_000, ms / 60_000 % 60, ms / 1000 % 60, ms % 1000)
}

fn times(ratio: f64) -> String {
    if ratio < 100.0 { format!("{ratio:.2}×") } else { format!("{ratio:.0}×") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_written_as_in_the_paper() {
        let [single, multi, gpu] = PAPER.map(|(_, seconds)| seconds);
        assert_eq!([single, multi, gpu].map(clock), ["08:03:27.491", "02:28:52.576", "00:01:02.646"]);
        assert_eq!([single / multi, multi / gpu, single / gpu].map(times), ["3.25×", "143×", "463×"]);
        assert_eq!(clock(59.9996), "00:01:00.000");
    }
}
