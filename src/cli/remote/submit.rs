//! `oviduct submit`: requests a model from a service, and waits for it and saves it with options.

use super::client::{Client, Followed, Model, Warning};
use crate::cli::args::{ModelArgs, SubmitArgs};
use crate::cli::exit::{Ended, Failure};
use crate::cli::{interrupt, model, term};
use anyhow::Context;
use serde::Deserialize;
use serde_json::{Map, Value, json};

pub(in crate::cli) async fn run(args: SubmitArgs) -> Ended {
    let client = Client::new(&args.service.url, args.service.key.as_ref())?;
    let mut body = request(&args.model)?;
    if !args.label.is_empty() {
        body["labels"] = labels(&args.label)?;
    }
    if args.priority != 0 {
        body["priority"] = json!(args.priority);
    }
    if args.no_reuse {
        body["reuse"] = json!(false);
    }
    if let Some(dir) = args.out.as_ref().filter(|dir| dir.exists()) {
        client.check_folder(&body, dir, args.force).await?;
    }
    let key = args.idempotency_key.clone().unwrap_or_else(|| uuid::Uuid::now_v7().to_string());
    let accepted = client.submit(&body, &key).await?;
    let id = read(&accepted)?.id;
    if !args.wait && args.out.is_none() {
        if args.json {
            term::print_json(&accepted)?;
        } else {
            term::print(&id)?;
        }
        return Ok(());
    }
    let ended = tokio::select! {
        ended = wait(&client, accepted) => ended?,
        () = interrupt::asked_to_stop() => {
            term::note(&format!("the model continues at {}", client.address(&format!("/models/{id}"))));
            return Err(Failure::Interrupted);
        }
    };
    let finished = read(&ended)?;
    if args.json {
        term::print_json(&ended)?;
    } else {
        term::print(&format!("{} {}", finished.id, finished.status))?;
    }
    warn(&finished.warnings);
    if finished.status != "succeeded" {
        return Err(anyhow::anyhow!(finished.why()).into());
    }
    if let Some(dir) = &args.out {
        let saved = tokio::select! {
            saved = client.download(&finished, dir, args.force) => saved?,
            () = interrupt::asked_to_stop() => return Err(Failure::Interrupted),
        };
        for path in saved.iter().filter(|_| !args.json) {
            term::print(&path.display().to_string())?;
        }
    }
    Ok(())
}

/// Returns the body of a request for the model that the options describe.
pub(in crate::cli) fn request(args: &ModelArgs) -> Result<Value, Failure> {
    let mut body = json!({
        "preset": args.of.preset, "spec": model::patch(&args.of)?, "outputs": args.outputs().formats,
        "bodies": args.outputs().bodies, "units": args.outputs().units, "backend": args.backend,
    });
    if let Some(seed) = args.of.seed {
        body["seed"] = json!(seed);
    }
    Ok(body)
}

fn labels(labels: &[String]) -> Result<Value, Failure> {
    let mut map = Map::new();
    for label in labels {
        let (name, value) =
            label.split_once(':').ok_or_else(|| Failure::usage(format!("--label {label}: must be NAME:VALUE")))?;
        map.insert(name.to_owned(), value.into());
    }
    Ok(Value::Object(map))
}

/// Reads a model from its JSON.
///
/// # Errors
/// If a required member is missing.
pub(in crate::cli) fn read(value: &Value) -> Result<Model, Failure> {
    Ok(Model::deserialize(value).context("the service's answer is not a model")?)
}

/// Prints warnings to stderr.
pub(in crate::cli) fn warn(warnings: &[Warning]) {
    for warning in warnings {
        term::note(&format!("warning: {}", warning.detail));
    }
}

/// Follows a model to its end, shows its progress and returns the ended model.
pub(in crate::cli) async fn wait(client: &Client, accepted: Value) -> Result<Value, Failure> {
    let model = read(&accepted)?;
    if model.is_ended() {
        return Ok(accepted);
    }
    let bar = term::Bar::on_stderr();
    let followed = client
        .follow(&model.id, |followed| match followed {
            Followed::Disconnected => bar.remark("the connection to the service was lost; retrying"),
            Followed::Model(model) => show(&bar, model),
        })
        .await;
    bar.clear();
    followed?;
    client.model(&model.id).await
}

fn show(bar: &term::Bar, model: &Model) {
    match &model.progress {
        Some(p) => {
            let message = format!("step {} of {}, {} particles", p.step, p.steps, p.particles);
            bar.show(&p.stage, p.fraction, message);
        }
        None => {
            let position = model.queue.as_ref().and_then(|queue| queue.position);
            let message = position.map_or_else(String::new, |n| format!("{n} models ahead in the queue"));
            bar.show(&model.status, 0.0, message);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_are_pairs() {
        let given = ["study:A3".to_owned(), "at:10:30".to_owned()];
        assert_eq!(labels(&given).expect("good"), json!({ "study": "A3", "at": "10:30" }));
        assert!(labels(&["x".to_owned()]).is_err());
    }
}
