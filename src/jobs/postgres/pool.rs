//! Connections to PostgreSQL. Nothing that uses one waits without a limit.
//!
//! - **Deadline.** A statement without an answer within [`StoreOptions::answer_within`] fails, and
//!   its connection is discarded. The server ends a statement a little earlier by itself.
//! - **Discarded connections.** A connection returns to the pool only between statements and
//!   outside a transaction. All others are closed: those of callers that were dropped, too.
//! - **Tests.** A connection that was idle is tested before it is used again. After a silence, idle
//!   connections that have not answered since are discarded without a test, one second each.
//! - **Refused connections** fail immediately; callers decide whether to try again.

use crate::clock::Stopwatch;
use crate::jobs::StoreOptions;
use crate::jobs::sql::SqlError;
use crate::lock::Mutex;
use deadpool::Runtime;
use deadpool::managed::{self, Metrics, Object, PoolError, QueueMode, RecycleError, RecycleResult, TimeoutType};
use sqlx::postgres::{PgConnectOptions, PgConnection};
use sqlx::{AssertSqlSafe, ConnectOptions as _, Connection as _};
use std::future::Future;
use std::sync::Arc;
use std::time::Duration;
use tokio::time::timeout;

/// Maximum time for which a caller waits for a connection, and for which one may take to open.
pub(super) const ACQUIRE_TIMEOUT: Duration = Duration::from_secs(5);
/// Maximum time for an idle connection to answer a test.
const TEST_TIMEOUT: Duration = Duration::from_secs(1);
/// Idle time after which a connection is tested before use.
const TESTED_AFTER: Duration = Duration::from_millis(200);
/// Age after which a connection is replaced, so that servers behind a name can change.
const REPLACED_AFTER: Duration = Duration::from_secs(30 * 60);

/// A pool of sessions.
pub(super) type Pool = managed::Pool<Sessions>;
/// A session on loan from the pool.
pub(in crate::jobs) type Loan = Object<Sessions>;

/// A connection to the database and its state.
#[derive(Debug)]
pub(in crate::jobs) struct Session {
    connection: PgConnection,
    /// True while a statement has no answer.
    is_waiting: bool,
    is_in_transaction: bool,
    /// True until the first statement of a transaction, which begins it.
    is_to_begin: bool,
    /// Maximum time for the answer to a statement.
    answer_within: Duration,
    last_answer: Stopwatch,
    answers: Arc<Answers>,
}

/// What the sessions of a pool know of the database.
#[derive(Debug, Default)]
pub(super) struct Answers {
    /// Time since the last answer of any session; `None` after an outage.
    latest: Mutex<Option<Stopwatch>>,
    /// Time since a statement last had no answer.
    silence: Mutex<Option<Stopwatch>>,
}

impl Answers {
    fn note(&self) -> Stopwatch {
        *self.latest.lock().insert(Stopwatch::start())
    }

    fn note_silence(&self) {
        *self.silence.lock() = Some(Stopwatch::start());
        self.note_outage();
    }

    fn note_outage(&self) {
        *self.latest.lock() = None;
    }

    /// True if the latest answer came `within` this time.
    pub(super) fn any_within(&self, within: Duration) -> bool {
        self.latest.lock().is_some_and(|since| since.elapsed() < within)
    }
}

impl Session {
    /// The answer to a statement, in a transaction if one is to begin. `send` sends the statement
    /// and awaits the answer.
    pub(in crate::jobs) async fn answer<'s, T, F>(
        &'s mut self,
        send: impl FnOnce(&'s mut PgConnection) -> F + Send,
    ) -> Result<T, SqlError>
    where
        F: Future<Output = Result<T, sqlx::Error>> + Send + 's,
    {
        if self.is_to_begin {
            self.send_simple("").await?;
        }
        self.answer_alone(send).await
    }

    /// Sends a statement without parameters, together with the begin of the transaction if it is to
    /// begin: one round trip instead of two.
    pub(in crate::jobs) async fn send_simple(&mut self, sql: &str) -> Result<(), SqlError> {
        let begin = if std::mem::take(&mut self.is_to_begin) { "BEGIN;" } else { "" };
        self.is_in_transaction |= !begin.is_empty();
        let sql = AssertSqlSafe(format!("{begin}{sql}"));
        self.answer_alone(|connection| sqlx::raw_sql(sql).execute(connection)).await.map(drop)
    }

