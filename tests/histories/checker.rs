//! Recorded histories, and their check: stateright searches an order of the operations of each key
//! that agrees with the specification, and the events of each stream are compared with it.

use crate::spec::{Cancel, Key, Op, Ret, Seen};
use oviduct::clock::Stopwatch;
use stateright::semantics::{ConsistencyTester, LinearizabilityTester};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use uuid::Uuid;

/// The common order of all invocations and responses of all clients.
#[derive(Debug, Default)]
pub struct Order(AtomicU64);

impl Order {
    pub fn next(&self) -> u64 {
        self.0.fetch_add(1, Ordering::SeqCst)
    }
}

/// An operation of a client.
#[derive(Clone, Debug)]
pub struct Record {
    pub client: u32,
    pub op: Op,
    pub invoked: u64,
    /// Time and content of the response; `None` if the outcome is unknown.
    pub returned: Option<(u64, Ret)>,
}

/// State of a model in an event.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Told {
    State(Seen),
    Deleted,
}

/// An event stream of one model.
#[derive(Clone, Debug)]
pub struct Stream {
    pub id: Uuid,
    pub opened: u64,
    /// Time, name and state of each event.
    pub events: Vec<(u64, String, Told)>,
    /// True if the service ended the stream in order.
    pub closed: bool,
}

/// All that clients have seen of one key.
#[derive(Clone, Debug, Default)]
pub struct History {
    pub records: Vec<Record>,
    pub streams: Vec<Stream>,
}

/// Time and direction of a record: its invocation, or its response.
type Turn<'a> = (u64, u32, Op, Option<&'a Ret>);

/// First number of the clients that stand for events, and of those whose outcome is unknown. Those
/// come last, because the checker tries the operations of clients in the order of their numbers.
const EVENTS: u32 = 1 << 16;
const UNKNOWN: u32 = 1 << 24;

/// Maximum time of a search, whose cost may grow exponentially with the operations in flight.
const SEARCHED_FOR: Duration = Duration::from_secs(60);

impl History {
    /// Checks the history.
    ///
    /// # Errors
    /// Describes the violation, with the history.
    pub fn check(&self) -> Result<Duration, String> {
        let since = Stopwatch::start();
        let fault = self.streams.iter().find_map(|stream| stream.fault(&self.records)).or_else(|| self.contradiction());
        let fault = fault.or_else(|| match self.is_linearizable() {
            Some(true) => None,
            Some(false) => Some("no order explains it".to_owned()),
            None => Some(format!("the search for an order took more than {SEARCHED_FOR:?}")),
        });
        fault.map_or_else(|| Ok(since.elapsed()), |fault| Err(format!("{fault}\n{}", self.lines().join("\n"))))
    }

    /// The operations, with the first and the last event of each stream as reads.
    fn operations(&self) -> Vec<Record> {
        let mut all = Vec::new();
        // Only the earliest of equal operations without a response counts: it may take effect
        // whenever the later ones may, and a second effect changes nothing.
        let mut unknown: BTreeSet<(bool, Uuid)> = BTreeSet::new();
        // A submission changes something if the key is free: at first, and after a deletion.
        let is_deletion = |record: &&Record| matches!(record.op, Op::Delete(_));
        let mut submissions = 1 + self.records.iter().filter(is_deletion).count();
        let mut records: Vec<&Record> = self.records.iter().collect();
        records.sort_by_key(|record| record.invoked);
        for (number, record) in records.into_iter().enumerate() {
            let counts = match (&record.returned, record.op) {
                (Some(_), _) => true,
                (None, Op::Submit) => {
                    let is_left = submissions > 0;
                    submissions = submissions.saturating_sub(1);
                    is_left
                }
                (None, Op::Cancel(id)) => unknown.insert((true, id)),
                (None, Op::Delete(id)) => unknown.insert((false, id)),
                (None, Op::Get(_) | Op::List) => false,
            };
            let client = if record.returned.is_none() { UNKNOWN + number as u32 } else { record.client };
            all.extend(counts.then(|| Record { client, ..record.clone() }));
        }
        for stream in &self.streams {
            let last = stream.events.last().filter(|(_, name, _)| name == "end" && stream.events.len() > 1);
            for (at, _, told) in stream.events.first().into_iter().chain(last) {
                let client = EVENTS + all.len() as u32;
                let ret = match told {
                    Told::State(seen) => Ret::Shown(stream.id, *seen),
                    Told::Deleted => Ret::Missing,
                };
                let op = Op::Get(stream.id);
                all.push(Record { client, op, invoked: stream.opened, returned: Some((*at, ret)) });
            }
        }
        all
    }

