//! Lists of jobs, queue positions, lists of workers.

use super::*;

pub async fn lists_are_filtered_and_paged(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let mut ids = Vec::new();
    for n in 0..23 {
        let mut new = new_job(&n.to_string());
        new.preset = if n % 2 == 0 { "pig" } else { "paper" }.into();
        new.labels = BTreeMap::from([("n".into(), (n % 3).to_string()), ("all".into(), "yes".into())]);
        ids.push(bench.store.submit(new).await.unwrap().job().id);
    }
    bench.store.cancel(ids[4]).await.unwrap();
    assert!(ids.is_sorted(), "ids are in order of age");
    let all = ListFilter { limit: 10, ..ListFilter::default() };
    let mut seen = Vec::new();
    let mut filter = all.clone();
    loop {
        let page = bench.store.list(&filter).await.unwrap();
        assert!(page.jobs.len() <= 10);
        seen.extend(page.jobs.iter().map(|job| job.id));
        let Some(next) = page.next else { break };
        filter.before = Some(next);
        // Jobs submitted in the meantime do not shift the pages.
        bench.queue(&format!("late {next}")).await;
    }
    ids.reverse();
    assert_eq!(seen, ids);
    ids.reverse();

    let select = |filter: ListFilter| {
        let store = bench.store.clone();
        async move {
            let page = store.list(&ListFilter { limit: 100, ..filter }).await.unwrap();
            assert_eq!(page.next, None);
            let mut found: Vec<JobId> = page.jobs.iter().map(|job| job.id).collect();
            found.reverse();
            found
        }
    };
    let label = |n: &str| vec![("n".to_owned(), n.to_owned()), ("all".to_owned(), "yes".to_owned())];
    let expect = |keep: &dyn Fn(usize) -> bool| -> Vec<JobId> {
        ids.iter().enumerate().filter(|(n, _)| keep(*n)).map(|(_, id)| *id).collect()
    };
    let found = select(ListFilter { labels: label("1"), ..ListFilter::default() }).await;
    assert_eq!(found, expect(&|n| n % 3 == 1));
    let found = select(ListFilter { labels: label("1"), preset: Some("paper".into()), ..ListFilter::default() }).await;
    assert_eq!(found, expect(&|n| n % 3 == 1 && n % 2 == 1));
    let found = select(ListFilter { status: Some(Status::Cancelled), ..ListFilter::default() }).await;
    assert_eq!(found, [ids[4]]);
    let found = select(ListFilter { labels: label("7"), ..ListFilter::default() }).await;
    assert!(found.is_empty());
}

pub async fn queue_positions_are_by_age(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let mut ids = Vec::new();
    for n in 0..4 {
        let job = bench.queue(&n.to_string()).await;
        assert_eq!(job.queue_position, Some(n));
        ids.push(job.id);
    }
    bench.store.cancel(ids[1]).await.unwrap();
    let claimed = bench.claim("w").await.unwrap();
    assert_eq!(claimed.job().id, ids[0]);
    let positions = async || {
        let page = bench.store.list(&ListFilter { limit: 10, ..ListFilter::default() }).await.unwrap();
        page.jobs.iter().rev().map(|job| job.queue_position).collect::<Vec<_>>()
    };
    assert_eq!(positions().await, [None, None, Some(0), Some(1)]);
    // A released job returns to its old place.
    bench.store.release(claimed, None).await.unwrap();
    assert_eq!(positions().await, [Some(0), None, Some(1), Some(2)]);
}

pub async fn workers_are_seen(factory: Factory) {
    let bench = bench(factory, |_| {}).await;
    let seen = |id: &str, jobs_done: u64, heartbeat_at: Timestamp| WorkerInfo {
        id: id.into(),
        host: "host".into(),
        kind: WorkerKind::Cpu,
        device: "cpu, 2 threads".into(),
        jobs: Vec::new(),
        jobs_done,
        heartbeat_at,
        pause: None,
        condition: None,
    };
    bench.store.worker_seen(&seen("b", 0, bench.clock.now())).await.unwrap();
    bench.clock.advance(Duration::from_secs(200));
    let (first, last) = (seen("a", 0, bench.clock.now()), seen("a", 3, bench.clock.now()));
    bench.store.worker_seen(&first).await.unwrap();
    let workers = bench.store.workers().await.unwrap();
    assert_eq!((workers.len(), &workers[0]), (2, &first));
    // A worker's jobs are the jobs whose leases it holds.
    let mut running = Vec::new();
    for n in 0..3 {
        running.push(bench.queue(&n.to_string()).await.id);
    }
    let urgent = NewJob { priority: 1.try_into().unwrap(), ..new_job("urgent") };
    running.push(bench.store.submit(urgent).await.unwrap().job().id);
    let mut claimed = bench.store.claim("a", ClaimScope::Cpu, LEASE, 4).await.unwrap();
    let jobs = async || bench.store.workers().await.unwrap().into_iter().map(|worker| worker.jobs).collect::<Vec<_>>();
    assert_eq!(jobs().await, [running.clone(), vec![]], "the oldest first");
    bench.store.release(claimed.swap_remove(0), None).await.unwrap();
    assert_eq!(jobs().await, [running[..3].to_vec(), vec![]]);
    for claimed in claimed {
        let done = finished(&claimed);
        bench.store.finish(claimed, done).await.unwrap();
    }
    bench.store.worker_seen(&last).await.unwrap();
    bench.clock.advance(Duration::from_secs(200));
    assert_eq!(bench.store.workers().await.unwrap(), std::slice::from_ref(&last));
    // A pause outlives the process of the worker, also until its name is used again.
    assert!(bench.store.instruct("a", Instruction::Pause, None).await.unwrap());
    bench.store.worker_stopped("a").await.unwrap();
    assert_eq!(bench.store.workers().await.unwrap(), []);
    assert!(!bench.store.instruct("a", Instruction::Resume, None).await.unwrap());
    assert_eq!(bench.store.count_live_workers(WorkerKind::Cpu, LEASE).await.unwrap(), 0);
    assert_eq!(bench.store.workforce(LEASE).await.unwrap(), Workforce::default());
    bench.store.worker_seen(&last).await.unwrap();
    assert_eq!(bench.store.workers().await.unwrap()[0].state(), WorkerState::Paused);
}
