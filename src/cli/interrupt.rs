//! Being asked to stop: Ctrl-C, or a terminate signal.

#[cfg(unix)]
use tokio::signal::unix::{Signal, SignalKind, signal};

/// The signals, heard from its making on: whoever makes something that must be cleared away listens before.
pub(super) struct Signals {
    #[cfg(unix)]
    heard: [Option<Signal>; 2],
}

impl Signals {
    /// From now on the signals no longer end the process by themselves.
    pub(super) fn listen() -> Self {
        Self {
            #[cfg(unix)]
            heard: [SignalKind::terminate(), SignalKind::interrupt()].map(|kind| signal(kind).ok()),
        }
    }

    /// Waits until the process is asked to stop, once more at each call.
    pub(super) async fn asked_to_stop(&mut self) {
        #[cfg(unix)]
        {
            let [terminate, interrupt] = &mut self.heard;
            tokio::select! {
                () = next(terminate) => {}
                () = next(interrupt) => {}
            }
        }
        #[cfg(not(unix))]
        asked_to_stop().await;
    }
}

/// The next signal; for ever where it cannot be heard, for then it ends the process as ever.
#[cfg(unix)]
async fn next(signal: &mut Option<Signal>) {
    let heard = match signal {
        Some(signal) => signal.recv().await,
        None => None,
    };
    if heard.is_none() {
        std::future::pending::<()>().await;
    }
}

/// Waits until the process is asked to stop.
///
/// Once this was called, the signals no longer end the process by themselves.
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

/// Waits for Ctrl-C; for ever where that cannot be heard, for then it ends the process as ever.
async fn ctrl_c() {
    if tokio::signal::ctrl_c().await.is_err() {
        std::future::pending::<()>().await;
    }
}
