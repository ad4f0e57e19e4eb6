//! `bench overhead`: the cost of the service. Small models are requested over HTTP from a service in this process (SQLite and
//! files in a temporary directory, one worker per core), and grown by the same number of threads that call the generator
//! directly. The two alternate, so that other load on the machine affects both.

use super::super::args::ServeArgs;
use super::super::client::Client;
use super::super::exit::Failure;
use super::super::load::{self, Grown, Lost, Model, Seeds};
use super::super::service::Service;
use super::machine;
use super::report::Report;
use crate::clock::Stopwatch;
use crate::generate::{Backend, Output};
use crate::spec::{ModelSpec, preset};
use anyhow::{Context, anyhow};
use serde_json::{Value, json};
use std::sync::Arc;
use std::time::Duration;
use tokio::net::TcpListener;

/// Small models: steps, and particles at start and end, as changes of preset `paper`.
const SIZES: [(u32, u32, u32); 3] = [(60, 300, 420), (200, 400, 900), (400, 500, 1800)];
const PRESET: &str = "paper";

/// Results for one size.
struct Row {
    label: String,
    /// Models per second of the generator alone, in each round.
    direct: Vec<f64>,
    /// Models per second of the service, in each round.
    service: Vec<f64>,
    /// Fraction of the workers' time spent in the stages of models, in each round, by the service's
    /// `oviduct_stage_seconds`.
    computing: Vec<f64>,
    /// Median time per model of the generator alone, in seconds.
    seconds: f64,
}

impl Row {
    /// Median over the rounds of service by direct.
    fn ratio(&self) -> f64 {
        machine::median(self.service.iter().zip(&self.direct).map(|(service, direct)| service / direct).collect())
    }
}

/// Seconds that the workers have spent in the stages of models so far.
async fn computed(client: &Client) -> anyhow::Result<f64> {
    let text = client.get("/metrics").await.map_err(plain)?.text().await?;
    let stages = ["simulate", "mesh", "certify", "export"];
    let sum = |stage: &str| {
        let name = format!("oviduct_stage_seconds_sum{{stage=\"{stage}\"}} ");
        text.lines().find_map(|line| line.strip_prefix(&name)?.parse::<f64>().ok()).unwrap_or_default()
    };
    Ok(stages.into_iter().map(sum).sum())
}

pub(super) async fn run(quick: bool) -> anyhow::Result<Report> {
    let (rounds, seconds_a_round) = if quick { (3, 1.0) } else { (9, 4.0) };
    let workers = machine::threads() as u32;
    let folder = std::env::temp_dir().join(format!("oviduct-bench-{}", uuid::Uuid::now_v7()));
    let mut args = ServeArgs::with(&["--gpu", "off"]).context("the defaults are not valid")?;
    args.process.database.data.clone_from(&folder);
    args.process.cpu_workers = workers;
    args.process.cpu_threads = Some(1);
    args.process.grace = Duration::ZERO;
    let listener = TcpListener::bind(("127.0.0.1", 0)).await.context("no port is free")?;
    let service = Service::start(&args, listener, None).await.map_err(plain)?;
    let client = Client::new(&format!("http://{}", service.address()), None).map_err(plain)?;
    let mut rows = Vec::new();
    for size in SIZES {
        rows.push(measure(&client, size, workers, rounds, seconds_a_round).await?);
    }
    service.stop(None).await.map_err(plain)?;
    std::fs::remove_dir_all(&folder).with_context(|| folder.display().to_string())?;
    Ok(report(&rows, workers, rounds))
}

#[expect(clippy::needless_pass_by_value, reason = "for `map_err`")]
fn plain(failure: Failure) -> anyhow::Error {
    anyhow!(failure.report().1.join("; "))
}

