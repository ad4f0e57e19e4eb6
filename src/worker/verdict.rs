//! What an error means for the job: whether another attempt could fare better, and what the client is told.

use super::generator::WorkError;
use crate::generate::GenerateError;
use crate::jobs::Problem;
use crate::jobs::fault::Injected;
use std::any::Any;
use tokio::task::JoinError;

/// What is to be done with the job.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Verdict {
    /// Another attempt would meet the same fault: fail at once.
    Fail(Problem),
    /// The fault may pass: give back, counted as an attempt.
    Retry(Problem),
    /// The fault is none of the job's: give back, without counting.
    GiveBack(Problem),
}

impl Verdict {
    /// Whether the disk of this machine is at fault, as far as can be told.
    pub(super) fn is_of_machine(&self) -> bool {
        matches!(self, Self::Retry(problem) | Self::GiveBack(problem) if problem.kind == IO)
    }
}

/// The kind of problem of files that could not be written.
const IO: &str = "io";

fn problem(kind: &str, title: &str, detail: String) -> Problem {
    Problem { kind: kind.into(), title: title.into(), detail }
}

/// The verdict on a generation that ended with an error.
pub(super) fn of_error(error: &WorkError) -> Verdict {
    let detail = error.to_string();
    match error {
        WorkError::Spec { .. } => Verdict::Fail(problem("spec", "The spec is not valid for this engine", detail)),
        WorkError::Generate(error) => match error {
            GenerateError::Certificate { .. } => {
                Verdict::Fail(problem("certificate", "The model failed its certificate", detail))
            }
            GenerateError::Memory { .. } => {
                Verdict::Fail(problem("memory", "The model needs more memory than allowed", detail))
            }
            GenerateError::Backend { .. } => Verdict::Fail(problem("backend", "The backend is not available", detail)),
            GenerateError::Gpu(_) => Verdict::Fail(of_gpu(detail)),
            GenerateError::Panic { detail } => Verdict::Fail(panicked(detail.clone())),
            GenerateError::Simulation { .. } => Verdict::Fail(problem("simulation", "The simulation failed", detail)),
            GenerateError::Io { source, .. } => {
                Verdict::Retry(problem(IO, "Files could not be written", format!("{detail}: {source}")))
            }
            // Nobody asked it to stop, as far as the worker knows.
            GenerateError::Cancelled => Verdict::Retry(problem("interrupted", "The generation was broken off", detail)),
        },
    }
}

/// The verdict on a generation whose thread gave no result: the same code on the same spec would panic again.
pub(super) fn of_join(error: JoinError) -> Verdict {
    let payload = match error.try_into_panic() {
        Ok(payload) => payload,
        // The runtime is going down.
        Err(error) => {
            return Verdict::Retry(problem("interrupted", "The generation was broken off", error.to_string()));
        }
    };
    Verdict::Fail(panicked(message(payload.as_ref())))
}

/// What a panic said.
pub(super) fn message(payload: &(dyn Any + Send)) -> String {
    let text = payload.downcast_ref::<&str>().map(|message| (*message).to_owned());
    text.or_else(|| payload.downcast_ref::<String>().cloned()).unwrap_or_else(|| "a panic without a message".to_owned())
}

/// The verdict on a member of a batch that ended without a word of it.
pub(super) fn of_silence() -> Verdict {
    Verdict::Retry(problem("interrupted", "The generation was broken off", "the batch ended without it".to_owned()))
}

fn panicked(message: String) -> Problem {
    problem("panic", "The generation panicked", message)
}

/// The problem of a job that asked for a GPU and nothing else.
pub(super) fn of_gpu(detail: String) -> Problem {
    problem("gpu", "The GPU could not grow the model", detail)
}

/// The verdict on a scratch folder that could not be made: no job has written to it yet.
pub(super) fn of_scratch(error: &std::io::Error) -> Verdict {
    Verdict::GiveBack(problem(IO, "No scratch folder could be made", error.to_string()))
}

/// The verdict on a job that waited for the threads of its worker in vain.
pub(super) fn of_waiting() -> Verdict {
    let detail = "another worker may be free before the threads of this one are".to_owned();
    Verdict::GiveBack(problem("busy", "The worker is busy", detail))
}

/// The verdict on an artifact store that stayed away or full.
pub(super) fn of_storage(detail: String) -> Verdict {
    Verdict::Fail(problem("storage", "The files could not be stored", detail))
}

/// The verdict on a generation that took longer than `limit`.
pub(super) fn of_timeout(limit: std::time::Duration) -> Verdict {
    let detail =
        format!("it was not done after {} seconds, the longest that a model may take here", limit.as_secs_f64());
    Verdict::Fail(problem("timeout", "The model took too long", detail))
}

/// The verdict on an injected fault.
pub(super) fn of_injected(injected: Injected) -> Verdict {
    Verdict::Retry(problem("fault", "A fault was injected", injected.to_string()))
}
