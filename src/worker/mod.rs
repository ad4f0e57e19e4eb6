//! Workers: claim jobs, generate models, move the files to the artifact store, end the jobs.
//!
//! A [`WorkerPool`] runs some workers in this process; others may run on other machines over the same stores.
//! Invariants: a worker writes to a job only through its claim, so one that lost its lease changes nothing
//! and removes what it uploaded; files are in the artifact store before the commit that names them; whatever
//! a generation does (panic, too much memory, an error, no answer), only its own job fails.
//!
//! | file | subject |
//! |---|---|
//! | `generator` | what a worker runs: [`Generator`] |
//! | `pool` | the workers of a process: claim loop, signs of life, shutdown |
//! | `attempt` | one attempt at a job, from its claim to its end |
//! | `keeper` | the lease while work goes on: heartbeat up, cancel down |
//! | `live` | progress and sections on their way to the heartbeat |
//! | `saver` | checkpoints to the artifact store, and back to the next attempt |
//! | `upload` | files to the artifact store |
//! | `verdict` | what an error means for the job |

mod attempt;
mod generator;
mod keeper;
mod live;
mod pool;
mod saver;
mod upload;
mod verdict;

pub use generator::{Generator, Work, WorkError};
pub use pool::{PoolOptions, WorkerPool};
