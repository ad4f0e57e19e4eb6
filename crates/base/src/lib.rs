//! Data, exact geometry and random numbers that all parts of the engine share.

pub mod clock;
pub mod geometry;
pub mod lock;
pub mod model;
pub mod random;
pub mod tissue;
#[doc(hidden)]
pub mod vectorize;

/// Version of the engine: part of every digest, so that a model is reused only where the same code
/// would grow the same bytes.
pub const ENGINE_VERSION: &str = env!("CARGO_PKG_VERSION");
