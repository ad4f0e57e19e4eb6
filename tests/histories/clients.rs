//! Clients that submit, read, list, follow, cancel and delete models, and record what they see.

use crate::checker::{History, Order, Record, Stream, Told};
use crate::dice::Dice;
use crate::spec::{Op, Ret, Seen};
use futures_util::StreamExt;
use oviduct::clock::Stopwatch;
use oviduct::jobs::Status;
use reqwest::{Method, RequestBuilder, StatusCode};
use serde::Deserialize;
use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use uuid::Uuid;

/// Time after which a client gives up. An operation that reaches it is a failure of the test.
const GIVEN_UP_AFTER: Duration = Duration::from_secs(120);
/// Time for which a client follows a model.
const FOLLOWED_FOR: Duration = Duration::from_secs(6);
/// Operations of a client on one key.
const OPERATIONS: u32 = 8;

/// Counts over all keys.
#[derive(Clone, Copy, Debug, Default)]
pub struct Counts {
    pub operations: u64,
    pub unknown: u64,
    pub streams: u64,
    pub events: u64,
    /// Longest time to the end of a response or to its failure.
    pub slowest: Duration,
}

/// The addresses of the services, and what all clients share.
pub struct World {
    http: reqwest::Client,
    pub urls: Vec<String>,
    pub order: Order,
    pub counts: Mutex<Counts>,
}

#[derive(Deserialize)]
struct Model {
    id: Uuid,
    version: u64,
    status: Status,
    attempts: u32,
}

impl Model {
    fn shown(&self) -> (Uuid, Seen) {
        (self.id, Seen { version: self.version, status: self.status, attempts: self.attempts })
    }
}

#[derive(Deserialize)]
struct Page {
    models: Vec<Model>,
}

/// Response to a request, or the reason why there is none.
enum Answer {
    Known(StatusCode, Vec<u8>),
    /// The request may have taken effect.
    Unknown,
    /// The request did not reach a service.
    Unsent,
}

impl World {
    pub fn new(urls: Vec<String>) -> Arc<Self> {
        oviduct::tls::install();
        let http = reqwest::Client::builder().no_proxy().pool_max_idle_per_host(0).connect_timeout(GIVEN_UP_AFTER);
        let http = http.build().unwrap();
        Arc::new(Self { http, urls, order: Order::default(), counts: Mutex::default() })
    }

    fn request(&self, method: Method, at: usize, path: &str) -> RequestBuilder {
        self.http.request(method, format!("{}{path}", self.urls[at % self.urls.len()]))
    }

    async fn send(&self, request: RequestBuilder) -> Answer {
        let since = Stopwatch::start();
        let answer = async {
            let response = request.timeout(GIVEN_UP_AFTER).send().await?;
            let status = response.status();
            Ok::<_, reqwest::Error>((status, response.bytes().await?))
        };
        let answer = answer.await;
        let elapsed = since.elapsed();
        let mut counts = self.counts.lock().unwrap();
        counts.operations += 1;
        counts.slowest = counts.slowest.max(elapsed);
        drop(counts);
        match answer {
            Ok((StatusCode::SERVICE_UNAVAILABLE, _)) => Answer::Unknown,
            Ok((status, bytes)) => Answer::Known(status, bytes.to_vec()),
            Err(error) if error.is_connect() => Answer::Unsent,
            Err(_) => Answer::Unknown,
        }
    }
}

/// One idempotency key, with all that is known of it.
pub struct Object {
    pub world: Arc<World>,
    pub name: String,
    pub history: Mutex<History>,
    /// Id of the model that a submission returned last.
    pub id: Mutex<Option<Uuid>>,
}

impl Object {
    /// A request for a model that takes about a second.
    fn body(&self) -> Value {
        let spec = json!({ "steps": 60, "particles": { "total": { "keys": [[0, 300], [1, 420]] } } });
        json!({ "spec": spec, "seed": 7, "reuse": false, "outputs": ["glb"], "labels": { "key": self.name } })
    }

