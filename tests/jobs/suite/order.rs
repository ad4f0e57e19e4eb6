//! Order of claims: priorities, turns of submitters, lanes.

use super::*;
use oviduct::jobs::Quota;

pub async fn submitters_take_turns(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let submit = async |who: &str, jobs: u32| {
        for n in 0..jobs {
            let new = NewJob { owner: Some(who.into()), ..new_job(&format!("{who}{n}")) };
            bench.store.submit(new).await.unwrap();
        }
    };
    let claim = async |jobs: usize| {
        let mut order = Vec::new();
        for _ in 0..jobs {
            order.push(bench.claim("w").await.unwrap().job().digest.clone());
        }
        order
    };
    submit("a", 6).await;
    submit("b", 3).await;
    assert_eq!(claim(3).await, ["a0", "b0", "a1"]);
    // A new submitter waits for at most one job of each other submitter. An idle submitter earns no
    // credit.
    submit("c", 2).await;
    assert_eq!(claim(8).await, ["b1", "c0", "a2", "b2", "c1", "a3", "a4", "a5"]);
    assert!(bench.claim("w").await.is_none());
}

pub async fn a_submitter_of_one_job_at_a_time_alternates_with_others(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let submit = async |who: &str, n: u32| {
        bench.submit(NewJob { owner: Some(who.into()), ..new_job(&format!("{who}{n}")) }).await;
    };
    for n in 0..8 {
        submit("a", n).await;
    }
    // Runs all the time; its turn says nothing about the present.
    let long = bench.claim("w").await.unwrap();
    let mut running = bench.claim("v").await.unwrap();
    let (mut order, mut next) = (Vec::new(), 0);
    for _ in 0..7 {
        // The submitter waits for the end of its job before it requests the next one.
        if running.job().owner.as_deref() == Some("a") {
            submit("b", next).await;
            next += 1;
        }
        bench.finish(running).await;
        running = bench.claim("v").await.unwrap();
        order.push(running.job().digest.clone());
    }
    // Only its first job waits for a job that was not yet running.
    assert_eq!(order, ["a2", "b0", "a3", "b1", "a4", "b2", "a5"]);
    bench.finish(long).await;
}

pub async fn a_released_job_keeps_its_turn(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    for n in 0..5 {
        bench.queue(&n.to_string()).await;
    }
    let first = bench.claim("w").await.unwrap();
    let second = bench.claim("w").await.unwrap();
    bench.store.release(first, None).await.unwrap();
    bench.queue("5").await;
    let mut order = Vec::new();
    while let Some(claimed) = bench.claim("w").await {
        order.push(claimed.job().digest.clone());
    }
    assert_eq!(order, ["0", "2", "3", "4", "5"]);
    bench.store.release(second, None).await.unwrap();
    assert_eq!(bench.claim("w").await.unwrap().job().digest, "1");
}

fn urgent(digest: &str, priority: i64) -> NewJob {
    NewJob { priority: priority.try_into().unwrap(), ..new_job(digest) }
}

impl Bench {
    pub(super) async fn submit(&self, new: NewJob) -> Job {
        self.store.submit(new).await.unwrap().job().clone()
    }

    /// Digests of the queued jobs, by position.
    async fn waiting(&self) -> Vec<String> {
        let page = self.store.list(&ListFilter { limit: 100, ..ListFilter::default() }).await.unwrap();
        let mut waiting: Vec<(u64, String)> =
            page.jobs.iter().filter_map(|job| Some((job.queue_position?, job.digest.clone()))).collect();
        waiting.sort();
        assert!(waiting.iter().map(|(at, _)| *at).eq(0..waiting.len() as u64), "{waiting:?}");
        for job in page.jobs {
            // A single read returns the same job as the page.
            assert_eq!(self.get(job.id).await, job);
        }
        waiting.into_iter().map(|(_, digest)| digest).collect()
    }

    /// Claims one job after another until none is due.
    async fn drain(&self) -> Vec<String> {
        let mut order = Vec::new();
        while let Some(claimed) = self.claim("w").await {
            order.push(claimed.job().digest.clone());
        }
        order
    }
}

/// Jobs of higher priority come first, within a priority the oldest; queue positions agree.
pub async fn the_higher_priority_goes_first(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    for (digest, priority) in [("a", 0), ("b", -100), ("c", 5), ("d", 100), ("e", 0), ("f", 5), ("g", -1), ("h", 100)] {
        let job = bench.submit(urgent(digest, priority)).await;
        assert_eq!(job.priority.get(), priority);
    }
    let order = ["d", "h", "c", "f", "a", "e", "g", "b"];
    assert_eq!(bench.waiting().await, order);
    assert_eq!(bench.claim("w").await.unwrap().job().digest, "d");
    // A later job with a priority in between.
    assert_eq!(bench.submit(urgent("i", 50)).await.queue_position, Some(1));
    assert_eq!(bench.drain().await, ["h", "i", "c", "f", "a", "e", "g", "b"]);
    // The digest does not include the priority, so a finished model is reused whatever its
    // priority.
    let made = bench.succeed("j").await;
    let reused = bench.submit(urgent("j", 9)).await;
    assert_eq!((reused.reused_from, reused.priority.get(), made.priority.get()), (Some(made.id), 9, 0));
}

