//! Changes sent to other processes by `NOTIFY`, and received from them by `LISTEN`.
//!
//! The notification follows the commit instead of being part of it: PostgreSQL serializes the
//! commits of transactions that notify, which would limit submissions and heartbeats to one fsync
//! at a time. A task sends the changes that have accumulated, many in one notification.
//! Notifications are lost if a process dies before it sends them, or with a lost connection;
//! polling by workers and event streams covers both. After a reconnection, the jobs that may have
//! changed in the meantime are reported as changed.

use super::pool::{Pool, acquire};
use crate::clock::Stopwatch;
use crate::jobs::sql::SqlError;
use crate::jobs::{Change, JobId};
use crate::lock::Mutex;
use sqlx::postgres::{PgConnectOptions, PgListener, PgPoolOptions};
use sqlx::{Executor, Row};
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::time::Duration;
use tokio::sync::{broadcast, mpsc};
use tokio::task::JoinSet;
use tokio::time::{sleep, timeout};

const CHANNEL: &str = "oviduct_changes";
/// Maximum number of changes in a notification, which PostgreSQL limits to 8000 bytes.
const MAX_CHANGES: usize = 120;
/// Minimum time between two notifications: each costs a transaction.
const SEND_EVERY: Duration = Duration::from_millis(10);
/// Time without notifications after which the connection is tested.
const SILENCE: Duration = Duration::from_secs(15);
/// Maximum time for a connection to open or to respond.
const RESPONSE_TIMEOUT: Duration = Duration::from_secs(5);
/// Wait before a lost connection is opened again.
const RECONNECT_WAIT: Duration = Duration::from_millis(250);
/// Maximum number of jobs of each status that are reported as changed after a reconnection.
const CAUGHT_UP: i64 = 2000;

/// The sending and the listening task, which end when this value is dropped.
#[derive(Debug)]
pub(super) struct Notifier {
    outbox: Mutex<Option<mpsc::UnboundedSender<Change>>>,
    sender: Mutex<JoinSet<()>>,
    _listener: JoinSet<()>,
}

impl Notifier {
    /// Starts to send over `pool`, and to listen on a separate connection. Received changes go to
    /// `changes`.
    pub(super) async fn start(
        connect: PgConnectOptions,
        pool: Pool,
        changes: broadcast::Sender<Change>,
    ) -> Result<Self, SqlError> {
        // Identifies this process, which ignores its own notifications.
        let own = uuid::Uuid::now_v7().simple().to_string();
        let connection = listen(&connect).await?;
        let (outbox, inbox) = mpsc::unbounded_channel();
        let mut sender = JoinSet::new();
        sender.spawn(send_all(pool.clone(), own.clone(), inbox));
        let mut listener = JoinSet::new();
        listener.spawn(receive(connect, connection, pool, own, changes));
        Ok(Self { outbox: Mutex::new(Some(outbox)), sender: Mutex::new(sender), _listener: listener })
    }

    pub(super) fn send(&self, changes: &[Change]) {
        if let Some(outbox) = self.outbox.lock().as_ref() {
            for change in changes {
                // Fails only if the store is closed.
                let _ = outbox.send(*change);
            }
        }
    }

    /// Sends the last changes and ends the sending task.
    pub(super) async fn close(&self) {
        self.outbox.lock().take();
        let mut sender = std::mem::take(&mut *self.sender.lock());
        if timeout(RESPONSE_TIMEOUT, sender.join_next()).await.is_err() {
            tracing::warn!("could not send the last changes to other processes; they will find them by polling");
        }
    }
}

/// Sends changes until the outbox is dropped.
async fn send_all(pool: Pool, own: String, mut inbox: mpsc::UnboundedReceiver<Change>) {
    let mut gathered = Vec::new();
    while inbox.recv_many(&mut gathered, MAX_CHANGES).await > 0 {
        let payload = write(&own, &gathered);
        gathered.clear();
        // Nothing is lost with a notification, so its commit need not wait for the disk.
        let notify = "SELECT set_config('synchronous_commit', 'off', TRUE), pg_notify($1, $2)";
        let notify = sqlx::query(notify).bind(CHANNEL).bind(payload);
        let sent = async { acquire(&pool).await?.answer(|connection| notify.execute(connection)).await };
        if let Err(error) = sent.await {
            tracing::warn!(%error, "could not send changes to other processes; they will find them by polling");
        }
        if !inbox.is_closed() {
            sleep(SEND_EVERY).await;
        }
    }
}

/// Formats a notification with the latest change of each job: `sender id version id version …`, `-`
/// for a deleted job.
fn write(own: &str, changes: &[Change]) -> String {
    let newest: BTreeMap<JobId, Option<u64>> = changes.iter().map(|change| (change.id, change.version)).collect();
    let mut payload = own.to_owned();
    for (id, version) in newest {
        // Writing to a String cannot fail.
        let _ = match version {
            Some(version) => write!(payload, " {} {version}", id.0.simple()),
            None => write!(payload, " {} -", id.0.simple()),
        };
    }
    payload
}

