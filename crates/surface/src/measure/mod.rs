//! Measures of a finished surface: its certificate (see [`certify`]), and the [`morphometry`] of
//! sections, including sections in images ([`micrograph`]); walls and gaps of any surface
//! ([`printable`]); the [`way`] through the lumen.

mod certificate;
pub mod checklist;
pub mod comparison;
pub mod micrograph;
pub mod morphometry;
pub mod printable;
pub mod way;

pub use certificate::{
    BothCertificate, Certificate, CheckOptions, Component, Failure, FailureKind, Place, RegionsCertificate,
    TriangleQuality, certify, certify_body, certify_regions, check_regions, check_surface,
};
