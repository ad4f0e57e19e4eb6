//! Talks to a service: submits a model, follows its events, fetches its files.

use super::exit::Failure;
use super::scratch::Scratch;
use super::sse::{Event, Parser};
use anyhow::{Context, anyhow};
use reqwest::{Response, StatusCode, header};
use serde::Deserialize;
use serde_json::Value;
use sha2::{Digest, Sha256};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// The server sends at least a comment every 15 seconds; a stream that is silent for longer than this is dead.
const SILENCE: Duration = Duration::from_secs(45);
/// Tries to reach a server that went away, one after the other, before giving up (about a minute).
const TRIES: u32 = 16;

/// What is read of a model here; the rest is passed on untouched.
#[derive(Clone, Debug, Deserialize)]
pub(super) struct Model {
    /// Identity.
    pub(super) id: String,
    /// `queued`, `running`, `succeeded`, `failed`, `cancelled`.
    pub(super) status: String,
    #[serde(default)]
    pub(super) queue: Option<Queue>,
    #[serde(default)]
    pub(super) progress: Option<Progress>,
    #[serde(default)]
    pub(super) files: Vec<RemoteFile>,
    #[serde(default)]
    pub(super) problem: Option<Problem>,
}

impl Model {
    /// Whether it can still change.
    pub(super) fn is_ended(&self) -> bool {
        !matches!(self.status.as_str(), "queued" | "running")
    }

    /// Why it ended without files, in words.
    pub(super) fn why(&self) -> String {
        match &self.problem {
            Some(problem) => format!("the model ended {}: {}", self.status, problem.text()),
            None => format!("the model ended {}", self.status),
        }
    }
}

/// Place in the queue.
#[derive(Clone, Debug, Deserialize)]
pub(super) struct Queue {
    pub(super) position: Option<u64>,
}

/// How far it is.
#[derive(Clone, Debug, Deserialize)]
pub(super) struct Progress {
    pub(super) stage: String,
    pub(super) fraction: f64,
    pub(super) step: u64,
    pub(super) steps: u64,
    pub(super) particles: u64,
}

/// A file to be fetched.
#[derive(Clone, Debug, Deserialize)]
pub(super) struct RemoteFile {
    pub(super) name: String,
    pub(super) bytes: u64,
    pub(super) sha256: String,
    pub(super) href: String,
}

/// A problem of RFC 9457.
#[derive(Clone, Debug, Default, Deserialize)]
pub(super) struct Problem {
    #[serde(default)]
    title: String,
    #[serde(default)]
    detail: String,
    #[serde(default)]
    errors: Vec<Fault>,
}

/// A fault of the request.
#[derive(Clone, Debug, Deserialize)]
struct Fault {
    pointer: Option<String>,
    header: Option<String>,
    detail: String,
}

impl std::fmt::Display for Fault {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.pointer.as_ref().or(self.header.as_ref()) {
            Some(place) if !place.is_empty() => write!(f, "{place}: {}", self.detail),
            _ => self.detail.fmt(f),
        }
    }
}

impl Problem {
    fn text(&self) -> String {
        match (self.title.is_empty(), self.detail.is_empty()) {
            (false, false) => format!("{}: {}", self.title, self.detail),
            (true, _) => self.detail.clone(),
            (_, true) => self.title.clone(),
        }
    }
}

/// A connection to a service.
#[derive(Clone, Debug)]
pub(super) struct Client {
    http: reqwest::Client,
    base: String,
}

impl Client {
    /// A client of the service at `url`.
    ///
    /// # Errors
    /// [`Failure::Usage`] where that is no `http:` or `https:` address.
    pub(super) fn new(url: &str) -> Result<Self, Failure> {
        let parsed = reqwest::Url::parse(url).map_err(|e| Failure::usage(format!("--url {url}: {e}")))?;
        if !matches!(parsed.scheme(), "http" | "https") || !parsed.has_host() {
            return Err(Failure::usage(format!("--url {url}: must begin with http:// or https:// and name a host")));
        }
        crate::tls::install();
        let http = reqwest::Client::builder().connect_timeout(Duration::from_secs(10)).build()?;
        Ok(Self { http, base: url.trim_end_matches('/').to_owned() })
    }