    /// `None` if the search takes too long.
    fn is_linearizable(&self) -> Option<bool> {
        let operations = self.operations();
        let mut turns: Vec<Turn<'_>> = Vec::new();
        for Record { client, op, invoked, returned } in &operations {
            turns.push((*invoked, *client, *op, None));
            turns.extend(returned.as_ref().map(|(at, ret)| (*at, *client, *op, Some(ret))));
        }
        turns.sort_by_key(|(at, client, ..)| (*at, *client));
        let shown = operations.iter().flat_map(|operation| match &operation.returned {
            Some((_, Ret::Shown(id, seen))) => vec![(*id, seen.version)],
            Some((_, Ret::Listed(models))) => models.iter().map(|(id, seen)| (*id, seen.version)).collect(),
            _ => vec![],
        });
        let mut tester = LinearizabilityTester::new(Key::with_versions(shown));
        for (_, client, op, ret) in turns {
            match ret {
                None => tester.on_invoke(client, op).map(drop),
                Some(ret) => tester.on_return(client, ret.clone()).map(drop),
            }
            .expect("a client has one operation in flight");
        }
        let (done, found) = std::sync::mpsc::channel();
        std::thread::spawn(move || done.send(tester.is_consistent()));
        found.recv_timeout(SEARCHED_FOR).ok()
    }

    /// Every state that was shown, with the time at which the operation began and ended.
    fn shown(&self) -> Vec<(u64, u64, Uuid, Seen)> {
        let mut all = Vec::new();
        for Record { invoked, returned, .. } in &self.records {
            match returned {
                Some((at, Ret::Shown(id, seen))) => all.push((*invoked, *at, *id, *seen)),
                Some((at, Ret::Listed(models))) => {
                    all.extend(models.iter().map(|(id, seen)| (*invoked, *at, *id, *seen)));
                }
                _ => {}
            }
        }
        for stream in &self.streams {
            for (at, _, told) in &stream.events {
                if let Told::State(seen) = told {
                    all.push((stream.opened, *at, stream.id, *seen));
                }
            }
        }
        all
    }

    /// A state that contradicts another of the same version, or an older one that was shown to an
    /// operation that began after the newer one had been shown.
    fn contradiction(&self) -> Option<String> {
        let mut versions: BTreeMap<(Uuid, u64), Seen> = BTreeMap::new();
        let all = self.shown();
        for (_, _, id, seen) in &all {
            let first = *versions.entry((*id, seen.version)).or_insert(*seen);
            if first != *seen {
                return Some(format!("{id} was shown as {first:?} and as {seen:?}"));
            }
        }
        all.iter().find_map(|(began, _, id, seen)| {
            let is_newer =
                |other: &&(u64, u64, Uuid, Seen)| other.2 == *id && other.1 < *began && other.3.version > seen.version;
            // The states of one stream are compared with each other in `Stream::fault`.
            all.iter().find(is_newer).map(|newer| format!("{seen:?} was shown after {:?} of {id}", newer.3))
        })
    }

    /// The history, in the order of invocations.
    fn lines(&self) -> Vec<String> {
        let mut lines: Vec<(u64, String)> = Vec::new();
        for Record { client, op, invoked, returned } in &self.records {
            let end = returned.as_ref().map_or("?".to_owned(), |(at, ret)| format!("{at}: {ret:?}"));
            lines.push((*invoked, format!("{invoked} client {client} {op:?} .. {end}")));
        }
        for Stream { id, opened, events, closed } in &self.streams {
            let events: Vec<_> = events.iter().map(|(at, name, told)| format!("  {at}: {name} {told:?}")).collect();
            let end = if *closed { "closed" } else { "cut" };
            lines.push((*opened, format!("{opened} stream of {id}, {end}\n{}", events.join("\n"))));
        }
        lines.sort();
        lines.into_iter().map(|(_, line)| line).collect()
    }
}

impl Stream {
    /// A violation of the order of events.
    fn fault(&self, records: &[Record]) -> Option<String> {
        // A stream tells nothing of cancellations, so the checker alone knows when one is possible.
        let cancelled = |record: &Record| record.op == Op::Cancel(self.id) || record.op == Op::Delete(self.id);
        let cancel = if records.iter().any(cancelled) { Cancel::Perhaps } else { Cancel::No };
        for (n, (_, name, told)) in self.events.iter().enumerate() {
            let is_end = match told {
                Told::State(seen) => seen.status.is_ended(),
                Told::Deleted => true,
            };
            if is_end != (name == "end") || (is_end && n + 1 < self.events.len()) {
                return Some(format!("{} has a wrong event {name}: {told:?}", self.id));
            }
            let before = n.checked_sub(1).map(|before| self.events[before].2);
            if let (Some(Told::State(before)), Told::State(seen)) = (before, told)
                && !before.leads_to(*seen, cancel)
            {
                return Some(format!("{}: {seen:?} follows {before:?}", self.id));
            }
        }
        let has_ended = self.events.last().is_some_and(|(_, name, _)| name == "end");
        (self.closed && self.events.is_empty()).then(|| format!("the stream of {} was empty", self.id)).or_else(|| {
            // The service also closes a stream when it shuts down, which no test of these does.
            (self.closed && !has_ended).then(|| format!("the stream of {} closed before the end", self.id))
        })
    }
}
