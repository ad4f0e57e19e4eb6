//! The certificate of a surface (see [`certify`]), and the [`morphometry`] of sections, those in images ([`micrograph`]) included.

mod certificate;
pub mod comparison;
pub mod micrograph;
pub mod morphometry;

pub use certificate::{
    Certificate, CheckOptions, Component, Failure, FailureKind, Place, certify, certify_soup, check_surface,
};
