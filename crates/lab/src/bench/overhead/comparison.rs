//! Alternating measurements of a service in this process and of direct calls of the generator.

use super::batches;
use crate::bench::{machine, probe};
use anyhow::{Context, anyhow};
use oviduct::cli::load::{self, Grown, Lost, Model, Seeds};
use oviduct::cli::{Client, Failure, ServeArgs, Service};
use oviduct::clock::Stopwatch;
use oviduct::generate::{Backend, Output};
use oviduct::sim::gpu::GpuDevice;
use serde_json::{Value, json};
use std::sync::Arc;
use tempfile::TempDir;
use tokio::net::TcpListener;

/// Preset of all models.
pub(super) const PRESET: &str = "paper";

/// Results for one size.
pub(super) struct Row {
    pub(super) label: String,
    /// Models per second of the generator alone, in each round.
    pub(super) direct: Vec<f64>,
    /// Models per second of the service, in each round.
    pub(super) service: Vec<f64>,
    /// Models per second of one thread that calls the generator; empty with a GPU.
    pub(super) one: Vec<f64>,
    /// Fraction of the workers' time spent in the stages of models, in each round, by the service's
    /// `oviduct_stage_seconds`.
    pub(super) computing: Vec<f64>,
    /// Median time per model of the generator alone, in seconds.
    pub(super) seconds: f64,
}

/// Returns the median over the rounds of `rates` divided by `by`.
pub(super) fn ratio(rates: &[f64], by: &[f64]) -> f64 {
    machine::median(rates.iter().zip(by).map(|(rate, by)| rate / by).collect())
}

/// Returns the total seconds that the workers have spent in the stages of models.
async fn computed(client: &Client) -> anyhow::Result<f64> {
    let text = client.get("/metrics").await.map_err(plain)?.text().await?;
    let stages = ["simulate", "mesh", "certify", "measure", "export"];
    let sum = |stage: &str| {
        let name = format!("oviduct_stage_seconds_sum{{stage=\"{stage}\"}} ");
        text.lines().find_map(|line| line.strip_prefix(&name)?.parse::<f64>().ok()).unwrap_or_default()
    };
    Ok(stages.into_iter().map(sum).sum())
}

#[expect(clippy::needless_pass_by_value, reason = "for `map_err`")]
fn plain(failure: Failure) -> anyhow::Error {
    anyhow!(failure.report().1.join("; "))
}

/// A service in this process, with its data in a temporary directory.
pub(super) struct Serving {
    service: Service,
    pub(super) client: Client,
    folder: TempDir,
}

impl Serving {
    /// Starts a service with these options of `oviduct serve`.
    pub(super) async fn start(options: &[&str]) -> anyhow::Result<Self> {
        let folder = tempfile::tempdir()?;
        let data = folder.path().display().to_string();
        let args = ServeArgs::with(&[&["--data", &data, "--grace", "0s"], options].concat())
            .context("the options of the service are not valid")?;
        let listener = TcpListener::bind(("127.0.0.1", 0)).await.context("no port is free")?;
        let service = Service::start(&args, listener, None).await.map_err(plain)?;
        let client = Client::new(&format!("http://{}", service.address()), None).map_err(plain)?;
        Ok(Self { service, client, folder })
    }

    pub(super) async fn stop(self) -> anyhow::Result<()> {
        self.service.stop(None).await.map_err(plain)?;
        Ok(self.folder.close()?)
    }
}

/// Direct calls of the generator.
pub(super) enum Direct {
    /// On this number of threads, one model each.
    Threads(u32),
    /// In batches of this size on a GPU.
    Batches(GpuDevice, usize),
}

