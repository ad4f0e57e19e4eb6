//! `POST /models` and `POST /models/validate`.

use super::app::{App, id, used};
use axum::http::header;
use oviduct::http::Limits;
use oviduct::jobs::{Finished, WorkerKind};
use oviduct::status::{Condition, Status};
use serde_json::{Value, json};
use std::time::Duration;

const GLB: [(&str, &str, &[u8]); 1] = [("model.glb", "model/gltf-binary", b"glTF")];

fn files() -> Vec<(&'static str, &'static str, Vec<u8>)> {
    GLB.iter().map(|(name, kind, bytes)| (*name, *kind, bytes.to_vec())).collect()
}

/// The model without the members that differ between runs and without the long spec.
fn steady(mut model: Value) -> Value {
    let id = model["id"].as_str().unwrap().to_owned();
    assert!(model["spec"].as_object().is_some_and(|spec| spec.contains_key("length_mm")));
    assert_eq!(model["digest"].as_str().unwrap().len(), 64);
    model["spec"] = "…".into();
    model["digest"] = "…".into();
    serde_json::from_str(&model.to_string().replace(&id, "ID")).unwrap()
}

#[tokio::test]
async fn a_model_is_accepted_and_queued() {
    let app = App::new().await;
    app.worker(WorkerKind::Cpu).await;
    let body = json!({ "preset": "pig", "seed": 7, "outputs": ["glb", "obj"], "labels": { "study": "A3" } });
    let reply = app.post("/models", &body).await;
    assert_eq!(reply.status, 202);
    let model = reply.json();
    assert_eq!(reply.location(), format!("/models/{}", model["id"].as_str().unwrap()));
    assert!(reply.header(header::RETRY_AFTER).unwrap().parse::<u32>().unwrap() >= 1);
    assert_eq!(reply.header(header::ETAG).unwrap(), format!("\"{}\"", model["version"]));
    assert_eq!(reply.header("preference-applied"), None);
    assert_eq!(reply.header("idempotency-replayed"), None);
    insta::assert_json_snapshot!(steady(model));
    assert_eq!(app.get(&reply.location()).await.json(), reply.json());
}

#[tokio::test]
async fn a_finished_model_shows_everything() {
    let app = App::new().await;
    let model = app.model(7).await;
    app.clock.advance(Duration::from_millis(200));
    let job = app.claim().await;
    app.beat(&job, 820, None).await;
    app.clock.advance(Duration::from_secs(5));
    app.finish(job, &files()).await;
    insta::assert_json_snapshot!(steady(app.get(&model).await.json()));
}

#[tokio::test]
async fn an_empty_request_takes_the_defaults_and_draws_a_seed() {
    let app = App::new().await;
    let (a, b) = (app.post("/models", &json!({})).await.json(), app.post("/models", &json!({})).await.json());
    for model in [&a, &b] {
        assert_eq!((&model["preset"], &model["outputs"]), (&json!("pig"), &json!(["glb", "lod"])));
        assert!(model["seed"].as_u64().unwrap() < 1 << 53);
    }
    assert_ne!(a["seed"], b["seed"]);
    assert_ne!(a["digest"], b["digest"]);
}

#[tokio::test]
async fn the_spec_is_merged_into_the_preset_and_echoed_whole() {
    let app = App::new().await;
    let model = app.post("/models", &json!({ "spec": { "length_mm": 45.0, "collision": null } })).await.json();
    let preset = app.get("/presets/pig").await.json();
    assert_eq!(model["spec"]["length_mm"], 45);
    assert_eq!(
        model["spec"]["collision"].as_object().map(serde_json::Map::len),
        preset["spec"]["collision"].as_object().map(serde_json::Map::len)
    );
}

#[tokio::test]
async fn whole_numbers_with_a_fraction_of_zero_are_integers() {
    let app = App::new().await;
    let body = r#"{"seed": 62.0, "spec": {"steps": 2000.0}}"#;
    let kind = [("content-type", "application/json; charset=utf-8")];
    let reply = app.request(axum::http::Method::POST, "/models", &kind, body.into()).await;
    assert_eq!(reply.status, 202);
    assert_eq!(reply.json()["seed"], 62);
}

