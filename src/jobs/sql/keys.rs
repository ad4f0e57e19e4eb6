//! Keys of clients and tickets.

use super::codec::{json, parse, until, values};
use super::error::{SqlError, broken};
use super::operation::{Done, Operation};
use super::tx::{Dialect, Row, Tx};
use crate::jobs::keys::{Key, NewKey, NewTicket, NoOwner};
use crate::jobs::store::{StoreError, StoreOptions};
use jiff::Timestamp;
use std::time::Duration;

const COLUMNS: &str = "prefix, hash, owner, scopes, limits, created_at, expires_at, revoked_at";

fn to_key(row: &Row) -> Result<Key, SqlError> {
    Ok(Key {
        prefix: row.text("prefix")?.to_owned(),
        hash: row.text("hash")?.to_owned(),
        owner: row.text("owner")?.parse().map_err(|error: NoOwner| broken(&error))?,
        // What only a later version knows is nothing that this one may allow.
        scopes: parse::<Vec<String>>(row.text("scopes")?)?.iter().filter_map(|name| name.parse().ok()).collect(),
        limits: parse(row.text("limits")?)?,
        created_at: row.time("created_at")?,
        expires_at: row.optional_time("expires_at")?,
        revoked_at: row.optional_time("revoked_at")?,
    })
}

/// The time, and all keys, the oldest first.
pub(super) async fn keys(tx: &mut Tx<'_>) -> Result<(Timestamp, Vec<Key>), SqlError> {
    let sql = format!("SELECT {COLUMNS} FROM keys ORDER BY created_at, prefix");
    let keys = tx.all(sql, values![]).await?.iter().map(to_key).collect::<Result<_, _>>()?;
    Ok((tx.now().await?, keys))
}

async fn key(tx: &mut Tx<'_>, prefix: &str) -> Result<Option<Key>, SqlError> {
    let sql = format!("SELECT {COLUMNS} FROM keys WHERE prefix = $1");
    tx.optional(sql, values![prefix]).await?.as_ref().map(to_key).transpose()
}

/// Stores a key; with `first`, only if there is none.
#[derive(Debug)]
pub(super) struct AddKey {
    pub(super) new: NewKey,
    pub(super) first: bool,
}

impl Operation for AddKey {
    type Output = Option<Key>;

    async fn run(&self, tx: &mut Tx<'_>, _: &StoreOptions) -> Result<Done<Option<Key>>, SqlError> {
        let now = tx.now().await?;
        let new = &self.new;
        if self.first {
            // Two processes that start at the same time make one key. SQLite has one writer anyway.
            if tx.dialect() == Dialect::Postgres {
                tx.execute("LOCK TABLE keys IN SHARE ROW EXCLUSIVE MODE", values![]).await?;
            }
            let others = tx.one("SELECT COUNT(*) AS n FROM keys WHERE prefix <> $1", values![&new.prefix]).await?;
            if others.count::<u64>("n")? > 0 {
                return Ok(Done::quiet(None));
            }
        }
        // A repeated try finds its own row.
        let sql = "INSERT INTO keys (prefix, hash, owner, scopes, limits, created_at, expires_at) \
                   VALUES ($1, $2, $3, $4, $5, $6, $7) ON CONFLICT (prefix) DO NOTHING";
        let (scopes, limits) = (json(&new.scopes), json(&new.limits));
        tx.execute(sql, values![&new.prefix, &new.hash, new.owner.name(), scopes, limits, now, new.expires_at]).await?;
        match key(tx, &new.prefix).await? {
            Some(key) if key.hash == new.hash => Ok(Done::quiet(Some(key))),
            _ => Err(StoreError::Database(format!("there is a key {} already; make another", new.prefix)).into()),
        }
    }
}

/// Ends a key.
#[derive(Debug)]
pub(super) struct RevokeKey {
    pub(super) prefix: String,
    pub(super) after: Duration,
}

impl Operation for RevokeKey {
    type Output = Option<Key>;

    async fn run(&self, tx: &mut Tx<'_>, _: &StoreOptions) -> Result<Done<Option<Key>>, SqlError> {
        let end = until(tx.now().await?, self.after);
        let sql = "UPDATE keys SET revoked_at = $2 WHERE prefix = $1 AND (revoked_at IS NULL OR revoked_at > $2)";
        tx.execute(sql, values![&self.prefix, end]).await?;
        Ok(Done::quiet(key(tx, &self.prefix).await?))
    }
}

/// Stores a ticket.
#[derive(Debug)]
pub(super) struct AddTicket(pub(super) NewTicket);

impl Operation for AddTicket {
    type Output = Timestamp;

    async fn run(&self, tx: &mut Tx<'_>, _: &StoreOptions) -> Result<Done<Timestamp>, SqlError> {
        let now = tx.now().await?;
        let NewTicket { hash, key, path, life } = &self.0;
        let end = until(now, *life);
        tx.execute("DELETE FROM tickets WHERE expires_at <= $1", values![now]).await?;
        let sql =
            "INSERT INTO tickets (hash, key, path, expires_at) VALUES ($1, $2, $3, $4) ON CONFLICT (hash) DO NOTHING";
        tx.execute(sql, values![hash, key, path, end]).await?;
        Ok(Done::quiet(end))
    }
}

/// The prefix of the key of a ticket that is good for a path.
pub(super) async fn ticket(tx: &mut Tx<'_>, hash: &str, path: &str) -> Result<Option<String>, SqlError> {
    let sql = "SELECT key FROM tickets WHERE hash = $1 AND path = $2 AND expires_at > $3";
    let now = tx.now().await?;
    let row = tx.optional(sql, values![hash, path, now]).await?;
    row.map(|row| row.text("key").map(str::to_owned)).transpose()
}

/// Uses up a ticket.
#[derive(Debug)]
pub(super) struct UseTicket {
    pub(super) hash: String,
    pub(super) path: String,
}

impl Operation for UseTicket {
    type Output = Option<String>;

    async fn run(&self, tx: &mut Tx<'_>, _: &StoreOptions) -> Result<Done<Option<String>>, SqlError> {
        let sql = "DELETE FROM tickets WHERE hash = $1 AND path = $2 AND expires_at > $3 RETURNING key";
        let now = tx.now().await?;
        let row = tx.optional(sql, values![&self.hash, &self.path, now]).await?;
        Ok(Done::quiet(row.map(|row| row.text("key").map(str::to_owned)).transpose()?))
    }
}
