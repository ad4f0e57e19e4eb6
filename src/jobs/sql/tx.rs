//! A connection to either database, with the few types of values that records consist of.

use super::codec::{Value, json, until};
use super::error::{SqlError, broken};
use super::place::Place;
use crate::clock::{Clock, Stopwatch};
use crate::jobs::postgres::pool as postgres;
use crate::jobs::sqlite::packed::{pack, unpack};
use crate::jobs::sqlite::pool as sqlite;
use crate::lock::Mutex;
use jiff::Timestamp;
use sqlx::postgres::{PgArguments, PgRow};
use sqlx::query::Query;
use sqlx::sqlite::{SqliteArguments, SqliteRow};
use sqlx::{AssertSqlSafe, Decode, Postgres, Row as _, SqlSafeStr, SqlStr, Sqlite, SqliteConnection, Type};
use std::borrow::Cow;
use std::io;
use std::sync::Arc;
use std::time::Duration;
use uuid::Uuid;

/// A connection on loan from a pool, in a transaction if its user has begun one.
#[derive(Debug)]
pub(in crate::jobs) enum Connection {
    Sqlite(sqlite::Loan),
    Postgres(postgres::Loan),
}

/// Source of the time of leases and records.
#[derive(Clone, Debug)]
pub(in crate::jobs) enum Time {
    /// A clock of this process; no other process has the store open.
    Clock(Clock, Steady),
    /// The database's clock, the same for all processes that share it.
    Database(LastRead),
}

/// The last time that this process has read from the clock of the database, and the time elapsed
/// since.
#[derive(Clone, Debug, Default)]
pub(in crate::jobs) struct LastRead(Arc<Mutex<Option<(Timestamp, Stopwatch)>>>);

/// Age up to which a time of the database is continued by the clock of this process.
const CONTINUED_FOR: Duration = Duration::from_secs(1);

impl LastRead {
    fn note(&self, now: Timestamp) {
        *self.0.lock() = Some((now, Stopwatch::start()));
    }

    /// The time of the database, or a little earlier; `None` if it was not read lately.
    fn continued(&self) -> Option<Timestamp> {
        let (read, since) = (*self.0.lock())?;
        let elapsed = since.elapsed();
        let now = timestamp(until(read, elapsed).as_microsecond()).ok();
        now.filter(|_| elapsed < CONTINUED_FOR)
    }
}

/// Time of the clock when the store was opened, and the time elapsed since. Setting the clock has
/// no effect on it.
#[derive(Clone, Copy, Debug)]
pub(in crate::jobs) struct Steady {
    start: Timestamp,
    since: Stopwatch,
}

impl Time {
    pub(in crate::jobs) fn from_clock(clock: Clock) -> Self {
        let steady = Steady { start: clock.now(), since: Stopwatch::start() };
        Self::Clock(clock, steady)
    }

    /// The time of leases and delays; `None` if it is the time of records.
    fn steady(&self) -> Option<Timestamp> {
        match self {
            Self::Clock(Clock::System, Steady { start, since }) => Some(until(*start, since.elapsed())),
            Self::Clock(Clock::Manual(_), _) | Self::Database(_) => None,
        }
    }
}

/// A connection, in a transaction unless it only reads, with the time.
#[derive(Debug)]
pub(in crate::jobs) struct Tx<'c> {
    connection: Connection,
    time: &'c Time,
    now: Option<Timestamp>,
    /// A place in the queue that this transaction has found to be farther back than positions are
    /// counted.
    far: Option<Place>,
}

/// Text of a query.
type Sql = Cow<'static, str>;

/// Marks a query as safe: siblings of this module assemble queries from constants, and input of
/// clients is always a parameter.
fn constant(sql: impl Into<Sql>) -> SqlStr {
    match sql.into() {
        Cow::Borrowed(sql) => sql.into_sql_str(),
        Cow::Owned(sql) => AssertSqlSafe(sql).into_sql_str(),
    }
}

