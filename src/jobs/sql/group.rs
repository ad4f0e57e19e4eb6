//! Group commit: changes that wait for the same transaction to end share the next one.
//!
//! A change without others begins its transaction immediately. While that is committed, further
//! changes gather; one of them, the leader, then runs all of them in one transaction with one
//! commit. A change that is refused writes nothing, so it does not affect the others. If anything
//! else fails, each change runs again alone, with its own retries.
//!
//! On SQLite all changes but submissions of batches are grouped, because there is one writer. On
//! PostgreSQL submissions, claims and ends of attempts form groups, each kind its own, and share
//! statements too. A group holds the locks of all its members, so one that waits for the lock of
//! another process delays the others; therefore heartbeats are not grouped there.

use super::error::SqlError;
use super::hook::Call;
use super::operation::{Done, Operation};
use super::tx::Tx;
use crate::jobs::StoreOptions;
use crate::lock::Mutex;
use futures_util::FutureExt;
use futures_util::future::BoxFuture;
use std::any::Any;
use std::future::Future;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use tokio::sync::oneshot;

/// Maximum number of changes in a group, which limits the time until the first is committed.
const MEMBERS: usize = 128;

/// Maximum number of times that a leader lets other tasks run before it takes the members.
const GATHERING: usize = 32;

/// Changes that wait for the next transaction.
#[derive(Default)]
pub(super) struct Group {
    waiting: Mutex<Vec<Box<dyn Member>>>,
    /// Number of members of the last group.
    last: AtomicUsize,
    /// Held by the leader until its transaction has ended.
    leader: tokio::sync::Mutex<()>,
}

/// What became of a change in a group.
pub(super) enum Outcome<T> {
    Committed(Done<T>),
    Refused(SqlError),
    /// The change runs alone. The value is the result of a run whose commit has an unknown outcome.
    Alone(Option<Done<T>>),
}

/// How the transaction of a group ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum End {
    Committed,
    /// The commit failed.
    Uncertain,
    RolledBack,
}

/// A change in a group.
trait Member: Any + Send {
    /// Runs the change in the transaction of the group, together with `others` of the same type. An
    /// error other than a refusal ends the group.
    fn run_with<'a>(
        &'a mut self,
        others: &'a mut [Box<dyn Member>],
        tx: &'a mut Tx<'_>,
        options: &'a StoreOptions,
    ) -> BoxFuture<'a, Result<(), SqlError>>;

    /// Tells the caller what became of the change.
    fn tell(self: Box<Self>, end: End);
}

struct Ticket<O: Operation> {
    operation: Arc<O>,
    call: Arc<Call>,
    result: Option<Result<Done<O::Output>, SqlError>>,
    caller: oneshot::Sender<Outcome<O::Output>>,
}

impl<O: Operation> Member for Ticket<O> {
    fn run_with<'a>(
        &'a mut self,
        others: &'a mut [Box<dyn Member>],
        tx: &'a mut Tx<'_>,
        options: &'a StoreOptions,
    ) -> BoxFuture<'a, Result<(), SqlError>> {
        let others = others.iter_mut().map(|other| {
            let other: &mut dyn Any = &mut **other;
            other.downcast_mut::<Self>().expect("the changes are of the same type")
        });
        let tickets: Vec<&mut Self> = std::iter::once(self).chain(others).collect();
        let operations: Vec<Arc<O>> = tickets.iter().map(|ticket| Arc::clone(&ticket.operation)).collect();
        async move {
            let results = O::run_together(&operations, tx, options).await?;
            for (ticket, result) in tickets.into_iter().zip(results) {
                ticket.result = Some(result);
            }
            Ok(())
        }
        .boxed()
    }

    fn tell(self: Box<Self>, end: End) {
        let Self { call, result, caller, .. } = *self;
        let outcome = match (end, result) {
            (End::Committed, Some(Ok(done))) if call.loses_commit() => Outcome::Alone(Some(done)),
            (End::Committed, Some(Ok(done))) => Outcome::Committed(done),
            (End::Committed, Some(Err(refusal))) => Outcome::Refused(refusal),
            (End::Uncertain, Some(Ok(done))) => Outcome::Alone(Some(done)),
            // A refusal may follow from changes of others that were rolled back.
            (_, _) => Outcome::Alone(None),
        };
        // Fails if the runtime is shutting down.
        let _ = caller.send(outcome);
    }
}

/// Where groups run.
pub(super) trait Transactions: Sync {
    /// A new transaction.
    fn begin(&self) -> impl Future<Output = Result<Tx<'_>, SqlError>> + Send;

    fn options(&self) -> &StoreOptions;

    /// Notes that a transaction failed.
    fn failed(&self, error: SqlError);
}

impl Group {
    /// Runs the operation of `call` together with others.
    pub(super) async fn transact<O: Operation>(
        &self,
        transactions: &impl Transactions,
        call: &Arc<Call>,
        operation: &Arc<O>,
    ) -> Outcome<O::Output> {
        let (caller, mut outcome) = oneshot::channel();
        let (operation, call) = (Arc::clone(operation), Arc::clone(call));
        self.waiting.lock().push(Box::new(Ticket { operation, call, result: None, caller }));
        loop {
            tokio::select! {
                biased;
                outcome = &mut outcome => return outcome.unwrap_or(Outcome::Alone(None)),
                _leader = self.leader.lock() => {
                    self.gather().await;
                    let mut members = std::mem::take(&mut *self.waiting.lock());
                    let later = members.split_off(members.len().min(MEMBERS));
                    self.waiting.lock().splice(..0, later);
                    self.last.store(members.len(), Ordering::Relaxed);
                    let end = run(transactions, &mut members).await;
                    members.into_iter().for_each(|member| member.tell(end));
                }
            }
        }
    }
}

impl Group {
    /// Lets the callers of the last group, which have just got their results, join this one.
    /// Otherwise two halves of the callers take turns in groups of half the size.
    async fn gather(&self) {
        for _ in 0..GATHERING {
            if self.waiting.lock().len() >= self.last.load(Ordering::Relaxed) {
                return;
            }
            tokio::task::yield_now().await;
        }
    }
}

/// Runs a group in one transaction.
async fn run(transactions: &impl Transactions, members: &mut [Box<dyn Member>]) -> End {
    let failed = |error, end| {
        transactions.failed(error);
        end
    };
    let mut tx = match transactions.begin().await {
        Ok(tx) => tx,
        Err(error) => return failed(error, End::RolledBack),
    };
    for alike in members.chunk_by_mut(|one, next| (**one).type_id() == (**next).type_id()) {
        let Some((first, others)) = alike.split_first_mut() else { continue };
        if let Err(error) = first.run_with(others, &mut tx, transactions.options()).await {
            tx.roll_back().await;
            return failed(error, End::RolledBack);
        }
    }
    match tx.commit().await {
        Ok(()) => End::Committed,
        Err(error) => failed(error, End::Uncertain),
    }
}
