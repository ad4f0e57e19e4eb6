//! Measures of sections and surfaces; the proof that a surface is sound (see [`certificate`](crate::measure::certify)).

mod certificate;

pub use certificate::{
    Certificate, CheckOptions, Component, Failure, FailureKind, Place, certify, certify_soup, check_surface,
};
