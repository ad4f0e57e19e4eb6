//! Faults in builds without fault injection: every point is a no-op.

use super::{BadFault, Injected, VARIABLE};

/// No faults.
#[derive(Clone, Debug, Default)]
pub struct Faults;

impl Faults {
    /// Arms no fault.
    #[must_use]
    pub fn none() -> Self {
        Self
    }

    /// Arms no fault.
    ///
    /// # Errors
    /// [`BadFault::Disabled`] if the environment arms one.
    pub fn from_env() -> Result<Self, BadFault> {
        match std::env::var_os(VARIABLE) {
            Some(text) if !text.is_empty() => Err(BadFault::Disabled),
            _ => Ok(Self),
        }
    }

    /// Does nothing.
    ///
    /// # Errors
    /// None.
    pub fn point_blocking(&self, _: &'static str) -> Result<(), Injected> {
        Ok(())
    }

    /// Does nothing.
    ///
    /// # Errors
    /// None.
    pub async fn point(&self, _: &'static str) -> Result<(), Injected> {
        Ok(())
    }
}
