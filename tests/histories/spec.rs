//! The sequential specification of one idempotency key: at most one model at a time, and what each
//! operation may show of it.
//!
//! Workers change a model between two operations, and no operation of a client is a change of a
//! worker. The specification therefore holds what was last shown of the model. An operation may
//! show any state that workers can reach from there.

use oviduct::jobs::Status;
use stateright::semantics::SequentialSpec;
use std::collections::BTreeMap;
use uuid::Uuid;

/// State of a model as a response or an event shows it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Seen {
    pub version: u64,
    pub status: Status,
    pub attempts: u32,
}

/// An operation of a client.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Op {
    /// `POST /models` with the idempotency key.
    Submit,
    /// `GET /models/{id}`, or the first or last event of a stream.
    Get(Uuid),
    Cancel(Uuid),
    Delete(Uuid),
    /// `GET /models` with the label that all models of the key have.
    List,
}

/// The response to an operation.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Ret {
    /// The model.
    Shown(Uuid, Seen),
    /// The model does not exist.
    Missing,
    /// The model was deleted by this operation.
    Deleted,
    /// All models of the key.
    Listed(Vec<(Uuid, Seen)>),
}

/// Whether a client has cancelled a model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cancel {
    No,
    /// A request without a response may have taken effect at any time.
    Perhaps,
    /// The response to a request showed the model running.
    Acknowledged,
}

impl Seen {
    /// State of a model before it is queued.
    const NEW: Self = Self { version: 0, status: Status::Queued, attempts: 0 };

    /// True if workers, and a cancellation if there was one, can change this state to `next`.
    pub fn leads_to(self, next: Self, cancel: Cancel) -> bool {
        if next.version <= self.version {
            return next == self;
        }
        let Some(more) = next.attempts.checked_sub(self.attempts) else { return false };
        let is_legal = match (self.status, next.status) {
            (Status::Queued | Status::Running, Status::Cancelled) => cancel != Cancel::No,
            (Status::Queued, Status::Queued) => true,
            // A queued model gets there by another attempt.
            (Status::Queued, _) => more > 0,
            (Status::Running, _) => true,
            _ => false,
        };
        let stops =
            cancel != Cancel::Acknowledged || (more == 0 && matches!(next.status, Status::Running | Status::Cancelled));
        is_legal && stops
    }
}

/// The model that a key names at present.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Accepted {
    /// `None` after a submission without a response.
    id: Option<Uuid>,
    seen: Seen,
    cancel: Cancel,
}

/// State of a key.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Key {
    present: Option<Accepted>,
    deleted: Vec<Uuid>,
    /// Versions that the operations to come show, largest first. An order that passes one of them
    /// explains no history, so the search need not go on.
    to_come: BTreeMap<Uuid, Vec<u64>>,
    is_hopeless: bool,
}

impl Key {
    /// A key whose operations show these models in these versions.
    pub fn with_versions(shown: impl IntoIterator<Item = (Uuid, u64)>) -> Self {
        let mut key = Self::default();
        for (id, version) in shown {
            key.to_come.entry(id).or_default().push(version);
        }
        for versions in key.to_come.values_mut() {
            versions.sort_unstable_by_key(|version| std::cmp::Reverse(*version));
        }
        key
    }

    /// Whether the model with this id may be shown in this state; notes it. After a refusal the key
    /// is of no use.
    fn shows(&mut self, id: Uuid, seen: Seen) -> bool {
        let is_deleted = self.deleted.contains(&id);
        let Some(present) = &mut self.present else { return false };
        let is_this = present.id.map_or(!is_deleted, |known| known == id);
        let next = self.to_come.get_mut(&id).and_then(Vec::pop);
        let is_legal = is_this && next == Some(seen.version) && present.seen.leads_to(seen, present.cancel);
        (present.id, present.seen) = (Some(id), seen);
        is_legal
    }

    /// The present model, if this is its id.
    fn with_id(&mut self, id: Uuid) -> Option<&mut Accepted> {
        self.present.as_mut().filter(|present| present.id == Some(id))
    }

    fn submit(&mut self) {
        self.present.get_or_insert(Accepted { id: None, seen: Seen::NEW, cancel: Cancel::No });
    }

    fn delete(&mut self, id: Uuid) -> bool {
        let is_present = self.with_id(id).is_some();
        if is_present {
            self.present = None;
            self.deleted.push(id);
            self.is_hopeless |= self.to_come.get(&id).is_some_and(|versions| !versions.is_empty());
        }
        is_present
    }
}

impl SequentialSpec for Key {
    type Op = Op;
    type Ret = Ret;

    /// The effect of an operation without a response. Its result is not used.
    fn invoke(&mut self, op: &Op) -> Ret {
        match *op {
            Op::Submit => self.submit(),
            Op::Cancel(id) => {
                if let Some(present) = self.with_id(id).filter(|present| present.cancel == Cancel::No) {
                    present.cancel = Cancel::Perhaps;
                }
            }
            Op::Delete(id) => drop(self.delete(id)),
            Op::Get(_) | Op::List => {}
        }
        Ret::Missing
    }

    fn is_valid_step(&mut self, op: &Op, ret: &Ret) -> bool {
        let is_valid = match (*op, ret) {
            (Op::Submit, Ret::Shown(id, seen)) => {
                self.submit();
                self.shows(*id, *seen)
            }
            (Op::Get(asked), Ret::Shown(id, seen)) => asked == *id && self.shows(*id, *seen),
            // An ended model stays as it is, a queued one ends, a running one is told to stop.
            (Op::Cancel(asked), Ret::Shown(id, seen)) => {
                self.invoke(op);
                let is_legal = asked == *id && seen.status != Status::Queued && self.shows(*id, *seen);
                if let Some(present) = self.with_id(asked).filter(|_| seen.status == Status::Running) {
                    present.cancel = Cancel::Acknowledged;
                }
                is_legal
            }
            (Op::Get(id) | Op::Cancel(id) | Op::Delete(id), Ret::Missing) => self.with_id(id).is_none(),
            (Op::Delete(id), Ret::Deleted) => self.delete(id),
            (Op::List, Ret::Listed(models)) => match (models.as_slice(), &self.present) {
                ([], present) => present.is_none(),
                ([(id, seen)], Some(_)) => self.shows(*id, *seen),
                _ => false,
            },
            _ => false,
        };
        is_valid && !self.is_hopeless
    }
}