fn for_sqlite<'q>(sql: SqlStr, values: Vec<Value>) -> Query<'q, Sqlite, SqliteArguments> {
    values.into_iter().fold(sqlx::query(sql), |query, value| match value {
        Value::Int(value) => query.bind(value),
        Value::Text(value) => query.bind(value),
        Value::Bytes(value) => query.bind(value),
        Value::Texts(values) => query.bind(json(&values)),
        Value::Flag(value) => query.bind(value),
    })
}

fn for_postgres<'q>(sql: SqlStr, values: Vec<Value>) -> Query<'q, Postgres, PgArguments> {
    values.into_iter().fold(sqlx::query(sql), |query, value| match value {
        Value::Int(value) => query.bind(value),
        Value::Text(value) => query.bind(value),
        Value::Bytes(value) => query.bind(value),
        Value::Texts(values) => query.bind(values),
        Value::Flag(value) => query.bind(value),
    })
}

impl<'c> Tx<'c> {
    pub(in crate::jobs) fn new(connection: Connection, time: &'c Time) -> Self {
        Self { connection, time, now: None, far: None }
    }

    /// True if this transaction has found a place before `place` in its lane to be farther back
    /// than positions are counted.
    pub(super) fn is_far(&self, place: &Place) -> bool {
        self.far.as_ref().is_some_and(|far| far.lane == place.lane && far < place)
    }

    /// Notes that a place is farther back than positions are counted.
    pub(super) fn note_far(&mut self, place: Place) {
        self.far = Some(place);
    }

    /// Commits the transaction. If this fails, the transaction was rolled back, or the outcome is
    /// unknown.
    pub(in crate::jobs) async fn commit(self) -> Result<(), SqlError> {
        match self.connection {
            Connection::Sqlite(mut connection) => {
                let committed = sqlx::query("COMMIT").execute(&mut *connection).await;
                if committed.is_err() {
                    roll_back(&mut connection).await;
                }
                committed?;
            }
            Connection::Postgres(mut session) => session.commit().await?,
        }
        Ok(())
    }

    /// Rolls the transaction back. Returns only then, because the next claim would skip rows that
    /// are still locked.
    pub(in crate::jobs) async fn roll_back(self) {
        match self.connection {
            Connection::Sqlite(mut connection) => roll_back(&mut connection).await,
            Connection::Postgres(mut session) => session.roll_back().await,
        }
    }

    pub(in crate::jobs) fn is_postgres(&self) -> bool {
        !matches!(self.connection, Connection::Sqlite(_))
    }

