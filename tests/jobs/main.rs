//! Jobs: one suite over every store, and the worker pool over a store with a scripted generator.
#![allow(clippy::unwrap_used, missing_docs, unreachable_pub, reason = "a test: what fails, fails here")]

mod deaf;
mod gpu;
mod kill;
mod scripted;
mod sqlite;
mod suite;
mod worker;
