//! Consequences of an error for a job: whether another attempt could succeed, and the problem that
//! the client sees.

use super::generator::WorkError;
use crate::fit::FitError;
use crate::generate::GenerateError;
use crate::jobs::fault::Injected;
use crate::jobs::{Problem, with_causes};
use crate::panics::panic_message;
use std::error::Error;
use std::io;
use std::time::Duration;
use tokio::task::JoinError;

/// Consequence for a job whose attempt failed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Verdict {
    /// Fail the job: another attempt would fail in the same way.
    Fail(Problem),
    /// Retry: the error may be transient. The attempt counts.
    Retry(Problem),
    /// Release the job, because another worker may run it sooner. The attempt does not count.
    Release(Problem),
    /// Release the job and pause claims, because storage failed. The attempt does not count.
    Storage {
        /// Problem of the attempt.
        problem: Problem,
        /// True if the scratch directory failed, false if the artifact store did.
        scratch: bool,
    },
}

/// Kind of the problem of files that could not be stored.
const STORAGE: &str = "storage";

fn problem(kind: &str, title: &str, detail: String) -> Problem {
    Problem { kind: kind.into(), title: title.into(), detail }
}

/// The verdict on a generation that returned an error.
pub(super) fn of_error(error: &WorkError) -> Verdict {
    let detail = error.to_string();
    let (kind, title) = match error {
        WorkError::Fit(FitError::Io(source)) if is_storage_fault(source) => return of_scratch(error),
        WorkError::Generate(GenerateError::Io { source, .. }) if is_storage_fault(source) => return of_scratch(error),
        WorkError::Fit(FitError::Io(_)) => return unwritten(detail),
        WorkError::Generate(GenerateError::Io { .. }) => return unwritten(with_causes(error)),
        // The worker did not request it.
        WorkError::Fit(FitError::Cancelled) => {
            return Verdict::Retry(problem("interrupted", "The fit was interrupted", detail));
        }
        WorkError::Generate(GenerateError::Cancelled) => return interrupted(detail),
        WorkError::Generate(GenerateError::Gpu(_)) => return Verdict::Fail(of_gpu(detail)),
        WorkError::Generate(GenerateError::Panic { detail }) => return Verdict::Fail(panicked(detail.clone())),
        WorkError::Spec { .. } => ("spec", "The spec is not valid for this engine"),
        WorkError::Fit(FitError::Search { .. }) => ("search", "The search found no candidate"),
        WorkError::Fit(FitError::Memory { .. }) => ("memory", "The models of the fit need more memory than allowed"),
        WorkError::Generate(GenerateError::Certificate { .. }) => ("certificate", "The model failed its certificate"),
        WorkError::Generate(GenerateError::Memory { .. }) => ("memory", "The model needs more memory than allowed"),
        WorkError::Generate(GenerateError::Format { .. }) => ("format", "A file cannot hold the model"),
        WorkError::Generate(GenerateError::Backend { .. }) => ("backend", "The backend is not available"),
        WorkError::Generate(GenerateError::Simulation { .. }) => ("simulation", "The simulation failed"),
    };
    Verdict::Fail(problem(kind, title, detail))
}

/// The verdict on a generation that could not write its files.
fn unwritten(detail: String) -> Verdict {
    Verdict::Retry(problem("io", "Files could not be written", detail))
}

/// The verdict on a generation that was interrupted although the worker did not request it.
fn interrupted(detail: String) -> Verdict {
    Verdict::Retry(problem("interrupted", "The generation was interrupted", detail))
}