    /// The first text on SQLite, the second on PostgreSQL.
    pub(in crate::jobs) fn either(&self, sqlite: &'static str, postgres: &'static str) -> &'static str {
        if self.is_postgres() { postgres } else { sqlite }
    }

    /// The stored form of a spec.
    pub(super) fn spec(&self, text: &str) -> Value {
        if self.is_postgres() { text.into() } else { pack(text).into() }
    }

    /// Expression for the time of PostgreSQL, in microseconds.
    pub(super) const NOW: &'static str = "CAST(EXTRACT(EPOCH FROM clock_timestamp()) * 1000000 AS BIGINT)";

    /// Uses a time that a statement read from [`Tx::NOW`], if leases and records have the time of the
    /// database and this is the first time of the transaction.
    pub(super) fn set_now(&mut self, now: Option<Timestamp>) {
        if let (Time::Database(read), Some(now)) = (self.time, now) {
            self.now.get_or_insert(now);
            read.note(now);
        }
    }

    /// Lets this transaction have the time of an earlier one.
    pub(super) fn use_time(&mut self, time: Timestamp) {
        self.now = Some(time);
    }

    /// The time of this transaction for a statement that otherwise reads [`Tx::NOW`]; `None` if the
    /// time is that of the database.
    pub(super) fn known_now(&self) -> Result<Option<Timestamp>, SqlError> {
        match (self.now, self.time) {
            (None, Time::Clock(clock, _)) => microseconds(clock).map(Some),
            (now, _) => Ok(now),
        }
    }

    /// The time of this transaction, read once.
    pub(in crate::jobs) async fn now(&mut self) -> Result<Timestamp, SqlError> {
        if let Some(now) = self.now {
            return Ok(now);
        }
        let now = match self.time {
            Time::Clock(clock, _) => microseconds(clock)?,
            Time::Database(read) => {
                let row = self.one(format!("SELECT {} AS now", Self::NOW), Vec::new()).await?;
                let now = timestamp(row.get("now")?)?;
                read.note(now);
                now
            }
        };
        Ok(*self.now.insert(now))
    }

    /// The time of this transaction, or a little earlier: that of the database is read at most once
    /// a second.
    pub(super) async fn recently(&mut self) -> Result<Timestamp, SqlError> {
        match self.time {
            Time::Database(read) if self.now.is_none() => match read.continued() {
                Some(now) => Ok(now),
                None => self.now().await,
            },
            _ => self.now().await,
        }
    }

    /// The time of leases and delays. On SQLite it is monotonic.
    pub(in crate::jobs) async fn steady(&mut self) -> Result<Timestamp, SqlError> {
        match self.time.steady() {
            Some(now) => Ok(now),
            None => self.now().await,
        }
    }

    /// Locks a text until the transaction ends. SQLite has one writer, so there it does nothing.
    pub(super) async fn lock_text(&mut self, text: &str) -> Result<(), SqlError> {
        let Connection::Postgres(session) = &mut self.connection else { return Ok(()) };
        let literal = text.replace('\'', "''");
        session.send_simple(&format!("SELECT pg_advisory_xact_lock(hashtextextended('{literal}', 0))")).await
    }

    /// Runs a statement and returns the number of changed rows.
    pub(super) async fn execute(&mut self, sql: impl Into<Sql>, values: Vec<Value>) -> Result<u64, SqlError> {
        let sql = constant(sql);
        Ok(match &mut self.connection {
            Connection::Sqlite(driver) => for_sqlite(sql, values).execute(&mut **driver).await?.rows_affected(),
            Connection::Postgres(session) => {
                let query = for_postgres(sql, values);
                session.answer(|driver| query.execute(driver)).await?.rows_affected()
            }
        })
    }

    /// All rows of a query.
    pub(super) async fn all(&mut self, sql: impl Into<Sql>, values: Vec<Value>) -> Result<Vec<Row>, SqlError> {
        let sql = constant(sql);
        Ok(match &mut self.connection {
            Connection::Sqlite(driver) => {
                for_sqlite(sql, values).fetch_all(&mut **driver).await?.into_iter().map(Row::Sqlite).collect()
            }
            Connection::Postgres(session) => {
                let query = for_postgres(sql, values);
                let rows = session.answer(|driver| query.fetch_all(driver)).await?;
                rows.into_iter().map(Row::Postgres).collect()
            }
        })
    }

    /// The row of a query; `None` if there is none.
    pub(super) async fn optional(&mut self, sql: impl Into<Sql>, values: Vec<Value>) -> Result<Option<Row>, SqlError> {
        let sql = constant(sql);
        Ok(match &mut self.connection {
            Connection::Sqlite(driver) => for_sqlite(sql, values).fetch_optional(&mut **driver).await?.map(Row::Sqlite),
            Connection::Postgres(session) => {
                let query = for_postgres(sql, values);
                session.answer(|driver| query.fetch_optional(driver)).await?.map(Row::Postgres)
            }
        })
    }

    /// The rows of a statement of PostgreSQL that is a transaction by itself, unless one has begun.
    /// If it fails, the outcome is unknown.
    pub(super) async fn all_alone(&mut self, sql: &'static str, values: Vec<Value>) -> Result<Vec<Row>, SqlError> {
        let Connection::Postgres(session) = &mut self.connection else { return self.all(sql, values).await };
        let query = for_postgres(constant(sql), values);
        let rows = session.answer_alone(|driver| query.fetch_all(driver)).await?;
        Ok(rows.into_iter().map(Row::Postgres).collect())
    }

    /// The row of a query that always has one.
    pub(super) async fn one(&mut self, sql: impl Into<Sql>, values: Vec<Value>) -> Result<Row, SqlError> {
        Ok(self.optional(sql, values).await?.ok_or(sqlx::Error::RowNotFound)?)
    }
}

