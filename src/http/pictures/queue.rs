//! State of the pictures of a service: turns to draw them, and the results of recent requests.

use crate::geometry::cut::Body;
use crate::http::wire::conditional::ETag;
use crate::lock::Mutex;
use bytes::Bytes;
use std::borrow::Borrow;
use std::collections::{HashMap, VecDeque};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

/// Maximum size of the kept pictures, in bytes.
const MAX_PICTURE_BYTES: usize = 16 << 20;
/// Maximum size of the kept surfaces, in bytes. The surface used last is kept even if it is larger.
const MAX_SURFACE_BYTES: usize = 128 << 20;
/// Maximum number of requests that wait for a turn or have one.
const MAX_REQUESTS: usize = 64;
/// Maximum number of these requests per owner, which leaves places for other owners. A browser
/// sends six at a time.
const MAX_REQUESTS_OF_OWNER: usize = 16;

/// A surface of a model, prepared for cuts.
pub(super) type Surface = Arc<Body<'static>>;

/// Turns to draw, recent pictures and recent surfaces.
pub(in crate::http) struct Pictures {
    turns: Arc<Semaphore>,
    requests: Arc<Mutex<PictureRequests>>,
    pictures: Mutex<Recent<ETag, Bytes>>,
    surfaces: Mutex<Recent<String, Surface>>,
}

/// The turn of a request to draw, until it is dropped.
pub(in crate::http) struct Turn {
    _place: QueuePlace,
    _permit: OwnedSemaphorePermit,
}

impl Pictures {
    /// Grants at most `max_turns` turns at a time.
    pub(in crate::http) fn new(max_turns: usize) -> Self {
        Self {
            turns: Arc::new(Semaphore::new(max_turns)),
            requests: Arc::default(),
            pictures: Mutex::default(),
            surfaces: Mutex::default(),
        }
    }

    /// Waits for a turn, first come, first served. `None` if the turn takes longer than `wait`, or
    /// if too many requests wait.
    pub(in crate::http) async fn turn(&self, owner: Option<&str>, wait: Duration) -> Option<Turn> {
        let place = QueuePlace::new(&self.requests, owner)?;
        let permit = tokio::time::timeout(wait, Arc::clone(&self.turns).acquire_owned()).await.ok()?.ok()?;
        Some(Turn { _place: place, _permit: permit })
    }

    /// The picture with this tag, if it is kept.
    pub(super) fn picture(&self, tag: &ETag) -> Option<Bytes> {
        self.pictures.lock().get(tag)
    }

    /// Keeps a picture.
    pub(super) fn keep_picture(&self, tag: ETag, png: Bytes) {
        // A larger picture would displace all others.
        if png.len() <= MAX_PICTURE_BYTES {
            self.pictures.lock().put(tag, png, MAX_PICTURE_BYTES, Bytes::len);
        }
    }

    /// The surface in the file with this SHA-256, if it is kept.
    pub(super) fn surface(&self, sha256: &str) -> Option<Surface> {
        self.surfaces.lock().get(sha256)
    }

    /// Keeps a surface.
    pub(super) fn keep_surface(&self, sha256: &str, surface: Surface) {
        self.surfaces.lock().put(sha256.to_owned(), surface, MAX_SURFACE_BYTES, |surface| surface.bytes());
    }
}

/// Number of requests that wait for a turn or have one, in total and by owner of their key.
#[derive(Default)]
struct PictureRequests {
    all: usize,
    by_owner: HashMap<String, usize>,
}

/// A request that [`PictureRequests`] counts, until it is dropped.
struct QueuePlace {
    requests: Arc<Mutex<PictureRequests>>,
    owner: Option<String>,
}

impl QueuePlace {
    fn new(requests: &Arc<Mutex<PictureRequests>>, owner: Option<&str>) -> Option<Self> {
        let mut counts = requests.lock();
        let own = owner.and_then(|owner| counts.by_owner.get(owner).copied()).unwrap_or(0);
        if counts.all >= MAX_REQUESTS || own >= MAX_REQUESTS_OF_OWNER {
            return None;
        }
        counts.all += 1;
        if let Some(owner) = owner {
            counts.by_owner.insert(owner.to_owned(), own + 1);
        }
        Some(Self { requests: Arc::clone(requests), owner: owner.map(str::to_owned) })
    }
}

impl Drop for QueuePlace {
    fn drop(&mut self) {
        let mut counts = self.requests.lock();
        counts.all -= 1;
        if let Some(owner) = &self.owner
            && let Some(own) = counts.by_owner.get_mut(owner)
        {
            *own -= 1;
            if *own == 0 {
                counts.by_owner.remove(owner);
            }
        }
    }
}

