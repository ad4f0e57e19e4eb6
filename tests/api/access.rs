//! API keys, tickets and quotas: which callers may use which routes and see which resources.

use super::app::{App, Reply, used};
use axum::body::Body;
use axum::http::{Method, Request, header};
use futures_util::future::BoxFuture;
use http_body_util::BodyExt;
use oviduct::http::{Limits, WithoutKeys};
use oviduct::jobs::keys::{KeyLimits, Scope, Secret};
use oviduct::jobs::{Hook, Problem, Quota, StoreError, WorkerKind};
use serde_json::{Value, json};
use std::sync::Arc;
use std::time::Duration;

/// Access rule of an operation, by its id in `openapi.yaml`. A new route must be added here.
fn needs(operation: &str) -> Option<Needs> {
    Some(match operation {
        "get_health" | "get_readiness" | "get_docs" => Needs::Nothing,
        "list_presets" | "get_preset" | "get_schema" | "get_openapi" => Needs::Key,
        "list_models" | "get_model" | "validate_model" | "get_batch" | "follow_model" | "follow_all"
        | "download_file" | "get_report" | "get_section" | "get_course" | "cut_model" | "get_way" | "get_preview"
        | "get_report_page" | "get_manifest" | "list_workers" | "list_fits" | "get_fit" | "validate_fit"
        | "follow_fit" | "create_ticket" | "validate_batch" | "get_batch_table" | "get_batch_archive"
        | "list_batches" | "list_operations" | "get_operation" => Needs::Scope(Scope::Read),
        "retry_model" | "cancel_models" | "delete_models" | "cancel_batch" | "create_model" | "delete_model"
        | "create_fit" | "cancel_fit" | "delete_fit" | "cancel_model" | "create_batch" | "delete_batch"
        | "cancel_operation" => Needs::Scope(Scope::Submit),
        "get_metrics" | "pause_workers" | "resume_workers" | "pause_worker" | "resume_worker" | "drain_worker" => {
            Needs::Scope(Scope::Admin)
        }
        _ => return None,
    })
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Needs {
    Nothing,
    Key,
    Scope(Scope),
}

/// A route of the service, as `openapi.yaml` lists it.
#[derive(Debug)]
struct Route {
    method: Method,
    path: String,
    operation: String,
    needs: Needs,
}

fn routes() -> Vec<Route> {
    let document: Value = yaml_serde::from_str(&oviduct::http::openapi_yaml()).unwrap();
    let mut routes = Vec::new();
    for (path, item) in document["paths"].as_object().unwrap() {
        for (method, operation) in item.as_object().unwrap() {
            let id = operation["operationId"].as_str().unwrap().to_owned();
            let needs = needs(&id).unwrap_or_else(|| panic!("{method} {path} ({id}) has no rule in this test"));
            // The description states the rule that the service enforces.
            let keys = json!({ "bearer": [] });
            let security = match (needs, method.as_str()) {
                (Needs::Nothing, _) => json!([]),
                (_, "get") => json!([keys, { "ticket": [] }]),
                _ => json!([keys]),
            };
            assert_eq!(operation["security"], security, "{id}");
            let scope = match needs {
                Needs::Scope(scope) => json!(scope.name()),
                _ => Value::Null,
            };
            assert_eq!(operation["x-required-scope"], scope, "{id}");
            let method = method.to_uppercase().parse().unwrap();
            routes.push(Route { method, path: path.clone(), operation: id, needs });
        }
    }
    assert!(routes.len() > 20);
    routes
}

/// The resources of one owner.
struct Things {
    finished: String,
    queued: String,
    batch: String,
    fit: String,
    operation: String,
}

async fn post(app: &App, path: &str, key: &str, body: &Value) -> Reply {
    app.post_with(path, &[("authorization", key)], body).await
}

async fn things(app: &App, key: &str) -> Things {
    let id = |reply: &Reply| reply.json()["id"].as_str().unwrap().to_owned();
    let finished = id(&post(app, "/models", key, &json!({ "seed": 1, "reuse": false })).await);
    let report = json!({ "engine": "x", "spec": {}, "summary": {}, "certificate": {} }).to_string();
    app.finish(app.claim().await, &[("report.json", "application/json", report.into_bytes())]).await;
    let queued = id(&post(app, "/models", key, &json!({ "seed": 2 })).await);
    app.worker(WorkerKind::Cpu).await;
    let batch = id(&post(app, "/batches", key, &json!({ "seeds": [3, 4] })).await);
    let fit = post(app, "/fits", key, &fit_request()).await;
    let operation = app.operation(fit.json()["owner"].as_str()).await;
    Things { finished, queued, batch, fit: id(&fit), operation }
}

fn fit_request() -> Value {
    json!({ "targets": [{ "region": "whole", "quantity": "fill", "value": 0.7 }] })
}

/// A valid request to a route, about these resources.
fn request(route: &Route, things: &Things, credential: Option<&str>) -> Request<Body> {
    let id = match route.operation.as_str() {
        _ if route.path.starts_with("/batches") => &things.batch,
        _ if route.path.starts_with("/fits") => &things.fit,
        _ if route.path.starts_with("/operations") => &things.operation,
        _ if route.path.starts_with("/workers") => "w1",
        "cancel_model" | "follow_model" => &things.queued,
        _ => &things.finished,
    };
    let path = route
        .path
        .replace("{id}", id)
        .replace("{name}", if route.path.starts_with("/presets") { "pig" } else { "report.json" });
    let body = match route.operation.as_str() {
        "create_model" | "validate_model" => json!({ "seed": 9 }),
        "create_batch" | "validate_batch" => json!({ "seeds": [9] }),
        "create_fit" | "validate_fit" => fit_request(),
        "create_ticket" => json!({ "path": "/models" }),
        _ => Value::Null,
    };
    let path = match route.operation.as_str() {
        "cancel_models" | "delete_models" => format!("{path}?all=true"),
        _ => path.replace("{k}", "0"),
    };
    let mut request = Request::builder().method(&route.method).uri(path);
    if let Some(credential) = credential {
        request = request.header(header::AUTHORIZATION, credential);
    }
    let body = if body.is_null() { Body::empty() } else { Body::from(body.to_string()) };
    request.header(header::CONTENT_TYPE, "application/json").body(body).unwrap()
}

fn guarded(app: App) -> App {
    app.with_access(WithoutKeys::Nobody, KeyLimits::default())
}

#[tokio::test(flavor = "multi_thread")]
async fn every_route_asks_for_the_key_that_it_needs() {
    let app = guarded(App::new().await);
    let all = [Scope::Read, Scope::Submit];
    let mine = app.key("a", &all).await;
    let things = things(&app, &mine).await;
    let later = app.clock.now() + Duration::from_secs(60);
    let expired = app.key_with("a", &all, KeyLimits::default(), Some(later)).await;
    app.clock.advance(Duration::from_secs(61));
    let revoked = app.key("a", &all).await;
    app.store.revoke_key(&revoked["Bearer oviduct_".len()..][..8], Duration::ZERO).await.unwrap();
    let unknown = format!("Bearer {}", Secret::generate().reveal());
    // The prefix of a valid API key with a different secret.
    let forged = format!("{}{}", &mine[..mine.len() - 4], if mine.ends_with("0000") { "1111" } else { "0000" });
    let basic = format!("Basic {}", &mine["Bearer ".len()..]);
    let strangers =
        [None, Some(&*expired), Some(&revoked), Some(&unknown), Some(&forged), Some(&basic), Some("Bearer "), Some("")];
    for route in &routes() {
        for credential in strangers {
            let reply = app.start(request(route, &things, credential)).await;
            let what = format!("{} {} with {credential:?}", route.method, route.path);
            if route.needs == Needs::Nothing {
                assert_eq!(reply.status(), 200, "{what}");
                continue;
            }
            assert_eq!(reply.status(), 401, "{what}");
            assert!(reply.headers()[header::WWW_AUTHENTICATE].to_str().unwrap().starts_with("Bearer "), "{what}");
            let body = reply.into_body().collect().await.unwrap().to_bytes();
            let text = String::from_utf8_lossy(&body);
            assert!(!text.contains(&things.finished) || route.path.contains("{id}"), "{what}: {text}");
            for secret in [&mine, &expired, &forged] {
                assert!(!text.contains(&secret["Bearer oviduct_".len() + 9..]), "{what}: {text}");
            }
        }
    }
    // The refused requests changed nothing.
    let models = app.get_with("/models", &[("authorization", &mine)]).await.json();
    assert_eq!(models["models"].as_array().unwrap().len(), 4);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_key_allows_what_its_scopes_say() {
    for scope in Scope::ALL {
        for route in &routes() {
            // Deletions remove what the next route needs, so each route gets new resources.
            let app = guarded(App::new().await);
            let mine = app.key("a", &[Scope::Read, Scope::Submit]).await;
            let things = things(&app, &mine).await;
            let one = app.key("a", &[scope]).await;
            let reply = app.start(request(route, &things, Some(&one))).await;
            let allowed = match route.needs {
                Needs::Nothing | Needs::Key => true,
                Needs::Scope(needed) => needed == scope || scope == Scope::Admin,
            };
            let status = reply.status();
            let what = format!("{} {} with {scope}: {status}", route.method, route.path);
            // The finished model has no sections and cannot be retried.
            let refused = [
                ("get_section", 404),
                ("cut_model", 422),
                ("get_way", 404),
                ("get_preview", 404),
                ("get_report_page", 404),
                ("retry_model", 409),
            ];
            let served = status.is_success() || refused.contains(&(route.operation.as_str(), status.as_u16()));
            assert_eq!((served, status == 403), (allowed, !allowed), "{what}");
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn resources_of_other_owners_are_not_found() {
    for route in &routes() {
        let app = guarded(App::new().await);
        let mine = app.key("a", &[Scope::Read, Scope::Submit]).await;
        let things = things(&app, &mine).await;
        let other = app.key("b", &[Scope::Read, Scope::Submit]).await;
        let reply = app.start(request(route, &things, Some(&other))).await;
        let what = format!("{} {}", route.method, route.path);
        if route.path.contains("{id}") && route.needs != Needs::Scope(Scope::Admin) {
            assert_eq!(reply.status(), 404, "{what}");
        }
        if reply.headers().get(header::CONTENT_TYPE).is_some_and(|kind| kind == "text/event-stream") {
            continue;
        }
        let body = reply.into_body().collect().await.unwrap().to_bytes();
        let text = String::from_utf8_lossy(&body);
        for id in [&things.finished, &things.queued, &things.batch, &things.fit] {
            assert!(!text.contains(id.as_str()) || route.path.contains("{id}"), "{what}: {text}");
        }
        // The refused request deleted nothing.
        for id in [&things.finished, &things.queued] {
            let model = app.get_with(&format!("/models/{id}"), &[("authorization", &mine)]).await;
            assert_eq!(model.status, 200, "{what}");
            assert_ne!(model.json()["status"], "cancelled", "{what}");
        }
    }
}

#[tokio::test]
async fn lists_and_workers_show_own_models_and_everything_to_an_admin() {
    let app = guarded(App::new().await);
    let [a, b] = [app.key("a", &[Scope::Read, Scope::Submit]).await, app.key("b", &[Scope::Read, Scope::Submit]).await];
    let admin = app.key("root", &[Scope::Admin]).await;
    for (key, seed) in [(&a, 1), (&a, 2), (&b, 1)] {
        assert_eq!(post(&app, "/models", key, &json!({ "seed": seed })).await.status, 202);
    }
    let count = async |key: &str| {
        let list = app.get_with("/models", &[("authorization", key)]).await.json();
        list["models"].as_array().unwrap().len()
    };
    assert_eq!((count(&a).await, count(&b).await, count(&admin).await), (2, 1, 3));
    app.worker(WorkerKind::Cpu).await;
    let _job = app.claim().await;
    let jobs = async |key: &str| {
        let list = app.get_with("/workers", &[("authorization", key)]).await.json();
        list["workers"][0]["jobs"].as_array().unwrap().len()
    };
    assert_eq!((jobs(&a).await, jobs(&b).await, jobs(&admin).await), (1, 0, 1));
    // Only admins see hosts and, in the names of workers, process ids.
    let names = async |key: &str| {
        let list = app.get_with("/workers", &[("authorization", key)]).await.json();
        ["id", "host"].map(|member| list["workers"][0][member].as_str().unwrap().to_owned())
    };
    assert_eq!(names(&admin).await, ["w1", "here"]);
    let [id, host] = names(&a).await;
    assert!(id.starts_with("worker-") && host.starts_with("host-"), "{id} {host}");
    assert_eq!(names(&b).await, [id, host], "the pseudonyms are stable");
    // Each owner has a separate set of idempotency keys.
    for (key, status) in [(&a, 202), (&a, 202), (&b, 202)] {
        let headers = [("authorization", key.as_str()), ("idempotency-key", "same")];
        let reply = app.post_with("/models", &headers, &json!({ "seed": 77 })).await;
        assert_eq!(reply.status, status);
    }
    assert_eq!((count(&a).await, count(&b).await), (3, 2));
}

#[tokio::test]
async fn a_ticket_serves_one_get_of_its_path() {
    let app = guarded(App::new().await);
    let mine = app.key("a", &[Scope::Read, Scope::Submit]).await;
    let things = things(&app, &mine).await;
    let path = format!("/models/{}", things.finished);
    let ticket = async |path: &str| {
        let reply = post(&app, "/tickets", &mine, &json!({ "path": path })).await;
        assert_eq!((reply.status.as_u16(), reply.header(header::CACHE_CONTROL)), (201, Some("no-store")), "{reply:?}");
        reply.json()["ticket"].as_str().unwrap().to_owned()
    };
    let good = ticket(&path).await;
    assert_eq!(app.get(&format!("/models?ticket={good}")).await.status, 401, "it is for another path");
    let cancel = app.request(Method::POST, &format!("{path}/cancel?ticket={good}"), &[], Body::empty()).await;
    assert_eq!(cancel.status, 401, "it is for GET");
    assert_eq!(app.get(&format!("{path}?ticket={good}")).await.status, 200);
    assert_eq!(app.get(&format!("{path}?ticket={good}")).await.status, 401, "it was used");
    // A ticket may accompany other parameters; they are still validated.
    let list = ticket("/models").await;
    assert_eq!(app.get(&format!("/models?limit=1&ticket={list}")).await.status, 200);
    // A ticket has only the rights of its API key. Metrics require the scope `admin`.
    let metrics = ticket("/metrics").await;
    assert_eq!(app.get(&format!("/metrics?ticket={metrics}")).await.status, 403);
    let late = ticket(&path).await;
    app.clock.advance(Duration::from_secs(61));
    assert_eq!(app.get(&format!("{path}?ticket={late}")).await.status, 401, "a minute has passed");
    // Revoking the API key revokes its tickets.
    let orphan = ticket(&path).await;
    app.store.revoke_key(&mine["Bearer oviduct_".len()..][..8], Duration::ZERO).await.unwrap();
    assert_eq!(app.get(&format!("{path}?ticket={orphan}")).await.status, 401);
    for (body, place) in [
        (json!({}), "/path"),
        (json!({ "path": 1 }), "/path"),
        (json!({ "path": "models" }), "/path"),
        (json!({ "path": "/models?x=1" }), "/path"),
        (json!({ "path": "/models", "life": 5 }), "/life"),
        (json!([]), ""),
    ] {
        let key = app.key("a", &[Scope::Read]).await;
        let reply = post(&app, "/tickets", &key, &body).await;
        assert_eq!((reply.status.as_u16(), reply.places()), (422, vec![place.to_owned()]), "{body}");
    }
}

#[tokio::test]
async fn a_key_has_a_rate_and_a_quota() {
    let app = guarded(App::new().await);
    // A rate of one request per thousand seconds, with a burst of one.
    let slow = KeyLimits { rate: Some(0.001), quota: Quota::default() };
    let slow = app.key_with("a", &[Scope::Read], slow, None).await;
    let first = app.get_with("/models", &[("authorization", &slow)]).await;
    assert_eq!((first.status.as_u16(), first.header("ratelimit")), (200, Some("\"requests\";r=0;t=1000")));
    assert_eq!(first.header("ratelimit-policy"), Some("\"requests\";q=1;w=1000"));
    let second = app.get_with("/models", &[("authorization", &slow)]).await;
    assert_eq!((second.status.as_u16(), second.slug().as_str()), (429, "rate-limited"));
    let wait: u64 = second.header(header::RETRY_AFTER).unwrap().parse().unwrap();
    assert!((990..=1000).contains(&wait), "{wait}");
    // Probes do not count towards the rate, and other API keys of the owner have separate rates.
    assert_eq!(app.get_with("/healthz", &[("authorization", &slow)]).await.status, 200);
    let two = KeyLimits { rate: None, quota: Quota { unfinished: Some(2), bytes: None } };
    let two = app.key_with("a", &[Scope::Read, Scope::Submit], two, None).await;
    for seed in [1, 2] {
        let reply = post(&app, "/models", &two, &json!({ "seed": seed })).await;
        assert_eq!((reply.status.as_u16(), reply.header("ratelimit")), (202, None));
    }
    let full = post(&app, "/models", &two, &json!({ "seed": 3 })).await;
    assert_eq!((full.status.as_u16(), full.slug().as_str()), (429, "quota-exceeded"));
    assert_eq!(full.json()["limit"], 2);
    assert!(full.header(header::RETRY_AFTER).is_some());
    assert_eq!(full.header("ratelimit"), Some("\"models\";r=0"));
    assert_eq!(full.header("ratelimit-policy"), Some("\"models\";q=2;qu=\"models\""));
}

#[tokio::test]
async fn an_admin_retries_a_model_of_another_owner() {
    let app = guarded(App::new().await);
    let of = |models| KeyLimits { rate: None, quota: Quota { unfinished: Some(models), bytes: None } };
    let owner = app.key_with("a", &[Scope::Read, Scope::Submit], of(3), None).await;
    let admin = app.key_with("root", &[Scope::Admin], of(1), None).await;
    let model = post(&app, "/models", &owner, &json!({ "seed": 9 })).await.location();
    let problem = Problem { kind: "certificate".into(), title: "A fault".into(), detail: "somewhere".into() };
    app.store.fail(app.claim().await, used(), problem).await.unwrap();
    let retry = format!("{model}/retry");
    let as_who = |key: &str| [("authorization", key.to_owned()), ("idempotency-key", "again".to_owned())];
    let ask = async |key: &str| {
        let headers = as_who(key);
        let headers = headers.each_ref().map(|(name, value)| (*name, value.as_str()));
        app.post_with(&retry, &headers, &json!({})).await
    };
    // The admin's own quota is full, and the owner uses the same idempotency key.
    assert_eq!(post(&app, "/models", &admin, &json!({ "seed": 1 })).await.status, 202);
    let mine = ask(&owner).await;
    assert!(mine.status.is_success(), "{mine:?}");
    let theirs = ask(&admin).await;
    assert!(theirs.status.is_success(), "{theirs:?}");
    assert_ne!(mine.json()["id"], theirs.json()["id"]);
    assert_eq!(theirs.json()["owner"], "a");
    assert_eq!(ask(&admin).await.json()["id"], theirs.json()["id"]);
}

#[tokio::test]
async fn a_refused_request_does_not_use_up_its_ticket() {
    let app = guarded(App::new().await);
    // The burst admits two requests: one creates the ticket, the other uses up the rate.
    let limits = KeyLimits { rate: Some(0.21), quota: Quota::default() };
    let key = app.key_with("a", &[Scope::Read], limits, None).await;
    let ticket = post(&app, "/tickets", &key, &json!({ "path": "/models" })).await.json();
    let path = format!("/models?ticket={}", ticket["ticket"].as_str().unwrap());
    assert_eq!(app.get_with("/models", &[("authorization", &key)]).await.status, 200);
    let full = app.get(&path).await;
    assert_eq!(full.status, 429);
    let wait: u64 = full.header(header::RETRY_AFTER).unwrap().parse().unwrap();
    tokio::time::sleep(Duration::from_secs(wait)).await;
    assert_eq!(app.get(&path).await.status, 200);
    for text in ["x", "ovt_", &format!("ovt_{}", "0".repeat(64)), &format!("OVT_{}", "0".repeat(64))] {
        assert_eq!(app.get(&format!("/models?ticket={text}")).await.status, 401, "{text}");
    }
}

/// Makes every read of the API keys take longer than a request waits for it.
struct SlowKeyReads;

impl Hook for SlowKeyReads {
    fn before<'a>(&'a self, call: &'static str) -> BoxFuture<'a, Result<(), StoreError>> {
        Box::pin(async move {
            if call == "keys" {
                tokio::time::sleep(Duration::from_millis(600)).await;
            }
            Ok(())
        })
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_revoked_key_stops_working_although_the_store_is_slow() {
    let app = App::new().await;
    let store = app.store.with_hook(Arc::new(SlowKeyReads));
    let slow = guarded(App::over(store, app.clock.clone(), Limits::default()));
    let key = app.key("a", &[Scope::Read]).await;
    let status = async || slow.get_with("/models", &[("authorization", &key)]).await.status.as_u16();
    assert_eq!(status().await, 200);
    app.store.revoke_key(&key["Bearer oviduct_".len()..][..8], Duration::ZERO).await.unwrap();
    let ended = async { while status().await != 401 {} };
    tokio::time::timeout(Duration::from_secs(60), ended).await.expect("it goes on to work");
}

#[tokio::test]
async fn without_keys_only_this_machine_is_served() {
    let app = App::new().await.with_access(WithoutKeys::Loopback, KeyLimits::default());
    for host in ["localhost", "127.0.0.1:8080", "[::1]:8080"] {
        assert_eq!(app.get_with("/models", &[("host", host)]).await.status, 200, "{host}");
    }
    // DNS rebinding: a foreign host name that resolves to the loopback address.
    let rebound = app.get_with("/models", &[("host", "evil.example:8080")]).await;
    assert_eq!((rebound.status.as_u16(), rebound.slug().as_str()), (421, "unknown-host"));
    // A request from a page of another origin.
    let headers = [("host", "localhost:8080"), ("origin", "https://evil.example")];
    let posted = app.post_with("/models", &headers, &json!({ "seed": 1 })).await;
    assert_eq!((posted.status.as_u16(), posted.slug().as_str()), (403, "forbidden-origin"));
    let headers = [("host", "localhost:8080"), ("origin", "http://localhost:8080")];
    assert_eq!(app.post_with("/models", &headers, &json!({ "seed": 1 })).await.status, 202);
    // Without API keys no ticket is required, but a page may request and use one anyway.
    let ticket = app.post_with("/tickets", &headers, &json!({ "path": "/models" })).await;
    assert_eq!((ticket.status.as_u16(), &ticket.json()["expires_at"]), (201, &Value::Null));
    let ticket = ticket.json()["ticket"].as_str().unwrap().to_owned();
    assert_eq!(app.get_with(&format!("/models?ticket={ticket}"), &[("host", "localhost")]).await.status, 200);
    // The first API key makes authentication mandatory and ends the check of host names.
    let key = app.key("a", &[Scope::Read]).await;
    assert_eq!(app.get_with("/models", &[("host", "localhost")]).await.status, 401);
    assert_eq!(app.get_with("/models", &[("host", "lab.example"), ("authorization", &key)]).await.status, 200);
    // Revoking the only API key does not restore access without keys.
    app.store.revoke_key(&key["Bearer oviduct_".len()..][..8], Duration::ZERO).await.unwrap();
    assert_eq!(app.get_with("/models", &[("host", "localhost")]).await.status, 401);
}

#[tokio::test]
async fn a_service_that_waits_for_its_first_key_serves_nobody() {
    let app = guarded(App::new().await);
    assert_eq!(app.get_with("/models", &[("host", "localhost")]).await.status, 401);
    assert_eq!(app.get("/healthz").await.status, 200);
    assert_eq!(app.get("/").await.status, 200);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stream_of_all_models_contains_only_own_models() {
    let app = guarded(App::new().await);
    let [a, b] = [app.key("a", &[Scope::Read, Scope::Submit]).await, app.key("b", &[Scope::Read, Scope::Submit]).await];
    let mine = post(&app, "/models", &a, &json!({ "seed": 1 })).await.json()["id"].as_str().unwrap().to_owned();
    let request = Request::get("/events").header(header::AUTHORIZATION, &b).body(Body::empty()).unwrap();
    let mut stream = app.start(request).await.into_body();
    // First another owner's model changes, then one of the caller's own.
    post(&app, &format!("/models/{mine}/cancel"), &a, &json!({})).await;
    let own = post(&app, "/models", &b, &json!({ "seed": 2 })).await.json()["id"].as_str().unwrap().to_owned();
    let mut text = String::new();
    while !text.contains(&own) {
        let frame = tokio::time::timeout(Duration::from_secs(20), stream.frame()).await.unwrap().unwrap().unwrap();
        text += std::str::from_utf8(frame.data_ref().unwrap()).unwrap();
    }
    assert!(!text.contains(&mine), "{text}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stream_without_a_key_ends_when_there_are_keys() {
    let limits = Limits { event_comment: Duration::from_millis(50), ..Limits::default() };
    let app = App::with(limits, 100).await.with_access(WithoutKeys::Anyone, KeyLimits::default());
    let mut stream = app.start(Request::get("/events").body(Body::empty()).unwrap()).await.into_body();
    let mut next = async || tokio::time::timeout(Duration::from_secs(20), stream.frame()).await.unwrap();
    assert!(next().await.is_some() && next().await.is_some() && next().await.is_some(), "it stays open");
    app.key("a", &[Scope::Read]).await;
    while next().await.is_some() {}
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stream_ends_after_its_key_was_revoked() {
    let limits = Limits { event_comment: Duration::from_millis(50), ..Limits::default() };
    let app = guarded(App::with(limits, 100).await);
    let key = app.key("a", &[Scope::Read]).await;
    let request = Request::get("/events").header(header::AUTHORIZATION, &key).body(Body::empty()).unwrap();
    let mut stream = app.start(request).await.into_body();
    let mut next = async || tokio::time::timeout(Duration::from_secs(20), stream.frame()).await.unwrap();
    assert!(next().await.is_some(), "it is open");
    assert!(next().await.is_some(), "it stays open");
    app.store.revoke_key(&key["Bearer oviduct_".len()..][..8], Duration::ZERO).await.unwrap();
    while next().await.is_some() {}
}
