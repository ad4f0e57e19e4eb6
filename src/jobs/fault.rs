//! Faults injected by name at each step of a job's life, so that tests can kill a worker or break a step
//! exactly there.
//!
//! `OVIDUCT_FAULT=<point>[:kill|error|stall][:<n>]` arms one fault, at the n-th passage of the point (from 1).
//! Without it, every point costs one comparison.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::Duration;

/// The environment variable that arms a fault.
pub const VARIABLE: &str = "OVIDUCT_FAULT";

/// How long a stall holds its step up: longer than any lease, shorter than a test's patience.
const STALL: Duration = Duration::from_secs(20);

/// The points, in the order of a job's life. `simulate` to `store` are passed at each progress of that stage.
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

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Kill,
    Error,
    Stall,
}

#[derive(Debug)]
struct Armed {
    point: &'static str,
    kind: Kind,
    /// Passages left until it strikes; it strikes once.
    left: AtomicU32,
}

/// The fault that is armed, if any. Clones share it.
#[derive(Clone, Debug, Default)]
pub struct Faults(Option<Arc<Armed>>);

/// An injected error.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a fault was injected at {0}")]
pub struct Injected(pub &'static str);

/// A fault that cannot be armed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{VARIABLE}={0:?} is not <point>[:kill|error|stall][:<n>] with a point of {POINTS:?}")]
pub struct BadFault(String);

impl Faults {
    /// No fault.
    #[must_use]
    pub fn none() -> Self {
        Self(None)
    }

    /// What the environment arms; to be read once, at start.
    ///
    /// # Errors
    /// [`BadFault`].
    pub fn from_env() -> Result<Self, BadFault> {
        match std::env::var(VARIABLE) {
            Ok(text) if !text.is_empty() => Self::parse(&text),
            _ => Ok(Self::none()),
        }
    }

    /// Arms the fault that `text` names.
    ///
    /// # Errors
    /// [`BadFault`].
    pub fn parse(text: &str) -> Result<Self, BadFault> {
        let bad = || BadFault(text.to_owned());
        let mut parts = text.split(':');
        let name = parts.next().unwrap_or_default();
        let point = POINTS.into_iter().find(|point| *point == name).ok_or_else(bad)?;
        let kind = match parts.next() {
            None | Some("kill") => Kind::Kill,
            Some("error") => Kind::Error,
            Some("stall") => Kind::Stall,
            Some(_) => return Err(bad()),
        };
        let passage = parts.next().map_or(Ok(1), str::parse).map_err(|_| bad())?;
        if passage == 0 || parts.next().is_some() {
            return Err(bad());
        }
        Ok(Self(Some(Arc::new(Armed { point, kind, left: AtomicU32::new(passage) }))))
    }

    /// Passes a point on a thread that may block.
    ///
    /// # Errors
    /// [`Injected`] where an error is armed here.
    pub fn point_blocking(&self, point: &'static str) -> Result<(), Injected> {
        match self.strikes(point) {
            None => Ok(()),
            Some(Kind::Kill) => std::process::abort(),
            Some(Kind::Error) => Err(Injected(point)),
            Some(Kind::Stall) => {
                std::thread::sleep(STALL);
                Ok(())
            }
        }
    }

    /// Passes a point in a task.
    ///
    /// # Errors
    /// [`Injected`] where an error is armed here.
    pub async fn point(&self, point: &'static str) -> Result<(), Injected> {
        match self.strikes(point) {
            None => Ok(()),
            Some(Kind::Kill) => std::process::abort(),
            Some(Kind::Error) => Err(Injected(point)),
            Some(Kind::Stall) => {
                tokio::time::sleep(STALL).await;
                Ok(())
            }
        }
    }

    fn strikes(&self, point: &str) -> Option<Kind> {
        let armed = self.0.as_deref().filter(|armed| armed.point == point)?;
        let before = armed.left.fetch_update(Ordering::Relaxed, Ordering::Relaxed, |left| left.checked_sub(1)).ok()?;
        (before == 1).then_some(armed.kind)
    }
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
        assert!(Faults::none().point_blocking("before-commit").is_ok());
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
