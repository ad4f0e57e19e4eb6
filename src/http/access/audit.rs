//! Audit lines: who changed what. They have the target `oviduct::audit`, so that a filter can send them elsewhere.

use super::Caller;

/// Records that `caller` did something with the model, batch or filter `subject`. The request's span has its id.
pub(in crate::http) fn audit(caller: &Caller, action: &'static str, subject: impl std::fmt::Display) {
    let (owner, key) = match caller {
        Caller::Anyone => ("", ""),
        Caller::Key(key) => (key.owner.name(), key.prefix.as_str()),
    };
    tracing::info!(target: "oviduct::audit", action, %subject, owner, key);
}
