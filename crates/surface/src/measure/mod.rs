//! The certificate of a surface (see [`certify`]), and the [`morphometry`] of sections, those in images ([`micrograph`]) included.

mod certificate;
pub mod comparison;
pub mod micrograph;
pub mod morphometry;

pub use certificate::{
    BothCertificate, Certificate, CheckOptions, Component, Failure, FailureKind, Place, RegionsCertificate,
    TriangleQuality, certify, certify_body, certify_regions, certify_soup, check_regions, check_surface,
};