/// Values by key, the one used last at the back.
struct Recent<K, V>(VecDeque<(K, V)>);

impl<K, V> Default for Recent<K, V> {
    fn default() -> Self {
        Self(VecDeque::new())
    }
}

impl<K: PartialEq, V: Clone> Recent<K, V> {
    fn get<Q: PartialEq + ?Sized>(&mut self, key: &Q) -> Option<V>
    where
        K: Borrow<Q>,
    {
        let place = self.0.iter().position(|(kept, _)| kept.borrow() == key)?;
        let entry = self.0.remove(place)?;
        let value = entry.1.clone();
        self.0.push_back(entry);
        Some(value)
    }

    /// Adds a value. Removes those used longest ago until all have at most `max_bytes`, but never
    /// the new one.
    fn put(&mut self, key: K, value: V, max_bytes: usize, bytes: impl Fn(&V) -> usize) {
        self.0.retain(|(kept, _)| *kept != key);
        self.0.push_back((key, value));
        while self.0.len() > 1 && self.0.iter().map(|(_, value)| bytes(value)).sum::<usize>() > max_bytes {
            self.0.pop_front();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::sample::tube;

    #[tokio::test]
    async fn no_owner_takes_all_places() {
        let pictures = Pictures::new(1);
        let request = |owner| QueuePlace::new(&pictures.requests, owner);
        let mut of_one: Vec<QueuePlace> = (0..MAX_REQUESTS_OF_OWNER).map(|_| request(Some("a")).unwrap()).collect();
        assert!(request(Some("a")).is_none());
        let others: Vec<QueuePlace> = (MAX_REQUESTS_OF_OWNER..MAX_REQUESTS).map(|_| request(None).unwrap()).collect();
        assert!(request(Some("b")).is_none(), "all places are taken");
        drop(of_one.pop());
        assert!(pictures.turn(Some("a"), Duration::from_secs(60)).await.is_some());
        drop((of_one, others));
        let counts = pictures.requests.lock();
        assert!(counts.all == 0 && counts.by_owner.is_empty());
    }

    #[tokio::test]
    async fn who_stops_waiting_leaves_no_trace() {
        let pictures = Pictures::new(0);
        assert!(pictures.turn(Some("a"), Duration::from_millis(1)).await.is_none());
        let waits = pictures.turn(Some("a"), Duration::from_secs(60));
        assert!(tokio::time::timeout(Duration::from_millis(1), waits).await.is_err());
        assert_eq!(pictures.requests.lock().all, 0);
    }

    #[test]
    fn pictures_that_were_not_used_for_longest_go_first() {
        let pictures = Pictures::new(1);
        let keep = |name: &str, bytes: usize| pictures.keep_picture(ETag::strong(name), Bytes::from(vec![0; bytes]));
        let is_kept = |name: &str| pictures.picture(&ETag::strong(name)).is_some();
        for name in ["a", "b", "c"] {
            keep(name, MAX_PICTURE_BYTES / 3);
        }
        assert!(is_kept("a"));
        keep("c", MAX_PICTURE_BYTES / 3);
        keep("d", MAX_PICTURE_BYTES / 3);
        assert_eq!(["a", "b", "c", "d"].map(is_kept), [true, false, true, true]);
        keep("e", MAX_PICTURE_BYTES + 1);
        assert_eq!(pictures.pictures.lock().0.len(), 3, "what is too large does not displace others");
    }

    #[test]
    fn the_surfaces_used_last_are_kept() {
        let pictures = Pictures::new(1);
        let surface = |vertices: usize| {
            let mesh = tube(3, 1, 0.0);
            Arc::new(Body::new(vec![[0.0; 3]; vertices], mesh.triangles, &[], 1e6))
        };
        let is_kept = |name: &str| pictures.surface(name).is_some();
        // Three of them exceed the limit.
        for name in ["a", "b"] {
            pictures.keep_surface(name, surface(MAX_SURFACE_BYTES / 30));
        }
        assert!(is_kept("a"));
        pictures.keep_surface("c", surface(MAX_SURFACE_BYTES / 30));
        assert_eq!(["a", "b", "c"].map(is_kept), [true, false, true]);
        pictures.keep_surface("large", surface(MAX_SURFACE_BYTES));
        assert!(is_kept("large") && !is_kept("a") && !is_kept("c"));
    }
}
