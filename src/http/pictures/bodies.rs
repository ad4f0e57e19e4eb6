//! Surfaces that were cut lately, kept in memory.

use crate::geometry::cut::Body;
use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Most bytes of surfaces in memory; the one used last stays in any case.
const KEPT_BYTES: usize = 128 << 20;

/// Surfaces by the SHA-256 of their file, those used last at the back.
#[derive(Default)]
pub(in crate::http) struct Bodies(Mutex<VecDeque<(String, Arc<Body<'static>>)>>);

impl Bodies {
    /// The surface of this file, if it is in memory.
    pub(in crate::http) fn kept(&self, sha256: &str) -> Option<Arc<Body<'static>>> {
        let mut all = self.lock();
        let entry = all.iter().position(|(kept, _)| kept == sha256).and_then(|place| all.remove(place))?;
        let body = Arc::clone(&entry.1);
        all.push_back(entry);
        Some(body)
    }

    /// Keeps a surface as long as there is room.
    pub(in crate::http) fn keep(&self, sha256: &str, body: &Arc<Body<'static>>) {
        let mut all = self.lock();
        all.retain(|(kept, _)| kept != sha256);
        all.push_back((sha256.to_owned(), Arc::clone(body)));
        while all.len() > 1 && all.iter().map(|(_, body)| body.bytes()).sum::<usize>() > KEPT_BYTES {
            all.pop_front();
        }
    }

    fn lock(&self) -> MutexGuard<'_, VecDeque<(String, Arc<Body<'static>>)>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::sample::tube;

    #[test]
    fn the_surfaces_used_last_are_kept() {
        let bodies = Bodies::default();
        // Three of them are more than fits.
        let body = || {
            let mesh = tube(3, 1, 0.0);
            let positions = vec![[0.0; 3]; KEPT_BYTES / 30];
            Arc::new(Body::new(positions, mesh.triangles, &[], 1e6))
        };
        for name in ["a", "b"] {
            bodies.keep(name, &body());
        }
        assert!(bodies.kept("a").is_some());
        bodies.keep("c", &body());
        assert_eq!(["a", "b", "c"].map(|name| bodies.kept(name).is_some()), [true, false, true]);
        let mesh = tube(3, 1, 0.0);
        let large = Arc::new(Body::new(vec![[0.0; 3]; KEPT_BYTES], mesh.triangles, &[], 1e6));
        bodies.keep("large", &large);
        assert!(bodies.kept("large").is_some() && bodies.kept("a").is_none() && bodies.kept("c").is_none());
    }
}
