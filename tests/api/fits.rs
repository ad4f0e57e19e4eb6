//! Fits over HTTP: requests, lists, events, cancellation, and the separation of fits from models.

use super::app::App;
use axum::body::Body;
use axum::http::{Method, header};
use http_body_util::BodyExt;
use oviduct::fit::{FitProgress, FitSpec, FitStage};
use oviduct::http::Limits;
use oviduct::jobs::keys::{KeyLimits, Scope};
use oviduct::jobs::{ClaimScope, Finished, JobProgress, Quota};
use serde_json::{Value, json};
use std::time::Duration;

fn target() -> Value {
    json!({ "region": "ampulla", "quantity": "folds_on_ring", "value": 30 })
}

fn request() -> Value {
    json!({ "targets": [target()], "evaluations": 50, "labels": { "study": "A" }, "priority": 3 })
}

#[tokio::test]
async fn a_fit_is_queued_read_and_deleted() {
    let app = App::new().await;
    let reply = app.post("/fits", &request()).await;
    assert_eq!(reply.status, 202, "{reply:?}");
    assert!(reply.header(header::RETRY_AFTER).is_some());
    let (address, fit) = (reply.location(), reply.json());
    assert_eq!(address, format!("/fits/{}", fit["id"].as_str().unwrap()));
    assert_eq!((&fit["status"], &fit["preset"], &fit["priority"]), (&json!("queued"), &json!("pig"), &json!(3)));
    assert_eq!((&fit["result"], &fit["progress"], &fit["labels"]["study"]), (&Value::Null, &Value::Null, &json!("A")));
    // The service adds the defaults of omitted members.
    let filled = &fit["request"];
    assert_eq!((&filled["evaluations"], &filled["seeds"], &filled["models"]), (&json!(50), &json!(4), &json!(4)));
    assert_eq!((&filled["targets"][0]["low"], &filled["targets"][0]["high"]), (&json!(28.5), &json!(31.5)));
    assert_eq!(filled["vary"].as_array().unwrap().len(), 3);
    assert_eq!(filled["spec"]["steps"], 2000);

    let again = app.get(&address).await;
    assert_eq!((again.status.as_u16(), again.json()), (200, fit.clone()));
    let tag = again.header(header::ETAG).unwrap().to_owned();
    assert_eq!(app.get_with(&address, &[("if-none-match", &tag)]).await.status, 304);

    let cancelled = app.post(&format!("{address}/cancel"), &json!({})).await;
    assert_eq!((cancelled.status.as_u16(), &cancelled.json()["status"]), (200, &json!("cancelled")));
    assert_eq!(app.delete(&address).await.status, 204);
    for reply in [app.get(&address).await, app.delete(&address).await, app.get("/fits/nonsense").await] {
        assert_eq!((reply.status.as_u16(), reply.slug().as_str()), (404, "fit-not-found"));
    }
}

#[tokio::test]
async fn fits_and_models_do_not_mix() {
    let app = App::new().await;
    let model = app.model(1).await;
    let fit = app.post("/fits", &request()).await.location();
    let [model_id, fit_id] = [&model, &fit].map(|path| path.rsplit('/').next().unwrap().to_owned());
    let models = app.get("/models").await.json();
    assert_eq!(
        models["models"].as_array().unwrap().iter().map(|m| m["id"].as_str().unwrap()).collect::<Vec<_>>(),
        [model_id.as_str()]
    );
    let fits = app.get("/fits").await.json();
    assert_eq!((fits["fits"].as_array().unwrap().len(), &fits["fits"][0]["id"]), (1, &json!(fit_id)));
    assert!(fits["fits"][0].get("request").is_none() && fits["fits"][0].get("result").is_none());
    for path in
        ["", "/events", "/files/model.glb", "/report", "/sections/0", "/preview.png", "/report.html", "/manifest.json"]
    {
        assert_eq!(app.get(&format!("/models/{fit_id}{path}")).await.slug(), "model-not-found", "{path}");
    }
    for path in ["/cancel", "/retry"] {
        assert_eq!(app.post(&format!("/models/{fit_id}{path}"), &json!({})).await.slug(), "model-not-found", "{path}");
    }
    assert_eq!(app.delete(&format!("/models/{fit_id}")).await.slug(), "model-not-found");
    for reply in [
        app.get(&format!("/fits/{model_id}")).await,
        app.get(&format!("/fits/{model_id}/events")).await,
        app.delete(&format!("/fits/{model_id}")).await,
    ] {
        assert_eq!(reply.slug(), "fit-not-found");
    }
    // A bulk request for all models does not affect the fit.
    let done = app.post("/models/cancel?status=queued", &json!({})).await.json();
    assert_eq!(done["count"], 1, "{done}");
    assert_eq!(app.get(&fit).await.json()["status"], "queued");
}

