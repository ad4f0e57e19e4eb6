//! `bench overhead`: the cost of the service.
//!
//! Small models are requested over HTTP from a service in this process (SQLite and files in a
//! temporary directory, one worker per core). The same models are grown by direct calls of the
//! generator, on as many threads and on one. The runs alternate, so that other load on the machine
//! affects all of them. With a GPU the comparison is repeated for models that the GPU grows,
//! without the single thread.

mod batches;
mod comparison;
mod gpu;

use super::machine;
use super::report::Report;
use comparison::{Comparison, Direct, PRESET, Row, Serving, ratio};
use oviduct::cli::GpuArgs;
use oviduct::generate::Backend;
use serde_json::{Value, json};

/// Small models as steps and particles at start and end, changes of preset `paper`.
const SIZES: [(u32, u32, u32); 3] = [(60, 300, 420), (200, 400, 900), (400, 500, 1800)];

pub(super) async fn run(quick: bool, args: GpuArgs) -> anyhow::Result<Report> {
    let (rounds, seconds_a_round) = if quick { (3, 1.0) } else { (9, 4.0) };
    let workers = machine::threads() as u32;
    let count = workers.to_string();
    let serving = Serving::start(&["--gpu", "off", "--cpu-workers", &count, "--cpu-threads", "1"]).await?;
    let mut rows = Vec::new();
    for size in SIZES {
        let comparison = Comparison {
            client: &serving.client,
            size,
            backend: Backend::CpuSingle,
            // So many requests at a time that no worker waits.
            asked: 4 * workers,
            rounds,
            seconds_a_round,
            direct: Direct::Threads(workers),
        };
        rows.push(comparison.measure().await?);
    }
    serving.stop().await?;
    let mut report = report(&rows, workers, rounds);
    let (lines, json) = gpu::run(args, rounds, seconds_a_round).await?;
    report.lines.push(String::new());
    report.lines.extend(lines);
    report.json["gpu"] = json;
    Ok(report)
}

fn report(rows: &[Row], workers: u32, rounds: u32) -> Report {
    let mut lines = vec![
        machine::line(),
        format!(
            "models per second, median of {rounds} rounds: {workers} single-threaded workers over HTTP (SQLite, local files, \
             client in the same process), and {workers} threads that call the generator directly; faster: than one such \
             thread; computing: fraction of the workers' time spent in the stages of models"
        ),
        format!(
            "{:<36} {:>9} {:>9} {:>9} {:>9} {:>9} {:>7} {:>10}",
            "model", "ms each", "one", "direct", "faster", "service", "ratio", "computing"
        ),
    ];
    let mut json_rows: Vec<Value> = Vec::new();
    for row in rows {
        let [one, direct, service] = [&row.one, &row.direct, &row.service].map(|rates| machine::median(rates.clone()));
        let faster = ratio(&row.direct, &row.one);
        lines.push(format!(
            "{:<36} {:>9.1} {one:>9.2} {direct:>9.2} {faster:>9.2} {service:>9.2} {:>6.1}% {:>9.1}%",
            row.label,
            1e3 * row.seconds,
            1e2 * ratio(&row.service, &row.direct),
            1e2 * machine::median(row.computing.clone()),
        ));
        json_rows.push(json!({
            "model": row.label, "seconds_each": row.seconds, "one_per_second": row.one, "direct_per_second": row.direct,
            "faster_than_one": faster,
            "service_per_second": row.service, "ratio": ratio(&row.service, &row.direct), "computing": row.computing,
        }));
    }
    let json = json!({
        "bench": "overhead", "engine": oviduct::ENGINE_VERSION, "machine": machine::describe(), "preset": PRESET,
        "workers": workers, "rounds": rounds, "rows": json_rows,
    });
    Report { lines, json, files: Vec::new() }
}
