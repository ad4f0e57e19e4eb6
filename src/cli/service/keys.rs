//! `oviduct keys`: creates, lists, revokes and rotates API keys directly in the database.
//!
//! A secret is printed once, to stdout. Everything else goes to stderr.

use super::{database, location};
use crate::cli::args::{DatabaseArgs, Keys, KeysAddArgs, KeysRotateArgs};
use crate::cli::exit::{Ended, Failure};
use crate::cli::term;
use crate::jobs::keys::{Key, KeyLimits, NewKey, Owner, Scopes, Secret};
use crate::jobs::{Database, Quota, Store};
use anyhow::Context;
use jiff::{SignedDuration, Timestamp};
use serde_json::{Value, json};
use std::time::Duration;

pub(in crate::cli) async fn run(keys: Keys) -> Ended {
    match keys {
        Keys::Add(args) => add(args).await,
        Keys::List { json, database } => list(&database, json).await,
        Keys::Revoke { prefix, database } => revoke(&database, &prefix).await,
        Keys::Rotate(args) => rotate(args).await,
    }
}

/// Opens the database. Creates an SQLite file only with `create`: a wrong path would otherwise give
/// keys that no service knows.
async fn open(args: &DatabaseArgs, create: bool) -> Result<Store, Failure> {
    let database = database(args)?;
    if let Database::Sqlite(path) = &database
        && !create
        && !path.exists()
    {
        return Err(Failure::usage(format!(
            "there is no database at {}; check --data and --database, or create it with `oviduct keys add --create`",
            path.display()
        )));
    }
    let opened = database.open_beside_service().await;
    Ok(opened.with_context(|| format!("the job store {} could not be opened", location(&database)))?)
}

async fn read(store: &Store) -> Result<(Timestamp, Vec<Key>), Failure> {
    Ok(store.keys().await.context("the keys could not be read")?)
}

async fn add(args: KeysAddArgs) -> Ended {
    let store = open(&args.database, args.create).await?;
    let (now, _) = read(&store).await?;
    let life = args.expires.map(|life| SignedDuration::try_from(life).ok().and_then(|life| now.checked_add(life).ok()));
    if life == Some(None) {
        return Err(Failure::usage("--expires: is too long; leave it out for a key that never ends"));
    }
    let limits = KeyLimits { rate: args.rate, quota: Quota { unfinished: args.models, bytes: args.bytes } };
    create(&store, args.owner, args.scopes.into_iter().collect(), limits, life.flatten(), args.json).await?;
    store.close().await;
    Ok(())
}

/// Stores a new key, and prints it with its secret.
async fn create(
    store: &Store,
    owner: Owner,
    scopes: Scopes,
    limits: KeyLimits,
    expires_at: Option<Timestamp>,
    as_json: bool,
) -> Ended {
    let secret = Secret::generate();
    let (prefix, hash) = (secret.prefix().to_owned(), secret.hash());
    let new = NewKey { prefix, hash, owner, scopes, limits, expires_at };
    let key = store.add_key(new).await.context("the key could not be stored")?;
    key.audit_added();
    if as_json {
        let mut value = described(&key, "active");
        value["key"] = json!(secret.reveal());
        return Ok(term::print_json(&value)?);
    }
    term::note(&format!("key of {} ({}); it is shown only this once:", key.owner, key.scopes));
    Ok(term::print(secret.reveal())?)
}

async fn list(database: &DatabaseArgs, as_json: bool) -> Ended {
    let store = open(database, false).await?;
    let (now, keys) = read(&store).await?;
    store.close().await;
    if as_json {
        let keys: Vec<Value> = keys.iter().map(|key| described(key, state(key, now))).collect();
        return Ok(term::print_json(&keys)?);
    }
    let row = |cells: [&str; 6]| {
        let [prefix, owner, scopes, state, created, limits] = cells;
        format!("{prefix:<9} {owner:<20} {scopes:<18} {state:<9} {created:<21} {limits}").trim_end().to_owned()
    };
    term::print(&row(["PREFIX", "OWNER", "SCOPES", "STATE", "CREATED", "ENDS AND LIMITS"]))?;
    for key in &keys {
        let (scopes, created) = (key.scopes.to_string(), seconds(key.created_at));
        term::print(&row([&key.prefix, key.owner.name(), &scopes, state(key, now), &created, &details(key)]))?;
    }
    Ok(())
}

/// Returns `active`, `ending` (revoked at a later time), `revoked` or `expired`.
fn state(key: &Key, now: Timestamp) -> &'static str {
    match (key.works_at(now), key.revoked_at) {
        (true, None) => "active",
        (true, Some(_)) => "ending",
        (false, Some(at)) if at <= now => "revoked",
        (false, _) => "expired",
    }
}

fn seconds(at: Timestamp) -> String {
    format!("{at:.0}")
}

fn details(key: &Key) -> String {
    let Quota { unfinished, bytes } = key.limits.quota;
    let end = key.expires_at.into_iter().chain(key.revoked_at).min();
    let parts = [
        end.map(|at| format!("ends {}", seconds(at))),
        key.limits.rate.map(|rate| format!("{rate} requests/s")),
        unfinished.map(|models| format!("{models} models")),
        bytes.map(|bytes| format!("{bytes} bytes")),
    ];
    parts.into_iter().flatten().collect::<Vec<_>>().join(", ")
}

fn described(key: &Key, state: &str) -> Value {
    let Quota { unfinished, bytes } = key.limits.quota;
    json!({
        "prefix": key.prefix, "owner": key.owner, "scopes": key.scopes, "state": state,
        "created_at": key.created_at, "expires_at": key.expires_at, "revoked_at": key.revoked_at,
        "limits": { "requests_per_second": key.limits.rate, "models": unfinished, "bytes": bytes },
    })
}

/// Returns the key of this prefix. Also accepts a whole key.
async fn find(store: &Store, text: &str) -> Result<(Timestamp, Key), Failure> {
    let (now, keys) = read(store).await?;
    let secret = Secret::parse(text).ok();
    let prefix = secret.as_ref().map_or(text, Secret::prefix);
    let key = keys.into_iter().find(|key| key.prefix == prefix);
    let key = key.ok_or_else(|| Failure::usage("there is no key of this prefix; `oviduct keys list` shows all"))?;
    Ok((now, key))
}

async fn revoke(database: &DatabaseArgs, prefix: &str) -> Ended {
    let store = open(database, false).await?;
    let (now, key) = find(&store, prefix).await?;
    if !key.works_at(now) {
        term::note(&format!("the key {} had ended before", key.prefix));
    }
    end(&store, &key, Duration::ZERO).await?;
    store.close().await;
    Ok(())
}

async fn end(store: &Store, key: &Key, after: Duration) -> Result<(), Failure> {
    store.revoke_key(&key.prefix, after).await.context("the key could not be revoked")?;
    key.audit_revoked();
    Ok(())
}

async fn rotate(args: KeysRotateArgs) -> Ended {
    let store = open(&args.database, false).await?;
    let (now, old) = find(&store, &args.prefix).await?;
    if !old.works_at(now) {
        return Err(Failure::usage(format!("the key {} has ended; `oviduct keys add` makes another", old.prefix)));
    }
    // The new key first: if the second step fails, both keys work, and the old key can still be
    // revoked.
    create(&store, old.owner.clone(), old.scopes.clone(), old.limits, old.expires_at, args.json).await?;
    end(&store, &old, args.overlap).await?;
    store.close().await;
    Ok(())
}
