//! API keys and tickets.

use super::codec::{json, parse, until, values};
use super::error::{SqlError, broken};
use super::operation::{Done, Run, Uncertain};
use super::store::Store;
use super::tx::{Row, Tx};
use crate::jobs::StoreError;
use crate::jobs::keys::{Key, NewKey, NewTicket};
use jiff::Timestamp;
use std::time::Duration;

const COLUMNS: &str = "prefix, hash, owner, scopes, limits, created_at, expires_at, revoked_at";

/// Calls for API keys and tickets.
impl Store {
    /// Stores a key.
    pub async fn add_key(&self, new: NewKey) -> Result<Key, StoreError> {
        self.apply("add_key", new, |new, tx, _| Box::pin(add(new, tx)), Uncertain::RunsAgain).await
    }

    /// Stores a key if there is no other, not even a revoked one; otherwise returns `None`.
    pub async fn add_first_key(&self, new: NewKey) -> Result<Option<Key>, StoreError> {
        self.apply("add_first_key", new, |new, tx, _| Box::pin(add_first(new, tx)), Uncertain::RunsAgain).await
    }

    /// The time of the store, and all keys, oldest first, including expired and revoked keys.
    pub async fn keys(&self) -> Result<(Timestamp, Vec<Key>), StoreError> {
        let tx = &mut self.read("keys").await?;
        let sql = format!("SELECT {COLUMNS} FROM keys ORDER BY created_at, prefix");
        let keys = tx.all(sql, values![]).await?.iter().map(to_key).collect::<Result<_, _>>()?;
        Ok((tx.now().await?, keys))
    }

    /// Revokes a key `after` this time, unless it is revoked earlier already; `None` if no key has
    /// this prefix.
    pub async fn revoke_key(&self, prefix: &str, after: Duration) -> Result<Option<Key>, StoreError> {
        let key = (prefix.to_owned(), after);
        let revoke: Run<(String, Duration), _> = |(prefix, after), tx, _| Box::pin(revoke(prefix, *after, tx));
        self.apply("revoke_key", key, revoke, Uncertain::RunsAgain).await
    }

    /// Stores a ticket, removes expired tickets, and returns the time at which the new one expires.
    pub async fn add_ticket(&self, new: NewTicket) -> Result<Timestamp, StoreError> {
        self.apply("add_ticket", new, |new, tx, _| Box::pin(add_ticket(new, tx)), Uncertain::RunsAgain).await
    }

    /// The prefix of the key whose ticket [`Store::use_ticket`] would use up.
    pub async fn ticket(&self, hash: &str, path: &str) -> Result<Option<String>, StoreError> {
        let tx = &mut self.read("ticket").await?;
        let sql = "SELECT key FROM tickets WHERE hash = $1 AND path = $2 AND expires_at > $3";
        let now = tx.now().await?;
        let row = tx.optional(sql, values![hash, path, now]).await?;
        Ok(row.map(|row| row.get("key")).transpose()?)
    }

    /// Uses up a ticket for this path and returns the prefix of its key. `None` if the ticket does
    /// not exist, has expired, or is for another path; a ticket for another path stays valid.
    pub async fn use_ticket(&self, hash: &str, path: &str) -> Result<Option<String>, StoreError> {
        let ticket = (hash.to_owned(), path.to_owned());
        let use_up: Run<(String, String), _> = |(hash, path), tx, _| Box::pin(use_ticket(hash, path, tx));
        // A ticket that may be used up counts as used: its client requests another.
        self.apply("use_ticket", ticket, use_up, Uncertain::RunsAgain).await
    }
}

fn to_key(row: &Row) -> Result<Key, SqlError> {
    Ok(Key {
        prefix: row.get("prefix")?,
        hash: row.get("hash")?,
        owner: row.get::<&str>("owner")?.parse().map_err(broken)?,
        // Scopes that only a later version knows grant nothing in this one.
        scopes: parse::<Vec<String>>(row.get("scopes")?)?.iter().filter_map(|name| name.parse().ok()).collect(),
        limits: parse(row.get("limits")?)?,
        created_at: row.time("created_at")?,
        expires_at: row.optional_time("expires_at")?,
        revoked_at: row.optional_time("revoked_at")?,
    })
}

async fn key(tx: &mut Tx<'_>, prefix: &str) -> Result<Option<Key>, SqlError> {
    let sql = format!("SELECT {COLUMNS} FROM keys WHERE prefix = $1");
    tx.optional(sql, values![prefix]).await?.as_ref().map(to_key).transpose()
}

/// Stores a key. A retry after a lost response finds its own row.
async fn add(new: &NewKey, tx: &mut Tx<'_>) -> Result<Done<Key>, SqlError> {
    let now = tx.now().await?;
    let sql = "INSERT INTO keys (prefix, hash, owner, scopes, limits, created_at, expires_at) \
               VALUES ($1, $2, $3, $4, $5, $6, $7) ON CONFLICT (prefix) DO NOTHING";
    let (scopes, limits) = (json(&new.scopes), json(&new.limits));
    tx.execute(sql, values![&new.prefix, &new.hash, new.owner.name(), scopes, limits, now, new.expires_at]).await?;
    match key(tx, &new.prefix).await? {
        Some(key) if key.hash == new.hash => Ok(Done::quiet(key)),
        _ => {
            let detail = format!("there is a key {} already; make another", new.prefix);
            Err(StoreError::Database(detail.into()).into())
        }
    }
}

async fn add_first(new: &NewKey, tx: &mut Tx<'_>) -> Result<Done<Option<Key>>, SqlError> {
    // Two processes that start at the same time create one key. SQLite has one writer anyway.
    if tx.is_postgres() {
        tx.execute("LOCK TABLE keys IN SHARE ROW EXCLUSIVE MODE", values![]).await?;
    }
    let others = tx.one("SELECT COUNT(*) AS n FROM keys WHERE prefix <> $1", values![&new.prefix]).await?;
    let is_first = others.count::<u64>("n")? == 0;
    Ok(Done::quiet(if is_first { Some(add(new, tx).await?.output) } else { None }))
}

async fn revoke(prefix: &str, after: Duration, tx: &mut Tx<'_>) -> Result<Done<Option<Key>>, SqlError> {
    let end = until(tx.now().await?, after);
    let sql = "UPDATE keys SET revoked_at = $2 WHERE prefix = $1 AND (revoked_at IS NULL OR revoked_at > $2)";
    tx.execute(sql, values![prefix, end]).await?;
    Ok(Done::quiet(key(tx, prefix).await?))
}

async fn add_ticket(new: &NewTicket, tx: &mut Tx<'_>) -> Result<Done<Timestamp>, SqlError> {
    let now = tx.now().await?;
    let NewTicket { hash, key, path, life } = new;
    let end = until(now, *life);
    tx.execute("DELETE FROM tickets WHERE expires_at <= $1", values![now]).await?;
    let sql = "INSERT INTO tickets (hash, key, path, expires_at) VALUES ($1, $2, $3, $4) ON CONFLICT (hash) DO NOTHING";
    tx.execute(sql, values![hash, key, path, end]).await?;
    Ok(Done::quiet(end))
}

async fn use_ticket(hash: &str, path: &str, tx: &mut Tx<'_>) -> Result<Done<Option<String>>, SqlError> {
    let sql = "DELETE FROM tickets WHERE hash = $1 AND path = $2 AND expires_at > $3 RETURNING key";
    let now = tx.now().await?;
    let row = tx.optional(sql, values![hash, path, now]).await?;
    Ok(Done::quiet(row.map(|row| row.get("key")).transpose()?))
}
