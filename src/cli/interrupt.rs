//! Being asked to stop: Ctrl-C, or a terminate signal.

/// Waits until the process is asked to stop.
///
/// Once this was called, the signals no longer end the process by themselves.
pub(super) async fn asked_to_stop() {
    #[cfg(unix)]
    {
        use tokio::signal::unix::{SignalKind, signal};
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
