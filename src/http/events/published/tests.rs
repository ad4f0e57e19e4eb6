//! What is published of the states that are offered, what readers get of it, and what is kept.

use super::super::samples::{job, running};
use super::*;
use crate::http::models::model::{Detail, LinkBase};
use crate::jobs::{JobKind, ListFilter};
use proptest::prelude::*;
use std::collections::BTreeSet;
use uuid::Uuid;

const MS: Duration = Duration::from_millis(1);

fn timing(interval: Duration) -> FeedTiming {
    FeedTiming { interval, poll: MS, keep: None }
}

fn id(n: u8) -> JobId {
    JobId(Uuid::from_u128(u128::from(n)))
}

/// No publications; all jobs are followed.
fn published(max_bytes: usize) -> Published {
    Published { follow_until: Some(LINGER), max_bytes, ..Published::default() }
}

/// Offers a state of a job that differs from the last one, and returns its number.
fn offer(published: &mut Published, n: u8, status: Status) -> u64 {
    let base = if status == Status::Running { running(10) } else { job() };
    let version = published.jobs.get(&id(n)).map_or(0, |published| published.snapshot.version) + 1;
    let job = Job { id: id(n), status, version, attempts: version as u32, ..base };
    published.offer(&job, Duration::ZERO, &timing(Duration::ZERO));
    published.last
}

/// Ids of the snapshots after `position`; `None` if it is unknown.
fn read(published: &Published, mut position: u64) -> Option<Vec<JobId>> {
    let mut ids = Vec::new();
    loop {
        match published.after(position, &Subscription::default()) {
            NextSnapshot::Found(snapshot) => {
                ids.push(snapshot.id);
                position = snapshot.number;
            }
            NextSnapshot::None(_) => return Some(ids),
            NextSnapshot::Unknown => return None,
        }
    }
}

/// Names of the events for a reader that has received everything before this offer.
fn names(published: &mut Published, job: &Job, now: Duration) -> Vec<String> {
    let before = published.last;
    published.offer(job, now, &timing(250 * MS));
    if published.last == before {
        return Vec::new();
    }
    let snapshot = published.latest(job.id).unwrap();
    let events = snapshot.events_after(before, "1", Detail::Summary, LinkBase::Root).concat();
    let text = String::from_utf8(events).unwrap();
    text.lines().filter_map(|line| line.strip_prefix("event: ").map(str::to_owned)).collect()
}

#[test]
fn nothing_is_kept_of_jobs_without_readers() {
    let mut published = Published::default();
    offer(&mut published, 1, Status::Queued);
    assert!(published.latest(id(1)).is_none());
    let readers = [published.follow_job(id(1)), published.follow_job(id(1))];
    offer(&mut published, 1, Status::Queued);
    published.release_unread(MS, 0);
    assert!(published.latest(id(1)).is_some());
    drop(readers);
    published.release_unread(MS, 0);
    assert!(published.jobs.is_empty() && published.order.is_empty() && published.watched.is_empty());
    assert_eq!(published.bytes, 0);
}

#[test]
fn all_jobs_are_followed_for_some_time_after_the_last_reader() {
    let mut published = Published::default();
    published.follow_all(Duration::ZERO);
    let position = offer(&mut published, 1, Status::Queued);
    published.release_unread(10 * LINGER, 1);
    published.release_unread(11 * LINGER - MS, 0);
    assert!(published.latest(id(1)).is_some() && read(&published, position).is_some());
    published.release_unread(11 * LINGER, 0);
    assert!(published.latest(id(1)).is_none() && !published.is_followed(id(1)));
    assert_eq!((read(&published, position), published.bytes), (None, 0));
}

#[test]
fn open_jobs_are_polled_in_turns_and_jobs_with_a_stream_each_time() {
    let mut published = published(usize::MAX);
    for n in 0..200 {
        offer(&mut published, n, Status::Queued);
    }
    offer(&mut published, 3, Status::Cancelled);
    let _reader = published.follow_job(id(3));
    let timing = timing(Duration::ZERO);
    let mut poll = |n: u32, readers: usize| {
        published.poll(n * MS, readers, &timing);
        std::mem::take(&mut published.due).into_keys().collect::<BTreeSet<_>>()
    };
    assert!(poll(0, 1).is_empty(), "not yet");
    assert_eq!(poll(1, 1).len(), 200, "one reader");
    let [mut first, second] = [poll(2, 50), poll(3, 50)];
    assert_eq!((first.len(), second.len()), (5, 5), "fifty readers");
    assert!(first.remove(&id(3)) && second.contains(&id(3)) && first.is_disjoint(&second));
    assert_eq!(poll(4, 0), BTreeSet::from([id(3)]), "no reader of many models");
}

