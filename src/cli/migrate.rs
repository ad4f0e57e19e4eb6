//! `oviduct migrate`: updates the database schema.

use super::args::DatabaseArgs;
use super::exit::Ended;
use super::service::{database, location};
use anyhow::Context;

pub(super) async fn run(args: DatabaseArgs) -> Ended {
    let database = database(&args)?;
    let migrated = database.migrate().await;
    Ok(migrated.with_context(|| format!("the schema of the job store {} could not be updated", location(&database)))?)
}