/// Parses the changes of a notification. None if this process sent it; skips what is malformed.
fn read(own: &str, payload: &str) -> Vec<Change> {
    let mut words = payload.split(' ');
    if words.next() == Some(own) {
        return Vec::new();
    }
    let words: Vec<&str> = words.collect();
    let (pairs, _) = words.as_chunks::<2>();
    pairs
        .iter()
        .filter_map(|[id, version]| {
            let version = if *version == "-" { None } else { Some(version.parse().ok()?) };
            Some(Change { id: JobId(id.parse().ok()?), version })
        })
        .collect()
}

async fn listen(connect: &PgConnectOptions) -> Result<PgListener, SqlError> {
    let late = |_| SqlError::NoAnswer(RESPONSE_TIMEOUT);
    timeout(RESPONSE_TIMEOUT, listen_unlimited(connect)).await.map_err(late)?.map_err(SqlError::from)
}

async fn listen_unlimited(connect: &PgConnectOptions) -> Result<PgListener, sqlx::Error> {
    let pool = PgPoolOptions::new()
        .max_connections(1)
        .acquire_timeout(RESPONSE_TIMEOUT)
        .max_lifetime(None)
        .idle_timeout(None)
        .connect_lazy_with(connect.clone());
    let mut listener = PgListener::connect_with(&pool).await?;
    listener.eager_reconnect(false);
    listener.listen(CHANNEL).await?;
    Ok(listener)
}

/// Receives until it is dropped. Reopens a lost connection and catches up.
async fn receive(
    connect: PgConnectOptions,
    mut listener: PgListener,
    pool: Pool,
    own: String,
    changes: broadcast::Sender<Change>,
) {
    loop {
        let mut since = Stopwatch::start();
        loop {
            match timeout(SILENCE, listener.try_recv()).await {
                Ok(Ok(Some(notification))) => {
                    for change in read(&own, notification.payload()) {
                        // Fails if nobody subscribes.
                        let _ = changes.send(change);
                    }
                }
                Ok(Ok(None) | Err(_)) => break,
                Err(_) => {
                    if !matches!(timeout(RESPONSE_TIMEOUT, listener.execute("SELECT 1")).await, Ok(Ok(_))) {
                        break;
                    }
                }
            }
            since = Stopwatch::start();
        }
        tracing::warn!("lost the connection for notifications of changes");
        listener = loop {
            match listen(&connect).await {
                Ok(listener) => break listener,
                Err(error) => {
                    tracing::warn!(%error, "could not reopen the connection for notifications; changes by other processes are found by polling");
                }
            }
            sleep(RECONNECT_WAIT).await;
        };
        match catch_up(&pool, since.elapsed() + SILENCE + RESPONSE_TIMEOUT).await {
            Ok(missed) => {
                tracing::info!(jobs = missed.len(), "reopened the connection for notifications of changes");
                for change in missed {
                    let _ = changes.send(change);
                }
            }
            Err(error) => tracing::warn!(%error, "could not read missed changes; they will be found by polling"),
        }
    }
}

/// Jobs that may have changed within the time `past`: running jobs, jobs that ended recently, and
/// the newest queued jobs. Readers notice deleted jobs when they read them.
async fn catch_up(pool: &Pool, past: Duration) -> Result<Vec<Change>, SqlError> {
    let mut session = acquire(pool).await?;
    let now = sqlx::query_scalar("SELECT CAST(EXTRACT(EPOCH FROM clock_timestamp()) * 1000000 AS BIGINT)");
    let now: i64 = session.answer(|connection| now.fetch_one(connection)).await?;
    let past = i64::try_from(past.as_micros()).unwrap_or(i64::MAX);
    let missed = sqlx::query(
        "(SELECT id, version FROM jobs WHERE status = 'running' LIMIT $1) \
         UNION (SELECT id, version FROM jobs WHERE finished_at >= $2 ORDER BY finished_at DESC LIMIT $1) \
         UNION (SELECT id, version FROM jobs WHERE status = 'queued' ORDER BY id DESC LIMIT $1)",
    )
    .bind(CAUGHT_UP)
    .bind(now.saturating_sub(past));
    let rows = session.answer(|connection| missed.fetch_all(connection)).await?;
    let change = |row: &sqlx::postgres::PgRow| {
        let (id, version): (&str, i64) = (row.try_get("id")?, row.try_get("version")?);
        Ok(id.parse().ok().map(|id| Change { id: JobId(id), version: u64::try_from(version).ok() }))
    };
    rows.iter().filter_map(|row| change(row).transpose()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_notification_is_read_by_all_but_its_sender() {
        let id = |n: u128| JobId(uuid::Uuid::from_u128(n << 100 | n));
        let change = |n: u128, version| Change { id: id(n), version };
        let changes = [change(1, Some(3)), change(2, None), change(1, Some(4)), change(3, Some(u64::MAX))];
        let payload = write("a", &changes);
        assert_eq!(read("b", &payload), [change(1, Some(4)), change(2, None), change(3, Some(u64::MAX))]);
        assert_eq!(read("a", &payload), []);
        for nonsense in ["", "c", "c 1", "c x y", "c  ", &format!("c {} z", id(1))] {
            assert_eq!(read("b", nonsense), [], "{nonsense}");
        }
    }

    #[test]
    fn the_longest_notification_fits() {
        let longest: Vec<Change> = (0..MAX_CHANGES as u128)
            .map(|n| Change { id: JobId(uuid::Uuid::from_u128(n)), version: Some(u64::MAX) })
            .collect();
        assert!(write(&"f".repeat(32), &longest).len() < 8000);
    }
}
