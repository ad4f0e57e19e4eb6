//! Oversized requests: responses stay short and state how many faults they omit.

use super::app::{App, Reply};
use axum::body::Body;
use axum::http::{Method, header};
use serde_json::{Value, json};

async fn raw(app: &App, path: &str, body: String) -> Reply {
    assert!(body.len() <= 1 << 20);
    app.request(Method::POST, path, &[("content-type", "application/json")], Body::from(body)).await
}

fn is_short(reply: &Reply) {
    assert_eq!((reply.status.as_u16(), reply.slug().as_str()), (422, "invalid-request"));
    assert!(reply.body.len() < 64 << 10, "{} bytes", reply.body.len());
    assert!(!reply.places().is_empty());
}

#[tokio::test]
async fn tens_of_thousands_of_faults_give_a_short_response() {
    let app = App::new().await;
    let many = |n: usize, item: fn(usize) -> String| (0..n).map(item).collect::<Vec<_>>().join(",");
    let ones = many(49_000, |_| "1".into());
    let bodies = [
        format!("{{\"outputs\":[{ones}]}}"),
        format!("{{{}}}", many(49_000, |n| format!("\"a{n}\":0"))),
        format!("{{\"labels\":{{{}}}}}", many(49_000, |n| format!("\"a{n}\":0"))),
        format!("{{\"spec\":{{{}}}}}", many(49_000, |n| format!("\"a{n}\":0"))),
        format!("{{\"spec\":{{\"friction\":{{\"keys\":[{ones}]}}}}}}"),
        format!("{{\"spec\":{{\"{}\":0}}}}", "x".repeat(1_000_000)),
        format!("{{\"{}\":0}}", "x".repeat(1_000_000)),
        format!("{{\"preset\":\"{}\"}}", "x".repeat(1_000_000)),
        format!("{{\"seed\":\"{}\"}}", "x".repeat(1_000_000)),
    ];
    for body in bodies {
        is_short(&raw(&app, "/models", body).await);
    }
    is_short(&raw(&app, "/batches", format!("{{\"seeds\":[{ones}]}}")).await);
    is_short(&app.get(&format!("/models?{}", "limit=&".repeat(9000))).await);
}

#[tokio::test]
async fn omitted_faults_are_counted() {
    let app = App::new().await;
    let body: Value = (0..250).map(|n| (format!("m{n:03}"), json!(0))).collect::<serde_json::Map<_, _>>().into();
    let problem = app.post("/models", &body).await.json();
    assert_eq!((problem["errors"].as_array().unwrap().len(), &problem["errors_left_out"]), (100, &json!(150)));
    assert!(problem["detail"].as_str().unwrap().contains("250 values"));
    assert_eq!(app.post("/models", &json!({ "sede": 1 })).await.json().get("errors_left_out"), None);
}

#[tokio::test]
async fn a_search_that_a_database_would_refuse_is_refused() {
    let app = App::new().await;
    let labels = |n: usize| (0..n).map(|n| format!("label=k{n}:v")).collect::<Vec<_>>().join("&");
    for (query, place) in [
        ("preset=%00".to_owned(), "preset"),
        ("preset=pig%00".to_owned(), "preset"),
        ("label=a:%00".to_owned(), "label"),
        ("label=a%00:b".to_owned(), "label"),
        (labels(17), "label"),
    ] {
        let reply = app.get(&format!("/models?{query}")).await;
        assert_eq!((reply.status.as_u16(), reply.places()), (422, vec![place.to_owned()]), "{query}");
    }
    // The longest request line that the HTTP server accepts.
    is_short(&app.get(&format!("/models?{}", labels(4000))).await);
    assert_eq!(app.get(&format!("/models?{}", labels(16))).await.json()["models"], json!([]));
    assert_eq!(app.post("/models", &json!({ "labels": { "a": "\0" } })).await.places(), ["/labels/a"]);
    assert_eq!(app.post("/models", &json!({ "labels": { "\0": "a" } })).await.status, 422);
}

#[tokio::test]
async fn an_idempotency_key_with_invisible_characters_is_refused() {
    let app = App::new().await;
    for key in [&b"k\xff"[..], b"k\x7fk", "schlüssel".as_bytes(), b"a\tb"] {
        let Ok(value) = header::HeaderValue::from_bytes(key) else { continue };
        let request = axum::http::Request::post("/models").header("content-type", "application/json");
        let reply = app.send(request.header("idempotency-key", value).body(Body::from("{}")).unwrap()).await;
        assert_eq!((reply.status.as_u16(), reply.places()), (422, vec!["idempotency-key".to_owned()]));
    }
}
