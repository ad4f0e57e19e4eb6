//! What the stores on SQLite and PostgreSQL share: every query that both understand, written once.
//!
//! A store hands an [`Operation`] a [`Link`], the connection of a transaction; the operation loads the state of
//! the job (and locks it, where others could change it meanwhile), asks the pure state machine, and writes
//! down what comes out. What differs between the two databases is decided by [`Link::dialect`], in few places.
//! Parameters are `$1`, `$2`, …; times are microseconds since 1970 UTC, ids hyphenated UUIDv7, so that they
//! sort by age.

mod batch;
mod claim;
mod lease;
mod link;
mod order;
mod read;
mod store;
mod submit;
mod workers;

pub(super) use lease::Expire;
pub(super) use link::{Connection, Dialect, Link, Row, SqlError, Time, Value};
pub use store::SqlStore;
pub(super) use store::{Engine, Reader};

use super::store::{Change, StoreError, StoreOptions};
use jiff::Timestamp;
use std::future::Future;
use std::time::Duration;

/// Changes that a slow receiver may be behind before it is told that it lags.
pub(super) const CHANGES: usize = 4096;

/// Something done in one transaction.
pub(super) trait Operation: Send + Sync + 'static {
    /// What comes of it.
    type Output: Send + 'static;

    /// Does it. May be called again where the transaction was rolled back.
    fn run(
        &self,
        link: &mut Link<'_>,
        options: &StoreOptions,
    ) -> impl Future<Output = Result<Done<Self::Output>, SqlError>> + Send;

    /// What came of it, where it was done by a commit whose answer got lost. `None` where it was not, and where
    /// doing it again leads to the same.
    fn done_before(&self, _link: &mut Link<'_>) -> impl Future<Output = Result<Before<Self::Output>, SqlError>> + Send {
        async { Ok(None) }
    }

    /// How long it is tried again while the database is away.
    fn patience(&self) -> Duration {
        Duration::from_secs(5)
    }
}

/// What an operation did.
#[derive(Debug)]
pub(super) struct Done<T> {
    /// What comes of it.
    pub(super) output: T,
    /// What others are to be told of.
    pub(super) changes: Vec<Change>,
}

/// What was done before, where it was.
pub(super) type Before<T> = Option<Done<T>>;

impl<T> Done<T> {
    fn new(output: T, changes: Vec<Change>) -> Self {
        Self { output, changes }
    }

    /// Nothing that others need to know.
    fn quiet(output: T) -> Self {
        Self::new(output, Vec::new())
    }
}

/// The values of the parameters of a query, in order.
macro_rules! values {
    ($($value:expr),* $(,)?) => { vec![$($crate::jobs::sql::Value::from($value)),*] };
}
use values;

fn broken(error: &dyn std::error::Error) -> SqlError {
    SqlError::Store(StoreError::Database(format!("a broken record: {error}")))
}

fn timestamp(micros: i64) -> Result<Timestamp, SqlError> {
    Timestamp::from_microsecond(micros).map_err(|error| broken(&error))
}

fn json<T: serde::Serialize>(value: &T) -> String {
    serde_json::to_string(value).expect("records have string keys and finite numbers only")
}

/// A unit variant as the string that serde names it by.
fn word<T: serde::Serialize>(value: T) -> String {
    match serde_json::to_value(value) {
        Ok(serde_json::Value::String(word)) => word,
        _ => unreachable!("only unit variants are stored as words"),
    }
}

fn parse<T: serde::de::DeserializeOwned>(text: &str) -> Result<T, SqlError> {
    serde_json::from_str(text).map_err(|error| broken(&error))
}

/// A unit variant, stored as the string that serde names it by.
fn variant<T: serde::de::DeserializeOwned>(word: &str) -> Result<T, SqlError> {
    serde_json::from_value(serde_json::Value::String(word.to_owned())).map_err(|error| broken(&error))
}

fn until(now: Timestamp, wait: Duration) -> Timestamp {
    now.saturating_add(wait).unwrap_or(Timestamp::MAX)
}
