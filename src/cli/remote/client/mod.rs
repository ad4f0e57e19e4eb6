//! HTTP client of a service: submits a model, follows its events, downloads its files.

mod wire;

pub(in crate::cli) use wire::{Model, RemoteFile, Warning};

use crate::cli::exit::Failure;
use crate::cli::local::folder::{self, Folder};
use crate::cli::remote::secret::Key;
use crate::cli::remote::sse::{Event, Parser};
use crate::cli::scratch::Scratch;
use crate::clock::Stopwatch;
use crate::generate::MANIFEST;
use anyhow::{Context, anyhow};
use reqwest::{Method, RequestBuilder, Response, StatusCode, header};
use serde::Deserialize;
use serde_json::Value;
use sha2::{Digest, Sha256};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::time::Duration;
use wire::{Fault, Problem};

/// Maximum silence of an event stream; the service sends at least a comment every 15 seconds.
const SILENCE: Duration = Duration::from_secs(45);
/// Time after which an open stream that sent anything counts as a response, even without an event:
/// a model may wait in the queue for hours behind a proxy that cuts connections.
const ALIVE: Duration = Duration::from_secs(10);

/// Limits of retries while a model is followed.
#[derive(Clone, Copy, Debug)]
struct Retries {
    /// Consecutive connections without a new event before giving up.
    most: u32,
    /// Wait after the first connection. It grows by the same time after each further one, up to
    /// tenfold.
    wait: Duration,
}

impl Default for Retries {
    /// About a minute in total.
    fn default() -> Self {
        Self { most: 16, wait: Duration::from_millis(500) }
    }
}

/// HTTP client of a service at an address.
#[derive(Clone, Debug)]
pub struct Client {
    http: reqwest::Client,
    base: String,
    retries: Retries,
}

/// Event while a model is followed.
#[derive(Debug)]
pub(in crate::cli) enum Followed<'a> {
    /// The model changed.
    Model(&'a Model),
    /// The connection was lost; another one is opened.
    Disconnected,
}

/// Failures that [`ErrorKind`] distinguishes.
#[derive(Debug, thiserror::Error)]
enum ServiceError {
    /// A response with an error status.
    #[error("the service answered {status}{}{text}", if .text.is_empty() { "" } else { ": " })]
    Refused { status: StatusCode, text: String },
    /// Nothing was received in time.
    #[error("nothing was received for {} s", SILENCE.as_secs())]
    Silent,
    /// The event stream ended without an `end` event.
    #[error("the event stream was closed before the model ended")]
    CutOff,
}

/// Kinds of errors that a report distinguishes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(in crate::cli) enum ErrorKind {
    /// A response with this status.
    Status(u16),
    /// No connection, or a lost connection.
    Connection,
    /// No response in time.
    Timeout,
    /// Anything else, such as a response that does not match the description of the interface.
    Other,
}

impl ErrorKind {
    /// Returns the kind of a failure of a [`Client`].
    pub(in crate::cli) fn of(failure: &Failure) -> Self {
        let Failure::Failed(error) = failure else { return Self::Other };
        match error.downcast_ref() {
            Some(ServiceError::Refused { status, .. }) => return Self::Status(status.as_u16()),
            Some(ServiceError::Silent) => return Self::Timeout,
            Some(ServiceError::CutOff) => return Self::Connection,
            None => {}
        }
        match error.chain().find_map(|cause| cause.downcast_ref::<reqwest::Error>()) {
            Some(error) if error.is_timeout() => Self::Timeout,
            // A body that breaks off is an error of decoding, but not of JSON.
            Some(sent)
                if !sent.is_builder() && !error.chain().any(<dyn std::error::Error>::is::<serde_json::Error>) =>
            {
                Self::Connection
            }
            _ => Self::Other,
        }
    }
}

/// Failure of an event stream before the end of the model.
enum Interruption {
    /// Another connection may work.
    Retry(anyhow::Error),
    /// Another connection would not work.
    Fatal(Failure),
}

impl From<Failure> for Interruption {
    fn from(failure: Failure) -> Self {
        Self::Fatal(failure)
    }
}

/// Position in the events of a model, across connections.
#[derive(Debug, Default)]
struct Cursor {
    last_id: Option<String>,
    /// Consecutive connections without a new event.
    tries: u32,
}