impl Direct {
    /// Grows the models of these seeds and returns the seconds of each.
    async fn grow(&self, model: &Model, seeds: Seeds) -> anyhow::Result<Vec<f64>> {
        match self {
            Self::Threads(count) => {
                let all = load::direct(model, seeds, *count, 1).await.map_err(plain)?;
                Ok(succeeded(all)?.iter().map(|one| one.seconds).collect())
            }
            Self::Batches(device, size) => {
                let (device, size, model, count) = (device.clone(), *size, model.clone(), seeds.left());
                let watch = Stopwatch::start();
                let grown = tokio::task::spawn_blocking(move || batches::grow(&device, &model, &seeds, size));
                grown.await.context("a task panicked")??;
                Ok(vec![watch.seconds() / count as f64; count as usize])
            }
        }
    }
}

/// Returns the patch of a small model: steps, and particles at start and end.
fn patch((steps, from, to): (u32, u32, u32)) -> Value {
    json!({ "steps": steps, "particles": { "total": { "keys": [[0, from], [1, to]] } } })
}

pub(super) fn model(size: (u32, u32, u32), backend: Backend) -> anyhow::Result<Model> {
    let spec = Arc::new(probe::paper(&patch(size))?);
    Ok(Model { preset: PRESET.to_owned(), spec, backend, outputs: vec![Output::Glb].into() })
}

/// A comparison of a service with direct calls, for one size of models.
pub(super) struct Comparison<'a> {
    pub(super) client: &'a Client,
    pub(super) size: (u32, u32, u32),
    pub(super) backend: Backend,
    /// Requests at a time.
    pub(super) asked: u32,
    pub(super) rounds: u32,
    pub(super) seconds_a_round: f64,
    pub(super) direct: Direct,
}

impl Comparison<'_> {
    pub(super) async fn measure(&self) -> anyhow::Result<Row> {
        let Self { client, size, asked, .. } = *self;
        let model = model(size, self.backend)?;
        let body = json!({ "preset": PRESET, "spec": patch(size), "backend": self.backend, "outputs": ["glb"] });
        let workers = machine::threads() as f64;
        let mut next = 1;
        let mut seeds = |count: u64| {
            let seeds = Seeds::new(next, count);
            next += count;
            seeds
        };
        // One run of both without measurement. The first one determines the number of models per
        // round.
        let watch = Stopwatch::start();
        self.direct.grow(&model, seeds(u64::from(asked))).await?;
        let rate = f64::from(asked) / watch.seconds();
        load::through(client, &body, seeds(u64::from(asked)), asked).await.map_err(plain)?;
        let count = (self.seconds_a_round * rate).ceil().max(f64::from(asked)) as u64;
        let (steps, from, to) = size;
        let mut row = Row {
            label: format!("{steps} steps, {from} to {to} particles"),
            direct: Vec::new(),
            service: Vec::new(),
            one: Vec::new(),
            computing: Vec::new(),
            seconds: 0.0,
        };
        let mut times = Vec::new();
        for round in 0..self.rounds {
            // The order alternates.
            for direct in [round % 2 == 0, round % 2 != 0] {
                let watch = Stopwatch::start();
                if direct {
                    if let Direct::Threads(threads) = self.direct {
                        let some = count.div_ceil(u64::from(threads));
                        Direct::Threads(1).grow(&model, seeds(some)).await?;
                        row.one.push(some as f64 / watch.seconds());
                    }
                    let watch = Stopwatch::start();
                    times.extend(self.direct.grow(&model, seeds(count)).await?);
                    row.direct.push(count as f64 / watch.seconds());
                } else {
                    let before = computed(client).await?;
                    load::through(client, &body, seeds(count), asked).await.map_err(plain)?;
                    let seconds = watch.seconds();
                    row.service.push(count as f64 / seconds);
                    row.computing.push((computed(client).await? - before) / (workers * seconds));
                }
            }
        }
        row.seconds = machine::median(times);
        Ok(row)
    }
}

/// Returns the models if all of them succeeded.
fn succeeded(all: Vec<Result<Grown, Lost>>) -> anyhow::Result<Vec<Grown>> {
    let all: Vec<Grown> = all.into_iter().collect::<Result<_, _>>().map_err(|lost| anyhow!(lost.message))?;
    anyhow::ensure!(all.iter().all(|one| one.succeeded), "not all models succeeded");
    Ok(all)
}
