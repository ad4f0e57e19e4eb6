//! The contract of a store of keys and tickets; the job stores keep them.

use super::{Key, KeyLimits, Owner, Scopes};
use crate::jobs::error::StoreError;
use async_trait::async_trait;
use jiff::Timestamp;
use std::time::Duration;

/// A key to be stored.
#[derive(Clone, Debug)]
pub struct NewKey {
    /// The part of its secret that names it.
    pub prefix: String,
    /// SHA-256 of its secret.
    pub hash: String,
    /// Whose it is.
    pub owner: Owner,
    /// What it allows.
    pub scopes: Scopes,
    /// How much it allows.
    pub limits: KeyLimits,
    /// When it stops working.
    pub expires_at: Option<Timestamp>,
}

/// A ticket to be stored.
#[derive(Clone, Debug)]
pub struct NewTicket {
    /// SHA-256 of its secret.
    pub hash: String,
    /// Prefix of the key whose rights it has.
    pub key: String,
    /// The path that it is good for.
    pub path: String,
    /// How long it is good.
    pub life: Duration,
}

/// A store of keys and tickets. Every call is atomic, and durable when it returns.
#[async_trait]
pub trait KeyStore: Send + Sync + 'static {
    /// Stores a key.
    async fn add_key(&self, new: NewKey) -> Result<Key, StoreError>;
    /// Stores a key if there is none yet, not even a revoked one; `None` if there is.
    async fn add_first_key(&self, new: NewKey) -> Result<Option<Key>, StoreError>;
    /// All keys, the oldest first, with those that no longer work; and the time of the store.
    async fn keys(&self) -> Result<(Timestamp, Vec<Key>), StoreError>;
    /// Ends a key `after` this time, unless it ends before; `None` if no key has this prefix.
    async fn revoke_key(&self, prefix: &str, after: Duration) -> Result<Option<Key>, StoreError>;
    /// Stores a ticket; returns when it expires. Tickets that have expired are removed.
    async fn add_ticket(&self, new: NewTicket) -> Result<Timestamp, StoreError>;
    /// The prefix of the key of a ticket that [`KeyStore::use_ticket`] would use up now.
    async fn ticket(&self, hash: &str, path: &str) -> Result<Option<String>, StoreError>;
    /// Uses up a ticket for this path. Returns the prefix of its key; `None` if there is no such ticket, if it has expired,
    /// or if it is for another path (then it stays).
    async fn use_ticket(&self, hash: &str, path: &str) -> Result<Option<String>, StoreError>;
}