impl Client {
    /// Creates a client of the service at `url` that sends this key with each request.
    ///
    /// # Errors
    /// [`Failure::Usage`] if `url` is not an `http:` or `https:` URL or the key cannot be part of a
    /// header.
    pub fn new(url: &str, key: Option<&Key>) -> Result<Self, Failure> {
        let parsed = reqwest::Url::parse(url).map_err(|e| Failure::usage(format!("--url {url}: {e}")))?;
        if !matches!(parsed.scheme(), "http" | "https") || !parsed.has_host() {
            return Err(Failure::usage(format!("--url {url}: must start with http:// or https:// and name a host")));
        }
        let key = key.map(Key::authorization).transpose()?;
        let headers = key.map(|value| (header::AUTHORIZATION, value)).into_iter().collect();
        crate::tls::install();
        let builder = reqwest::Client::builder().connect_timeout(Duration::from_secs(10)).default_headers(headers);
        let http = builder.build()?;
        Ok(Self { http, base: url.trim_end_matches('/').to_owned(), retries: Retries::default() })
    }

    /// Returns the URL of a path on the service.
    pub(in crate::cli) fn address(&self, path: &str) -> String {
        format!("{}{path}", self.base)
    }

    /// Builds a request for a path of the service.
    pub(in crate::cli) fn request(&self, method: Method, path: &str) -> RequestBuilder {
        self.http.request(method, self.address(path))
    }

    /// Gets a small resource.
    ///
    /// # Errors
    /// [`Failure::Failed`] if the service is unavailable or responds with an error.
    pub async fn get(&self, path: &str) -> Result<Response, Failure> {
        let answer = self.http.get(self.address(path)).timeout(Duration::from_secs(30)).send().await;
        accept(answer.with_context(|| format!("GET {}", self.address(path)))?).await
    }

    /// Posts without a body to the path with these segments, which are percent-encoded.
    ///
    /// # Errors
    /// [`Failure::Failed`] if the service is unavailable or responds with an error.
    pub(in crate::cli) async fn post(&self, path: &[&str]) -> Result<Response, Failure> {
        let mut url = reqwest::Url::parse(&self.base)?;
        url.path_segments_mut().map_err(|()| anyhow!("{} has no path", self.base))?.pop_if_empty().extend(path);
        let answer = self.http.post(url.clone()).timeout(Duration::from_secs(30)).send().await;
        accept(answer.with_context(|| format!("POST {url}"))?).await
    }

    /// Requests a model.
    ///
    /// # Errors
    /// [`Failure::Usage`] with each fault if the request is invalid; [`Failure::Failed`] if the
    /// service is unavailable or refuses it.
    pub(in crate::cli) async fn submit(&self, body: &Value, idempotency_key: &str) -> Result<Value, Failure> {
        model_of(accept(self.post_model(body, idempotency_key).await?).await?).await
    }

    /// Checks that a folder may receive the files of the model that a request describes, so that no
    /// model is grown in vain. Without a seed, the model is another one than any in the folder.
    ///
    /// # Errors
    /// - [`Failure::Usage`] if `dir` has files of another model and `force` is false.
    /// - As [`Client::submit`].
    pub(in crate::cli) async fn check_folder(&self, body: &Value, dir: &Path, force: bool) -> Result<(), Failure> {
        let address = self.address("/models/validate");
        let request = self.http.post(&address).json(body).timeout(Duration::from_secs(60));
        let answer = request.send().await.with_context(|| format!("POST {address}"))?;
        let valid = model_of(accept(answer).await?).await?;
        Folder::open(dir, valid["digest"].as_str().unwrap_or_default(), force).map(drop)
    }

    /// Requests a model, and retries while the queue is full. Also returns the number of responses
    /// 429.
    ///
    /// # Errors
    /// As [`Client::submit`].
    pub(in crate::cli) async fn submit_patiently(&self, body: &Value, key: &str) -> Result<(Value, u64), Failure> {
        let mut refused = 0;
        loop {
            let answer = self.post_model(body, key).await?;
            if answer.status() != StatusCode::TOO_MANY_REQUESTS {
                return Ok((model_of(accept(answer).await?).await?, refused));
            }
            refused += 1;
            let seconds = answer.headers().get(header::RETRY_AFTER).and_then(|v| v.to_str().ok()?.parse().ok());
            tokio::time::sleep(Duration::from_secs(seconds.unwrap_or(1))).await;
        }
    }