#[tokio::test]
async fn lists_of_fits_are_narrowed_and_paged() {
    let app = App::new().await;
    for (seed, study) in [(1, "A"), (2, "B"), (3, "A")] {
        let body = json!({ "targets": [target()], "seed": seed, "labels": { "study": study } });
        assert_eq!(app.post("/fits", &body).await.status, 202);
    }
    let count = async |query: &str| app.get(&format!("/fits{query}")).await.json()["fits"].as_array().unwrap().len();
    assert_eq!((count("").await, count("?label=study:A").await, count("?status=running").await), (3, 2, 0));
    assert_eq!((count("?preset=pig").await, count("?preset=cow").await), (3, 0));
    let page = app.get("/fits?limit=2").await.json();
    let next = page["next"].as_str().unwrap();
    assert_eq!((page["fits"].as_array().unwrap().len(), count(&format!("?limit=2&cursor={next}")).await), (2, 1));
    for (query, place) in [("?limit=0", "limit"), ("?status=x", "status"), ("?sort=1", "sort"), ("?view=full", "view")]
    {
        assert_eq!(app.get(&format!("/fits{query}")).await.places(), [place]);
    }
}

#[tokio::test]
async fn an_idempotency_key_gives_the_same_fit() {
    let app = App::new().await;
    let key = [("idempotency-key", "k1")];
    let first = app.post_with("/fits", &key, &request()).await;
    let again = app.post_with("/fits", &key, &request()).await;
    assert_eq!(first.json()["id"], again.json()["id"]);
    assert_eq!(again.header("idempotency-replayed"), Some("true"));
    let other = app.post_with("/fits", &key, &json!({ "targets": [target()] })).await;
    assert_eq!((other.status.as_u16(), other.slug().as_str()), (422, "idempotency-key-reused"));
    // Fits and models have separate idempotency keys.
    assert_eq!(app.post_with("/models", &key, &json!({ "seed": 1 })).await.status, 202);
}

#[tokio::test]
async fn validation_returns_the_fit_that_would_be_queued() {
    let app = App::new().await;
    let reply = app.post("/fits/validate", &request()).await;
    assert_eq!(reply.status, 200, "{reply:?}");
    let (checked, fit) = (reply.json(), app.post("/fits", &request()).await.json());
    assert_eq!((&checked["request"], &checked["digest"]), (&fit["request"], &fit["digest"]));
    assert!(checked["seconds"].as_f64().unwrap() > 10.0, "{checked}");
    assert_eq!(app.get("/fits").await.json()["fits"].as_array().unwrap().len(), 1);
}

