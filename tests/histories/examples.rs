//! Histories written by hand: the checker accepts the legal ones and rejects the others.

use crate::checker::{History, Record, Stream, Told};
use crate::spec::{Op, Ret, Seen};
use oviduct::jobs::Status;
use uuid::Uuid;

const A: Uuid = Uuid::from_u128(0xa);
const B: Uuid = Uuid::from_u128(0xb);

fn seen(version: u64, status: Status, attempts: u32) -> Seen {
    Seen { version, status, attempts }
}

fn shown(id: Uuid, version: u64, status: Status, attempts: u32) -> Ret {
    Ret::Shown(id, seen(version, status, attempts))
}

/// Invocation, operation, and time and content of the response.
type Timed = (u64, Op, Option<(u64, Ret)>);

/// A history of these operations with the times of their invocations and responses, each of
/// another client.
fn history(operations: &[Timed]) -> History {
    let record = |(client, (invoked, op, returned)): (usize, &Timed)| Record {
        client: client as u32,
        op: *op,
        invoked: *invoked,
        returned: returned.clone(),
    };
    History { records: operations.iter().enumerate().map(record).collect(), streams: Vec::new() }
}

/// A history of operations that follow one another.
fn sequence(operations: &[(Op, Ret)]) -> History {
    let at = |n: usize| 10 * n as u64;
    let timed: Vec<_> =
        operations.iter().enumerate().map(|(n, (op, ret))| (at(n), *op, Some((at(n) + 5, ret.clone())))).collect();
    history(&timed)
}

#[track_caller]
fn accepted(history: &History) {
    if let Err(fault) = history.check() {
        panic!("{fault}");
    }
}

#[track_caller]
fn rejected(history: &History) {
    assert!(history.check().is_err(), "{history:?}");
}

fn submitted() -> (Op, Ret) {
    (Op::Submit, shown(A, 1, Status::Queued, 0))
}

#[test]
fn the_life_of_a_model_is_accepted() {
    accepted(&sequence(&[
        (Op::List, Ret::Listed(vec![])),
        submitted(),
        (Op::Get(A), shown(A, 1, Status::Queued, 0)),
        (Op::Get(A), shown(A, 3, Status::Running, 1)),
        // The worker vanished.
        (Op::List, Ret::Listed(vec![(A, seen(7, Status::Queued, 1))])),
        (Op::Submit, shown(A, 8, Status::Running, 2)),
        (Op::Get(A), shown(A, 20, Status::Succeeded, 4)),
        (Op::Cancel(A), shown(A, 20, Status::Succeeded, 4)),
        (Op::Delete(A), Ret::Deleted),
        (Op::Get(A), Ret::Missing),
        (Op::Delete(A), Ret::Missing),
        (Op::List, Ret::Listed(vec![])),
        // The key is free again.
        (Op::Submit, shown(B, 1, Status::Queued, 0)),
        (Op::Cancel(B), shown(B, 2, Status::Cancelled, 0)),
        (Op::Get(B), shown(B, 2, Status::Cancelled, 0)),
    ]));
}

#[test]
fn the_result_of_a_model_does_not_go_back() {
    let succeeded = (Op::Get(A), shown(A, 9, Status::Succeeded, 1));
    rejected(&sequence(&[submitted(), succeeded.clone(), (Op::Get(A), shown(A, 10, Status::Running, 1))]));
    rejected(&sequence(&[submitted(), succeeded.clone(), (Op::Get(A), shown(A, 8, Status::Running, 1))]));
    rejected(&sequence(&[submitted(), succeeded, (Op::Get(A), shown(A, 10, Status::Failed, 1))]));
}

#[test]
fn versions_and_attempts_do_not_fall() {
    let running = (Op::Get(A), shown(A, 5, Status::Running, 2));
    rejected(&sequence(&[submitted(), running.clone(), (Op::Get(A), shown(A, 4, Status::Running, 2))]));
    rejected(&sequence(&[submitted(), running.clone(), (Op::Get(A), shown(A, 6, Status::Running, 1))]));
    rejected(&sequence(&[submitted(), running, (Op::Get(A), shown(A, 5, Status::Queued, 2))]));
    // A queued model runs by another attempt.
    rejected(&sequence(&[submitted(), (Op::Get(A), shown(A, 5, Status::Running, 0))]));
}

#[test]
fn a_deleted_model_stays_deleted() {
    let deleted = (Op::Delete(A), Ret::Deleted);
    rejected(&sequence(&[submitted(), deleted.clone(), (Op::Get(A), shown(A, 1, Status::Queued, 0))]));
    rejected(&sequence(&[
        submitted(),
        deleted.clone(),
        (Op::List, Ret::Listed(vec![(A, seen(1, Status::Queued, 0))])),
    ]));
    rejected(&sequence(&[submitted(), deleted.clone(), (Op::Submit, shown(A, 1, Status::Queued, 0))]));
    rejected(&sequence(&[submitted(), deleted.clone(), deleted]));
}

#[test]
fn a_key_has_one_model() {
    rejected(&sequence(&[submitted(), (Op::Submit, shown(B, 1, Status::Queued, 0))]));
    let two = vec![(A, seen(1, Status::Queued, 0)), (B, seen(1, Status::Queued, 0))];
    rejected(&sequence(&[submitted(), (Op::List, Ret::Listed(two))]));
    // Two submissions at the same time.
    let first = (0, Op::Submit, Some((9, shown(A, 1, Status::Queued, 0))));
    rejected(&history(&[first.clone(), (1, Op::Submit, Some((8, shown(B, 1, Status::Queued, 0))))]));
    accepted(&history(&[first, (1, Op::Submit, Some((8, shown(A, 1, Status::Queued, 0))))]));
}

