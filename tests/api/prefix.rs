//! A path prefix that a proxy strips: every reference in a response is relative to the request URL.

use super::app::{App, id};
use super::events::Stream;
use reqwest::Url;
use serde_json::{Value, json};

const BASE: &str = "https://lab.example/tools/oviduct";

/// Resolves a reference in the response to `path`, as a client behind the proxy does; returns the
/// path at the service.
fn resolve(path: &str, reference: &str) -> String {
    let url = Url::parse(&format!("{BASE}{path}")).unwrap().join(reference).unwrap();
    url.as_str().strip_prefix(BASE).unwrap_or_else(|| panic!("{reference} in {path} leads to {url}")).to_owned()
}

/// Path at the service of a model's first file, from a response to `path`.
fn file(path: &str, model: &Value) -> String {
    resolve(path, model["files"][0]["href"].as_str().unwrap())
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn references_resolve_to_the_same_path_from_every_response() {
    let app = App::new().await;
    let body = json!({ "seed": 7 });
    let first = app.post("/models", &body).await;
    let model = resolve("/models", first.header("location").unwrap());
    let events = format!("{model}/events");
    let (mut all, mut one) = (Stream::open(&app, "/events", None).await, Stream::open(&app, &events, None).await);
    let job = app.claim().await;
    app.finish(job, &[("model.glb", "model/gltf-binary", b"glTF".to_vec())]).await;
    let there = format!("{model}/files/model.glb");
    assert_eq!(app.get(&there).await.status, 200);

    assert_eq!(file(&model, &app.get(&model).await.json()), there);
    assert_eq!(file("/models", &app.get("/models").await.json()["models"][0]), there);
    let cancel = format!("{model}/cancel");
    assert_eq!(file(&cancel, &app.post(&cancel, &json!({})).await.json()), there);
    assert_eq!(file("/events", &all.until("end").await.data), there);
    assert_eq!(file(&events, &one.until("end").await.data), there);
    drop(one);
    let mut late = Stream::open(&app, &events, None).await;
    assert_eq!(file(&events, &late.until("end").await.data), there);
    let path = format!("/events?ids={}", id(&model));
    let mut some = Stream::open(&app, &path, None).await;
    assert_eq!(file(&path, &some.until("end").await.data), there);

    let again = app.post("/models", &body).await;
    let reused = resolve("/models", again.header("location").unwrap());
    assert_eq!((again.status.as_u16(), file("/models", &again.json())), (201, format!("{reused}/files/model.glb")));
    let batch = app.post("/batches", &json!({ "count": 1 })).await;
    assert_eq!(app.get(&resolve("/batches", batch.header("location").unwrap())).await.json(), batch.json());
}
