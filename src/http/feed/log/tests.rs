//! What a reader gets, whatever was published, and that the bytes are bounded.

use super::super::super::samples::{job, running};
use super::super::super::view::Name;
use super::*;
use crate::jobs::Job;
use proptest::prelude::*;
use uuid::Uuid;

fn id(n: u8) -> JobId {
    JobId(Uuid::from_u128(u128::from(n)))
}

fn insert(log: &mut Log, n: u8, status: Status) -> Arc<View> {
    let base = if status == Status::Running { running(10) } else { job() };
    let job = Job { id: id(n), status, ..base };
    let before = log.view(job.id).cloned();
    log.insert(View::of(&job, None, &[Name::Status], log.last() + 1, before.as_deref()))
}

/// Ids of the states that a reader at `number` gets; `None` if it has to begin anew.
fn read(log: &Log, mut number: u64) -> Option<Vec<JobId>> {
    let mut ids = Vec::new();
    loop {
        match log.after(number, &Interest::default()) {
            Next::View(view) => {
                ids.push(view.id());
                number = view.number();
            }
            Next::Nothing(_) => return Some(ids),
            Next::Unknown => return None,
        }
    }
}

#[test]
fn a_number_beyond_the_log_is_unknown() {
    let mut log = Log::new(usize::MAX);
    assert_eq!(read(&log, 1), Some(vec![]));
    assert_eq!((read(&log, 0), read(&log, 2)), (None, None));
    insert(&mut log, 1, Status::Queued);
    log.clear(|_| false);
    assert_eq!((read(&log, 2), read(&log, log.last()), log.bytes()), (None, Some(vec![]), 0));
}

#[test]
fn the_oldest_states_are_dropped_but_not_those_of_running_models() {
    let mut log = Log::new(0);
    let running = insert(&mut log, 1, Status::Running);
    let queued = insert(&mut log, 2, Status::Queued);
    assert_eq!(read(&log, 1), Some(vec![id(1), id(2)]), "the newest state is never dropped");
    let last = insert(&mut log, 3, Status::Queued);
    assert_eq!((read(&log, running.number()), read(&log, queued.number())), (None, Some(vec![id(3)])));
    assert_eq!(log.bytes(), running.bytes() + last.bytes());
    assert_eq!(log.first(false), BTreeSet::from([id(1), id(3)]));
}

#[test]
fn a_reader_begins_with_what_runs_and_the_newest_that_wait() {
    let mut log = Log::new(usize::MAX);
    (0..150).for_each(|n| drop(insert(&mut log, n, Status::Queued)));
    insert(&mut log, 3, Status::Running);
    insert(&mut log, 200, Status::Failed);
    let want: BTreeSet<_> = [3].into_iter().chain(50..150).map(id).collect();
    assert_eq!(log.first(false), want);
    assert_eq!(log.first(true), want.into_iter().chain([id(200)]).collect());
}

proptest! {
    /// A reader gets each model that changed once, in the order of the last changes, or is told that it cannot.
    #[test]
    fn a_reader_gets_each_changed_model_once_or_begins_anew(
        changes in prop::collection::vec(0u8..6, 0..40), from in 0usize..40, kept in 1usize..6,
    ) {
        let each = insert(&mut Log::new(0), 0, Status::Queued).bytes();
        let mut log = Log::new(kept * each);
        let mut lasts = vec![log.last()];
        for &n in &changes {
            insert(&mut log, n, Status::Queued);
            lasts.push(log.last());
        }
        let from = from.min(changes.len());
        let mut want: Vec<JobId> = Vec::new();
        for &n in changes[from..].iter().rev() {
            if !want.contains(&id(n)) {
                want.insert(0, id(n));
            }
        }
        match read(&log, lasts[from]) {
            Some(got) => prop_assert_eq!(got, want),
            None => prop_assert!(want.len() > kept),
        }
        prop_assert!(log.bytes() <= kept * each);
        prop_assert!(log.views.len() == log.numbers.len());
    }
}
