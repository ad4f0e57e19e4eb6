//! An HTTP service that grows 3D models of folded tubular organs.
//!
//! The engine is the crate `oviduct_engine` and those below it (`crates/`); this crate queues jobs,
//! runs them, serves their results and defines the commands. ARCHITECTURE.md describes both.

pub use oviduct_engine::{
    ENGINE_VERSION, export, fit, generate, geometry, lock, measure, mesh, model, preview, random, render, report, sim,
    spec, tissue, way,
};

pub mod availability;
pub mod clock;
pub mod metrics;
mod panics;
pub mod status;
pub mod tls;
pub mod trace;

pub mod jobs;

pub mod http;
pub mod worker;

pub mod cli;

#[cfg(feature = "fuzzing")]
#[doc(hidden)]
pub mod fuzzing;
