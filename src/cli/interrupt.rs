//! The signals that stop a command: SIGINT (Ctrl-C), SIGTERM, and SIGHUP, which a terminal sends
//! when it closes.

use super::exit::Failure;
use super::term::Bar;
use crate::generate::CancelToken;
use anyhow::Context;
#[cfg(unix)]
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::task::{JoinError, JoinHandle};

/// Receives the signals that arrive after its creation. A command that has to clean up files
/// creates it before the files.
#[derive(Debug)]
pub struct Signals {
    #[cfg(unix)]
    signals: [Option<Signal>; 3],
}

impl Signals {
    /// Starts to receive the signals. They then do not end the process by themselves.
    #[must_use]
    pub fn listen() -> Self {
        Self {
            #[cfg(unix)]
            signals: [
                signal(SignalKind::terminate()).ok(),
                signal(SignalKind::interrupt()).ok(),
                // `nohup` lets a command ignore SIGHUP; a handler would undo that.
                if ignores_hangup() { None } else { signal(SignalKind::hangup()).ok() },
            ],
        }
    }

    /// Waits for a thread. A signal stops the thread at its next step; a second signal returns at
    /// once.
    pub(super) async fn stoppable<T>(
        &mut self,
        mut thread: JoinHandle<T>,
        cancel: &CancelToken,
        bar: &Bar,
    ) -> Result<Result<T, JoinError>, Failure> {
        let ended = tokio::select! {
            ended = &mut thread => Ok(ended),
            () = self.asked_to_stop() => Err(Failure::Interrupted),
        };
        bar.clear();
        if ended.is_err() {
            cancel.cancel();
            tokio::select! { _ = &mut thread => {} () = self.asked_to_stop() => {} }
        }
        ended
    }

    /// Runs `work`, such as `drawing`, on another thread. A signal returns at once, without waiting
    /// for the thread.
    ///
    /// # Errors
    /// [`Failure::Interrupted`]; [`Failure::Failed`] if `work` panics.
    pub async fn run<T: Send + 'static>(
        &mut self,
        name: &'static str,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Result<T, Failure> {
        tokio::select! {
            done = tokio::task::spawn_blocking(work) => Ok(done.with_context(|| format!("{name} panicked"))?),
            () = self.asked_to_stop() => Err(Failure::Interrupted),
        }
    }

    /// Waits for the next signal.
    pub async fn asked_to_stop(&mut self) {
        #[cfg(unix)]
        {
            let [terminate, interrupt, hangup] = &mut self.signals;
            tokio::select! {
                () = next(terminate) => {}
                () = next(interrupt) => {}
                () = next(hangup) => {}
            }
        }
        // Waits forever if Ctrl-C cannot be received, because it then ends the process by itself.
        #[cfg(not(unix))]
        if tokio::signal::ctrl_c().await.is_err() {
            std::future::pending::<()>().await;
        }
    }
}

/// Waits for the signal. Waits forever if it cannot be received, because it then ends the process
/// by itself.
#[cfg(unix)]
async fn next(signal: &mut Option<Signal>) {
    let received = match signal {
        Some(signal) => signal.recv().await,
        None => None,
    };
    if received.is_none() {
        std::future::pending::<()>().await;
    }
}

/// True if this process ignores SIGHUP. False where the kernel does not report it.
#[cfg(unix)]
fn ignores_hangup() -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let ignored = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    // Bit 0 is signal 1, SIGHUP.
    ignored.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).is_some_and(|mask| mask & 1 == 1)
}

/// Waits for SIGINT, SIGTERM or SIGHUP. After the first call they no longer end the process by
/// themselves.
pub(super) async fn asked_to_stop() {
    Signals::listen().asked_to_stop().await;
}