#[tokio::test]
async fn validating_queues_nothing_and_predicts() {
    let app = App::new().await;
    let reply = app.post("/models/validate", &json!({ "seed": 7, "outputs": ["glb", "obj", "lod"] })).await;
    assert_eq!(reply.status, 200);
    let validation = reply.json();
    for member in [
        "/spec/length_mm",
        "/cost/vertices",
        "/cost/triangles",
        "/cost/bytes/glb",
        "/cost/bytes/obj",
        "/cost/bytes/lod",
        "/cost/seconds/cpu/basis",
    ] {
        assert!(validation.pointer(member).is_some_and(|v| !v.is_null()), "{member} of {validation}");
    }
    assert_eq!(app.get("/models").await.json()["models"], json!([]));
    let model = app.post("/models", &json!({ "seed": 7 })).await.json();
    assert_eq!(model["digest"], validation["digest"]);
    assert_eq!(model["spec"], validation["spec"]);
    assert_eq!(app.post("/models/validate", &json!({})).await.json()["digest"], Value::Null);
}

#[tokio::test]
async fn models_of_higher_priority_are_started_first() {
    let app = App::new().await;
    let ask = async |path: &str, body: Value| app.post(path, &body).await.json();
    let plain = ask("/models", json!({ "seed": 1 })).await;
    let low = ask("/models", json!({ "seed": 2, "priority": -100 })).await;
    let urgent = ask("/models", json!({ "seed": 3, "priority": 100 })).await;
    let batch = ask("/batches", json!({ "seeds": [4, 5], "priority": 50.0 })).await;
    assert_eq!((&plain["priority"], &low["priority"], &urgent["priority"]), (&json!(0), &json!(-100), &json!(100)));
    assert_eq!(batch["priority"], 50);
    assert_eq!(app.get(&format!("/batches/{}", batch["id"].as_str().unwrap())).await.json(), batch);
    let order = [&urgent["id"], &batch["models"][0], &batch["models"][1], &plain["id"], &low["id"]];
    for (place, id) in order.iter().enumerate() {
        let model = app.get(&format!("/models/{}", id.as_str().unwrap())).await.json();
        assert_eq!(model["queue"]["position"], place);
    }
    for id in order {
        assert_eq!(app.claim().await.job().id.to_string(), id.as_str().unwrap());
    }
}

/// The priority changes when a model is grown, but not its contents.
#[tokio::test]
async fn the_priority_is_no_part_of_the_digest_but_of_the_request() {
    let app = App::new().await;
    let key = [("idempotency-key", "k")];
    let made = app.post_with("/models", &key, &json!({ "seed": 1 })).await.json();
    let other = app.post_with("/models", &key, &json!({ "seed": 1, "priority": 3 })).await;
    assert_eq!((other.status.as_u16(), other.slug().as_str()), (422, "idempotency-key-reused"));
    app.finish(app.claim().await, &files()).await;
    let reused = app.post("/models", &json!({ "seed": 1, "priority": 3 })).await;
    assert_eq!((reused.status.as_u16(), &reused.json()["reused_from"]), (201, &made["id"]));
    assert_eq!((&reused.json()["digest"], &reused.json()["priority"]), (&made["digest"], &json!(3)));
}

#[tokio::test]
async fn an_idempotency_key_gives_the_same_model() {
    let app = App::new().await;
    let key = [("idempotency-key", "k-1")];
    let first = app.post_with("/models", &key, &json!({ "labels": { "a": "1", "b": "2" }, "preset": "pig" })).await;
    assert_eq!((first.status.as_u16(), first.header("idempotency-replayed")), (202, None));
    // The same JSON value in another layout is the same request.
    let headers = [("content-type", "application/json"), key[0]];
    let again = r#"{ "preset" : "pig", "labels": {"b":"2", "a":"1"} }"#;
    let again = app.request(axum::http::Method::POST, "/models", &headers, again.into()).await;
    assert_eq!((again.status.as_u16(), again.header("idempotency-replayed")), (202, Some("true")));
    assert_eq!(again.json()["id"], first.json()["id"]);
    assert_eq!(again.json()["seed"], first.json()["seed"], "the drawn seed too");
    assert_eq!(again.header(header::LOCATION), first.header(header::LOCATION));

    let other = app.post_with("/models", &key, &json!({ "preset": "paper" })).await;
    assert_eq!((other.status.as_u16(), other.slug().as_str()), (422, "idempotency-key-reused"));
    let another = app.post_with("/models", &[("idempotency-key", "k-2")], &json!({ "preset": "pig" })).await;
    assert_ne!(another.json()["id"], first.json()["id"]);

    // An idempotency key is valid as long as its model exists.
    app.delete(&first.location()).await;
    let fresh = app.post_with("/models", &key, &json!({ "preset": "paper" })).await;
    assert_eq!((fresh.status.as_u16(), fresh.header("idempotency-replayed")), (202, None));
}

