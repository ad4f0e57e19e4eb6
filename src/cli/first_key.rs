//! The first key of a service that others can reach.

use crate::jobs::Store;
use crate::jobs::keys::{KeyLimits, NewKey, NoOwner, Scope, Secret};
use anyhow::Context;

/// Makes an admin key if there is no key at all yet; returns its secret.
///
/// # Errors
/// If the store fails.
pub(super) async fn make(store: &Store) -> anyhow::Result<Option<Secret>> {
    let secret = Secret::generate();
    let new = NewKey {
        prefix: secret.prefix().to_owned(),
        hash: secret.hash(),
        owner: "admin".parse().map_err(|error: NoOwner| anyhow::anyhow!(error))?,
        scopes: [Scope::Admin].into_iter().collect(),
        limits: KeyLimits::default(),
        expires_at: None,
    };
    let added = store.add_first_key(new).await.context("the first key could not be stored")?;
    Ok(added.map(|key| {
        key.audit_added();
        secret
    }))
}