/// Turns are counted per priority. A submitter with many urgent jobs delays neither the urgent jobs
/// of others nor its own turn at lower priorities.
pub async fn submitters_take_turns_within_a_priority(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    for (who, priority, jobs) in [("a", 0, 4), ("a", 7, 4), ("b", 0, 2), ("b", 7, 2), ("c", 7, 1)] {
        for n in 0..jobs {
            let new = NewJob { owner: Some(who.into()), ..urgent(&format!("{who}{priority}{n}"), priority) };
            bench.submit(new).await;
        }
    }
    let order = ["a70", "b70", "c70", "a71", "b71", "a72", "a73", "a00", "b00", "a01", "b01", "a02", "a03"];
    assert_eq!(bench.waiting().await, order);
    assert_eq!(bench.drain().await, order);
}

/// A job that is released or retried, or whose lease expires, returns to its place among the jobs
/// of its priority.
pub async fn a_released_job_keeps_its_priority_and_turn(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    for (digest, priority) in [("a", 3), ("b", 3), ("c", 3), ("d", 3), ("e", 0)] {
        bench.submit(urgent(digest, priority)).await;
    }
    let released = bench.claim("w").await.unwrap();
    let retried = bench.claim("w").await.unwrap();
    let _expires = bench.claim("w").await.unwrap();
    assert_eq!(bench.waiting().await, ["d", "e"]);
    bench.store.release(released, None).await.unwrap();
    let retried = bench.retry(retried).await;
    assert_eq!((retried.priority.get(), retried.queue_position), (3, Some(1)));
    bench.submit(urgent("f", 3)).await;
    bench.submit(urgent("g", 4)).await;
    assert_eq!(bench.waiting().await, ["g", "a", "b", "d", "f", "e"]);
    bench.clock.advance(LEASE);
    assert_eq!(bench.claim("w").await.unwrap().job().digest, "g");
    assert_eq!(bench.waiting().await, ["a", "b", "c", "d", "f", "e"]);
    assert_eq!(bench.drain().await, ["a", "b", "c", "d", "f", "e"]);
}

/// Of the heads of all lanes, the one with the highest priority is claimed first, then the oldest.
/// Each lane keeps its order.
pub async fn a_claim_of_several_takes_due_jobs_of_all_lanes(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let ask = async |digest: &str, backend, who: &str, priority| {
        bench.submit(NewJob { backend, owner: Some(who.into()), ..urgent(digest, priority) }).await;
    };
    // In the lane `auto`, the last job precedes the second, because its submitter has not had a
    // turn.
    ask("auto 1", Backend::Auto, "x", 0).await;
    ask("auto 3", Backend::Auto, "x", 0).await;
    ask("cpu 1", Backend::Cpu, "x", 0).await;
    ask("cpu urgent", Backend::Cpu, "x", 1).await;
    ask("auto 2", Backend::Auto, "y", 0).await;
    ask("single 1", Backend::CpuSingle, "x", 0).await;
    for (scope, waiting) in [(ClaimScope::Gpu, 3), (ClaimScope::Cpu, 6), (ClaimScope::CpuOnly, 3)] {
        assert_eq!(bench.store.count_claimable_jobs(scope).await.unwrap(), waiting, "{scope:?}");
    }
    let order = ["cpu urgent", "auto 1", "cpu 1", "auto 2", "auto 3", "single 1"];
    for limit in [1, 2, 4, 9] {
        let mut claimed = Vec::new();
        while claimed.len() < order.len() {
            claimed.extend(bench.store.claim("w", ClaimScope::Cpu, LEASE, limit).await.unwrap());
        }
        let digests: Vec<&str> = claimed.iter().map(|claimed| claimed.job().digest.as_str()).collect();
        assert_eq!(digests, order, "{limit} at a time");
        for claimed in claimed {
            bench.store.release(claimed, None).await.unwrap();
        }
    }
}