#[tokio::test]
async fn a_replay_of_an_ended_model_shows_it_as_it_is() {
    let app = App::new().await;
    let headers = [("idempotency-key", "k"), ("prefer", "wait=1")];
    let reply = app.post_with("/models", &headers[..1], &json!({ "seed": 1 })).await;
    app.store.cancel(id(&reply.location())).await.unwrap();
    let again = app.post_with("/models", &headers, &json!({ "seed": 1 })).await;
    assert_eq!((again.status.as_u16(), again.header("idempotency-replayed")), (200, Some("true")));
    assert_eq!(again.json()["status"], "cancelled");
}

#[tokio::test]
async fn a_piece_is_complete_at_its_last_step() {
    let app = App::new().await;
    let body = json!({ "seed": 7, "spec": { "piece": { "from": 0.4, "to": 0.5 } } });
    let first = app.post("/models", &body).await.location();
    let job = app.claim().await;
    app.finish(job, &files()).await;
    let progress = &app.get(&first).await.json()["progress"];
    let last = progress["steps"].as_u64().unwrap();
    assert!((200..1900).contains(&last) && progress["step"] == last, "{progress}");
}

#[tokio::test]
async fn a_finished_model_of_the_same_digest_is_reused() {
    let app = App::new().await;
    let body = json!({ "seed": 7 });
    let first = app.finished(7, &files()).await;
    let reply = app.post("/models", &body).await;
    assert_eq!(reply.status, 201);
    let model = reply.json();
    assert_eq!(model["status"], "succeeded");
    assert_eq!(model["reused_from"].as_str().unwrap(), id(&first).to_string());
    let location = reply.location();
    assert_ne!(location, first);
    assert_eq!(model["files"][0]["href"], format!("{}/files/model.glb", &location[1..]));

    // The files exist until the last of the models that share them is deleted.
    assert_eq!(app.delete(&first).await.status, 204);
    assert_eq!(app.get(&format!("{location}/files/model.glb")).await.body, "glTF");

    for other in [json!({ "seed": 7, "reuse": false }), json!({ "seed": 8 }), json!({ "seed": 7, "outputs": ["obj"] })]
    {
        assert_eq!(app.post("/models", &other).await.status, 202, "{other}");
    }
}

#[tokio::test]
async fn equal_requests_in_flight_share_one_growth() {
    let app = App::new().await;
    let first = app.model(7).await;
    let body = json!({ "seed": 7 });
    let wait = [("prefer", "wait=30"), ("idempotency-key", "k")];
    let (held, ()) = tokio::join!(app.post_with("/models", &wait, &body), async {
        while app.get("/models").await.json()["models"].as_array().unwrap().len() < 2 {
            tokio::task::yield_now().await;
        }
        let batch = app.post("/batches", &json!({ "seeds": [7, 8] })).await.json();
        assert_eq!(batch["counts"]["queued"], 2);
        app.finish(app.claim().await, &files()).await;
    });
    let model = held.json();
    assert_eq!((held.status.as_u16(), &model["status"]), (200, &json!("succeeded")), "{held:?}");
    assert_eq!(model["reused_from"].as_str().unwrap(), id(&first).to_string());
    assert_eq!((&model["attempts"], &model["started_at"]), (&json!(0), &Value::Null));
    assert_eq!(app.get(&format!("{}/files/model.glb", held.location())).await.body, "glTF");
    let again = app.post_with("/models", &wait[1..], &body).await;
    assert_eq!((again.status.as_u16(), again.header("idempotency-replayed")), (200, Some("true")));
    // Of the two models of the batch, only the one with the other seed remained to be grown.
    assert_eq!(app.claim().await.job().seed, 8);
    assert_eq!(app.get("/models?status=queued").await.json()["models"], json!([]));
}

