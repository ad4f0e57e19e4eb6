//! Event streams that are held open for a whole run. Each follows a model to its end, and then the next one.

use super::super::client::Followed;
use super::target::Target;
use std::sync::Arc;
use std::time::Duration;
use tokio::task::JoinSet;

/// Pause while there is no model to follow.
const PAUSE: Duration = Duration::from_millis(100);

/// Opens this many streams. The tasks end when the run is over and each stream was told of the end that it waits for;
/// dropping them closes the streams.
pub(super) fn hold(target: &Arc<Target>, count: u32) -> JoinSet<()> {
    target.record.streams(|streams| streams.held = count);
    let mut tasks = JoinSet::new();
    for place in 0..count {
        let target = Arc::clone(target);
        tasks.spawn(async move {
            while !target.over.is_cancelled() {
                // Neighbours follow different models, as far as there are that many.
                match target.known.open(place as usize) {
                    Some(id) => follow(&target, &id).await,
                    None => tokio::time::sleep(PAUSE).await,
                }
            }
        });
    }
    tasks
}

/// Follows a model to its end, over any number of connections.
async fn follow(target: &Target, id: &str) {
    let record = &target.record;
    record.streams(|streams| streams.followed += 1);
    let lost = |followed: Followed<'_>| {
        if matches!(followed, Followed::Away) {
            record.streams(|streams| streams.cut += 1);
        }
    };
    match target.client.follow(id, lost).await {
        Ok(()) => {
            target.known.end(id, None);
            record.streams(|streams| streams.told += 1);
        }
        Err(failure) => {
            record.streams(|streams| streams.errors.add(failure.into()));
            tokio::time::sleep(PAUSE).await;
        }
    }
}
