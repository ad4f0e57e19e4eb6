//! Requests to stop: SIGINT (Ctrl-C) and SIGTERM.

use super::exit::Failure;
use super::term::Bar;
use crate::generate::CancelToken;
#[cfg(unix)]
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::task::{JoinError, JoinHandle};

/// Receives the signals from its creation on. A command that creates something to clean up listens before it does.
#[derive(Debug)]
pub struct Signals {
    #[cfg(unix)]
    signals: [Option<Signal>; 2],
}

impl Signals {
    /// From now on the signals do not end the process by default.
    #[must_use]
    pub fn listen() -> Self {
        Self {
            #[cfg(unix)]
            signals: [SignalKind::terminate(), SignalKind::interrupt()].map(|kind| signal(kind).ok()),
        }
    }

    /// Waits for a thread; a signal stops it at its next step, a second one does not wait for that.
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

    /// Waits for the next signal.
    pub async fn asked_to_stop(&mut self) {
        #[cfg(unix)]
        {
            let [terminate, interrupt] = &mut self.signals;
            tokio::select! {
                () = next(terminate) => {}
                () = next(interrupt) => {}
            }
        }
        #[cfg(not(unix))]
        asked_to_stop().await;
    }
}

/// Waits for the signal; forever if it cannot be received, since then it ends the process by default.
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

/// Waits for a request to stop. After the first call the signals do not end the process by default.
pub(super) async fn asked_to_stop() {
    #[cfg(unix)]
    {
        if let Ok(mut terminate) = signal(SignalKind::terminate()) {
            tokio::select! {
                _ = terminate.recv() => {}
                () = ctrl_c() => {}
            }
            return;
        }
    }
    ctrl_c().await;
}

/// Waits for Ctrl-C; forever if it cannot be received, since then it ends the process by default.
async fn ctrl_c() {
    if tokio::signal::ctrl_c().await.is_err() {
        std::future::pending::<()>().await;
    }
}
