//! Jobs: the record of each request for a model, the queue, the job stores, and the artifact store.
//!
//! HTTP and workers communicate only through this module. A job's states are `queued → running → succeeded | failed |
//! cancelled`; an ended job never changes. Every write of a worker is fenced with the number of the attempt that
//! it claimed, so that a worker that lost its lease cannot change a job that another worker holds.

pub mod artifacts;
mod error;
pub mod fault;
mod job;
pub mod keys;
mod open;
mod operators;
pub mod postgres;
pub mod reuse;
pub mod scratch;
mod sql;
pub mod sqlite;
pub mod state;
mod store;
pub mod sweep;

pub use job::{
    BackendReport, BatchId, File, Job, JobId, JobKind, JobProgress, LiveSection, NewJob, NoPriority, Priority, Problem,
    Quota, Status,
};
pub use open::{Database, open};
pub use operators::{Instruction, Pause, PoolUse, WorkerInfo, WorkerState};
pub use sql::SqlStore;
pub use store::{
    Applied, Attempt, Batch, BatchFilter, BatchPage, Change, ClaimedJob, Counts, Directive, Finished, ListFilter,
    NewBatch, Page, Quantity, Store, StoreError, StoreOptions, Submitted, SubmittedBatch, UpkeepTask,
};
