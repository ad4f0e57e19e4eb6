//! Workers: claim jobs, generate models, move the files to the artifact store, end the jobs.
//!
//! A [`WorkerPool`] runs some workers in this process; others may run on other machines over the same stores.
//! Invariants: a worker writes to a job only through its claim, so one that lost its lease changes nothing
//! and removes what it uploaded; files are in the artifact store before the commit that names them; whatever
//! a generation does (panic, exceed its memory or time, return an error, not return), only its own job fails; storage that is
//! unavailable fails no job and counts no attempt.
//!
//! A CPU worker computes one job at a time, a GPU worker (one per adapter) a batch of jobs with the same batch key; each
//! claims its next when its device is free, or when the job before has come to its certificate, so that its threads do not
//! wait for the stores; a job that was claimed early and whose threads do not come free soon is released. Which worker takes
//! which jobs:
//! - `gpu` goes to GPU workers, `cpu` and `cpu-single` to CPU workers, whatever else is queued.
//! - `auto` goes to GPU workers. A CPU worker takes it only while no GPU worker is alive, or while more jobs are queued
//!   than the GPU workers take with their next two claims.
//! - A job that a GPU worker holds and its device cannot grow (it does not fit; the device is lost or out of memory)
//!   continues, within the same attempt, on the CPU of that worker if it is `auto`, and fails if it is `gpu`.
//!
//! A worker that is paused or drained (`jobs::Store::instruct`) claims nothing, and `auto` is not left to it.
//!
//! Whenever `auto` does not run on a GPU, `backend.fallback` says why.
//!
//! Each file imports only from files above it in this table:
//!
//! | file | subject |
//! |---|---|
//! | `options` | settings of a pool |
//! | `generator` | the interface to what a worker runs: [`Generator`], [`BatchGenerator`] |
//! | `verdict` | what an error means for the job |
//! | `policy` | who takes what; pauses of claims while storage is unavailable |
//! | `busy` | whether a worker runs anything, for the metrics |
//! | `context` | what all slots and attempts of a pool share |
//! | `checkpoint` | checkpoints to the artifact store, and back to the next attempt |
//! | `progress` | the sink of a generation: progress and sections for the heartbeats |
//! | `lease` | the lease while work goes on: heartbeats out, cancels in |
//! | `upload` | files to the artifact store |
//! | `backend` | generations on the threads of a CPU or on a GPU |
//! | `attempt` | one attempt at a job, from its claim to its end |
//! | `pool` | the workers of a process: slots, claims, heartbeats, shutdown |

mod attempt;
mod backend;
mod busy;
mod checkpoint;
mod context;
mod generator;
mod lease;
mod options;
mod policy;
mod pool;
mod progress;
mod upload;
mod verdict;

pub use backend::cpu::generate_on_cpu;
pub use backend::gpu::GpuGenerator;
pub use generator::{Admitted, BatchCalls, BatchGenerator, BatchWork, Generator, Work, WorkError};
pub use options::{ALIVE_HEARTBEATS, PoolOptions};
pub use pool::WorkerPool;