#[tokio::test]
async fn a_model_whose_file_is_missing_is_not_reused() {
    let app = App::new().await;
    let first = app.finished(7, &files()).await;
    let file = app.store.get(id(&first)).await.unwrap().unwrap().files[0].key.clone();
    app.artifacts.delete(&[file]).await.unwrap();
    let again = app.post("/models", &json!({ "seed": 7 })).await;
    assert_eq!((again.status.as_u16(), &again.json()["reused_from"]), (202, &Value::Null));
    app.finish(app.claim().await, &files()).await;
    let reused = app.post("/models", &json!({ "seed": 7 })).await;
    assert_eq!((reused.status.as_u16(), &reused.json()["reused_from"]), (201, &again.json()["id"]));
}

/// The files contain the name of the preset.
#[tokio::test]
async fn a_model_of_another_preset_is_not_reused() {
    let app = App::new().await;
    let paper = app.post("/models", &json!({ "preset": "paper", "seed": 7 })).await.json();
    app.finish(app.claim().await, &files()).await;
    let echoed = json!({ "seed": 7, "spec": paper["spec"] });
    let pig = app.post("/models", &echoed).await;
    assert_eq!((pig.status.as_u16(), &pig.json()["digest"]), (202, &paper["digest"]));
    app.finish(app.claim().await, &files()).await;
    // Each preset has a finished model.
    let again = app.post("/models", &echoed).await;
    assert_eq!((again.status.as_u16(), &again.json()["reused_from"]), (201, &pig.json()["id"]));
    let again = app.post("/models", &json!({ "preset": "paper", "seed": 7 })).await;
    assert_eq!((again.status.as_u16(), &again.json()["reused_from"]), (201, &paper["id"]));
}

