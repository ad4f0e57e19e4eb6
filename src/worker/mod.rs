//! Workers: claim jobs, generate models, upload the files to the artifact store, and end the jobs.
//!
//! A [`WorkerPool`] runs the workers of this process; other machines may run workers over the same
//! stores. Invariants:
//!
//! - A worker writes to a job only through its claim. A worker that lost its lease changes nothing
//!   and removes its uploads.
//! - Files are in the artifact store before the commit that names them.
//! - If a generation panics, exceeds its memory or time, returns an error, or does not return, only
//!   its job fails.
//! - Unavailable storage makes no job fail, and the attempts do not count.
//!
//! A CPU worker computes one model at a time, and one fit beside the models; a GPU worker (one per
//! adapter) computes a batch of jobs with the same batch key. A worker claims its next job when its
//! device is free, or when the current job nearly ends, so that its threads do not wait for the
//! stores. If the threads are not free soon after, it releases the job that it claimed early.
//! Workers claim by the requested backend:
//!
//! - `gpu`: GPU workers. `cpu` and `cpu-single`: CPU workers.
//! - `auto`: GPU workers. CPU workers claim `auto` jobs only while no GPU worker is live, or while
//!   the queue is longer than the GPU workers can take with their next two claims.
//! - A job that a GPU cannot grow (it does not fit; the device is lost or out of memory) continues
//!   within the same attempt on the CPU of that worker if it is `auto`, and fails if it is `gpu`.
//!
//! A worker that is paused or drained (`jobs::Store::instruct`) claims nothing, and CPU workers
//! leave no `auto` jobs to it.
//!
//! If an `auto` job does not run on a GPU, `backend.fallback` is the reason.
//!
//! Each file imports only from files above it in this table:
//!
//! | file | subject |
//! |---|---|
//! | `options` | settings of a pool |
//! | `generator` | the interface to the generators of models: [`Generator`], [`BatchGenerator`] |
//! | `verdict` | consequences of errors for a job |
//! | `policy` | jobs that a worker may claim; pauses while storage is unavailable |
//! | `gate` | division of the time of a worker between models and a fit |
//! | `busy` | busy workers, for the metrics |
//! | `context` | state that all slots and attempts of a pool share |
//! | `checkpoint` | checkpoints to the artifact store, and back to the next attempt |
//! | `progress` | the sink of a generation: progress and sections for the heartbeats |
//! | `lease` | the lease during the work: heartbeats and cancellations |
//! | `upload` | files to the artifact store |
//! | `backend` | generations on the threads of a CPU or on a GPU |
//! | `attempt` | one attempt at a job, from its claim to its end |
//! | `pool` | the workers of a process: slots, claims, heartbeats, shutdown |

mod attempt;
mod backend;
mod busy;
mod checkpoint;
mod context;
mod gate;
mod generator;
mod lease;
mod options;
mod policy;
mod pool;
mod progress;
mod upload;
mod verdict;

pub use backend::cpu::{generate_on_cpu, lower_priority};
pub use backend::gpu::GpuGenerator;
pub use generator::{AdmittedPlan, BatchCallbacks, BatchGenerator, BatchMember, GenerationInput, Generator, WorkError};
pub use options::{ALIVE_HEARTBEATS, PoolOptions};
pub use pool::WorkerPool;