/// The priority of a batch applies to all its jobs.
pub async fn a_batch_has_one_priority(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    bench.submit(urgent("a", 2)).await;
    let jobs = vec![new_job("b"), new_job("c")];
    let batch = NewBatch {
        jobs,
        owner: None,
        quota: Default::default(),
        priority: 3.try_into().unwrap(),
        study: None,
        idempotency: None,
    };
    let batch = bench.store.submit_batch(batch).await.unwrap().batch().clone();
    assert_eq!(batch.priority.get(), 3);
    assert_eq!(bench.waiting().await, ["b", "c", "a"]);
    bench.store.delete(batch.jobs[0]).await.unwrap();
    assert_eq!(bench.store.batch(batch.id).await.unwrap().unwrap().priority.get(), 3);
}

/// A GPU worker claims the first due job, and with it only jobs that can run in the same GPU batch.
pub async fn a_gpu_claims_due_jobs_of_one_batch_key(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let ask = async |digest: &str, backend, key: Option<&str>, priority| {
        let new = NewJob { backend, batch_key: key.map(str::to_owned), ..urgent(digest, priority) };
        bench.submit(new).await;
    };
    use Backend::{Auto, Cpu, Gpu};
    ask("small 1", Auto, Some("small"), 0).await;
    ask("large 1", Auto, Some("large"), 0).await;
    ask("small 2", Gpu, Some("small"), 0).await;
    ask("small on a CPU", Cpu, Some("small"), 9).await;
    ask("alone 1", Gpu, None, 1).await;
    ask("small 4", Auto, Some("small"), -5).await;
    ask("small 3", Auto, Some("small"), 0).await;
    ask("large 2", Gpu, Some("large"), 1).await;
    ask("alone 2", Auto, None, -9).await;
    let claim = async |limit| {
        let claimed = bench.store.claim("w", ClaimScope::Gpu, LEASE, limit).await.unwrap();
        claimed.iter().map(|claimed| claimed.job().digest.clone()).collect::<Vec<_>>()
    };
    assert_eq!(claim(16).await, ["alone 1"], "without a key: alone");
    assert_eq!(claim(16).await, ["large 2", "large 1"]);
    assert_eq!(claim(3).await, ["small 1", "small 2", "small 3"]);
    assert_eq!(claim(1).await, ["small 4"]);
    assert_eq!(claim(16).await, ["alone 2"]);
    assert_eq!(claim(16).await, Vec::<String>::new());
    assert_eq!(bench.drain().await, ["small on a CPU"]);
}

pub async fn a_gpu_claim_passes_over_jobs_that_are_not_due(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    for digest in ["a", "b", "c"] {
        bench.submit(urgent(digest, 0)).await;
    }
    let mut claimed = bench.store.claim("w", ClaimScope::Gpu, LEASE, 3).await.unwrap();
    assert_eq!(claimed.len(), 3);
    bench.store.retry(claimed.remove(1), problem("io")).await.unwrap();
    for claimed in claimed {
        bench.store.release(claimed, None).await.unwrap();
    }
    let digests = async || {
        let claimed = bench.store.claim("w", ClaimScope::Gpu, LEASE, 3).await.unwrap();
        claimed.iter().map(|claimed| claimed.job().digest.clone()).collect::<Vec<_>>()
    };
    assert_eq!(digests().await, ["a", "c"]);
    bench.clock.advance(Duration::from_secs(1));
    assert_eq!(digests().await, ["b"]);
}

fn fit_of(owner: &str, digest: &str) -> NewJob {
    NewJob { kind: JobKind::Fit, backend: Backend::Cpu, owner: Some(owner.into()), reuse: false, ..new_job(digest) }
}

impl Bench {
    async fn claim_fit(&self) -> Option<ClaimedJob> {
        self.store.claim("w", ClaimScope::Fits, LEASE, 1).await.unwrap().pop()
    }
}

pub async fn fits_and_models_are_claimed_separately(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let fit = bench.submit(fit_of("a", "fit")).await;
    let model = bench.submit(NewJob { backend: Backend::Cpu, owner: Some("a".into()), ..new_job("model") }).await;
    assert_eq!((fit.queue_position, model.queue_position), (Some(0), Some(0)));
    assert_eq!(bench.get(model.id).await.queue_position, Some(0));
    assert_eq!(bench.store.count_claimable_jobs(ClaimScope::Fits).await.unwrap(), 1);
    assert_eq!(bench.claim("w").await.unwrap().job().id, model.id);
    assert!(bench.claim("w").await.is_none());
    let claimed = bench.claim_fit().await.unwrap();
    assert_eq!((claimed.job().id, claimed.job().backend.requested), (fit.id, Backend::Cpu));
    assert!(bench.claim_fit().await.is_none());
}