#[tokio::test]
async fn invalid_requests_name_their_members() {
    let app = App::new().await;
    for (body, place) in [
        (json!({}), "/targets"),
        (json!([]), ""),
        (json!({ "targets": [{ "region": "x", "quantity": "fill", "value": 1 }] }), "/targets/0/region"),
        (json!({ "targets": [target()], "preset": "dog" }), "/preset"),
        (json!({ "targets": [target()], "spec": { "steps": 0 } }), "/spec/steps"),
        (json!({ "targets": [target()], "labels": { "a": 1 } }), "/labels/a"),
        (json!({ "targets": [target()], "priority": 101 }), "/priority"),
        (json!({ "targets": [target()], "outputs": [] }), "/outputs"),
        (json!({ "targets": [target()], "vary": [{ "parameter": "/nothing" }] }), "/vary/0/parameter"),
        (json!({ "images": [{ "region": "isthmus", "png": "R0lGODlh", "pixel_um": 2 }] }), "/images/0/png"),
        (json!({ "images": [{ "region": "isthmus", "image": "R0lGODlh" }] }), "/images/0/image"),
        (json!({ "images": [{ "region": "isthmus", "image": "R0lG", "png": "R0lG" }] }), "/images/0/png"),
        (json!({ "images": [{ "region": "isthmus", "image": "R0lGODlh", "threshold": 0 }] }), "/images/0/threshold"),
        (json!({ "images": 3 }), "/images"),
    ] {
        for path in ["/fits", "/fits/validate"] {
            let reply = app.post(path, &body).await;
            assert_eq!((reply.status.as_u16(), reply.places()), (422, vec![place.to_owned()]), "{body}");
        }
    }
    // The service refuses a fit before queueing it if it would take too long or grow too large
    // models.
    for body in [
        json!({ "preset": "cow", "targets": [target()], "evaluations": 2000, "seeds": 16 }),
        json!({ "targets": [target()], "spec": { "steps": 50_000, "solver": { "record_every": 1 } } }),
    ] {
        let reply = app.post("/fits", &body).await;
        assert_eq!((reply.status.as_u16(), reply.slug().as_str()), (422, "cost-limit"), "{reply:?}");
    }
    let large = json!({ "targets": [target()], "labels": { "a": "x".repeat(9 << 20) } });
    assert_eq!(app.post("/fits", &large).await.slug(), "payload-too-large");
    let text = app.request(Method::POST, "/fits", &[("content-type", "text/csv")], Body::from("a,b")).await;
    assert_eq!(text.slug(), "unsupported-media-type");
}

#[tokio::test]
async fn a_fit_has_a_limit_of_predicted_time() {
    let limits = Limits { fit_time: Duration::from_secs(3600), ..Limits::default() };
    let app = App::with(limits, 100).await;
    let long = json!({ "targets": [target()], "evaluations": 2000, "seeds": 16 });
    let refused = app.post("/fits", &long).await;
    assert_eq!((refused.slug().as_str(), refused.places()), ("cost-limit", vec!["/evaluations".to_owned()]));
    assert!(refused.json()["detail"].as_str().unwrap().contains("the limit is 3600"), "{refused:?}");
}

#[tokio::test]
async fn a_fit_counts_by_its_predicted_time() {
    let app = App::new().await;
    let checked = FitSpec::read(&request(), Vec::new(), &["labels", "priority"]).unwrap();
    let counts_as = (checked.predicted_seconds() / 60.0).ceil() as u64;
    assert!(counts_as > 1);
    let limits = KeyLimits { rate: None, quota: Quota { unfinished: Some(counts_as), bytes: None } };
    let key = app.key_with("lab", &[Scope::Read, Scope::Submit], limits, None).await;
    let post = async |path: &str, body: &Value| app.post_with(path, &[("authorization", &key)], body).await;
    assert_eq!(post("/fits/validate", &request()).await.json()["counts_as"], counts_as);
    assert_eq!(post("/fits", &request()).await.status, 202);
    let full = post("/models", &json!({ "seed": 1 })).await;
    assert_eq!((full.status.as_u16(), full.slug().as_str()), (429, "quota-exceeded"));
    let other = post("/fits", &json!({ "targets": [target()] })).await.json();
    let expected =
        format!("You have {counts_as} queued and running models of at most {counts_as}. The request counts as");
    assert!(other["detail"].as_str().unwrap().starts_with(&expected), "{other}");
}

