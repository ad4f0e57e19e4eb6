//! Workers: claim jobs, generate models, move the files to the artifact store, end the jobs.
//!
//! A [`WorkerPool`] runs some workers in this process; others may run on other machines over the same stores.
//! Invariants: a worker writes to a job only through its claim, so one that lost its lease changes nothing
//! and removes what it uploaded; files are in the artifact store before the commit that names them; whatever
//! a generation does (panic, too much memory, an error, no answer), only its own job fails.
//!
//! A CPU worker computes a job at a time, a GPU worker (one an adapter) a batch of like size; each claims its next one a
//! moment before it is done, so that it never waits for the stores, and gives it back where its turn does not come soon. Who
//! takes what:
//! - `gpu` goes to GPU workers, `cpu` and `cpu-single` to CPU workers, whatever else waits.
//! - `auto` goes to GPU workers. A CPU worker takes it only while no GPU worker is alive, or while more jobs wait
//!   than the GPU workers take with their next two claims.
//! - A job that a GPU worker holds and its device cannot do (it does not fit; the device is lost or out of memory)
//!   goes on, within the same attempt, on the CPU of that worker if it is `auto`, and fails if it is `gpu`.
//!
//! Wherever `auto` does not run on a GPU, `backend.fallback` says why.
//!
//! | file | subject |
//! |---|---|
//! | `generator` | what a worker runs: [`Generator`], [`BatchGenerator`] |
//! | `engine` | the real ones |
//! | `pool` | the workers of a process: claim loop, signs of life, shutdown |
//! | `options` | its settings |
//! | `share` | which jobs a CPU worker leaves to GPU workers |
//! | `batch` | the attempts of a batch side by side |
//! | `attempt` | one attempt at a job, from its claim to its end |
//! | `follow` | from the start of a generation to its outcome |
//! | `turn` | whose turn it is on the threads of a worker |
//! | `health` | rests after faults of this machine |
//! | `generation` | a generation on threads of its own, and the threads of a worker |
//! | `keeper` | the lease while work goes on: heartbeat up, cancel down |
//! | `live` | progress and sections on their way to the heartbeat |
//! | `saver` | checkpoints to the artifact store, and back to the next attempt |
//! | `upload` | files to the artifact store |
//! | `verdict` | what an error means for the job |

mod attempt;
mod batch;
mod engine;
mod follow;
mod generation;
mod generator;
mod health;
mod keeper;
mod live;
mod options;
mod pool;
mod saver;
mod share;
mod turn;
mod upload;
mod verdict;

pub use engine::{GpuGenerator, generate_on_cpu};
pub use generator::{BatchEnds, BatchGenerator, BatchWork, Generator, Work, WorkError};
pub use options::PoolOptions;
pub use pool::WorkerPool;