async fn measure(
    client: &Client,
    (steps, from, to): (u32, u32, u32),
    workers: u32,
    rounds: u32,
    seconds_a_round: f64,
) -> anyhow::Result<Row> {
    let patch = json!({ "steps": steps, "particles": { "total": { "keys": [[0, from], [1, to]] } } });
    let spec = ModelSpec::resolve(preset(PRESET).context("there is no preset `paper`")?, &patch)
        .map_err(|faults| anyhow!("the small model is not valid: {faults:?}"))?;
    let model = Model {
        preset: PRESET.to_owned(),
        spec: Arc::new(spec),
        backend: Backend::CpuSingle,
        outputs: vec![Output::Glb].into(),
    };
    let body = json!({ "preset": PRESET, "spec": patch, "backend": "cpu-single", "outputs": ["glb"] });
    // Enough requests at a time that no worker waits for one.
    let asked = 4 * workers;
    let mut next = 1;
    let mut seeds = |count: u64| {
        let seeds = Seeds::new(next, count);
        next += count;
        seeds
    };
    // Both once without measurement; the first determines the number of models per round.
    let first = load::direct(&model, seeds(u64::from(asked)), workers, 1).await.map_err(plain)?;
    let first = succeeded(first)?;
    load::through(client, &body, seeds(u64::from(asked)), asked).await.map_err(plain)?;
    let each = machine::median(first.iter().map(|one| one.seconds).collect());
    let count = (seconds_a_round * f64::from(workers) / each).ceil().max(f64::from(asked)) as u64;
    let mut row = Row {
        label: format!("{steps} steps, {from} to {to} particles"),
        direct: Vec::new(),
        service: Vec::new(),
        computing: Vec::new(),
        seconds: 0.0,
    };
    let mut times = Vec::new();
    for round in 0..rounds {
        // Which one goes first alternates.
        for direct in [round % 2 == 0, round % 2 != 0] {
            let watch = Stopwatch::start();
            if direct {
                let all = load::direct(&model, seeds(count), workers, 1).await.map_err(plain)?;
                row.direct.push(count as f64 / watch.seconds());
                times.extend(succeeded(all)?.iter().map(|one| one.seconds));
            } else {
                let before = computed(client).await?;
                load::through(client, &body, seeds(count), asked).await.map_err(plain)?;
                let seconds = watch.seconds();
                row.service.push(count as f64 / seconds);
                row.computing.push((computed(client).await? - before) / (f64::from(workers) * seconds));
            }
        }
    }
    row.seconds = machine::median(times);
    Ok(row)
}

/// All of these models, if each of them succeeded.
fn succeeded(all: Vec<Result<Grown, Lost>>) -> anyhow::Result<Vec<Grown>> {
    let all: Vec<Grown> = all.into_iter().collect::<Result<_, _>>().map_err(|lost| anyhow!(lost.message))?;
    anyhow::ensure!(all.iter().all(|one| one.succeeded), "not all models succeeded");
    Ok(all)
}

fn report(rows: &[Row], workers: u32, rounds: u32) -> Report {
    let mut lines = vec![
        machine::line(),
        format!(
            "models per second, median of {rounds} rounds: {workers} single-threaded workers over HTTP (SQLite, local files, \
             client in the same process), and {workers} threads that call the generator directly; computing: fraction of \
             the workers' time spent in the stages of models"
        ),
        format!("{:<36} {:>9} {:>9} {:>9} {:>7} {:>10}", "model", "ms each", "direct", "service", "ratio", "computing"),
    ];
    let mut json_rows: Vec<Value> = Vec::new();
    for row in rows {
        let (direct, service) = (machine::median(row.direct.clone()), machine::median(row.service.clone()));
        lines.push(format!(
            "{:<36} {:>9.1} {direct:>9.2} {service:>9.2} {:>6.1}% {:>9.1}%",
            row.label,
            1e3 * row.seconds,
            1e2 * row.ratio(),
            1e2 * machine::median(row.computing.clone()),
        ));
        json_rows.push(json!({
            "model": row.label, "seconds_each": row.seconds, "direct_per_second": row.direct,
            "service_per_second": row.service, "ratio": row.ratio(), "computing": row.computing,
        }));
    }
    let json = json!({
        "bench": "overhead", "engine": crate::ENGINE_VERSION, "machine": machine::describe(), "preset": PRESET,
        "workers": workers, "rounds": rounds, "rows": json_rows,
    });
    Report { lines, json, files: Vec::new() }
}