    /// Address of something in the service.
    pub(super) fn address(&self, path: &str) -> String {
        format!("{}{path}", self.base)
    }

    /// Gets something small.
    ///
    /// # Errors
    /// Where the service is away or refuses.
    pub(super) async fn get(&self, path: &str) -> Result<Response, Failure> {
        let answer = self.http.get(self.address(path)).timeout(Duration::from_secs(30)).send().await;
        accept(answer.with_context(|| format!("GET {}", self.address(path)))?).await
    }

    /// Asks for a model.
    ///
    /// # Errors
    /// [`Failure::Usage`] with each fault where the request is invalid; else where the service is away or refuses.
    pub(super) async fn submit(&self, body: &Value, idempotency_key: &str) -> Result<Value, Failure> {
        let address = self.address("/models");
        let request = self.http.post(&address).header("Idempotency-Key", idempotency_key).json(body);
        let answer = request.timeout(Duration::from_secs(60)).send().await;
        Ok(accept(answer.with_context(|| format!("POST {address}"))?).await?.json().await?)
    }

    /// Asks for a model, again and again while the queue is full. Also gives how often it was.
    ///
    /// # Errors
    /// As [`Client::submit`].
    pub(super) async fn submit_patiently(&self, body: &Value, key: &str) -> Result<(Value, u64), Failure> {
        let address = self.address("/models");
        let mut refused = 0;
        loop {
            let request = self.http.post(&address).header("Idempotency-Key", key).json(body);
            let answer = request.timeout(Duration::from_secs(60)).send().await;
            let answer = answer.with_context(|| format!("POST {address}"))?;
            if answer.status() != StatusCode::TOO_MANY_REQUESTS {
                return Ok((accept(answer).await?.json().await?, refused));
            }
            refused += 1;
            let seconds = answer.headers().get(header::RETRY_AFTER).and_then(|v| v.to_str().ok()?.parse().ok());
            tokio::time::sleep(Duration::from_secs(seconds.unwrap_or(1))).await;
        }
    }

    /// Waits until a model has ended, without its progress.
    ///
    /// # Errors
    /// Where the service stays away or the model is deleted.
    pub(super) async fn wait_for(&self, id: &str) -> Result<Value, Failure> {
        self.follow(id, |_| {}).await?;
        self.model(id).await
    }

    /// Gets a model.
    ///
    /// # Errors
    /// Where the service is away or knows no such model.
    pub(super) async fn model(&self, id: &str) -> Result<Value, Failure> {
        Ok(self.get(&format!("/models/{id}")).await?.json().await?)
    }