    fn request(&self, op: Op, at: usize) -> RequestBuilder {
        let request = |method, path: &str| self.world.request(method, at, path);
        match op {
            Op::Submit => request(Method::POST, "/models").header("idempotency-key", &self.name).json(&self.body()),
            Op::Get(id) => request(Method::GET, &format!("/models/{id}?view=summary")),
            Op::Cancel(id) => request(Method::POST, &format!("/models/{id}/cancel")),
            Op::Delete(id) => request(Method::DELETE, &format!("/models/{id}")),
            Op::List => request(Method::GET, &format!("/models?view=summary&label=key:{}", self.name)),
        }
    }

    /// The content of a response with this status.
    fn read(op: Op, status: StatusCode, bytes: &[u8]) -> Ret {
        let text = String::from_utf8_lossy(bytes);
        let unexpected = || -> ! { panic!("{op:?} got {status}: {text}") };
        match (op, status.as_u16()) {
            (Op::Submit, 200 | 202) | (Op::Get(_) | Op::Cancel(_), 200) => {
                let (id, seen) = serde_json::from_slice::<Model>(bytes).unwrap().shown();
                Ret::Shown(id, seen)
            }
            (Op::Get(_) | Op::Cancel(_) | Op::Delete(_), 404) => Ret::Missing,
            (Op::Delete(_), 204) => Ret::Deleted,
            (Op::List, 200) => {
                Ret::Listed(serde_json::from_slice::<Page>(bytes).unwrap().models.iter().map(Model::shown).collect())
            }
            _ => unexpected(),
        }
    }

    /// Runs an operation and records it.
    pub async fn operate(&self, client: u32, op: Op, at: usize) -> Option<Ret> {
        let invoked = self.world.order.next();
        let ret = match self.world.send(self.request(op, at)).await {
            Answer::Known(status, bytes) => Some(Self::read(op, status, &bytes)),
            Answer::Unknown => None,
            Answer::Unsent => return None,
        };
        self.world.counts.lock().unwrap().unknown += u64::from(ret.is_none());
        let returned = ret.clone().map(|ret| (self.world.order.next(), ret));
        if op == Op::Submit
            && let Some(Ret::Shown(id, _)) = ret
        {
            *self.id.lock().unwrap() = Some(id);
        }
        self.history.lock().unwrap().records.push(Record { client, op, invoked, returned });
        ret
    }

    /// Follows a model for a while and records the events. `last` is the id of the last event, and
    /// whether it was the end.
    async fn follow(&self, id: Uuid, at: usize, last: &mut Option<(String, bool)>) {
        let opened = self.world.order.next();
        let mut request = self.world.request(Method::GET, at, &format!("/models/{id}/events"));
        if let Some((last_id, _)) = &*last {
            request = request.header("last-event-id", last_id);
        }
        let mut stream = Stream { id, opened, events: Vec::new(), closed: false };
        let read = async {
            let Ok(response) = request.send().await else { return };
            match response.status().as_u16() {
                200 => {}
                204 if last.as_ref().is_some_and(|(_, is_end)| *is_end) => return,
                404 => stream.events.push((self.world.order.next(), "end".to_owned(), Told::Deleted)),
                503 => return,
                status => panic!("the stream of {id} after {last:?} got {status}"),
            }
            let (mut pieces, mut text) = (response.bytes_stream(), String::new());
            loop {
                match pieces.next().await {
                    Some(Ok(piece)) => text.push_str(std::str::from_utf8(&piece).unwrap()),
                    Some(Err(_)) => return,
                    None => stream.closed = true,
                }
                while let Some((event, rest)) = text.split_once("\n\n") {
                    if let Some((name, version, told)) = Self::event(event) {
                        *last = Some((version, name == "end"));
                        stream.events.push((self.world.order.next(), name, told));
                    }
                    text = rest.to_owned();
                }
                if stream.closed {
                    return;
                }
            }
        };
        let _ = tokio::time::timeout(FOLLOWED_FOR, read).await;
        let mut counts = self.world.counts.lock().unwrap();
        counts.streams += 1;
        counts.events += stream.events.len() as u64;
        self.history.lock().unwrap().streams.push(stream);
    }