/// Rolls back a transaction on SQLite. Fails if SQLite has rolled back already, which is harmless.
pub(in crate::jobs) async fn roll_back(connection: &mut SqliteConnection) {
    let _ = sqlx::query("ROLLBACK").execute(connection).await;
}

/// A row of either database.
#[derive(Debug)]
pub(in crate::jobs) enum Row {
    Sqlite(SqliteRow),
    Postgres(PgRow),
}

impl Row {
    /// The value of a column: a text, an integer, a flag, or an optional one of these.
    pub(in crate::jobs) fn get<'r, T>(&'r self, column: &str) -> Result<T, SqlError>
    where
        T: Decode<'r, Sqlite> + Type<Sqlite> + Decode<'r, Postgres> + Type<Postgres>,
    {
        Ok(match self {
            Self::Sqlite(row) => row.try_get(column)?,
            Self::Postgres(row) => row.try_get(column)?,
        })
    }

    /// A count, as any integer type.
    pub(in crate::jobs) fn count<T: TryFrom<i64, Error: std::error::Error + Send + Sync + 'static>>(
        &self,
        column: &str,
    ) -> Result<T, SqlError> {
        T::try_from(self.get(column)?).map_err(broken)
    }

    /// The id of a job or a batch.
    pub(in crate::jobs) fn id(&self, column: &str) -> Result<Uuid, SqlError> {
        self.get::<&str>(column)?.parse().map_err(broken)
    }

    pub(in crate::jobs) fn optional_id(&self, column: &str) -> Result<Option<Uuid>, SqlError> {
        self.get::<Option<&str>>(column)?.map(str::parse).transpose().map_err(broken)
    }

    /// The text of the spec of a job; an error if its stored form is damaged.
    pub(super) fn spec(&self) -> Result<io::Result<Cow<'_, str>>, SqlError> {
        Ok(match self {
            Self::Sqlite(row) => unpack(row.try_get("spec")?),
            Self::Postgres(row) => Ok(row.try_get::<&str, _>("spec")?.into()),
        })
    }

    pub(in crate::jobs) fn time(&self, column: &str) -> Result<Timestamp, SqlError> {
        timestamp(self.get(column)?)
    }

    pub(in crate::jobs) fn optional_time(&self, column: &str) -> Result<Option<Timestamp>, SqlError> {
        self.get::<Option<i64>>(column)?.map(timestamp).transpose()
    }
}

/// The time of a clock in the resolution of records.
fn microseconds(clock: &Clock) -> Result<Timestamp, SqlError> {
    timestamp(clock.now().as_microsecond())
}

fn timestamp(micros: i64) -> Result<Timestamp, SqlError> {
    Timestamp::from_microsecond(micros).map_err(broken)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn leases_do_not_follow_a_clock_that_is_set() {
        // The clock was set back by an hour since the store was opened.
        let hour = Duration::from_secs(3600);
        let start = until(Clock::System.now(), hour);
        let time = Time::Clock(Clock::System, Steady { start, since: Stopwatch::start() });
        let first = time.steady().unwrap();
        assert!(first >= start && first < until(start, hour));
        std::thread::sleep(Duration::from_millis(2));
        assert!(time.steady().unwrap() > first);
        let manual = Time::from_clock(Clock::manual(start));
        assert!(manual.steady().is_none(), "tests move a manual clock");
    }
}
