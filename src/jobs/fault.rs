//! Fault injection: named points in the life of a job at which tests kill a worker, make a step
//! fail, or delay it.
//!
//! Only builds with the cargo feature `fault-injection` can inject faults. The package depends on
//! itself with that feature for its tests, so `cargo test` always has it and `cargo build` never
//! has it. Without the feature, every point is a no-op, and [`Faults::from_env`] fails if the
//! variable is set.
//!
//! `OVIDUCT_FAULT=<point>[:kill|error|stall][:<n>]` arms one fault, at the n-th passage of the
//! point (counted from 1).

#[cfg(feature = "fault-injection")]
mod armed;
#[cfg(not(feature = "fault-injection"))]
mod disabled;

#[cfg(feature = "fault-injection")]
pub use armed::Faults;
#[cfg(not(feature = "fault-injection"))]
pub use disabled::Faults;

/// Name of the environment variable that arms a fault.
pub const VARIABLE: &str = "OVIDUCT_FAULT";

/// Points, in the order of a job's life. Each report of progress passes the point of its stage,
/// `simulate` to `store`.
pub const POINTS: [&str; 11] = [
    "after-claim",
    "simulate",
    "mesh",
    "certify",
    "export",
    "store",
    "during-renewal",
    "before-upload",
    "after-upload",
    "before-commit",
    "after-commit",
];

/// An injected error.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a fault was injected at {0}")]
pub struct Injected(pub &'static str);

/// Reason why a fault cannot be armed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum BadFault {
    /// The text does not name a fault.
    #[error("{VARIABLE}={0:?} is not <point>[:kill|error|stall][:<n>] with one of the points {POINTS:?}")]
    Unknown(String),
    /// This build cannot inject faults.
    #[error(
        "{VARIABLE} is set, but this build has no fault injection: build with `--features fault-injection`, or unset it"
    )]
    Disabled,
}
