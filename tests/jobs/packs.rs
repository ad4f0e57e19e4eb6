//! Packs: the small files of a model are one object of the artifact store.

use crate::outage;
use crate::scripted::{Database, NAMES, Place, scripted};
use bytes::Bytes;
use futures_util::TryStreamExt;
use oviduct::clock::Clock;
use oviduct::jobs::artifacts::{ArtifactError, Artifacts, Stored, key};
use oviduct::jobs::{File, Job, JobId, NewJob, Status, StoreOptions};
use sha2::{Digest, Sha256};
use std::time::Duration;

const KEY: &str = "models/a/1/pack";

/// Name, object and position of each file of a job.
fn places(job: &Job) -> Vec<(&str, &str, Option<u64>)> {
    job.files.iter().map(|file| (&*file.name, file.key.rsplit('/').next().unwrap(), file.start)).collect()
}

async fn small_files_are_one_write(database: Database) {
    let (place, switch) = outage::place(database).await;
    let pool = place.start(|_| {});
    let small = place.ended(place.queue("ok", 1).await).await;
    assert_eq!(switch.written(), [key(small.id, 1, "pack")]);
    assert_eq!(places(&small), [("report.json", "pack", Some(0)), ("model.glb", "pack", Some(1000))]);
    // `model.glb` of seed 2 is large, and one small file needs no pack.
    let large = place.ended(place.queue("ok", 2).await).await;
    let mut written = switch.written();
    written.sort();
    assert_eq!(written, [key(large.id, 1, "model.glb"), key(large.id, 1, "report.json")]);
    assert_eq!(places(&large), [("report.json", "report.json", None), ("model.glb", "model.glb", None)]);
    for job in [small, large] {
        assert_eq!(job.status, Status::Succeeded);
        place.check_files(&job).await;
    }
    pool.shutdown(Duration::from_secs(5)).await;
    place.store.close().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn small_files_are_one_write_on_sqlite() {
    small_files_are_one_write(Database::Sqlite).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn small_files_are_one_write_on_postgres() {
    small_files_are_one_write(Database::Postgres).await;
}

/// A model, one that waited for its growth, and one that reuses it have the same pack, which is
/// deleted with the last of them.
async fn a_shared_pack_goes_with_its_last_model(database: Database) {
    let place = Place::on(database, StoreOptions::default()).await;
    let wish = NewJob { reuse: true, ..scripted("ok", 1) };
    let submit = async || place.store.submit(wish.clone()).await.unwrap().job().id;
    let (first, waiting) = (submit().await, submit().await);
    let pool = place.start(|_| {});
    let made = place.ended(first).await;
    let waited = place.ended(waiting).await;
    let reused = submit().await;
    pool.shutdown(Duration::from_secs(5)).await;
    assert_eq!(places(&made), NAMES.map(|name| (name, "pack", Some(if name == NAMES[0] { 0 } else { 1000 }))));
    let kept = async |ids: &[JobId]| {
        let now = Clock::System.now() + Duration::from_secs(60);
        assert_eq!(place.sweep_orphans(now, Duration::ZERO).await, 0);
        assert_eq!(place.store.stored_bytes().await.unwrap(), 2000, "each file counts once");
        for id in ids {
            let job = place.store.get(*id).await.unwrap().unwrap();
            assert_eq!((job.status, &job.files), (Status::Succeeded, &made.files));
            place.check_files(&job).await;
        }
    };
    assert_eq!(waited.reused_from, Some(first));
    kept(&[first, waiting, reused]).await;
    assert_eq!(place.store.delete(first).await.unwrap(), Some(vec![]));
    kept(&[waiting, reused]).await;
    assert_eq!(place.store.delete(waiting).await.unwrap(), Some(vec![]));
    kept(&[reused]).await;
    assert_eq!(place.store.delete(reused).await.unwrap(), Some(vec![key(first, 1, "pack")]));
    assert_eq!(place.store.stored_bytes().await.unwrap(), 0);
    place.store.close().await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_shared_pack_goes_with_its_last_model_on_sqlite() {
    a_shared_pack_goes_with_its_last_model(Database::Sqlite).await;
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn a_shared_pack_goes_with_its_last_model_on_postgres() {
    a_shared_pack_goes_with_its_last_model(Database::Postgres).await;
}

/// What the store reports of a file with these bytes.
fn stored(bytes: &[u8]) -> Stored {
    Stored { bytes: bytes.len() as u64, sha256: hex::encode(Sha256::digest(bytes)) }
}

/// The record of a file with these bytes, at `start` of a pack or alone.
fn recorded(key: &str, bytes: &[u8], start: Option<u64>) -> File {
    let Stored { bytes, sha256 } = stored(bytes);
    let (name, media_type) = ("model.glb".to_owned(), "model/gltf-binary".to_owned());
    File { name, media_type, bytes, sha256, key: key.to_owned(), start }
}

#[tokio::test]
async fn a_file_in_a_pack_is_read_without_its_neighbours() {
    let dir = tempfile::tempdir().unwrap();
    let artifacts = Artifacts::local(&dir.path().join("files")).unwrap();
    let data: Vec<u8> = (0..1000).map(|i| (i * 31 % 251) as u8).collect();
    let [path, other] = ["scratch", "other"].map(|name| dir.path().join(name));
    std::fs::write(&path, &data).unwrap();
    std::fs::write(&other, b"other").unwrap();
    let written = artifacts.put_pack(KEY, vec![other.clone(), path, other]).await.unwrap();
    assert_eq!(written, [stored(b"other"), stored(&data), stored(b"other")]);
    let read = async |file: &File, range| {
        let chunks: Vec<Bytes> = artifacts.open(file, range).await?.try_collect().await?;
        Ok::<_, ArtifactError>(chunks.concat())
    };
    let file = recorded(KEY, &data, Some(5));
    for whole in [None, Some(0..1000)] {
        assert!(read(&file, whole).await.unwrap() == data);
    }
    assert!(read(&file, Some(990..5000)).await.unwrap() == data[990..]);
    assert!(artifacts.get_ranges(&file, &[0..3, 999..1000]).await.unwrap() == [&data[..3], &data[999..]]);
    let outside = [
        read(&file, Some(1000..1003)).await.map(drop),
        artifacts.get_ranges(&file, &[0..1, 998..1001]).await.map(drop),
    ];
    // One byte off, and beyond the end of the pack.
    let wrong = [read(&recorded(KEY, &data, Some(6)), None).await, read(&recorded(KEY, &data, Some(11)), None).await];
    let beyond =
        [read(&recorded(KEY, &data, Some(2000)), None).await, read(&recorded(KEY, &data, Some(11)), Some(0..1)).await];
    for result in outside.into_iter().chain(wrong.into_iter().chain(beyond).map(|read| read.map(drop))) {
        assert!(matches!(result, Err(ArtifactError::Damaged { .. })), "{result:?}");
    }
    // The record of a file alone does not match the pack.
    assert!(matches!(read(&recorded(KEY, b"other", None), None).await, Err(ArtifactError::Damaged { .. })));
}
