//! A certificate that is made while the surface comes, chunk by chunk along the tube, in memory for a window of it.
//!
//! With each chunk comes a promise: which vertices no later triangle names (they *retire*), and below which z no later
//! triangle lies. It is checked, not trusted. What retires is final: all triangles at a retired vertex are known, so its fan
//! and its edges to greater vertices can be judged, by the same functions that judge a whole surface. A triangle is
//! *settled* once its least vertex has retired, as then all its copies are known; it is searched for meetings with those
//! that settle with it and with earlier ones in the window. A settled triangle leaves the window when all its vertices
//! have retired and it lies below all triangles to come.
//!
//! Findings, places and counts are those of [`super::certify_body`] for the triangles in the order of the stream; sums have an
//! order that depends on the chunks only. Which component lies within which is not examined: a body that has several fails
//! in any case.

mod chunk;
mod parts;
mod promises;
mod window;

use super::collide::{Known, Meetings};
use super::sections::Contours;
use super::shape::{self, Shape};
use super::surface::Tally;
use super::topology::{Copies, Faults, Stars, crowded, fans};
use super::types::{Certificate, Failures, METRE_UM, Place};
use super::{demanded, nesting, of_findings};
use crate::model::{BodyKind, LengthUnit, Section};
use parts::Parts;
use promises::Promises;
use window::Window;

pub use chunk::Chunk;

/// Judges the surface of one body while it comes; see [`Chunk`].
///
/// Time and memory go with the triangles in the window: those of the last chunk, those that have a vertex that is not
/// retired, and those that reach to `retired_z`. Chunks of one slab or several are best.
pub struct StreamCertifier {
    body: BodyKind,
    unit_um: f64,
    contours: Contours,
    promises: Promises,
    window: Window,
    parts: Parts,
    faults: Faults,
    shape: Shape,
    degenerate: Tally,
    /// Those in the window.
    copies: Copies,
    /// The last ones, whose memory the next ones use.
    stars: Stars,
    meetings: Meetings,
    /// Where volumes are measured from: the first corner.
    origin: Option<[f64; 3]>,
    /// Place of the first vertex with triangles.
    first: Option<Place>,
}

impl StreamCertifier {
    /// Begins the surface of a body, whose positions are in `unit`.
    #[must_use]
    pub fn new(body: BodyKind, unit: LengthUnit) -> Self {
        Self {
            body,
            unit_um: unit.metres() * METRE_UM,
            contours: Contours::default(),
            promises: Promises::default(),
            window: Window::default(),
            parts: Parts::default(),
            faults: Faults::default(),
            shape: Shape::new(),
            degenerate: Tally::default(),
            copies: Copies::default(),
            stars: Stars::default(),
            meetings: Meetings::default(),
            origin: None,
            first: None,
        }
    }

    /// Examines the next sections that the surface was made from, which need not be those of the next chunk.
    pub fn examine(&mut self, sections: &[Section]) {
        self.contours.add(sections);
    }

    /// Takes the next chunk. One that is not as promised is a failure, after which chunks are only counted.
    #[inline(never)] // counted by scripts/counts
    pub fn push(&mut self, chunk: &Chunk<'_>) {
        let first_triangle = self.promises.triangles;
        if !self.promises.check(chunk, &self.window) {
            self.window = Window::default();
            return;
        }
        let new = self.window.add(chunk, first_triangle as u32);
        self.measure(new);
        self.retire(chunk.retired_vertices, chunk.retired_z);
    }

    /// The certificate, when all chunks have come.
    #[must_use]
    #[inline(never)] // counted by scripts/counts
    pub fn finish(mut self) -> Certificate {
        let mut failures = Failures::default();
        let contours = std::mem::take(&mut self.contours);
        contours.report(&mut failures);
        let mut certificate = match self.promises.failure() {
            None => self.conclude(failures),
            Some(failure) => {
                failures.0.push(failure);
                Certificate::without_surface(failures)
            }
        };
        certificate.add_sections(contours);
        certificate
    }

    /// The certificate of the surface that has come, with the failures of its sections.
    fn conclude(mut self, mut failures: Failures) -> Certificate {
        self.retire(u32::MAX, f32::INFINITY);
        let totals = self.parts.finish();
        self.faults.report(&mut failures);
        shape::report(&self.degenerate, &mut failures);
        self.meetings.report(&mut failures);
        if self.faults.has_volume() && totals.components == 1 && totals.volume <= 0.0 {
            nesting::report_inverted(1, self.first.into_iter().collect(), &mut failures);
        }
        let found = of_findings(self.unit_um, &self.faults, totals, self.shape, self.degenerate.count, &self.meetings);
        demanded(found.conclude(failures), self.body)
    }

    /// Measures the triangles of the window from number `new` of those that wait on.
    fn measure(&mut self, new: usize) {
        let (surface, turns) = self.window.waiting(new, self.unit_um);
        self.parts.join(surface.positions.len(), surface.triangles);
        if surface.triangles.is_empty() {
            return;
        }
        let origin = *self.origin.get_or_insert_with(|| surface.corners(0)[0]);
        let known = self.shape.degenerate.len();
        self.shape.add(&surface, origin, |t| self.parts.part_of(t[0]), turns);
        self.parts.add_volumes(&mut self.shape.volumes);
        shape::tally(&surface, &self.shape.degenerate[known..], &mut self.degenerate);
    }

    /// Judges what is final when the vertices below `vertices` have retired, and forgets what no later triangle can reach.
    fn retire(&mut self, vertices: u32, z: f32) {
        let retiring = self.window.retire(vertices, z);
        let fresh = self.window.settle();
        let surface = self.window.settled(self.unit_um);
        let stars = Stars::of(std::mem::take(&mut self.stars), &surface, retiring.clone());
        let found = fans(&surface, &stars, self.parts.labels(), self.window.settled_turns());
        self.parts.add_edges(&found);
        for vertex in retiring.filter(|&v| !stars.at(v).is_empty()) {
            self.parts.add_vertex(vertex, self.window.first_vertex() + vertex);
            self.first.get_or_insert_with(|| surface.place_of_vertex(vertex));
        }
        self.faults.add(&surface, &found);
        let copies = Copies::among(&surface, &found);
        self.meetings.add_duplicates(&surface, &self.shape.degenerate, &copies);
        self.copies.add(&copies);
        let crowded = crowded(&found);
        let known =
            Known { degenerate: &self.shape.degenerate, copies: &self.copies, stars: &stars, crowded: &crowded };
        self.meetings.search(&surface, fresh, &known);
        self.stars = stars;
        self.parts.forget(self.window.forget());
        if !(self.copies.is_empty() && self.shape.degenerate.is_empty()) {
            let kept = self.window.numbers();
            let is_kept = |number: u32| kept.binary_search(&number).is_ok();
            self.copies.retain(is_kept);
            self.shape.degenerate.retain(|&number| is_kept(number));
        }
    }
}

#[cfg(test)]
mod tests;
