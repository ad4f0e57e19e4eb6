//! Tests of jobs: one suite over every job store, and the worker pool over a job store with a
//! scripted generator.
#![allow(
    clippy::unwrap_used,
    clippy::print_stderr,
    missing_docs,
    unreachable_pub,
    reason = "a test: what fails, fails here"
)]

mod apart;
mod artifacts;
mod bounds;
mod bucket;
mod checkpoint;
#[path = "../common/postgres.rs"]
mod cluster;
mod cost;
#[cfg(target_os = "linux")]
mod disk;
mod fits;
mod gate;
mod gpu;
mod kill;
mod mismatch;
mod outage;
mod packs;
mod postgres;
mod protocol;
#[path = "../common/queue.rs"]
mod queue;
mod random;
mod redirect;
#[allow(dead_code, reason = "shared with tests that need more of it")]
mod relay;
mod scripted;
mod scrub;
mod sick;
mod silence;
mod sqlite;
mod step;
mod streams;
mod suite;
mod unread;
mod upgrade;
mod watched;
mod worker;
