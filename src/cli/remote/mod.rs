//! Commands that talk to a service over HTTP, and their client.

pub(super) mod client;
pub(super) mod demo;
mod secret;
pub(super) mod sse;
pub(super) mod submit;
pub(super) mod workers;

pub use client::Client;
pub use secret::Key;