pub async fn fits_of_different_owners_take_turns(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    for digest in ["a0", "a1"] {
        bench.submit(fit_of("a", digest)).await;
    }
    let running = bench.claim_fit().await.unwrap();
    assert!(!bench.store.fit_waits(&running).await.unwrap(), "only a fit of the same owner waits");
    for (owner, digest) in [("b", "b0"), ("c", "c0")] {
        bench.submit(fit_of(owner, digest)).await;
    }
    let (mut running, mut order) = (running, Vec::new());
    for _ in 0..6 {
        assert!(bench.store.fit_waits(&running).await.unwrap());
        bench.store.yield_turn(running).await.unwrap();
        running = bench.claim_fit().await.unwrap();
        order.push(running.job().digest.clone());
    }
    assert_eq!(order, ["a1", "b0", "c0", "a0", "a1", "b0"]);
    assert_eq!(bench.get(running.job().id).await.attempts, 2);
    // A fit that was cancelled in the meantime ends.
    let id = running.job().id;
    bench.store.cancel(id).await.unwrap();
    bench.store.yield_turn(running).await.unwrap();
    assert_eq!(bench.get(id).await.status, Status::Cancelled);
    // A fit of higher priority goes first, also if it is of the same owner.
    let running = bench.claim_fit().await.unwrap();
    assert_eq!(running.job().digest, "a0");
    bench.submit(NewJob { priority: 1.try_into().unwrap(), ..fit_of("a", "urgent") }).await;
    bench.store.yield_turn(running).await.unwrap();
    let urgent = bench.claim_fit().await.unwrap();
    assert_eq!(urgent.job().digest, "urgent");
    assert!(!bench.store.fit_waits(&urgent).await.unwrap(), "less urgent ones do not count");
}

/// A CPU worker that runs a long model claims short ones in their order; all other claims ignore
/// the length.
pub async fn short_models_are_claimed_alone_or_with_all_others(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let ask = async |digest: &str, backend, who: &str, priority, short| {
        bench.submit(NewJob { backend, short, owner: Some(who.into()), ..urgent(digest, priority) }).await;
    };
    use Backend::{Auto, Cpu, CpuSingle, Gpu};
    ask("long", Cpu, "x", 9, false).await;
    ask("x 1", Auto, "x", 0, true).await;
    ask("x 2", Auto, "x", 0, true).await;
    ask("y 1", Auto, "y", 0, true).await;
    ask("gpu", Gpu, "x", 9, true).await;
    ask("single", CpuSingle, "y", 1, true).await;
    let claim = async |scope, limit| {
        let claimed = bench.store.claim("w", scope, LEASE, limit).await.unwrap();
        let digests: Vec<String> = claimed.iter().map(|claimed| claimed.job().digest.clone()).collect();
        for claimed in claimed {
            bench.store.release(claimed, None).await.unwrap();
        }
        digests
    };
    for limit in [1, 9] {
        assert_eq!(claim(ClaimScope::CpuShort, limit).await, ["single", "x 1", "y 1", "x 2"][..limit.min(4) as usize]);
    }
    assert_eq!(claim(ClaimScope::CpuOnlyShort, 9).await, ["single"]);
    assert_eq!(claim(ClaimScope::Cpu, 9).await, ["long", "single", "x 1", "y 1", "x 2"]);
    assert_eq!(claim(ClaimScope::Gpu, 9).await, ["gpu", "x 1", "y 1", "x 2"]);
    let claimed = bench.store.claim("w", ClaimScope::CpuShort, LEASE, 9).await.unwrap();
    assert_eq!(claimed.len(), 4);
    assert!(claim(ClaimScope::CpuShort, 9).await.is_empty(), "the long one stays");
}

pub async fn a_fit_counts_by_its_weight(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let quota = Quota { unfinished: Some(10), bytes: None };
    let fit = |digest: &str, weight| NewJob { quota, weight, ..fit_of("a", digest) };
    let model = |digest: &str| NewJob { quota, owner: Some("a".into()), ..new_job(digest) };
    bench.submit(fit("1", 6)).await;
    bench.submit(model("2")).await;
    let refused = bench.store.submit(fit("3", 4)).await.unwrap_err();
    assert!(matches!(refused, StoreError::QuotaExceeded { used: 7, more: 4, limit: 10, .. }), "{refused:?}");
    let running = bench.claim_fit().await.unwrap();
    assert!(bench.store.submit(fit("3", 4)).await.is_err(), "a running fit counts");
    bench.submit(fit("3", 3)).await;
    assert!(bench.store.submit(model("4")).await.is_err());
    let done = finished(&running);
    bench.store.finish(running, done).await.unwrap();
    for digest in ["4", "5", "6", "7", "8", "9"] {
        bench.submit(model(digest)).await;
    }
    assert!(bench.store.submit(model("10")).await.is_err(), "4 models and 3 for the fit, and 3 more");
}