/// True if an I/O error results from the state of a disk (full, over quota, read-only, failing,
/// missing) rather than from the data.
pub(super) fn is_storage_fault(error: &io::Error) -> bool {
    // EIO has no `ErrorKind`.
    const EIO: i32 = 5;
    let is_fault = error.raw_os_error() == Some(EIO)
        || matches!(
            error.kind(),
            io::ErrorKind::StorageFull
                | io::ErrorKind::QuotaExceeded
                | io::ErrorKind::FileTooLarge
                | io::ErrorKind::ReadOnlyFilesystem
                | io::ErrorKind::StaleNetworkFileHandle
                | io::ErrorKind::NotADirectory
                | io::ErrorKind::NotFound
        );
    // Writers may wrap the error of the underlying file.
    let inner = error.get_ref().and_then(|inner| inner.downcast_ref::<io::Error>());
    is_fault || inner.is_some_and(is_storage_fault)
}

/// The verdict on a generation whose thread returned no result. After a panic, a retry would panic
/// again.
pub(super) fn of_join(error: JoinError) -> Verdict {
    match error.try_into_panic() {
        Ok(payload) => Verdict::Fail(panicked(panic_message(payload.as_ref()).to_owned())),
        // The runtime is shutting down.
        Err(error) => interrupted(error.to_string()),
    }
}

/// The verdict on a member of a GPU batch without a result.
pub(super) fn of_silence() -> Verdict {
    interrupted("the batch ended without a result for it".to_owned())
}

fn panicked(message: String) -> Problem {
    problem("panic", "The generation panicked", message)
}

/// The problem of a job that requires a GPU.
pub(super) fn of_gpu(detail: String) -> Problem {
    problem("gpu", "The GPU could not grow the model", detail)
}

/// The verdict on a scratch directory that cannot be created, read or written.
pub(super) fn of_scratch(error: &dyn Error) -> Verdict {
    let problem = problem(STORAGE, "The scratch directory is unavailable", with_causes(error));
    Verdict::Storage { problem, scratch: true }
}

/// The verdict on an artifact store that does not accept files.
pub(super) fn of_storage(error: &dyn Error) -> Verdict {
    let problem = problem(STORAGE, "The artifact store is unavailable", with_causes(error));
    Verdict::Storage { problem, scratch: false }
}

/// The verdict on a job whose worker has had no free threads for too long.
pub(super) fn of_busy_worker() -> Verdict {
    let detail = "another worker may be free before this one".to_owned();
    Verdict::Release(problem("busy", "The worker is busy", detail))
}

/// The verdict on scratch files that differ from what the generator wrote, or cannot be read.
pub(super) fn of_damage(error: &dyn Error) -> Verdict {
    Verdict::Retry(problem("io", "Files in the scratch directory are damaged", with_causes(error)))
}

/// The verdict on a generation that took longer than `limit`.
pub(super) fn of_timeout(limit: Duration) -> Verdict {
    let detail = format!("it was stopped after {} seconds, its time limit", limit.as_secs_f64());
    Verdict::Fail(problem("timeout", "The model took too long", detail))
}

/// The problem of a job that does not fit on a GPU together with the rest of its batch.
pub(super) fn of_misfit() -> Problem {
    problem(MISFIT, "The job does not fit the batch", "the device has no memory for it beside older jobs".to_owned())
}

/// Kind of the problem of [`of_misfit`].
pub(super) const MISFIT: &str = "batch";

/// The verdict on an injected fault.
pub(super) fn of_injected(fault: Injected) -> Verdict {
    Verdict::Retry(injected(fault))
}

/// The problem of an injected fault.
pub(super) fn injected(fault: Injected) -> Problem {
    problem("fault", "A fault was injected", fault.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faults_of_a_disk_are_told_from_other_io_errors() {
        // EIO, ENOSPC, EROFS, EDQUOT, EFBIG.
        #[cfg(target_os = "linux")]
        for code in [5, 28, 30, 122, 27] {
            assert!(is_storage_fault(&io::Error::from_raw_os_error(code)), "{code}");
        }
        let wrapped = io::Error::other(io::Error::from(io::ErrorKind::StorageFull));
        assert!(is_storage_fault(&wrapped));
        assert!(!is_storage_fault(&io::Error::from(io::ErrorKind::InvalidInput)));
        assert!(!is_storage_fault(&io::Error::other("nothing known")));
    }
}