#[test]
fn models_created_since_the_last_search_are_read() {
    let mut published = published(usize::MAX);
    let mut read = |found: &[u8]| {
        let found: Vec<_> = found.iter().map(|n| id(*n)).collect();
        let unknown = published.unknown_newest(&found);
        published.note_newest(found);
        unknown
    };
    assert_eq!(read(&[3, 5]), [id(3), id(5)], "all at first");
    assert_eq!(read(&[3, 4, 5, 6]), [id(4), id(6)], "also one by a process whose clock is behind");
    assert!(read(&[1, 2, 3, 5]).is_empty(), "older ones, after others were deleted");
    offer(&mut published, 7, Status::Queued);
    assert!(published.unknown_newest(&[id(5), id(7)]).is_empty(), "it is known");
}

#[test]
fn a_new_reader_begins_with_the_version_that_it_read() {
    let mut published = published(usize::MAX);
    let at = |version: u64, step: u32| Job { version, ..running(step) };
    assert_eq!(names(&mut published, &at(1, 10), Duration::ZERO), ["status", "section"]);
    assert!(names(&mut published, &at(2, 20), MS).is_empty(), "too early for other readers");
    // A heartbeat that ran twice raises the version alone.
    for (version, step) in [(2, 20), (3, 20), (4, 10)] {
        let before = published.last;
        published.offer_to_new_reader(&at(version, step), 2 * MS, &timing(250 * MS));
        let snapshot = published.latest(at(version, step).id).unwrap();
        assert_eq!(snapshot.version, version);
        let begin = String::from_utf8(snapshot.events_after(0, "1", Detail::Summary, LinkBase::Root).concat()).unwrap();
        assert!(begin.contains("event: status\n") && begin.contains(&format!("\"version\":{version},")), "{begin}");
        let others = snapshot.events_after(before, "1", Detail::Summary, LinkBase::Root).concat();
        assert!(!String::from_utf8(others).unwrap().contains("event: progress"));
        published.offer_to_new_reader(&at(1, 30), 2 * MS, &timing(250 * MS));
        assert_eq!(published.latest(at(version, step).id).unwrap().version, version, "an older state");
    }
    // The others receive it when it is due.
    assert_eq!(names(&mut published, &at(5, 20), 251 * MS), ["progress", "section"]);
}

#[test]
fn older_states_and_repeated_ends_are_not_published() {
    let mut published = published(usize::MAX);
    let mut next = |job: &Job| {
        let before = published.last;
        published.offer(job, Duration::ZERO, &timing(Duration::ZERO));
        published.last > before
    };
    let at = |version: u64, job: Job| Job { version, ..job };
    assert!(next(&at(3, running(10))));
    assert!(!next(&at(2, job())));
    let end = at(5, Job { status: Status::Cancelled, ..running(10) });
    assert!(next(&end));
    assert!(!next(&end));
    assert!(!next(&at(4, running(20))), "it has ended");
    published.delete(end.id);
    let deleted = published.latest(end.id).unwrap();
    assert_eq!((deleted.version, deleted.is_last), (6, true), "the version after the last");
    published.delete(end.id);
    published.offer(&at(7, running(30)), Duration::ZERO, &timing(Duration::ZERO));
    assert_eq!(published.last, deleted.number, "it is deleted");
}

#[test]
fn a_reader_that_lags_gets_the_newest_state_only() {
    let mut published = published(usize::MAX);
    let position = published.last;
    for version in 1..=1000 {
        published.offer(&Job { version, ..running(version as u32) }, Duration::ZERO, &timing(Duration::ZERO));
    }
    let NextSnapshot::Found(snapshot) = published.after(position, &Subscription::default()) else { panic!("nothing") };
    assert_eq!(snapshot.version, 1000);
    assert!(matches!(published.after(snapshot.number, &Subscription::default()), NextSnapshot::None(_)));
}

#[test]
fn fits_are_published_to_their_own_streams_alone() {
    let mut published = published(usize::MAX);
    let position = published.last;
    let fit = Job { kind: JobKind::Fit, ..job() };
    published.offer(&fit, Duration::ZERO, &timing(Duration::ZERO));
    published.delete(fit.id);
    assert!(published.last > position);
    assert_eq!(read(&published, position), Some(vec![]));
}

#[test]
fn an_unknown_position_is_reported() {
    let published = published(usize::MAX);
    assert_eq!(read(&published, 1), Some(vec![]));
    assert_eq!((read(&published, 0), read(&published, 2)), (None, None));
}