#[tokio::test]
async fn fits_are_visible_only_to_their_owner() {
    let app = App::new().await;
    let lab = app.key("lab", &[Scope::Read, Scope::Submit]).await;
    let other = app.key("other", &[Scope::Read, Scope::Submit]).await;
    let fit = app.post_with("/fits", &[("authorization", &lab)], &request()).await.location();
    assert_eq!(app.get_with(&fit, &[("authorization", &lab)]).await.json()["owner"], "lab");
    for path in [fit.clone(), format!("{fit}/events")] {
        assert_eq!(app.get_with(&path, &[("authorization", &other)]).await.slug(), "fit-not-found");
    }
    let list = app.get_with("/fits", &[("authorization", &other)]).await.json();
    assert_eq!(list["fits"], json!([]));
}

/// The events of a stream: name and data.
fn events(text: &str) -> Vec<(String, Value)> {
    let field = |event: &str, name: &str| {
        event.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix(": ").map(str::to_owned))
    };
    text.split("\n\n")
        .filter_map(|event| Some((field(event, "event")?, serde_json::from_str(&field(event, "data")?).ok()?)))
        .collect()
}

#[tokio::test]
async fn a_fit_is_followed_to_its_end() {
    let app = App::new().await;
    let fit = app.post("/fits", &request()).await.location();
    let stream = app.start(axum::http::Request::get(format!("{fit}/events")).body(Body::empty()).unwrap()).await;
    let all = app.start(axum::http::Request::get("/events").body(Body::empty()).unwrap()).await;
    let reading = tokio::spawn(async move { stream.into_body().collect().await.unwrap().to_bytes() });
    let mut claimed = app.store.claim("w", ClaimScope::Fits, super::app::LEASE, 1).await.unwrap();
    let job = claimed.pop().unwrap();
    let progress = FitProgress {
        stage: FitStage::Search,
        fraction: 0.1,
        evaluations: 7,
        evaluations_most: 50,
        models: 0,
        misfit: Some(2.5),
        eta_seconds: Some(30.0),
    };
    let (lease, used) = (super::app::LEASE, super::app::used());
    app.store.heartbeat(&job, lease, &used, Some(&JobProgress::Fit(progress)), None).await.unwrap();
    assert_eq!(app.get(&fit).await.json()["progress"], json!(progress));
    tokio::time::sleep(std::time::Duration::from_millis(300)).await;
    let finished = Finished {
        backend: super::app::used(),
        files: Vec::new(),
        summary: json!({
            "preset": "pig", "spec": {}, "models": [{}, {}], "search": { "evaluations": 9, "misfit": 0.5 },
        }),
        engine: "test".into(),
    };
    app.store.finish(job, finished).await.unwrap();
    let bytes = reading.await.unwrap();
    let events = events(std::str::from_utf8(&bytes).unwrap());
    let names: Vec<&str> = events.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!((names.first(), names.last()), (Some(&"status"), Some(&"end")), "{names:?}");
    assert!(names.contains(&"progress") || names.len() == 3, "{names:?}");
    let end = &events.last().unwrap().1;
    assert_eq!(
        (&end["status"], &end["result"]["preset"], end.get("request")),
        (&json!("succeeded"), &json!("pig"), None)
    );
    let whole = FitProgress {
        stage: FitStage::Verify,
        fraction: 1.0,
        evaluations: 9,
        models: 2,
        misfit: Some(0.5),
        eta_seconds: None,
        ..progress
    };
    assert_eq!(end["progress"], json!(whole));
    // A client that has the last version receives no further event.
    let version = end["version"].to_string();
    assert_eq!(app.get_with(&format!("{fit}/events"), &[("last-event-id", &version)]).await.status, 204);
    let after = app.get(&format!("{fit}/events")).await;
    assert_eq!(self::events(std::str::from_utf8(&after.body).unwrap()).len(), 1);
    // The stream of all models reports neither the fit nor its removal.
    assert_eq!(app.delete(&fit).await.status, 204);
    app.model(5).await;
    let mut body = all.into_body();
    let mut text = String::new();
    while !text.contains("\"seed\":5") {
        let frame = body.frame().await.unwrap().unwrap();
        text += std::str::from_utf8(frame.data_ref().unwrap()).unwrap();
    }
    let id = fit.rsplit('/').next().unwrap();
    assert!(!text.contains(id), "{text}");
}
