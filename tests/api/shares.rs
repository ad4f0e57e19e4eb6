//! Shares of owners: one owner does not take all downloads, event streams or held responses.

use super::app::{App, Reply};
use axum::body::Body;
use axum::http::{Request, header};
use axum::response::Response;
use oviduct::http::{Limits, WithoutKeys};
use oviduct::jobs::keys::{KeyLimits, Scope};
use serde_json::json;
use std::time::Duration;

/// A service with these limits, with a model that has a file of 1 MiB, and with keys of two owners.
struct Crowded {
    app: App,
    file: String,
    batch: String,
    greedy: String,
    modest: String,
}

impl Crowded {
    async fn new(limits: Limits) -> Self {
        let app = App::with(limits, 10).await.with_access(WithoutKeys::Anyone, KeyLimits::default());
        app.expect_faults();
        let model = app.finished(7, &[("model.glb", "model/gltf-binary", vec![7; 1 << 20])]).await;
        let batch = app.post("/batches", &json!({ "seeds": [1, 2, 3] })).await.json();
        let [file, batch] = [format!("{model}/files/model.glb"), format!("/batches/{}", batch["id"].as_str().unwrap())];
        let [greedy, modest] = [app.key("greedy", &[Scope::Admin]).await, app.key("modest", &[Scope::Admin]).await];
        Self { app, file, batch, greedy, modest }
    }

    /// Starts a request whose response the client does not read yet.
    async fn start(&self, key: &str, path: &str) -> Response {
        let request = Request::get(path).header(header::AUTHORIZATION, key);
        self.app.start(request.body(Body::empty()).unwrap()).await
    }

    async fn get(&self, key: &str, path: &str) -> Reply {
        self.app.get_with(path, &[("authorization", key)]).await
    }

    async fn post(&self, key: &str, path: &str, headers: &[(&str, &str)], body: &serde_json::Value) -> Reply {
        self.app.post_with(path, &[&[("authorization", key)], headers].concat(), body).await
    }

    /// Asserts that the greedy owner gets `granted` responses and a refusal, and the other owner a
    /// response.
    async fn assert_shared(&self, path: &str, granted: usize, refusal: &str) {
        let mut running = Vec::new();
        for _ in 0..granted {
            let response = self.start(&self.greedy, path).await;
            assert_eq!(response.status(), 200);
            running.push(response);
        }
        let refused = self.start(&self.greedy, path).await;
        assert_eq!(refused.status(), 503, "{path} of an owner with {granted}");
        drop(refused);
        let refused = self.get(&self.greedy, path).await;
        assert_eq!((refused.status.as_u16(), refused.slug().as_str()), (503, refusal), "{path}");
        assert!(refused.header(header::RETRY_AFTER).is_some());
        let detail = refused.json()["detail"].as_str().unwrap().to_owned();
        assert!(detail.contains(&format!("{granted} ")) && detail.contains("your owner"), "{detail}");
        running.push(self.start(&self.modest, path).await);
        assert_eq!(running[granted].status(), 200, "{path} of another owner");
        drop(running);
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn one_owner_does_not_take_all_downloads_archives_and_tables() {
    let crowded = Crowded::new(Limits { downloads: 4, ..Limits::default() }).await;
    crowded.assert_shared(&crowded.file, 2, "too-many-downloads").await;
    crowded.assert_shared(&format!("{}/table", crowded.batch), 2, "too-many-downloads").await;
    let archive = format!("{}/archive", crowded.batch);
    crowded.assert_shared(&archive, 2, "too-many-downloads").await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn one_owner_does_not_take_all_event_streams() {
    let crowded = Crowded::new(Limits { streams: 4, ..Limits::default() }).await;
    crowded.assert_shared("/events", 2, "too-many-streams").await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn one_owner_does_not_take_all_held_responses() {
    let crowded = Crowded::new(Limits { held: 2, ..Limits::default() }).await;
    let request = |key: &'static str, seconds: &'static str, seed: u64| {
        let key = if key == "greedy" { crowded.greedy.clone() } else { crowded.modest.clone() };
        let crowded = &crowded;
        async move { crowded.post(&key, "/models", &[("prefer", seconds)], &json!({ "seed": seed })).await }
    };
    let is_held = |reply: &Reply| reply.header("preference-applied").is_some();
    let held = request("greedy", "wait=60", 100);
    let others = async {
        while !String::from_utf8_lossy(&crowded.get(&crowded.modest, "/metrics").await.body)
            .contains("oviduct_held_answers 1")
        {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        assert!(!is_held(&request("greedy", "wait=1", 101).await), "a second response of the greedy owner");
        assert!(is_held(&request("modest", "wait=1", 102).await), "a response of another owner");
        crowded.app.shutdown.cancel();
    };
    let (held, ()) = tokio::join!(held, others);
    assert!(is_held(&held));
}

/// A table is made whole in memory, and stays there until its client has read it.
#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_table_is_one_download_until_it_is_sent() {
    let crowded = Crowded::new(Limits { downloads: 1, ..Limits::default() }).await;
    for format in ["json", "csv"] {
        let table = format!("{}/table?format={format}", crowded.batch);
        let running = crowded.start(&crowded.greedy, &table).await;
        let length: usize = running.headers()[header::CONTENT_LENGTH].to_str().unwrap().parse().unwrap();
        let refused = crowded.get(&crowded.modest, &crowded.file).await;
        assert_eq!((refused.status.as_u16(), refused.slug().as_str()), (503, "too-many-downloads"));
        drop(running);
        assert_eq!(crowded.get(&crowded.greedy, &table).await.body.len(), length, "{format}");
    }
    let running = crowded.start(&crowded.greedy, &crowded.file).await;
    let refused = crowded.get(&crowded.modest, &format!("{}/table", crowded.batch)).await;
    assert_eq!((refused.status.as_u16(), refused.slug().as_str()), (503, "too-many-downloads"));
    drop(running);
}
