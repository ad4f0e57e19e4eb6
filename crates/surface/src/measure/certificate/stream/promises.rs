//! What is promised of the order of a stream, and the faults of chunks that do not keep to it.

use super::super::surface::{beyond_range, empty, out_of_range};
use super::super::types::{Failure, FailureKind};
use super::chunk::Chunk;
use super::window::{Window, are_above};
use rayon::prelude::*;

/// What has come, and faults.
#[derive(Default)]
pub(super) struct Promises {
    vertices: u32,
    pub(super) triangles: u64,
    /// Chunks and triangles out of order, and what is wrong with the first.
    disorder: u64,
    first: String,
    /// Triangles that name vertices that have not come.
    missing: u64,
    /// Vertices beyond the range of the predicates, and the first of them.
    beyond: u64,
    first_beyond: u64,
}

impl Promises {
    /// Checks a chunk that comes after those in the window; whether it and all before are sound.
    pub(super) fn check(&mut self, chunk: &Chunk<'_>, window: &Window) -> bool {
        let first = self.vertices;
        if chunk.first_vertex != first {
            self.out_of_order(|| format!("vertex {first} is numbered {}", chunk.first_vertex));
        }
        let (beyond, at) = beyond_range(chunk.positions);
        if self.beyond == 0 {
            self.first_beyond = u64::from(first) + at as u64;
        }
        self.beyond += beyond;
        match u32::try_from(u64::from(first) + chunk.positions.len() as u64) {
            Ok(vertices) => self.vertices = vertices,
            Err(_) => self.out_of_order(|| "there are too many vertices".to_owned()),
        }
        let triangles = self.triangles;
        self.triangles += chunk.count() as u64;
        if self.triangles > u64::from(u32::MAX) {
            self.out_of_order(|| "there are too many triangles".to_owned());
        }
        let z = |v: u32| match v.checked_sub(first) {
            Some(new) => chunk.positions[new as usize][2],
            None => window.z(v),
        };
        let (retired, low) = window.retired();
        let vertices = self.vertices;
        // After a fault the window is empty, and heights are unknown. Mostly no vertex is so low that triangles need be looked at.
        let may_be_below = self.is_sound() && !(window.is_above(low) && are_above(chunk.positions, low));
        let fault = |t: &[u32; 3]| {
            if t.iter().any(|&v| v >= vertices) {
                Some(Fault::Missing)
            } else if t.iter().any(|&v| v < retired) {
                Some(Fault::Retired)
            } else if may_be_below && t.iter().any(|&v| z(v) < low) {
                Some(Fault::Below)
            } else {
                None
            }
        };
        if chunk.triangles.iter().any(|of| of.par_iter().with_min_len(1 << 14).any(|t| fault(t).is_some())) {
            for (number, t) in (triangles..).zip(chunk.triangles.iter().copied().flatten()) {
                match fault(t) {
                    None => {}
                    Some(Fault::Missing) => self.missing += 1,
                    Some(Fault::Retired) => {
                        self.out_of_order(|| {
                            format!("triangle {number} {t:?} names a vertex below {retired}, all retired")
                        });
                    }
                    Some(Fault::Below) => {
                        self.out_of_order(|| {
                            format!("triangle {number} has a corner below z = {low}, promised as the least")
                        });
                    }
                }
            }
        }
        self.is_sound()
    }

    fn out_of_order(&mut self, what: impl FnOnce() -> String) {
        if self.disorder == 0 {
            self.first = what();
        }
        self.disorder += 1;
    }

    fn is_sound(&self) -> bool {
        self.disorder + self.missing + self.beyond == 0
    }

    /// What makes the stream no surface.
    pub(super) fn failure(&self) -> Option<Failure> {
        let failure = |kind, count, detail| Some(Failure { kind, count, detail, places: Vec::new() });
        if self.triangles == 0 {
            Some(empty())
        } else if self.disorder > 0 {
            let detail =
                format!("{} parts of the surface do not come as promised, the first: {}", self.disorder, self.first);
            failure(FailureKind::Order, self.disorder, detail)
        } else if self.missing > 0 {
            let detail = format!("{} triangles name vertices that have not come", self.missing);
            failure(FailureKind::Indices, self.missing, detail)
        } else if self.beyond > 0 {
            Some(out_of_range(self.beyond, self.first_beyond))
        } else {
            None
        }
    }
}

#[derive(Clone, Copy)]
enum Fault {
    Missing,
    Retired,
    Below,
}
