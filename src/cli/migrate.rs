//! `oviduct migrate`: brings the tables of the database up to date.

use super::args::DatabaseArgs;
use super::exit::Ended;
use super::service::database;
use anyhow::Context;

pub(super) async fn run(args: DatabaseArgs) -> Ended {
    Ok(database(&args)?.migrate().await.context("the tables could not be brought up to date")?)
}
