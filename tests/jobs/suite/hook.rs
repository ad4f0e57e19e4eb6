//! Hooks into the calls of a store; the tests that inject faults or count calls depend on them.

use super::*;
use oviduct::jobs::Hook;
use std::sync::{Arc, Mutex};

/// Records all calls, fails one of them before it begins, and loses the response of another.
#[derive(Default)]
struct Recorder {
    calls: Mutex<Vec<&'static str>>,
    fails: Option<&'static str>,
    loses: Option<&'static str>,
}

fn injected() -> StoreError {
    StoreError::Database("injected".into())
}

impl Hook for Recorder {
    fn before<'a>(&'a self, call: &'static str) -> BoxFuture<'a, Result<(), StoreError>> {
        Box::pin(async move {
            self.calls.lock().unwrap().push(call);
            if self.fails == Some(call) { Err(injected()) } else { Ok(()) }
        })
    }

    fn after(&self, call: &'static str) -> Result<(), StoreError> {
        if self.loses == Some(call) { Err(injected()) } else { Ok(()) }
    }
}

pub async fn a_hook_fails_calls_and_loses_responses(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let fails = bench.store.with_hook(Arc::new(Recorder { fails: Some("submit"), ..Recorder::default() }));
    assert!(fails.submit(new_job("a")).await.unwrap_err().to_string().contains("injected"));
    assert_eq!(bench.store.counts().await.unwrap().total(), 0, "a call that fails does nothing");

    let loses = bench.store.with_hook(Arc::new(Recorder { loses: Some("submit"), ..Recorder::default() }));
    assert!(loses.submit(new_job("a")).await.unwrap_err().to_string().contains("injected"));
    assert_eq!(bench.store.counts().await.unwrap().queued, 1, "a call without a response has its effect");
    let loses = bench.store.with_hook(Arc::new(Recorder { loses: Some("claim"), ..Recorder::default() }));
    assert!(loses.claim("w", ClaimScope::Cpu, LEASE, 1).await.is_err());
    assert_eq!(bench.store.counts().await.unwrap().running, 1);
}

pub async fn a_hook_sees_the_calls_of_its_view_alone(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let recorder = Arc::new(Recorder::default());
    let view = bench.store.with_hook(Arc::<Recorder>::clone(&recorder));
    let job = view.submit(new_job("a")).await.unwrap().job().clone();
    bench.store.get(job.id).await.unwrap();
    let claimed = view.clone().claim("w", ClaimScope::Cpu, LEASE, 1).await.unwrap().pop().unwrap();
    view.heartbeat(&claimed, LEASE, &by_cpu(), None, None).await.unwrap();
    view.keys().await.unwrap();
    view.ready().await.unwrap();
    assert_eq!(*recorder.calls.lock().unwrap(), ["submit", "claim", "heartbeat", "keys", "ready"]);
}
