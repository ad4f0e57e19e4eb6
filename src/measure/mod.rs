//! Measures of sections and surfaces, and the certificate of a surface (see [`certify`]).

mod certificate;

pub use certificate::{
    Certificate, CheckOptions, Component, Failure, FailureKind, Place, certify, certify_soup, check_surface,
};