    /// Follows the events of a model until it ends; comes back after an interruption where it left off.
    ///
    /// # Errors
    /// Where the model is deleted, or the service stays away.
    pub(super) async fn follow(&self, id: &str, mut seen: impl FnMut(Followed<'_>)) -> Result<(), Failure> {
        let mut last_id: Option<String> = None;
        let mut tries = 0;
        loop {
            match self.follow_once(id, &mut last_id, &mut tries, &mut seen).await {
                Ok(Some(status)) if status == "deleted" => return Err(anyhow!("the model was deleted").into()),
                Ok(Some(_)) => return Ok(()),
                Ok(None) => {}
                Err(Failure::Failed(error)) if tries < TRIES && error.is::<Lost>() => {}
                Err(failure) => return Err(failure),
            }
            tries += 1;
            seen(Followed::Away);
            tokio::time::sleep(Duration::from_millis(500 * u64::from(tries.min(10)))).await;
        }
    }

    /// One connection; gives the status of the `end` event, or none where the stream broke off before.
    async fn follow_once(
        &self,
        id: &str,
        last_id: &mut Option<String>,
        tries: &mut u32,
        seen: &mut impl FnMut(Followed<'_>),
    ) -> Result<Option<String>, Failure> {
        let mut request = self.http.get(self.address(&format!("/models/{id}/events")));
        request = request.header(header::ACCEPT, "text/event-stream");
        if let Some(last) = last_id.as_deref() {
            request = request.header("Last-Event-ID", last);
        }
        let answer = tokio::time::timeout(SILENCE, request.send()).await.map_err(|_| Lost)?;
        let answer = answer.map_err(|error| anyhow!(error).context(Lost))?;
        if answer.status().is_server_error() {
            return Err(anyhow!("the service answered {}", answer.status()).context(Lost).into());
        }
        let mut answer = accept(answer).await?;
        let mut parser = Parser::default();
        loop {
            let piece = match tokio::time::timeout(SILENCE, answer.chunk()).await {
                Ok(Ok(Some(piece))) => piece,
                Ok(Ok(None) | Err(_)) | Err(_) => return Ok(None),
            };
            for event in parser.feed(&piece) {
                *tries = 0;
                if event.id.is_some() {
                    last_id.clone_from(&event.id);
                }
                if let Some(status) = self.take(&event, seen)? {
                    return Ok(Some(status));
                }
            }
        }
    }

    /// Hands an event on; gives the status where it is the last one.
    fn take(&self, event: &Event, seen: &mut impl FnMut(Followed<'_>)) -> Result<Option<String>, Failure> {
        match event.kind.as_str() {
            "status" | "progress" => {
                let model: Model = serde_json::from_str(&event.data).context("an event is no model")?;
                seen(Followed::Model(&model));
                Ok(None)
            }
            "end" => {
                #[derive(Deserialize)]
                struct End {
                    status: String,
                }
                let end: End = serde_json::from_str(&event.data).context("the last event has no status")?;
                Ok(Some(end.status))
            }
            _ => Ok(None),
        }
    }

    /// Saves all files of a model in `dir`, each of them proven by its SHA-256.
    ///
    /// # Errors
    /// Where a file cannot be fetched or written, or is not what was announced.
    pub(super) async fn download(&self, model: &Model, dir: &Path) -> Result<Vec<PathBuf>, Failure> {
        let scratch = Scratch::new(dir).with_context(|| format!("{}", dir.display()))?;
        for file in &model.files {
            self.fetch(file, scratch.dir()).await?;
        }
        let publish = |file: &RemoteFile| scratch.publish(&file.name).with_context(|| file.name.clone());
        Ok(model.files.iter().map(publish).collect::<anyhow::Result<_>>()?)
    }

    async fn fetch(&self, file: &RemoteFile, dir: &Path) -> Result<(), Failure> {
        let name = file.name.as_str();
        if name.starts_with('.') || Path::new(name).file_name() != Some(name.as_ref()) {
            return Err(anyhow!("the service named a file `{name}`, which is no file name").into());
        }
        let answer = self.http.get(self.address(&file.href)).send().await;
        let mut answer = accept(answer.with_context(|| format!("GET {}", file.href))?).await?;
        let mut out = std::fs::File::create(dir.join(name)).with_context(|| name.to_owned())?;
        let (mut hash, mut bytes) = (Sha256::new(), 0);
        while let Some(piece) = answer.chunk().await.with_context(|| format!("fetching {name}"))? {
            hash.update(&piece);
            bytes += piece.len() as u64;
            out.write_all(&piece).with_context(|| name.to_owned())?;
        }
        out.sync_all().with_context(|| name.to_owned())?;
        if bytes != file.bytes || hex::encode(hash.finalize()) != file.sha256 {
            return Err(anyhow!("{name} is not the file that was announced ({bytes} of {} bytes)", file.bytes).into());
        }
        Ok(())
    }
}

/// What happens while following a model.
#[derive(Debug)]
pub(super) enum Followed<'a> {
    /// It stands here.
    Model(&'a Model),
    /// The service is away; it is tried again.
    Away,
}

/// The connection was lost, and is worth another try.
#[derive(Debug, thiserror::Error)]
#[error("the connection to the service was lost")]
struct Lost;

/// Passes a good answer on; turns a problem into a failure.
async fn accept(answer: Response) -> Result<Response, Failure> {
    let status = answer.status();
    if status.is_success() {
        return Ok(answer);
    }
    let problem: Problem = answer.json().await.unwrap_or_default();
    Err(refusal(status, &problem))
}

fn refusal(status: StatusCode, problem: &Problem) -> Failure {
    let text = problem.text();
    if problem.errors.is_empty() {
        return anyhow!("the service answered {status}{}{text}", if text.is_empty() { "" } else { ": " }).into();
    }
    Failure::Usage(problem.errors.iter().map(Fault::to_string).collect())
}

#[cfg(test)]
mod tests;