#[test]
fn an_accepted_model_is_not_lost() {
    rejected(&sequence(&[submitted(), (Op::Get(A), Ret::Missing)]));
    rejected(&sequence(&[submitted(), (Op::List, Ret::Listed(vec![]))]));
    rejected(&sequence(&[submitted(), (Op::Delete(A), Ret::Missing)]));
    // Another deletion without a response may have been first.
    accepted(&history(&[
        (0, Op::Submit, Some((5, shown(A, 1, Status::Queued, 0)))),
        (6, Op::Delete(A), None),
        (7, Op::Delete(A), Some((9, Ret::Missing))),
    ]));
}

#[test]
fn a_cancelled_model_neither_succeeds_nor_runs_again() {
    let cancelled = (Op::Cancel(A), shown(A, 4, Status::Running, 1));
    for (status, attempts) in [(Status::Succeeded, 1), (Status::Failed, 1), (Status::Queued, 1), (Status::Running, 2)] {
        rejected(&sequence(&[submitted(), cancelled.clone(), (Op::Get(A), shown(A, 6, status, attempts))]));
    }
    accepted(&sequence(&[submitted(), cancelled, (Op::Get(A), shown(A, 6, Status::Cancelled, 1))]));
    // A queued model ends at once.
    rejected(&sequence(&[submitted(), (Op::Cancel(A), shown(A, 1, Status::Queued, 0))]));
    // Nobody cancelled the model.
    rejected(&sequence(&[submitted(), (Op::Get(A), shown(A, 2, Status::Cancelled, 0))]));
}

#[test]
fn an_operation_without_a_response_may_take_effect_late_or_never() {
    let submit = (0, Op::Submit, Some((5, shown(A, 1, Status::Queued, 0))));
    for op in [Op::Delete(A), Op::Cancel(A), Op::Submit] {
        let running = (20, Op::Get(A), Some((25, shown(A, 3, Status::Running, 1))));
        let unknown = (10, op, None);
        accepted(&history(&[submit.clone(), unknown.clone(), running.clone()]));
        let missing = (30, Op::Get(A), Some((35, Ret::Missing)));
        let late = history(&[submit.clone(), unknown.clone(), running.clone(), missing.clone()]);
        let ended = (30, Op::Get(A), Some((35, shown(A, 4, Status::Cancelled, 1))));
        let stopped = history(&[submit.clone(), unknown, running.clone(), ended]);
        match op {
            Op::Delete(_) => (accepted(&late), rejected(&stopped)),
            Op::Cancel(_) => (rejected(&late), accepted(&stopped)),
            _ => (rejected(&late), rejected(&stopped)),
        };
        // Nothing takes effect before its invocation.
        rejected(&history(&[submit.clone(), running, missing, (40, op, None)]));
    }
    // Neither client knows the id of the model that the second one deletes after it was listed.
    accepted(&history(&[
        (0, Op::Submit, None),
        (1, Op::List, Some((2, Ret::Listed(vec![])))),
        (3, Op::List, Some((4, Ret::Listed(vec![(B, seen(2, Status::Running, 1))])))),
        (5, Op::Delete(B), Some((6, Ret::Deleted))),
        (7, Op::List, Some((8, Ret::Listed(vec![])))),
    ]));
}

/// A history with one submission and one stream.
fn streamed(events: &[(&str, Told)], closed: bool, then: &[(Op, Ret)]) -> History {
    let mut history = sequence(&[&[submitted()], then].concat());
    let event = |(n, (name, told)): (usize, &(&str, Told))| (6 + n as u64, (*name).to_owned(), *told);
    let mut events: Vec<_> = events.iter().enumerate().map(event).collect();
    events.truncate(4);
    history.streams.push(Stream { id: A, opened: 6, events, closed });
    history
}

#[test]
fn events_are_states_in_order_and_the_last_one_is_the_end() {
    let state = |version, status, attempts| Told::State(seen(version, status, attempts));
    let (queued, running) = (state(1, Status::Queued, 0), state(3, Status::Running, 1));
    let (late, ended) = (state(5, Status::Running, 1), state(9, Status::Succeeded, 1));
    accepted(&streamed(&[("status", queued), ("status", running), ("progress", running), ("end", ended)], true, &[]));
    accepted(&streamed(&[("status", queued), ("end", Told::Deleted)], true, &[]).deleted());
    accepted(&streamed(&[("status", late)], false, &[]));
    // Back, without an end, after the end, without an event, deleted by nobody.
    rejected(&streamed(&[("status", late), ("progress", running)], false, &[]));
    rejected(&streamed(&[("status", queued), ("status", running)], true, &[]));
    rejected(&streamed(&[("end", ended), ("status", late)], true, &[]));
    rejected(&streamed(&[("status", ended)], true, &[]));
    rejected(&streamed(&[], true, &[]));
    rejected(&streamed(&[("end", Told::Deleted)], true, &[]));
    // Operations after an event show its state or a later one.
    let get = |version, status| [(Op::Get(A), shown(A, version, status, 1))];
    accepted(&streamed(&[("status", queued), ("status", late)], false, &get(5, Status::Running)));
    rejected(&streamed(&[("status", queued), ("status", late)], false, &get(4, Status::Running)));
    rejected(&streamed(&[("status", late)], false, &get(5, Status::Succeeded)));
}

impl History {
    /// The same history with a deletion while the stream was open.
    fn deleted(mut self) -> Self {
        self.records.push(Record { client: 9, op: Op::Delete(A), invoked: 6, returned: Some((9, Ret::Deleted)) });
        self
    }
}