#[test]
fn the_oldest_snapshots_are_dropped_but_not_those_of_running_or_watched_jobs() {
    let mut published = published(0);
    let running = offer(&mut published, 1, Status::Running);
    let queued = offer(&mut published, 2, Status::Queued);
    assert_eq!(read(&published, 1), Some(vec![id(1), id(2)]), "the newest snapshot is never dropped");
    offer(&mut published, 3, Status::Queued);
    assert_eq!((read(&published, running), read(&published, queued)), (None, Some(vec![id(3)])));
    let _reader = published.follow_job(id(3));
    offer(&mut published, 4, Status::Queued);
    offer(&mut published, 5, Status::Queued);
    let kept: Vec<_> = (1..6).filter(|n| published.latest(id(*n)).is_some()).collect();
    assert_eq!(kept, [1, 3, 5]);
}

#[test]
fn a_job_whose_snapshot_was_dropped_is_followed_to_its_end() {
    let mut published = published(0);
    let both = Subscription::new(ListFilter { ids: vec![id(1), id(2)], ..ListFilter::default() });
    offer(&mut published, 1, Status::Queued);
    offer(&mut published, 2, Status::Succeeded);
    assert!(published.latest(id(1)).is_none() && published.has_open(&both));
    let same = Job { id: id(1), attempts: 1, ..job() };
    let reader = published.follow_job(id(1));
    published.offer(&same, Duration::ZERO, &timing(Duration::ZERO));
    assert!(published.latest(id(1)).is_some(), "its own stream begins with it");
    drop(reader);
    published.release_unread(MS, 1);
    offer(&mut published, 2, Status::Succeeded);
    published.poll(MS, 1, &timing(Duration::ZERO));
    assert_eq!(published.due_jobs(MS), [id(1)]);
    // Nothing has changed.
    let position = published.last;
    published.offer(&same, Duration::ZERO, &timing(Duration::ZERO));
    assert_eq!(published.last, position);
    let end = Job {
        id: id(1),
        status: Status::Cancelled,
        version: 2,
        spec: serde_json::json!({ "steps": 2000 }).into(),
        ..job()
    };
    published.offer(&end, Duration::ZERO, &timing(Duration::ZERO));
    let events = published.latest(id(1)).unwrap().events_after(position, "2", Detail::Full, LinkBase::Root).concat();
    let text = std::str::from_utf8(&events).unwrap();
    assert!(text.starts_with("event: end\n") && text.contains("\"spec\":{\"steps\":2000}"), "{text}");
    assert!(!published.has_open(&both));
}

#[test]
fn progress_is_held_back_and_then_published() {
    let mut published = published(usize::MAX);
    assert_eq!(names(&mut published, &running(10), Duration::ZERO), ["status", "section"]);
    assert!(names(&mut published, &running(10), MS).is_empty(), "nothing is new");
    assert!(names(&mut published, &running(20), 100 * MS).is_empty());
    assert_eq!((published.due_jobs(249 * MS), published.due_jobs(250 * MS)), (vec![], vec![running(20).id]));
    let timing = FeedTiming { poll: Duration::from_secs(9), ..timing(250 * MS) };
    assert_eq!(published.pause(100 * MS, &timing), 150 * MS);
    let number = published.last + 1;
    published.note_read(running(20).id, Some(&running(20)), 250 * MS, &timing);
    assert_eq!((published.last, published.due_jobs(Duration::MAX)), (number, vec![]));
}

#[test]
fn a_new_stream_begins_with_progress_that_was_held_back() {
    let mut published = published(usize::MAX);
    names(&mut published, &running(10), Duration::ZERO);
    assert!(names(&mut published, &running(20), MS).is_empty());
    let _reader = published.follow_job(running(20).id);
    assert_eq!(names(&mut published, &running(20), MS), ["progress", "section"]);
}

#[test]
fn a_job_that_cannot_be_read_does_not_hold_up_others() {
    let mut published = published(usize::MAX);
    (1..3).for_each(|n| published.note_change(id(n)));
    published.postpone(id(1), 3 * MS);
    assert_eq!((published.due_jobs(MS), published.due_jobs(3 * MS)), (vec![id(2)], vec![id(1), id(2)]));
}

#[test]
fn a_reported_change_is_read_although_progress_is_held_back() {
    let mut published = published(usize::MAX);
    names(&mut published, &running(10), Duration::ZERO);
    published.note_change(running(10).id);
    names(&mut published, &running(20), MS);
    assert_eq!(published.due_jobs(MS), [running(20).id]);
}

