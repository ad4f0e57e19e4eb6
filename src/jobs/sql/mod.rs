//! What the stores on SQLite and PostgreSQL share: every query that both databases understand, written once.
//!
//! An [`Engine`] runs an [`Operation`] in a transaction ([`Tx`]). The operation loads the state of the job (and locks its
//! row, if other connections could change it), asks the pure state machine, and writes the result. Where the two databases
//! differ, the operation asks [`Tx::dialect`]. Parameters are `$1`, `$2`, …; times are microseconds since 1970 UTC; ids are
//! hyphenated UUIDv7, so they sort by age.
//!
//! | file | subject |
//! |---|---|
//! | `store` | the [`Store`](super::Store) trait over either engine; retries |
//! | `tx`, `codec`, `error`, `operation` | connections, values, errors, what runs in a transaction |
//! | `submit`, `batch`, `claim`, `lease`, `workers`, `pause`, `upkeep` | the operations |
//! | `bulk` | many jobs in one transaction |
//! | `share` | equal requests that wait for one growth |
//! | `keys` | keys of clients, tickets |
//! | `order` | turns and positions in the queue |
//! | `quota` | what an owner has |
//! | `migrations` | the tables from one version to the next |
//! | `record`, `read` | rows to jobs and attempts; lists and counts |

mod batch;
mod bulk;
mod claim;
mod codec;
mod error;
mod keys;
mod lease;
mod migrations;
mod operation;
mod order;
mod pause;
mod quota;
mod read;
mod record;
mod share;
mod store;
mod submit;
mod tx;
mod upkeep;
mod workers;

pub(super) use error::SqlError;
pub(super) use lease::Expire;
pub(super) use migrations::{migrations, migrator};
pub(super) use operation::{Done, Operation};
pub use store::SqlStore;
pub(super) use store::{Engine, Reader, Trouble, run_or_find};
pub(super) use tx::{Connection, Time, Tx};
pub(super) use upkeep::FreeUpkeep;
