//! `Prefer: wait` when the store fails, other models change, or many requests wait.

use super::app::{App, Reply, id};
use super::wire::Wire;
use oviduct::http::Limits;
use oviduct::jobs::ListFilter;
use serde_json::json;
use std::time::Duration;

fn limits() -> Limits {
    Limits { event_poll: Duration::from_millis(20), ..Limits::default() }
}

async fn ask(app: &App, prefer: &str, seed: u64) -> Reply {
    app.post_with("/models", &[("prefer", prefer)], &json!({ "seed": seed })).await
}

/// Once a model is queued, a failure of the store must not look like a refusal: the client would
/// retry the request and get a second model.
#[tokio::test]
async fn a_queued_model_is_never_reported_as_refused() {
    let (app, wire) = Wire::app(limits(), None).await;
    wire.set_broken(true);
    let reply = ask(&app, "wait=1", 1).await;
    assert_eq!((reply.status.as_u16(), reply.json()["status"].clone()), (202, json!("queued")));
    wire.set_broken(false);
    assert_eq!(app.get(&reply.location()).await.json(), reply.json());
}

#[tokio::test]
async fn a_store_that_comes_back_is_waited_for() {
    let (app, wire) = Wire::app(limits(), None).await;
    wire.set_broken(true);
    let (reply, ()) = tokio::join!(ask(&app, "wait=60", 1), async {
        for _ in 0..4000 {
            if wire.reads() >= 3 {
                break;
            }
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        assert!(wire.reads() >= 3, "it reads again");
        let model = app.get("/models").await.json()["models"][0]["id"].as_str().unwrap().to_owned();
        app.store.cancel(id(&format!("/models/{model}"))).await.unwrap();
        wire.set_broken(false);
    });
    assert_eq!((reply.status.as_u16(), reply.json()["status"].clone()), (200, json!("cancelled")));
}

/// Otherwise a thousand held responses would read a thousand models at each change of any model.
#[tokio::test]
async fn changes_of_other_models_cost_held_responses_nothing() {
    let (app, wire) = Wire::app(Limits { event_poll: Duration::from_secs(60), ..Limits::default() }, None).await;
    app.model(1).await;
    let job = app.claim().await;
    let (reply, ()) = tokio::join!(ask(&app, "wait=2", 2), async {
        for step in 1..=20 {
            app.beat(&job, step, None).await;
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    });
    assert_eq!(reply.status, 202);
    assert!(wire.reads() <= 2, "{} reads", wire.reads());
}

#[tokio::test]
async fn there_is_a_limit_to_held_responses() {
    let (app, wire) = Wire::app(Limits { held: 1, ..limits() }, None).await;
    let (held, ()) = tokio::join!(ask(&app, "wait=60", 1), async {
        while wire.reads() == 0 {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        let model = app.claim().await.job().id;
        let reply = ask(&app, "wait=60", 2).await;
        assert_eq!((reply.status.as_u16(), reply.header("preference-applied")), (202, None), "it is sent at once");
        app.store.delete(model).await.unwrap();
    });
    assert_eq!((held.status.as_u16(), held.header("preference-applied")), (202, Some("wait=60")));
    let (reply, ()) = tokio::join!(ask(&app, "wait=60", 3), async {
        while app.store.list(&ListFilter { limit: 9, ..ListFilter::default() }).await.unwrap().jobs.len() < 2 {
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        for job in app.store.list(&ListFilter { limit: 9, ..ListFilter::default() }).await.unwrap().jobs {
            app.store.cancel(job.id).await.unwrap();
        }
    });
    assert_eq!(
        (reply.status.as_u16(), reply.header("preference-applied")),
        (200, Some("wait=60")),
        "there is room again"
    );
}