#[test]
fn a_change_of_the_status_or_of_the_position_in_the_queue_is_published_immediately() {
    let mut published = published(usize::MAX);
    assert_eq!(names(&mut published, &Job { queue_position: Some(3), ..job() }, Duration::ZERO), ["status"]);
    assert_eq!(names(&mut published, &job(), MS), ["status"]);
    let claimed = Job { progress: None, section: None, ..running(0) };
    assert_eq!(names(&mut published, &claimed, 2 * MS), ["status"]);
    assert_eq!(names(&mut published, &running(10), 3 * MS), ["progress", "section"], "the first is not held back");
    assert_eq!(names(&mut published, &Job { attempts: 2, ..running(20) }, 4 * MS), ["status", "section"]);
    assert_eq!(names(&mut published, &Job { attempts: 2, ..running(20) }, 253 * MS), ["progress"]);
    assert_eq!(names(&mut published, &Job { attempts: 3, ..claimed }, 600 * MS), ["status"]);
    let end = Job { status: Status::Cancelled, ..running(30) };
    assert_eq!(names(&mut published, &end, 601 * MS), ["end"]);
}

#[test]
fn an_end_is_published_once_even_while_progress_is_held_back() {
    let mut published = published(usize::MAX);
    names(&mut published, &running(10), Duration::ZERO);
    assert!(names(&mut published, &running(20), MS).is_empty(), "it is held back");
    let end = Job { status: Status::Cancelled, ..running(20) };
    assert_eq!(names(&mut published, &end, 2 * MS), ["end"]);
    assert!(names(&mut published, &end, 300 * MS).is_empty());
}

proptest! {
    /// Every change of the status is published, progress at most once per interval, and the last
    /// state once the interval has passed.
    #[test]
    fn no_change_is_lost(changes in prop::collection::vec((0u8..3, 0u64..120), 1..60)) {
        let interval = 250 * MS;
        let mut published = published(usize::MAX);
        let (mut now, mut step, mut attempts) = (Duration::ZERO, 0, 1);
        let mut progress_at = Vec::new();
        for (n, (kind, gap)) in changes.into_iter().enumerate() {
            now += Duration::from_millis(gap);
            if kind == 0 { attempts += 1 } else { step += 10 }
            let names = names(&mut published, &Job { attempts, version: n as u64 + 1, ..running(step) }, now);
            prop_assert!(kind != 0 || names.iter().any(|name| name == "status"));
            if names.iter().any(|name| name == "progress") {
                progress_at.push(now);
            }
            prop_assert!(published.due.values().all(|at| *at <= now + interval));
        }
        prop_assert!(progress_at.windows(2).all(|pair| pair[1] - pair[0] >= interval));
        let last = Job { attempts, version: 1000, ..running(step) };
        names(&mut published, &last, now + interval);
        prop_assert_eq!(published.jobs[&last.id].shown.as_ref(), Some(&PublishedFields::new(&last, &JobContext::default())));
        prop_assert!(names(&mut published, &last, now + 2 * interval).is_empty());
    }

    /// A reader receives each changed job once, in the order of the last changes, unless its
    /// position is unknown.
    #[test]
    fn a_reader_gets_each_changed_job_once_or_begins_anew(
        changes in prop::collection::vec(0u8..6, 0..40), from in 0usize..40, kept in 1usize..6,
    ) {
        let mut sample = published(usize::MAX);
        offer(&mut sample, 0, Status::Queued);
        // Versions and attempts of two digits.
        let each = sample.bytes + 2;
        let mut published = published(kept * each);
        let mut numbers = vec![published.last];
        for &n in &changes {
            numbers.push(offer(&mut published, n, Status::Queued));
        }
        let from = from.min(changes.len());
        let mut expected: Vec<JobId> = Vec::new();
        for &n in changes[from..].iter().rev() {
            if !expected.contains(&id(n)) {
                expected.insert(0, id(n));
            }
        }
        match read(&published, numbers[from]) {
            Some(ids) => prop_assert_eq!(ids, expected),
            None => prop_assert!(expected.len() > kept),
        }
        prop_assert!(published.bytes <= kept * each);
        let kept = published.jobs.values().filter(|job| job.snapshot.has_data());
        prop_assert_eq!(published.order.len(), kept.count());
    }
}

#[test]
fn a_subscription_is_open_until_all_its_models_have_ended() {
    let mut published = published(usize::MAX);
    let ids = vec![id(1), id(2)];
    let subscription = Subscription::new(ListFilter { ids, ..ListFilter::default() });
    offer(&mut published, 1, Status::Running);
    offer(&mut published, 2, Status::Queued);
    offer(&mut published, 3, Status::Queued);
    published.delete(id(2));
    assert!(published.has_open(&subscription));
    offer(&mut published, 1, Status::Succeeded);
    assert!(!published.has_open(&subscription));
}
