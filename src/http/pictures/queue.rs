//! What the requests for pictures share: turns to draw, and the pictures that were asked for lately.

use crate::http::wire::conditional::ETag;
use bytes::Bytes;
use std::collections::{HashMap, VecDeque};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// Most bytes of pictures in memory.
const KEPT_BYTES: usize = 16 << 20;
/// Most requests that wait for a turn or have one.
const MOST_WAITING: usize = 64;
/// Most of them from keys of one owner, so that others get a place. A browser asks for six at a time.
const MOST_OF_OWNER: usize = 16;

/// Turns and pictures.
pub(in crate::http) struct Pictures {
    turns: Arc<Semaphore>,
    waiting: Arc<Mutex<Waiting>>,
    recent: Mutex<Kept>,
}

/// Permission to draw a picture, until it is dropped.
pub(in crate::http) struct Turn {
    _place: Place,
    _permit: OwnedSemaphorePermit,
}

impl Pictures {
    /// Gives at most `most` turns at a time.
    pub(in crate::http) fn new(most: usize) -> Self {
        Self { turns: Arc::new(Semaphore::new(most)), waiting: Arc::default(), recent: Mutex::default() }
    }

    /// A turn to draw, first come, first served; none if `wait` passes before, or if too many wait.
    pub(in crate::http) async fn turn(&self, owner: Option<&str>, wait: Duration) -> Option<Turn> {
        let place = Place::new(&self.waiting, owner)?;
        let permit = tokio::time::timeout(wait, Arc::clone(&self.turns).acquire_owned()).await.ok()?.ok()?;
        Some(Turn { _place: place, _permit: permit })
    }

    /// The picture with this tag, if it is in memory.
    pub(in crate::http) fn kept(&self, tag: &ETag) -> Option<Bytes> {
        self.recent().get(tag)
    }

    /// Keeps a picture as long as there is room.
    pub(in crate::http) fn keep(&self, tag: ETag, png: Bytes) {
        self.recent().put(tag, png);
    }

    fn recent(&self) -> MutexGuard<'_, Kept> {
        lock(&self.recent)
    }
}

/// Number of requests that wait or draw, in all and by owner of their key.
#[derive(Default)]
struct Waiting {
    all: usize,
    by_owner: HashMap<String, usize>,
}

/// One of the requests in [`Waiting`].
struct Place {
    waiting: Arc<Mutex<Waiting>>,
    owner: Option<String>,
}

impl Place {
    fn new(waiting: &Arc<Mutex<Waiting>>, owner: Option<&str>) -> Option<Self> {
        let mut now = lock(waiting);
        let own = owner.and_then(|owner| now.by_owner.get(owner).copied()).unwrap_or(0);
        if now.all >= MOST_WAITING || own >= MOST_OF_OWNER {
            return None;
        }
        now.all += 1;
        if let Some(owner) = owner {
            now.by_owner.insert(owner.to_owned(), own + 1);
        }
        Some(Self { waiting: Arc::clone(waiting), owner: owner.map(str::to_owned) })
    }
}

impl Drop for Place {
    fn drop(&mut self) {
        let mut now = lock(&self.waiting);
        now.all -= 1;
        if let Some(owner) = &self.owner
            && let Some(own) = now.by_owner.get_mut(owner)
        {
            *own -= 1;
            if *own == 0 {
                now.by_owner.remove(owner);
            }
        }
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
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
        if png.len() > KEPT_BYTES {
            return;
        }
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

    #[tokio::test]
    async fn no_owner_takes_all_places() {
        let pictures = Pictures::new(1);
        let ask = |owner| Place::new(&pictures.waiting, owner);
        let mut of_one: Vec<Place> = (0..MOST_OF_OWNER).map(|_| ask(Some("a")).unwrap()).collect();
        assert!(ask(Some("a")).is_none());
        let others: Vec<Place> = (MOST_OF_OWNER..MOST_WAITING).map(|_| ask(None).unwrap()).collect();
        assert!(ask(Some("b")).is_none(), "all places are taken");
        drop(of_one.pop());
        assert!(pictures.turn(Some("a"), Duration::from_secs(60)).await.is_some());
        drop((of_one, others));
        let now = lock(&pictures.waiting);
        assert!(now.all == 0 && now.by_owner.is_empty());
    }

    #[tokio::test]
    async fn who_stops_waiting_leaves_no_trace() {
        let pictures = Pictures::new(0);
        assert!(pictures.turn(Some("a"), Duration::from_millis(1)).await.is_none());
        let waits = pictures.turn(Some("a"), Duration::from_secs(60));
        assert!(tokio::time::timeout(Duration::from_millis(1), waits).await.is_err());
        assert_eq!(lock(&pictures.waiting).all, 0);
    }

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
        assert_eq!(kept.0.len(), 3, "what is too large does not displace others");
    }
}
