//! The job store on SQLite and PostgreSQL: every query that both databases understand, written
//! once.
//!
//! A call of [`Store`] reads, or runs an [`Operation`](operation::Operation) in a transaction
//! ([`Tx`]). The operation loads the state of the job (and locks its row, if other connections
//! could change it), asks the pure state machine, and writes the result. Where the two databases
//! differ, it asks [`Tx::dialect`]. Parameters are `$1`, `$2`, …; times are microseconds since 1970
//! UTC; ids are hyphenated UUIDv7, so they sort by age.
//!
//! | file | subject, with its calls |
//! |---|---|
//! | `store`, `hook` | [`Store`]: connections to either database, retries, notification; test hook |
//! | `tx`, `codec`, `error`, `operation` | transactions, values, errors, operations |
//! | `group` | changes that share a transaction and its commit |
//! | `submit`, `delete`, `spent` | submissions and reuse; deletion; ids that no submission may use any more |
//! | `batch` | batches |
//! | `bulk` | changes of many jobs in one transaction |
//! | `claim`, `order`, `place` | claims; turns and positions in the queue |
//! | `lease`, `end` | heartbeats, cancellation, expiry; ends of attempts |
//! | `share` | equal requests that wait for one growth |
//! | `read`, `record` | jobs, lists, attempts and counts; rows to jobs |
//! | `workers` | the list of workers; pauses |
//! | `keys`, `quota` | API keys and tickets; quotas of owners |
//! | `upkeep` | locks of periodic tasks; keys in use; state that outlives processes |
//! | `migrations` | the tables from one version to the next |

mod batch;
mod bulk;
mod claim;
mod codec;
mod delete;
mod end;
mod error;
mod group;
mod hook;
mod keys;
mod lease;
mod migrations;
mod operation;
mod order;
mod place;
mod quota;
mod read;
mod record;
mod share;
mod spent;
mod store;
mod submit;
mod tx;
mod upkeep;
mod workers;

pub(super) use error::{Severity, SqlError};
pub use hook::Hook;
pub(super) use migrations::{migrations, migrator};
pub(super) use store::Engine;
pub use store::Store;
pub(super) use tx::{Connection, LastRead, Time, roll_back};
pub use upkeep::{LastRound, Mismatch, Observation, UpkeepRound, UpkeepState, UpkeepTask};
