//! `oviduct demo`: the whole way of a request in one command, over real HTTP, with all that it makes in `./demo`.

use super::args::{DemoArgs, ServiceArgs};
use super::client::Client;
use super::exit::{Ended, Failure};
use super::interrupt::Signals;
use super::service::Service;
use super::{submit, term, units};
use anyhow::{Context, anyhow};
use clap::Parser;
use serde_json::{Value, json};
use std::path::Path;
use std::time::Duration;
use tokio::net::TcpListener;

/// Where everything is kept.
const FOLDER: &str = "demo";
/// The port that is tried first.
const PORT: u16 = 8080;
/// How many ports are tried before any free one is taken.
const PORTS: u16 = 20;
/// The seed of the pictures in the README.
const SEED: u64 = 7;

/// The defaults of a service, read from where they are defined.
#[derive(Debug, Parser)]
struct Defaults {
    #[command(flatten)]
    service: ServiceArgs,
}

pub(super) async fn run(mut args: DemoArgs) -> Ended {
    args.model.seed.get_or_insert(SEED);
    let mut body = submit::request(&args.model)?;
    body["labels"] = json!({ "made-by": "demo" });

    let mut service = Defaults::try_parse_from(["oviduct"]).context("the defaults are not valid")?.service;
    service.database.data = Path::new(FOLDER).join("data");
    // Once the model is there, or no longer wanted, nothing is worth waiting for but the last answers.
    service.grace = Duration::ZERO;
    let mut signals = Signals::listen();
    let mut service = Service::start(&service, listen().await?).await?;
    let url = format!("http://{}", service.address());
    let shown = tokio::select! {
        shown = show(&url, &body, args.exit) => shown,
        failed = service.failed() => return service.stop(Some(failed)).await,
        () = signals.asked_to_stop() => Err(Failure::Interrupted),
    };
    if shown.is_ok() && !args.exit {
        term::print(&format!("serving on {url}/ until Ctrl-C"))?;
        tokio::select! {
            failed = service.failed() => return service.stop(Some(failed)).await,
            () = signals.asked_to_stop() => {}
        }
    }
    tokio::select! {
        stopped = service.stop(None) => shown.and(stopped),
        () = signals.asked_to_stop() => Err(Failure::Interrupted),
    }
}

/// Port 8080, or one of the next, or any that is free.
async fn listen() -> anyhow::Result<TcpListener> {
    for port in PORT..PORT + PORTS {
        if let Ok(listener) = TcpListener::bind(("127.0.0.1", port)).await {
            return Ok(listener);
        }
    }
    TcpListener::bind(("127.0.0.1", 0)).await.context("no port is free")
}

/// Asks for the model, follows it, saves it, and reads its proof.
async fn show(url: &str, body: &Value, last: bool) -> Ended {
    let client = Client::new(url)?;
    let accepted = client.submit(body, &uuid::Uuid::now_v7().to_string()).await?;
    let id = submit::read(&accepted)?.id;
    term::print(&format!("asked {url}/models for a {} of seed {}: {id}", text(&body["preset"]), body["seed"]))?;
    let ended = submit::wait(&client, accepted).await?;
    let model = submit::read(&ended)?;
    if model.status != "succeeded" {
        return Err(anyhow!(model.why()).into());
    }
    for path in client.download(&model, Path::new(FOLDER)).await? {
        let bytes = std::fs::metadata(&path).map_or(0, |found| found.len());
        term::print(&format!("{}  {}", path.display(), units::show_bytes(bytes)))?;
    }
    let report: Value = client.get(&format!("/models/{id}/report")).await?.json().await?;
    let proof = &report["certificate"];
    if proof["passed"] != json!(true) {
        return Err(anyhow!("the model has no certificate: {proof}").into());
    }
    let summary = &ended["summary"];
    term::print(&format!(
        "certified: {} sections, {} vertices, {} triangles, closed, oriented, Euler number {}, no triangles meet",
        summary["sections"], summary["vertices"], summary["triangles"], proof["euler"],
    ))?;
    if !last {
        term::print(&format!("the model: {url}/models/{id}"))?;
    }
    Ok(())
}

fn text(value: &Value) -> &str {
    value.as_str().unwrap_or_default()
}