    /// The answer to a statement that begins no transaction. If none has begun, the statement is
    /// one by itself.
    pub(in crate::jobs) async fn answer_alone<'s, T, F>(
        &'s mut self,
        send: impl FnOnce(&'s mut PgConnection) -> F + Send,
    ) -> Result<T, SqlError>
    where
        F: Future<Output = Result<T, sqlx::Error>> + Send + 's,
    {
        let Self { connection, is_waiting, answer_within, last_answer, answers, .. } = self;
        // Stays true if the caller is dropped, or if there is no answer.
        *is_waiting = true;
        let Ok(answer) = timeout(*answer_within, send(connection)).await else {
            answers.note_silence();
            return Err(SqlError::NoAnswer(*answer_within));
        };
        // After an error of the server the connection can be used again; after others it cannot.
        *is_waiting = !matches!(answer, Ok(_) | Err(sqlx::Error::Database(_) | sqlx::Error::RowNotFound));
        if *is_waiting {
            answers.note_outage();
        } else {
            *last_answer = answers.note();
        }
        Ok(answer?)
    }

    /// Lets the next statement begin a transaction.
    pub(super) fn begin(&mut self) {
        self.is_to_begin = true;
    }

    /// Commits the transaction. If this fails, the outcome is unknown.
    pub(in crate::jobs) async fn commit(&mut self) -> Result<(), SqlError> {
        if self.is_in_transaction {
            self.send_simple("COMMIT").await?;
        }
        (self.is_in_transaction, self.is_to_begin) = (false, false);
        Ok(())
    }

    /// Rolls the transaction back. If this fails, the connection is discarded, and the server rolls
    /// back when it notices.
    pub(in crate::jobs) async fn roll_back(&mut self) {
        self.is_to_begin = false;
        if self.is_in_transaction && !self.is_waiting {
            self.is_in_transaction = self.send_simple("ROLLBACK").await.is_err();
        }
    }

    /// True if the session may be used again, perhaps after a test.
    fn is_reusable(&self) -> bool {
        let silence = *self.answers.silence.lock();
        let is_outdated = silence.is_some_and(|silence| silence.elapsed() < self.last_answer.elapsed());
        !self.is_waiting && !self.is_in_transaction && !self.is_to_begin && !is_outdated
    }
}

/// Opens and tests the sessions of a pool.
#[derive(Debug)]
pub(in crate::jobs) struct Sessions {
    connect: PgConnectOptions,
    answer_within: Duration,
    answers: Arc<Answers>,
}

impl managed::Manager for Sessions {
    type Type = Session;
    type Error = sqlx::Error;

    async fn create(&self) -> Result<Session, sqlx::Error> {
        let connection = self.connect.connect().await?;
        Ok(Session {
            connection,
            is_waiting: false,
            is_in_transaction: false,
            is_to_begin: false,
            answer_within: self.answer_within,
            last_answer: self.answers.note(),
            answers: Arc::clone(&self.answers),
        })
    }

    async fn recycle(&self, session: &mut Session, metrics: &Metrics) -> RecycleResult<sqlx::Error> {
        if !session.is_reusable() || metrics.age() > REPLACED_AFTER {
            return Err(RecycleError::message("the session cannot be used again"));
        }
        if metrics.last_used() < TESTED_AFTER {
            return Ok(());
        }
        let Ok(answer) = timeout(TEST_TIMEOUT, session.connection.ping()).await else {
            self.answers.note_silence();
            return Err(RecycleError::message("the session does not answer"));
        };
        answer.inspect_err(|_| self.answers.note_outage())?;
        session.last_answer = self.answers.note();
        Ok(())
    }
}

/// A pool of at most `options.connections` sessions. Opens none yet.
pub(super) fn pool(connect: PgConnectOptions, options: &StoreOptions) -> Pool {
    let manager = Sessions { connect, answer_within: options.answer_within, answers: Arc::default() };
    Pool::builder(manager)
        .max_size(options.connections as usize)
        .wait_timeout(Some(ACQUIRE_TIMEOUT))
        .create_timeout(Some(ACQUIRE_TIMEOUT))
        // The sessions used last, so that few stay idle.
        .queue_mode(QueueMode::Lifo)
        .runtime(Runtime::Tokio1)
        .build()
        .expect("a runtime is given")
}

/// What the sessions of the pool know of the database.
pub(super) fn answers(pool: &Pool) -> &Answers {
    &pool.manager().answers
}

/// A session of the pool.
pub(super) async fn acquire(pool: &Pool) -> Result<Loan, SqlError> {
    pool.get().await.map_err(|error| match error {
        PoolError::Backend(error) => error.into(),
        PoolError::Closed => sqlx::Error::PoolClosed.into(),
        PoolError::Timeout(TimeoutType::Wait) => sqlx::Error::PoolTimedOut.into(),
        _ => SqlError::NoAnswer(ACQUIRE_TIMEOUT),
    })
}
