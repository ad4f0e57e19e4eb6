//! State of the pictures of a service: turns to draw them, and the results of recent requests.

use crate::geometry::cut::Body;
use crate::http::wire::conditional::ETag;
use crate::http::wire::shares::Turns;
use crate::lock::Mutex;
use bytes::Bytes;
use std::borrow::Borrow;
use std::collections::VecDeque;
use std::sync::Arc;

/// Maximum size of the kept pictures, in bytes.
const MAX_PICTURE_BYTES: usize = 16 << 20;
/// Maximum size of the kept surfaces, in bytes. The surface used last is kept even if it is larger.
const MAX_SURFACE_BYTES: usize = 128 << 20;

/// A surface of a model, prepared for cuts.
pub(super) type Surface = Arc<Body<'static>>;

/// Turns to draw, recent pictures and recent surfaces.
pub(in crate::http) struct Pictures {
    pub(super) turns: Turns,
    pictures: Mutex<Recent<ETag, Bytes>>,
    surfaces: Mutex<Recent<String, Surface>>,
}

impl Pictures {
    /// Grants at most `max_turns` turns at a time.
    pub(in crate::http) fn new(max_turns: usize) -> Self {
        Self { turns: Turns::new(max_turns), pictures: Mutex::default(), surfaces: Mutex::default() }
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
