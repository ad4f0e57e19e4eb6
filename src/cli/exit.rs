//! Results of commands: exit codes, and messages on stderr.

use crate::jobs::with_causes;
use std::process::ExitCode;

/// Failure of a command.
#[derive(Debug)]
pub enum Failure {
    /// Invalid usage or an invalid spec: one line for each fault. Exit code 2.
    Usage(Vec<String>),
    /// Any other error. Exit code 1.
    Failed(anyhow::Error),
    /// A negative result that was already printed to stdout. Exit code 1.
    Negative,
    /// Interrupted by a signal. Exit code 130.
    Interrupted,
}

/// Result of a command.
pub type Ended = Result<(), Failure>;

impl Failure {
    /// Returns a failure by invalid usage with one fault.
    pub fn usage(line: impl Into<String>) -> Self {
        Self::Usage(vec![line.into()])
    }

    /// Returns the exit code and the lines for stderr.
    #[must_use]
    pub fn report(&self) -> (u8, Vec<String>) {
        match self {
            Self::Usage(lines) => (2, lines.iter().map(|line| format!("error: {line}")).collect()),
            Self::Failed(error) if is_broken_pipe(error) => (0, Vec::new()),
            Self::Failed(error) => (1, vec![format!("error: {}", with_causes(&**error))]),
            Self::Negative => (1, Vec::new()),
            Self::Interrupted => (130, vec!["interrupted".to_owned()]),
        }
    }
}

/// Returns true if the reader of stdout closed it, as in `oviduct schema | head`. This is not a
/// failure.
fn is_broken_pipe(error: &anyhow::Error) -> bool {
    error.downcast_ref::<std::io::Error>().is_some_and(|error| error.kind() == std::io::ErrorKind::BrokenPipe)
}

impl<E: Into<anyhow::Error>> From<E> for Failure {
    fn from(error: E) -> Self {
        Self::Failed(error.into())
    }
}

/// Prints the reason of a failure to stderr; returns the exit code.
#[must_use]
pub fn exit_code(ended: &Ended) -> ExitCode {
    match ended {
        Ok(()) => ExitCode::SUCCESS,
        Err(failure) => {
            let (code, lines) = failure.report();
            for line in lines {
                super::term::note(&line);
            }
            ExitCode::from(code)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use anyhow::Context;

    #[test]
    fn failures_have_exit_codes_and_messages() {
        let usage = Failure::Usage(vec!["/spec/steps: too many".into(), "/seed: negative".into()]);
        assert_eq!(usage.report(), (2, vec!["error: /spec/steps: too many".into(), "error: /seed: negative".into()]));
        assert_eq!(Failure::Interrupted.report().0, 130);
        assert_eq!(Failure::Negative.report(), (1, vec![]));
        let failed: Failure = anyhow::anyhow!("disk full").context("writing model.glb failed").into();
        assert_eq!(failed.report(), (1, vec!["error: writing model.glb failed: disk full".into()]));
    }

    #[test]
    fn a_closed_pipe_is_not_a_failure() {
        let closed = std::io::Error::from(std::io::ErrorKind::BrokenPipe);
        assert_eq!(Failure::from(closed).report(), (0, vec![]));
        let other: anyhow::Result<()> = Err(std::io::Error::other("gone")).context("x");
        assert_eq!(Failure::from(other.expect_err("an error")).report().0, 1);
    }
}
