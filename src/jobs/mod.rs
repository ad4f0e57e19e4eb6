//! Jobs: the record of each request for a model or a fit, the queue, the job store, and the
//! artifact store.
//!
//! HTTP and workers communicate only through this module. The states of a job are `queued → running
//! → succeeded | failed | cancelled`; an ended job never changes. Every write of a worker carries
//! the number of the attempt that it claimed, so a worker that lost its lease cannot change a job
//! that another worker holds.

pub mod artifacts;
mod attempt;
mod batch;
mod bulk;
mod error;
pub mod fault;
mod folders;
mod job;
pub mod jumps;
pub mod keys;
mod list;
mod open;
mod operators;
mod options;
mod postgres;
pub mod reuse;
#[cfg(test)]
mod sample;
pub mod scratch;
pub mod scrub;
mod sql;
mod sqlite;
pub mod state;
pub mod sweep;

pub use attempt::{Attempt, ClaimedJob, Directive, Finished};
pub use batch::{Batch, BatchFilter, BatchPage, NewBatch, SubmittedBatch};
pub use bulk::{BulkAction, BulkOperation, BulkPage, BulkStep, NewBulk, OperationId};
pub use error::{Quantity, StoreError, with_causes};
pub use job::{
    BackendReport, BatchId, File, Job, JobId, JobKind, JobProgress, LiveSection, NewJob, NoPriority, Priority, Problem,
    Quota, Status, Submitted,
};
pub use list::{Change, Counts, ListFilter, Page};
pub use open::{Database, open};
pub use operators::{
    Instruction, Pause, PoolUse, QueueReason, WorkerCondition, WorkerCounts, WorkerInfo, WorkerKind, WorkerState,
    Workforce,
};
pub use options::StoreOptions;
pub use sql::{Hook, LastRound, Mismatch, Observation, Store, UpkeepRound, UpkeepState, UpkeepTask};
pub use state::{ClaimScope, Lane, MAX_LEASE};
