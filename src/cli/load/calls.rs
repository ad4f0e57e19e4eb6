//! The calls of a mix. No error is retried, and every response is checked.

use super::errors::Lost;
use super::known::File;
use super::mix::Call;
use super::plan::Planned;
use super::record::{Outcome, Timed};
use super::target::Target;
use crate::cli::exit::Failure;
use crate::cli::remote::client::{self, ErrorKind, Model};
use crate::cli::remote::sse::Parser;
use anyhow::{Context, anyhow};
use reqwest::{Method, RequestBuilder, Response, header};
use serde::de::DeserializeOwned;
use serde_json::Value;

/// Makes a call and records it. Returns true if the response was valid.
pub(super) async fn make(target: &Target, planned: Planned) -> bool {
    let Planned { at, call, word } = planned;
    let sent = target.watch.elapsed();
    let made = match call {
        Call::Submit => submit(target, target.record.counts(at)).await,
        Call::Get => get(target, word).await,
        Call::List => list(target).await,
        Call::Download => download(target, word).await,
        Call::Events => events(target, word).await,
        Call::Model => unreachable!("a mix has no whole models"),
    };
    let outcome = match made {
        Ok(Some(bytes)) => Outcome::Answered(bytes),
        Ok(None) => Outcome::Skipped,
        Err(lost) => Outcome::Lost(lost),
    };
    let answered = matches!(outcome, Outcome::Answered(_));
    target.record.ended(Timed { call, planned: at, sent, ended: target.watch.elapsed() }, outcome);
    answered
}

/// Returns the bytes of the response; `None` if the call needs a model that the run does not have.
type Made = Result<Option<u64>, Lost>;

/// Sends a request. A response with an error status becomes an error of that status.
async fn send(target: &Target, request: RequestBuilder) -> Result<Response, Lost> {
    let answer = request.timeout(target.timeout).send().await.map_err(Failure::from)?;
    let status = answer.status().as_u16();
    client::accept(answer).await.map_err(|failure| Lost { kind: ErrorKind::Status(status), ..Lost::from(failure) })
}

/// Reads a JSON response and its length.
async fn read<T: DeserializeOwned>(answer: Response) -> Result<(T, u64), Failure> {
    let body = answer.bytes().await?;
    let value = serde_json::from_slice(&body).context("the answer is not what the interface describes")?;
    Ok((value, body.len() as u64))
}

/// Requests a model and adds its id to the models of the run. The model counts if the call counts.
async fn submit(target: &Target, counted: bool) -> Made {
    let Some(seed) = target.seeds.take() else { return Ok(None) };
    let key = uuid::Uuid::now_v7().to_string();
    let request = target.client.request(Method::POST, "/models").header("Idempotency-Key", key);
    let request = request.json(&target.body(seed)).timeout(target.timeout);
    let answer = request.send().await.map_err(Failure::from)?;
    let status = answer.status();
    let answer = match client::accept(answer).await {
        Ok(answer) => answer,
        Err(failure) => {
            if let (Failure::Usage(faults), true, true) = (&failure, status.is_client_error(), target.known.is_empty())
            {
                target.refuse(faults.clone());
            }
            return Err(Lost { kind: ErrorKind::Status(status.as_u16()), ..Lost::from(failure) });
        }
    };
    let (model, bytes): (Model, u64) = read(answer).await?;
    target.known.accept(&model.id, counted);
    Ok(Some(bytes))
}

async fn get(target: &Target, word: u32) -> Made {
    let Some(id) = target.known.any(word) else { return Ok(None) };
    let answer = send(target, target.client.request(Method::GET, &format!("/models/{id}"))).await?;
    let (model, bytes): (Model, u64) = read(answer).await?;
    if *model.id != *id {
        return Err(Failure::from(anyhow!("asked for model {id}, the service answered model {}", model.id)).into());
    }
    if model.is_ended() {
        target.known.end(&id, largest(&model));
    }
    Ok(Some(bytes))
}

/// Returns the largest file of a model.
pub(super) fn largest(model: &Model) -> Option<File> {
    let file = model.files.iter().max_by_key(|file| file.bytes)?;
    Some(File { path: format!("/models/{}/files/{}", model.id, file.name), bytes: file.bytes })
}

async fn list(target: &Target) -> Made {
    let answer = send(target, target.client.request(Method::GET, "/models")).await?;
    let (page, bytes): (Value, u64) = read(answer).await?;
    match page["models"].as_array() {
        Some(_) => Ok(Some(bytes)),
        None => Err(Failure::from(anyhow!("the service answered a list without `models`")).into()),
    }
}

async fn download(target: &Target, word: u32) -> Made {
    let Some(file) = target.known.file(word) else { return Ok(None) };
    let mut answer = send(target, target.client.request(Method::GET, &file.path)).await?;
    let mut bytes = 0;
    while let Some(piece) = answer.chunk().await.map_err(Failure::from)? {
        bytes += piece.len() as u64;
    }
    if bytes != file.bytes {
        let said = anyhow!("{} has {bytes} bytes; its model says {}", file.path, file.bytes);
        return Err(Failure::from(said).into());
    }
    Ok(Some(bytes))
}

/// Opens an event stream and closes it after the first event.
async fn events(target: &Target, word: u32) -> Made {
    let Some(id) = target.known.any(word) else { return Ok(None) };
    let request = target.client.request(Method::GET, &format!("/models/{id}/events"));
    let mut answer = send(target, request.header(header::ACCEPT, "text/event-stream")).await?;
    let (mut parser, mut bytes) = (Parser::default(), 0);
    while let Some(piece) = answer.chunk().await.map_err(Failure::from)? {
        bytes += piece.len() as u64;
        if !parser.feed(&piece).is_empty() {
            return Ok(Some(bytes));
        }
    }
    Err(Failure::from(anyhow!("the event stream of model {id} ended without an event")).into())
}