    /// Name, id and state of an event; `None` for a comment.
    fn event(text: &str) -> Option<(String, String, Told)> {
        let field = |name: &str| text.lines().find_map(|line| line.strip_prefix(name));
        let (name, version, data) = (field("event: ")?, field("id: ")?, field("data: ")?);
        let data: Value = serde_json::from_str(data).unwrap();
        let told = if data["status"] == "deleted" {
            Told::Deleted
        } else {
            Told::State(Model::deserialize(data).unwrap().shown().1)
        };
        Some((name.to_owned(), version.to_owned(), told))
    }

    /// The operations of one client: a submission, and then what the dice say.
    pub async fn use_as(self: Arc<Self>, client: u32, mut dice: Dice, cancels: bool, deletes: bool) {
        let mut follows: (Option<Uuid>, Option<(String, bool)>) = (None, None);
        for n in 0..OPERATIONS {
            let at = dice.below(8) as usize;
            let known = *self.id.lock().unwrap();
            let (roll, is_late) = (dice.below(100), n >= OPERATIONS / 2);
            match known {
                Some(id) if n > 0 => match roll {
                    0..45 => drop(self.operate(client, Op::Get(id), at).await),
                    45..57 => drop(self.operate(client, Op::List, at).await),
                    57..67 => drop(self.operate(client, Op::Submit, at).await),
                    67..74 if cancels && is_late => drop(self.operate(client, Op::Cancel(id), at).await),
                    74..80 if deletes && is_late => drop(self.operate(client, Op::Delete(id), at).await),
                    _ => {
                        if follows.0 != Some(id) {
                            follows = (Some(id), None);
                        }
                        self.follow(id, at, &mut follows.1).await;
                    }
                },
                _ => drop(self.operate(client, Op::Submit, at).await),
            }
            tokio::time::sleep(Duration::from_millis(20 + u64::from(dice.below(250)))).await;
        }
    }

    /// Waits for the end of the model after the faults; checks that it succeeded or was cancelled,
    /// and that its files are there. Returns whether there is a model.
    pub async fn ended(&self, client: u32, within: Duration) -> bool {
        let since = Stopwatch::start();
        let mut at = 0;
        let last = loop {
            let listed = self.operate(client, Op::List, at).await;
            at += 1;
            match listed {
                Some(Ret::Listed(models)) if models.iter().all(|(_, seen)| seen.status.is_ended()) => break models,
                Some(Ret::Listed(_)) | None => {}
                Some(ret) => panic!("{ret:?}"),
            }
            assert!(since.elapsed() < within, "key {} has not ended: {listed:?}", self.name);
            tokio::time::sleep(Duration::from_millis(200)).await;
        };
        for (id, seen) in &last {
            assert!(matches!(seen.status, Status::Succeeded | Status::Cancelled), "{id}: {seen:?}");
            for at in 0..self.world.urls.len() {
                assert_eq!(self.operate(client, Op::Get(*id), at).await, Some(Ret::Shown(*id, *seen)));
                self.check_files(*id, at, seen.status == Status::Succeeded).await;
            }
        }
        !last.is_empty()
    }

    async fn check_files(&self, id: Uuid, at: usize, exist: bool) {
        let get = async |path: String| match self.world.send(self.world.request(Method::GET, at, &path)).await {
            Answer::Known(StatusCode::OK, bytes) => bytes,
            Answer::Known(status, bytes) => panic!("{path} got {status}: {}", String::from_utf8_lossy(&bytes)),
            Answer::Unknown | Answer::Unsent => panic!("{path} got no answer"),
        };
        let model: Value = serde_json::from_slice(&get(format!("/models/{id}")).await).unwrap();
        let files = model["files"].as_array().unwrap();
        assert_eq!(files.is_empty(), !exist, "{id}");
        for file in files {
            let bytes = get(format!("/models/{id}/files/{}", file["name"].as_str().unwrap())).await;
            assert_eq!(hex::encode(Sha256::digest(&bytes)), file["sha256"].as_str().unwrap(), "{id}");
        }
    }
}
