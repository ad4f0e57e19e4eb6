//! What the requests for pictures share: turns to draw, and the pictures that were asked for lately.

use super::conditional::ETag;
use bytes::Bytes;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// Most bytes of pictures in memory.
const KEPT_BYTES: usize = 16 << 20;

/// Turns and pictures.
pub(super) struct Pictures {
    turns: Arc<Semaphore>,
    recent: Mutex<Kept>,
}

impl Pictures {
    /// Gives at most `most` turns at a time.
    pub(super) fn new(most: usize) -> Self {
        Self { turns: Arc::new(Semaphore::new(most)), recent: Mutex::default() }
    }

    /// A turn to draw, first come, first served; none if `wait` passes before.
    pub(super) async fn turn(&self, wait: Duration) -> Option<OwnedSemaphorePermit> {
        tokio::time::timeout(wait, Arc::clone(&self.turns).acquire_owned()).await.ok()?.ok()
    }

    /// The picture with this tag, if it is in memory.
    pub(super) fn kept(&self, tag: &ETag) -> Option<Bytes> {
        self.recent().get(tag)
    }

    /// Keeps a picture as long as there is room.
    pub(super) fn keep(&self, tag: ETag, png: Bytes) {
        self.recent().put(tag, png);
    }

    fn recent(&self) -> MutexGuard<'_, Kept> {
        self.recent.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Pictures by entity tag, those used last at the back.
#[derive(Default)]
struct Kept(VecDeque<(ETag, Bytes)>);

impl Kept {
    fn get(&mut self, tag: &ETag) -> Option<Bytes> {
        let place = self.0.iter().position(|(kept, _)| kept == tag)?;
        let entry = self.0.remove(place)?;
        let png = entry.1.clone();
        self.0.push_back(entry);
        Some(png)
    }

    fn put(&mut self, tag: ETag, png: Bytes) {
        self.0.retain(|(kept, _)| *kept != tag);
        self.0.push_back((tag, png));
        while self.0.iter().map(|(_, png)| png.len()).sum::<usize>() > KEPT_BYTES {
            self.0.pop_front();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_that_were_not_used_for_longest_go_first() {
        let mut kept = Kept::default();
        let third = || Bytes::from(vec![0; KEPT_BYTES / 3]);
        for name in ["a", "b", "c"] {
            kept.put(ETag::strong(name), third());
        }
        assert!(kept.get(&ETag::strong("a")).is_some());
        kept.put(ETag::strong("c"), third());
        kept.put(ETag::strong("d"), third());
        let left = ["a", "b", "c", "d"].map(|name| kept.get(&ETag::strong(name)).is_some());
        assert_eq!(left, [true, false, true, true]);
        kept.put(ETag::strong("e"), Bytes::from(vec![0; KEPT_BYTES + 1]));
        assert!(kept.0.is_empty(), "what is too large is not kept");
    }
}
