//! What is published of the states that are offered.

use super::super::samples::{job, running};
use super::*;
use crate::jobs::{Store, StoreOptions};

const PACE: Pace = Pace { interval: Duration::ZERO, poll: Duration::from_millis(1), keep: None };

async fn feed() -> Arc<Feed> {
    Arc::new(Feed::new(Store::open_in_memory(StoreOptions::default()).await.unwrap(), PACE))
}

#[tokio::test]
async fn cursors_belong_to_one_feed() {
    let (feed, other) = (feed().await, feed().await);
    let (reader, other) = (feed.follow().await.unwrap(), other.follow().await.unwrap());
    assert_ne!(reader.name(), other.name());
}

#[tokio::test]
async fn nothing_is_kept_of_models_that_nobody_watches() {
    let feed = feed().await;
    feed.offer(&job());
    assert!(feed.lock().log.view(job().id).is_none());
    let mut readers = [feed.watch(job().id), feed.watch(job().id)];
    feed.offer(&job());
    let views = readers.each_mut().map(|reader| reader.view().unwrap());
    assert!(Arc::ptr_eq(&views[0], &views[1]), "one state for all readers");
    drop(readers);
    let state = feed.lock();
    assert!(state.log.view(job().id).is_none() && state.tracks.is_empty() && state.watched.is_empty());
}

#[tokio::test]
async fn older_states_and_repeated_ends_are_not_published() {
    let feed = feed().await;
    let mut reader = feed.follow().await.unwrap();
    let mut number = reader.first(false).1;
    let mut next = |feed: &Feed, job: &Job| {
        feed.offer(job);
        let Next::View(view) = reader.after(number, &Interest::default()) else { return None };
        number = view.number();
        Some((view.version(), view.status()))
    };
    let at = |version: u64, job: Job| Job { version, ..job };
    assert_eq!(next(&feed, &at(3, running(10))), Some((3, Some(Status::Running))));
    assert_eq!(next(&feed, &at(2, job())), None);
    let end = at(5, Job { status: Status::Cancelled, ..running(10) });
    assert_eq!(next(&feed, &end), Some((5, Some(Status::Cancelled))));
    assert_eq!(next(&feed, &end), None);
    assert_eq!(next(&feed, &at(4, running(20))), None, "it has ended");
}

#[tokio::test]
async fn a_reader_that_lags_gets_the_newest_state_only() {
    let feed = feed().await;
    let mut reader = feed.follow().await.unwrap();
    let (_, number) = reader.first(false);
    for version in 1..=1000 {
        feed.offer(&Job { version, ..running(version as u32) });
    }
    let Next::View(view) = reader.after(number, &Interest::default()) else { panic!("nothing was published") };
    assert_eq!(view.version(), 1000);
    assert!(matches!(reader.after(view.number(), &Interest::default()), Next::Nothing(_)));
}
