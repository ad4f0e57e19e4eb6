//! `oviduct demo`: starts a service, requests a model over HTTP and saves it. All files are in
//! `./demo`.

use super::client::Client;
use super::submit;
use crate::cli::args::{DemoArgs, ServeArgs};
use crate::cli::exit::{Ended, Failure};
use crate::cli::interrupt::Signals;
use crate::cli::service::{Service, connections};
use crate::cli::{term, units};
use anyhow::{Context, anyhow};
use serde_json::{Value, json};
use std::net::Ipv4Addr;
use std::path::Path;
use std::time::Duration;
use tokio::net::TcpListener;

/// Directory for all files.
const FOLDER: &str = "demo";
/// First port to try.
const PORT: u16 = 8080;
/// Number of consecutive ports to try before a random free one.
const PORTS: u16 = 20;

pub(in crate::cli) async fn run(args: DemoArgs) -> Ended {
    let mut body = submit::request(&args.model)?;
    body["labels"] = json!({ "made-by": "demo" });

    let mut serve = ServeArgs::with(&[]).context("the defaults are not valid")?;
    serve.process.database.data = Path::new(FOLDER).join("data");
    // When the demo stops, no other model is running.
    serve.process.grace = Duration::ZERO;
    let mut signals = Signals::listen();
    let mut service = Service::start(&serve, listen()?, None).await?;
    let url = format!("http://{}", service.address());
    let shown = tokio::select! {
        shown = show(&url, &body, &args) => shown,
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

/// Listens on the first free port from 8080 on, or on a random free port.
fn listen() -> anyhow::Result<TcpListener> {
    for port in PORT..PORT + PORTS {
        if let Ok(listener) = connections::listen((Ipv4Addr::LOCALHOST, port).into()) {
            return Ok(listener);
        }
    }
    connections::listen((Ipv4Addr::LOCALHOST, 0).into()).context("no port is free")
}

/// Requests the model, follows it, saves it and checks its certificate.
async fn show(url: &str, body: &Value, args: &DemoArgs) -> Ended {
    let client = Client::new(url, None)?;
    client.check_folder(body, Path::new(FOLDER), args.force).await?;
    let accepted = client.submit(body, &uuid::Uuid::now_v7().to_string()).await?;
    let id = submit::read(&accepted)?.id;
    term::print(&format!(
        "requested from {url}/models: preset {}, seed {}, model {id}",
        text(&body["preset"]),
        body["seed"]
    ))?;
    let ended = submit::wait(&client, accepted).await?;
    let model = submit::read(&ended)?;
    if model.status != "succeeded" {
        return Err(anyhow!(model.why()).into());
    }
    for path in client.download(&model, Path::new(FOLDER), args.force).await? {
        let bytes = std::fs::metadata(&path).map_or(0, |found| found.len());
        term::print(&format!("{}  {}", path.display(), units::show_bytes(bytes)))?;
    }
    let report: Value = client.get(&format!("/models/{id}/report")).await?.json().await?;
    let proof = &report["certificate"];
    if proof["passed"] != json!(true) {
        return Err(anyhow!("the model is not certified: {proof}").into());
    }
    submit::warn(&model.warnings);
    let summary = &ended["summary"];
    term::print(&format!(
        "certified: {} sections, {} vertices, {} triangles, closed, oriented, Euler number {}, no triangles intersect",
        summary["sections"], summary["vertices"], summary["triangles"], proof["euler"],
    ))?;
    if !args.exit {
        term::print(&format!("the model: {url}/models/{id}"))?;
    }
    Ok(())
}

fn text(value: &Value) -> &str {
    value.as_str().unwrap_or_default()
}
