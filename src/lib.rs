//! Grows 3D models of folded tubular organs and serves them over HTTP.
//!
//! The method is that of Burkitt, Romano, Walker and Fazeli, *3D Modelling of Complex Biological
//! Structures: The Oviduct*: a loop of particles is grown inside a containing ellipse, recorded as a
//! series of cross sections, and lofted into a closed surface.
//!
//! Floors, each importing only from floors below it (`tests/architecture.rs` checks it):
//!
//! | floor | modules |
//! |---|---|
//! | 0 | [`clock`], [`metrics`], [`status`], [`availability`], [`random`], [`tls`], `vectorize`, [`model`], [`geometry`], [`tissue`] |
//! | 1 | [`spec`] |
//! | 2 | [`sim`], [`mesh`], [`measure`], [`export`], [`render`] |
//! | 3 | [`generate`], [`fit`], [`jobs`], [`preview`], [`report`] |
//! | 4 | [`worker`], [`http`] |
//! | 5 | [`cli`], and `fuzzing` in builds with that feature |

pub mod availability;
pub mod clock;
pub mod geometry;
pub mod metrics;
pub mod model;
pub mod random;
pub mod status;
pub mod tissue;
pub mod tls;
pub mod trace;
mod vectorize;

pub mod spec;

pub mod export;
pub mod measure;
pub mod mesh;
pub mod render;
pub mod sim;

pub mod fit;
pub mod generate;
pub mod jobs;
pub mod preview;
pub mod report;

pub mod http;
pub mod worker;

pub mod cli;

#[cfg(feature = "fuzzing")]
#[doc(hidden)]
pub mod fuzzing;

/// Version of the engine: part of every digest, so that a model is reused only where the same code
/// would grow the same bytes.
pub const ENGINE_VERSION: &str = env!("CARGO_PKG_VERSION");
