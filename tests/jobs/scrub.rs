//! Comparison of a whole artifact store with the records, on both databases and both artifact
//! stores.

use crate::bucket::Bucket;
use crate::scripted::{Database, Place, content, scripted};
use bytes::Bytes;
use oviduct::jobs::artifacts::key;
use oviduct::jobs::scrub::{Difference, Scrubbed, scrub};
use oviduct::jobs::{NewJob, Status, StoreOptions};
use std::time::Duration;

async fn compare(place: &Place) -> (Scrubbed, Vec<Difference>) {
    let mut found = Vec::new();
    let scrubbed = scrub(&place.store, &place.artifacts, |difference| found.push(difference)).await.unwrap();
    (scrubbed, found)
}

async fn every_difference_is_found(database: Database, bucket: Option<&Bucket>) {
    let mut place = Place::on(database, StoreOptions::default()).await;
    place.artifacts = bucket.map_or(place.artifacts, Bucket::artifacts);
    assert_eq!(compare(&place).await, (Scrubbed::default(), vec![]));
    let pool = place.start(|_| {});
    let mut jobs = Vec::new();
    for seed in [1, 2, 3] {
        let job = place.ended(place.queue("ok", seed).await).await;
        assert_eq!(job.status, Status::Succeeded);
        jobs.push(job);
    }
    pool.shutdown(Duration::from_secs(5)).await;
    let shared = NewJob { reuse: true, ..scripted("ok", 1) };
    let shared = place.store.submit(shared).await.unwrap().job().id;
    // Files of a running attempt have no records yet.
    let running = place.queue("ok", 4).await;
    let claimed = place.store.claim("w", oviduct::jobs::ClaimScope::Cpu, Duration::from_secs(600), 1).await.unwrap();
    assert_eq!(claimed[0].job().id, running);
    let put = async |key: &str, bytes: Vec<u8>| place.artifacts.put_bytes(key, Bytes::from(bytes)).await.unwrap();
    put(&key(running, 1, "model.glb"), b"new".to_vec()).await;
    // Shared files count once. `model.glb` of seed 2 has 9,000,000 bytes, all others 1000.
    let whole = Scrubbed { files: 6, bytes: 9_005_000 };
    assert_eq!(compare(&place).await, (whole, vec![]));

    let named = |job: usize, name: &str| key(jobs[job].id, 1, name);
    let missing = named(0, "pack");
    place.artifacts.delete(std::slice::from_ref(&missing)).await.unwrap();
    let mut changed = content(2, "model.glb");
    changed[8_999_999] ^= 1;
    put(&named(1, "model.glb"), changed).await;
    put(&named(1, "report.json"), vec![7; 999]).await;
    // Of a pack, one byte of the second file.
    let mut pack = [content(3, "report.json"), content(3, "model.glb")].concat();
    pack[1000] ^= 1;
    put(&named(2, "pack"), pack.clone()).await;
    let unknown = [named(0, "other"), "models/none/1/model.glb".to_owned()];
    for key in &unknown {
        put(key, b"unknown".to_vec()).await;
    }
    let (scrubbed, found) = compare(&place).await;
    assert_eq!((scrubbed, found.len()), (whole, 7), "{found:?}");
    for name in ["report.json", "model.glb"] {
        let (name, key, jobs) = (name.to_owned(), missing.clone(), vec![jobs[0].id, shared]);
        assert!(found.contains(&Difference::Missing { name, key, jobs }), "{found:?}");
    }
    let damaged = |found: &[Difference], job: usize, name: &str, object: &str, reason: &str| {
        let is_it = |difference: &&Difference| {
            matches!(difference, Difference::Damaged { name: file, key, jobs: of, detail }
                if file == name && *key == named(job, object) && *of == [jobs[job].id] && detail.contains(reason))
        };
        found.iter().filter(is_it).count()
    };
    for (job, name, object, reason) in [
        (1, "model.glb", "model.glb", "SHA-256"),
        (1, "report.json", "report.json", "999 bytes instead of 1000"),
        (2, "model.glb", "pack", "SHA-256"),
    ] {
        assert_eq!(damaged(&found, job, name, object, reason), 1, "{found:?}");
    }
    for key in unknown {
        assert!(found.contains(&Difference::Unknown { key }), "{found:?}");
    }
    // Nothing was changed.
    assert_eq!(compare(&place).await, (scrubbed, found));
    // A pack that ends too early.
    pack.truncate(1999);
    put(&named(2, "pack"), pack).await;
    let (_, found) = compare(&place).await;
    assert_eq!(damaged(&found, 2, "model.glb", "pack", "999 bytes instead of 1000"), 1, "{found:?}");
}

/// Each database with each artifact store.
macro_rules! everywhere {
    ($($test:ident: $database:expr, $bucket:expr;)*) => {
        $(
            #[tokio::test(flavor = "multi_thread", worker_threads = 2)]
            async fn $test() {
                every_difference_is_found($database, $bucket.as_ref()).await;
            }
        )*
    };
}

everywhere! {
    on_sqlite_with_a_folder: Database::Sqlite, None::<Bucket>;
    on_sqlite_with_a_bucket: Database::Sqlite, Some(Bucket::start().await);
    on_postgres_with_a_folder: Database::Postgres, None::<Bucket>;
    on_postgres_with_a_bucket: Database::Postgres, Some(Bucket::start().await);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn an_unavailable_store_is_an_error_and_no_list_of_differences() {
    let bucket = Bucket::start().await;
    let mut place = Place::on(Database::Sqlite, StoreOptions::default()).await;
    place.artifacts = bucket.artifacts();
    bucket.set_up(false);
    assert!(scrub(&place.store, &place.artifacts, |found| panic!("{found:?}")).await.is_err());
}