#[tokio::test]
async fn waiting_ends_with_the_model() {
    let app = App::new().await;
    let headers = [("prefer", "respond-async, wait=30")];
    let body = json!({ "seed": 7 });
    let (reply, ()) = tokio::join!(app.post_with("/models", &headers, &body), async {
        while app.get("/models").await.json()["models"] == json!([]) {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        let job = app.claim().await;
        app.finish(job, &files()).await;
    });
    assert_eq!(reply.status, 200);
    assert_eq!(reply.json()["status"], "succeeded");
    assert_eq!(reply.header("preference-applied"), Some("wait=30"));
    assert_eq!(reply.header(header::RETRY_AFTER), None);
}

#[tokio::test]
async fn waiting_ends_with_the_time() {
    let app = App::new().await;
    let reply = app.post_with("/models", &[("prefer", "wait=1")], &json!({})).await;
    assert_eq!(reply.status, 202);
    assert_eq!(reply.header("preference-applied"), Some("wait=1"));
    assert!(reply.header(header::RETRY_AFTER).is_some());
    let reply = app.post_with("/models", &[("prefer", "wait=soon")], &json!({})).await;
    assert_eq!((reply.status.as_u16(), reply.header("preference-applied")), (202, None));
}

#[tokio::test]
async fn waiting_ends_with_the_service() {
    let app = App::new().await;
    app.shutdown.cancel();
    let reply = app.post_with("/models", &[("prefer", "wait=60")], &json!({})).await;
    assert_eq!(reply.status, 202);
}

#[tokio::test]
async fn a_full_queue_refuses_and_everything_else_works() {
    let app = App::with(Limits::default(), 2).await;
    let models = [app.model(1).await, app.model(2).await];
    let reply = app.post("/models", &json!({ "seed": 3 })).await;
    assert_eq!((reply.status.as_u16(), reply.slug().as_str()), (429, "queue-full"));
    assert!(reply.header(header::RETRY_AFTER).unwrap().parse::<u32>().unwrap() > 0);
    assert_eq!(reply.json()["limit"], 2);
    assert_eq!(app.get(&models[0]).await.status, 200);
    assert_eq!(app.post(&format!("{}/cancel", models[0]), &json!({})).await.status, 200);
    assert_eq!(app.delete(&models[1]).await.status, 204);
    assert_eq!(app.post("/models", &json!({ "seed": 3 })).await.status, 202);
}

#[tokio::test]
async fn a_gpu_is_accepted_only_if_a_worker_is_alive() {
    let app = App::new().await;
    let body = json!({ "backend": "gpu" });
    let refused = app.post("/models", &body).await;
    assert_eq!((refused.status.as_u16(), refused.slug().as_str()), (422, "gpu-unavailable"));
    assert_eq!(refused.places(), ["/backend"]);
    app.worker(WorkerKind::Cpu).await;
    assert_eq!(app.post("/models", &body).await.status, 422);
    app.worker(WorkerKind::Gpu).await;
    assert_eq!(app.post("/models", &body).await.status, 202);
    app.clock.advance(Duration::from_secs(301));
    assert_eq!(app.post("/models", &body).await.status, 422);
}

#[tokio::test]
async fn a_model_that_costs_too_much_is_refused_with_the_prediction() {
    let limits = Limits {
        cost: oviduct::generate::CostLimits { max_vertices: 1000, ..Default::default() },
        ..Limits::default()
    };
    let app = App::with(limits, 10).await;
    for path in ["/models", "/models/validate"] {
        let reply = app.post(path, &json!({})).await;
        assert_eq!((reply.status.as_u16(), reply.slug().as_str()), (422, "cost-limit"));
        let problem = reply.json();
        assert_eq!(problem["limit"], json!({ "vertices": 1000.0 }));
        assert!(problem["prediction"]["vertices"].as_u64().unwrap() > 1000);
    }
}

/// In a cluster with autoscaling, GPU workers start only after jobs are queued.
#[tokio::test]
async fn an_expected_gpu_is_waited_for_in_the_queue() {
    let app = App::with(Limits { gpu_expected: true, ..Limits::default() }, 10).await;
    let reply = app.post("/models", &json!({ "backend": "gpu" })).await;
    assert_eq!((reply.status.as_u16(), reply.json()["status"].clone()), (202, json!("queued")));
}

#[tokio::test]
async fn a_request_for_a_gpu_waits_while_devices_are_opened() {
    let status = Status::default();
    status.set(Condition::OpeningDevices, "The process is opening 1 GPU.");
    let app = App::with(Limits { gpu_wait: Duration::from_millis(50), ..Limits::default() }, 10).await;
    let app = app.with_status(status.clone());
    app.expect_faults();
    let body = json!({ "backend": "gpu" });
    // While devices are being opened, the service does not know whether it has a GPU.
    let reply = app.post("/models", &body).await;
    assert_eq!((reply.status.as_u16(), reply.slug().as_str()), (503, "not-ready"));
    assert_eq!(reply.json()["condition"], "opening-devices");
    assert!(reply.header(header::RETRY_AFTER).is_some());
    assert_eq!(app.post("/models", &json!({ "backend": "cpu" })).await.status, 202);

    let app = App::with(Limits { gpu_wait: Duration::from_secs(60), ..Limits::default() }, 10).await;
    let app = app.with_status(status.clone());
    let (reply, ()) = tokio::join!(app.post("/models", &body), async {
        tokio::time::sleep(Duration::from_millis(50)).await;
        app.worker(WorkerKind::Gpu).await;
        status.clear(Condition::OpeningDevices);
    });
    assert_eq!(reply.status, 202);
}

#[tokio::test]
async fn warnings_of_the_summary_are_members_of_the_model() {
    let app = App::new().await;
    let model = app.model(7).await;
    assert_eq!(app.get(&model).await.json()["warnings"], json!([]), "none before the end");
    let warnings = json!([{ "code": "splits-missing", "detail": "3 of 20 splits are missing." }]);
    let summary = json!({ "sections": 201, "warnings": warnings });
    let engine = oviduct::ENGINE_VERSION.into();
    let job = app.claim().await;
    app.store.finish(job, Finished { backend: used(), files: vec![], summary, engine }).await.unwrap();
    assert_eq!(app.get(&model).await.json()["warnings"], warnings);
}
