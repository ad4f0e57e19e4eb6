//! Fault injection: named points in the life of a job at which tests kill a worker, make a step
//! fail, or delay it.
//!
//! Only builds with the cargo feature `fault-injection` arm faults. The package depends on itself
//! with that feature for its tests, so `cargo test` always has it and `cargo build` never has it.
//! Without the feature, [`Faults::from_env`] fails if the variable is set.
//!
//! `OVIDUCT_FAULT=<point>[:kill|error|stall][:<n>]` arms one fault, at the n-th passage of the
//! point (counted from 1).

use crate::random::{Stream, below, words};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

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

/// Duration of a stall: longer than any lease, shorter than the timeouts of tests.
const STALL: Duration = Duration::from_secs(20);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Kill,
    Error,
    Stall(Duration),
}

#[derive(Debug)]
enum Armed {
    /// Strikes at one passage of one point.
    Once {
        point: &'static str,
        kind: Kind,
        /// Passages left until it strikes; it strikes once.
        left: AtomicU32,
    },
    /// Strikes at passages of any point.
    Random {
        seed: u64,
        one_in: u32,
        stall: Duration,
        /// Number of passages so far.
        passages: AtomicU32,
        /// Number of faults left.
        left: AtomicU32,
    },
}

/// Average number of random faults per stall; the others are errors.
const STALLS: u32 = 16;

/// The armed faults, if any. Clones share them.
#[derive(Clone, Debug, Default)]
pub struct Faults(Option<Arc<Armed>>);

impl Faults {
    /// Arms the fault that the environment variable names; to be called once, at the start.
    ///
    /// # Errors
    /// [`BadFault`] if the variable is set and does not name a fault, or if this build has no fault
    /// injection.
    pub fn from_env() -> Result<Self, BadFault> {
        match std::env::var_os(VARIABLE).unwrap_or_default().to_string_lossy() {
            text if text.is_empty() => Ok(Self::default()),
            _ if cfg!(not(feature = "fault-injection")) => Err(BadFault::Disabled),
            text => Self::parse(&text),
        }
    }

    /// Arms the fault that `text` names.
    ///
    /// # Errors
    /// [`BadFault::Unknown`].
    pub fn parse(text: &str) -> Result<Self, BadFault> {
        let bad = || BadFault::Unknown(text.to_owned());
        let mut parts = text.split(':');
        let name = parts.next().unwrap_or_default();
        let point = POINTS.into_iter().find(|point| *point == name).ok_or_else(bad)?;
        let kind = match parts.next() {
            None | Some("kill") => Kind::Kill,
            Some("error") => Kind::Error,
            Some("stall") => Kind::Stall(STALL),
            Some(_) => return Err(bad()),
        };
        let passage = parts.next().map_or(Ok(1), str::parse).map_err(|_| bad())?;
        if passage == 0 || parts.next().is_some() {
            return Err(bad());
        }
        Ok(Self(Some(Arc::new(Armed::Once { point, kind, left: AtomicU32::new(passage) }))))
    }

    /// Arms `faults` faults, which strike on average at one passage in `one_in` of any point:
    /// errors, and sometimes a stall of `stall`. The passages and the faults depend only on `seed`
    /// and the number of the passage.
    #[must_use]
    pub fn random(seed: u64, one_in: u32, faults: u32, stall: Duration) -> Self {
        let (passages, left) = (AtomicU32::new(0), AtomicU32::new(faults));
        Self(Some(Arc::new(Armed::Random { seed, one_in, stall, passages, left })))
    }

    /// Number of random faults, or of passages of the one point, that are left.
    #[must_use]
    pub fn left(&self) -> u32 {
        match self.0.as_deref() {
            None => 0,
            Some(Armed::Once { left, .. } | Armed::Random { left, .. }) => left.load(Ordering::Relaxed),
        }
    }

    /// Passes a point on a thread that may block.
    ///
    /// # Errors
    /// [`Injected`] if an error is armed here.
    pub fn point_blocking(&self, point: &'static str) -> Result<(), Injected> {
        if let Some(stall) = self.pass(point)? {
            std::thread::sleep(stall);
        }
        Ok(())
    }

    /// Passes a point in a task.
    ///
    /// # Errors
    /// [`Injected`] if an error is armed here.
    pub async fn point(&self, point: &'static str) -> Result<(), Injected> {
        if let Some(stall) = self.pass(point)? {
            tokio::time::sleep(stall).await;
        }
        Ok(())
    }

    /// Passes a point. Returns the duration of the stall that is armed here.
    fn pass(&self, point: &'static str) -> Result<Option<Duration>, Injected> {
        match self.strikes(point) {
            None => Ok(None),
            Some(Kind::Kill) => std::process::abort(),
            Some(Kind::Error) => Err(Injected(point)),
            Some(Kind::Stall(time)) => Ok(Some(time)),
        }
    }

    fn strikes(&self, point: &str) -> Option<Kind> {
        if cfg!(not(feature = "fault-injection")) {
            return None;
        }
        match self.0.as_deref()? {
            Armed::Once { point: armed, kind, left } => (*armed == point && take_one(left) == Some(1)).then_some(*kind),
            Armed::Random { seed, one_in, stall, passages, left } => {
                let passage = passages.fetch_add(1, Ordering::Relaxed);
                let [whether, how, ..] = words(*seed, Stream::Growth, passage, 0);
                let strikes = below(whether, *one_in) == 0 && take_one(left).is_some();
                strikes.then_some(if below(how, STALLS) == 0 { Kind::Stall(*stall) } else { Kind::Error })
            }
        }
    }
}

/// Decrements a number above 0 and returns its previous value; `None` at 0.
fn take_one(left: &AtomicU32) -> Option<u32> {
    left.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |left| left.checked_sub(1)).ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_fault_strikes_once_at_its_passage_of_its_point() {
        let faults = Faults::parse("before-commit:error:3").unwrap();
        let hits: Vec<bool> = (0..6).map(|_| faults.point_blocking("before-commit").is_err()).collect();
        assert_eq!(hits, [false, false, true, false, false, false]);
        assert!(faults.point_blocking("after-commit").is_ok());
        assert!(Faults::default().point_blocking("before-commit").is_ok());
    }

    #[test]
    fn random_faults_come_by_their_seed_and_end() {
        let hits = |seed| {
            let faults = Faults::random(seed, 7, 20, Duration::ZERO);
            let hits: Vec<bool> = (0..400).map(|n| faults.point_blocking(POINTS[n % POINTS.len()]).is_err()).collect();
            assert_eq!(faults.left(), 0);
            hits
        };
        assert_eq!(hits(1), hits(1));
        assert_ne!(hits(1), hits(2));
        let errors = hits(1).iter().filter(|hit| **hit).count();
        assert!((15..=20).contains(&errors), "{errors}");
    }

    #[test]
    fn every_point_parses_and_nonsense_does_not() {
        for point in POINTS {
            assert!(Faults::parse(point).is_ok());
            assert!(Faults::parse(&format!("{point}:stall:2")).is_ok());
        }
        for bad in ["nowhere", "store:explode", "store:kill:0", "store:kill:x", "store:kill:1:2"] {
            assert!(Faults::parse(bad).is_err(), "{bad}");
        }
    }
}