    async fn post_model(&self, body: &Value, idempotency_key: &str) -> anyhow::Result<Response> {
        let address = self.address("/models");
        let request = self.http.post(&address).header("Idempotency-Key", idempotency_key).json(body);
        request.timeout(Duration::from_secs(60)).send().await.with_context(|| format!("POST {address}"))
    }

    /// Waits until a model has ended, and gets it.
    ///
    /// # Errors
    /// As [`Client::follow`] and [`Client::model`].
    pub(in crate::cli) async fn wait_for(&self, id: &str) -> Result<Value, Failure> {
        self.follow(id, |_| {}).await?;
        self.model(id).await
    }

    /// Gets a model.
    ///
    /// # Errors
    /// [`Failure::Failed`] if the service is unavailable or has no such model.
    pub(in crate::cli) async fn model(&self, id: &str) -> Result<Value, Failure> {
        model_of(self.get(&format!("/models/{id}")).await?).await
    }

    /// Follows the events of a model until it ends. A lost connection is reopened with
    /// `Last-Event-ID`, so that no event is seen twice.
    ///
    /// # Errors
    /// [`Failure::Failed`] if the model is deleted, the service refuses, or a minute of further
    /// connections brings no new event.
    pub(in crate::cli) async fn follow(&self, id: &str, mut seen: impl FnMut(Followed<'_>)) -> Result<(), Failure> {
        let mut cursor = Cursor::default();
        loop {
            let error = match self.follow_once(id, &mut cursor, &mut seen).await {
                Ok(()) => return Ok(()),
                Err(Interruption::Fatal(failure)) => return Err(failure),
                Err(Interruption::Retry(error)) => error,
            };
            cursor.tries += 1;
            if cursor.tries > self.retries.most {
                let told = format!("no new event of model {id} after {} connections to {}", cursor.tries, self.base);
                return Err(error.context(told).into());
            }
            seen(Followed::Disconnected);
            tokio::time::sleep(self.retries.wait * cursor.tries.min(10)).await;
        }
    }

    /// Reads one event stream to its end.
    async fn follow_once(
        &self,
        id: &str,
        cursor: &mut Cursor,
        seen: &mut impl FnMut(Followed<'_>),
    ) -> Result<(), Interruption> {
        let mut request = self.http.get(self.address(&format!("/models/{id}/events")));
        request = request.header(header::ACCEPT, "text/event-stream");
        if let Some(last) = cursor.last_id.as_deref() {
            request = request.header("Last-Event-ID", last);
        }
        let mut answer = open(request).await?;
        // The model ended with the last event that was seen.
        if answer.status() == StatusCode::NO_CONTENT {
            return Ok(());
        }
        let opened = Stopwatch::start();
        let mut parser = Parser::default();
        loop {
            let piece = match tokio::time::timeout(SILENCE, answer.chunk()).await {
                Ok(Ok(Some(piece))) => piece,
                Ok(Ok(None)) => return Err(Interruption::Retry(ServiceError::CutOff.into())),
                Ok(Err(error)) => return Err(Interruption::Retry(anyhow!(error).context(ServiceError::CutOff))),
                Err(_) => return Err(Interruption::Retry(ServiceError::Silent.into())),
            };
            if opened.elapsed() >= ALIVE {
                cursor.tries = 0;
            }
            for event in parser.feed(&piece) {
                if event.id.is_some() && event.id != cursor.last_id {
                    cursor.last_id.clone_from(&event.id);
                    cursor.tries = 0;
                }
                if is_end(&event, seen)? {
                    return Ok(());
                }
            }
        }
    }

    /// Saves all files of a model and its manifest in `dir`, after comparing each file with its
    /// SHA-256. With `force`, the files of another model in `dir` are replaced.
    ///
    /// # Errors
    /// - [`Failure::Usage`] if `dir` has files of another model and `force` is false.
    /// - [`Failure::Failed`] if a file cannot be downloaded or written, or differs from its
    ///   SHA-256.
    ///
    /// `dir` is unchanged until all files are downloaded.
    pub(in crate::cli) async fn download(
        &self,
        model: &Model,
        dir: &Path,
        force: bool,
    ) -> Result<Vec<PathBuf>, Failure> {
        let manifest = self.get(&format!("/models/{}/{MANIFEST}", model.id)).await?.bytes().await?;
        let digest = folder::parse(&manifest).context("the service's answer is not a manifest")?.digest;
        let folder = Folder::open(dir, &digest, force)?;
        let scratch = Scratch::new(dir).with_context(|| format!("{}", dir.display()))?;
        for file in &model.files {
            self.fetch(file, scratch.dir()).await?;
        }
        std::fs::write(scratch.dir().join(MANIFEST), &manifest).context(MANIFEST)?;
        let names: Vec<&str> = model.files.iter().map(|file| file.name.as_str()).chain([MANIFEST]).collect();
        folder.clear(&names)?;
        let publish = |name: &&str| scratch.publish(name).with_context(|| (*name).to_owned());
        Ok(names.iter().map(publish).collect::<anyhow::Result<_>>()?)
    }

    async fn fetch(&self, file: &RemoteFile, dir: &Path) -> Result<(), Failure> {
        let name = file.name.as_str();
        if !folder::is_plain(name) {
            return Err(anyhow!("the service named a file `{name}`, which is not a valid file name").into());
        }
        let answer = self.http.get(&file.href).send().await;
        let mut answer = accept(answer.with_context(|| format!("GET {}", file.href))?).await?;
        let mut out = std::fs::File::create(dir.join(name)).with_context(|| name.to_owned())?;
        let (mut hash, mut bytes) = (Sha256::new(), 0);
        while let Some(piece) = answer.chunk().await.with_context(|| format!("downloading {name}"))? {
            hash.update(&piece);
            bytes += piece.len() as u64;
            out.write_all(&piece).with_context(|| name.to_owned())?;
        }
        out.sync_all().with_context(|| name.to_owned())?;
        if bytes != file.bytes || hex::encode(hash.finalize()) != file.sha256 {
            return Err(anyhow!("{name} differs from its SHA-256 ({bytes} of {} bytes received)", file.bytes).into());
        }
        Ok(())
    }
}

/// Returns the model in a response, with relative references to its files resolved to URLs.
async fn model_of(answer: Response) -> Result<Value, Failure> {
    let url = answer.url().clone();
    let mut model: Value = answer.json().await?;
    for file in model.get_mut("files").and_then(Value::as_array_mut).into_iter().flatten() {
        let Some(href) = file.get_mut("href") else { continue };
        if let Some(absolute) = href.as_str().and_then(|relative| url.join(relative).ok()) {
            *href = absolute.as_str().into();
        }
    }
    Ok(model)
}

/// Opens an event stream.
async fn open(request: RequestBuilder) -> Result<Response, Interruption> {
    let answer = match tokio::time::timeout(SILENCE, request.send()).await {
        Err(_) => return Err(Interruption::Retry(ServiceError::Silent.into())),
        Ok(Err(error)) => return Err(Interruption::Retry(error.into())),
        Ok(Ok(answer)) => answer,
    };
    match (answer.status().is_server_error(), accept(answer).await) {
        (true, Err(Failure::Failed(error))) => Err(Interruption::Retry(error)),
        (_, answer) => Ok(answer?),
    }
}

/// Reports an event of a model. Returns true if the event is the last one.
///
/// # Errors
/// [`Failure::Failed`] if the event is invalid or says that the model was deleted.
fn is_end(event: &Event, seen: &mut impl FnMut(Followed<'_>)) -> Result<bool, Failure> {
    match event.kind.as_str() {
        "status" | "progress" => {
            let model: Model = serde_json::from_str(&event.data).context("an event does not hold a model")?;
            seen(Followed::Model(&model));
            Ok(false)
        }
        "end" => {
            #[derive(Deserialize)]
            struct Last {
                status: String,
            }
            let last: Last = serde_json::from_str(&event.data).context("the `end` event has no status")?;
            if last.status == "deleted" { Err(anyhow!("the model was deleted").into()) } else { Ok(true) }
        }
        _ => Ok(false),
    }
}

/// Converts a response with an error status to a failure.
///
/// # Errors
/// [`Failure::Usage`] with each fault if the response lists faults of the request; otherwise
/// [`Failure::Failed`].
pub(in crate::cli) async fn accept(answer: Response) -> Result<Response, Failure> {
    let status = answer.status();
    if status.is_success() {
        return Ok(answer);
    }
    let problem: Problem = match tokio::time::timeout(SILENCE, answer.json()).await {
        Ok(Ok(problem)) => problem,
        Ok(Err(_)) | Err(_) => Problem::default(),
    };
    if problem.errors.is_empty() {
        return Err(ServiceError::Refused { status, text: problem.text() }.into());
    }
    Err(Failure::Usage(problem.errors.iter().map(Fault::to_string).collect()))
}

#[cfg(test)]
mod tests;
