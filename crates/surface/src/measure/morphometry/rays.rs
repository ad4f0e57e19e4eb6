//! Tissue thickness and lumen gap: distances along the normals of the boundary of the lumen to the
//! first wall.
//!
//! Rays start at equal distances along the boundary, and normals are perpendicular to chords. The
//! distributions therefore do not depend on how a contour is divided.

use super::disc::Chord;
use super::shape::{Shape, edges};
use super::spread::Spread;
use super::walls::Walls;
use crate::geometry::predicates::widen2;
use crate::geometry::vector::{distance, dot};

type P2 = [f64; 2];

/// Minimum number of rays of a section, because the tails of distributions need them, and maximum
/// number, for images of any scale.
const RAYS: [f64; 2] = [4096.0, 1_048_576.0];
/// Distance along the boundary, on both sides, of the ends of the chord that defines the normal,
/// µm. The direction of a single edge depends on the sampling of the contour, and a few degrees
/// decide which wall is hit.
const REACH_UM: f64 = 15.0;
/// Gap below which two walls touch in a histological section, µm; chosen.
const TOUCHING_UM: f32 = 10.0;
/// Minimum cosine between a chord and the edge in its middle. At a sharper corner the edge defines
/// the normal.
const LEAST_COSINE: f64 = 0.2;

/// Distances from points along the boundary of the lumen, along its normals.
pub(super) struct Distances {
    /// Distances through the tissue.
    pub(super) thickness: Option<Spread>,
    /// Distances through the lumen.
    pub(super) gap: Option<Spread>,
    /// Share of the rays through the lumen that are shorter than [`TOUCHING_UM`].
    pub(super) touching: Option<f64>,
    /// Rays through the lumen, if they were asked for.
    pub(super) chords: Vec<Chord>,
}

/// Distances of a section. The starts of rays are at most `spacing_um` apart. `with_chords` also
/// keeps each ray through the lumen.
pub(super) fn distances(shape: &Shape<'_>, spacing_um: f64, with_chords: bool) -> Distances {
    pulp::Arch::new().dispatch(Rays { shape, spacing_um, with_chords })
}

/// Compiled for the widest vectors of the processor. No operation is reordered or fused, so results
/// are the same on all processors.
struct Rays<'a, 'b> {
    shape: &'a Shape<'b>,
    spacing_um: f64,
    with_chords: bool,
}

impl pulp::WithSimd for Rays<'_, '_> {
    type Output = Distances;

    #[inline(always)]
    fn with_simd<S: pulp::Simd>(self, _: S) -> Distances {
        let Self { shape, spacing_um, with_chords } = self;
        let mut chords = Vec::new();
        let perimeter = shape.perimeter();
        let count = (perimeter / spacing_um).clamp(RAYS[0], RAYS[1]).ceil();
        let spacing = perimeter / count;
        let (mut thickness, mut gap) = (Vec::with_capacity(count as usize + 1), Vec::with_capacity(count as usize + 1));
        let walls = Walls::new(shape);
        // Distance along the contour to the next start.
        let mut next = 0.5 * spacing;
        for ring in &shape.lumen {
            let length: f64 = edges(ring).map(|(a, b)| distance(a, b)).sum();
            if length.is_nan() || length <= 0.0 {
                continue;
            }
            let reach = REACH_UM.min(length / 8.0);
            let [mut behind, mut here, mut ahead] = [0; 3].map(|_| Walker::new(ring));
            while next < length {
                let from = here.at(next);
                let (chord, _) = direction([behind.at(next + length - reach), ahead.at(next + reach)]);
                let cosine = dot(chord, here.along);
                let [x, y] = (if cosine < LEAST_COSINE { here.along } else { chord }).map(|x| x as f32);
                if let Some(length) = walls.first(from, [-y, x]) {
                    gap.push(length);
                    if with_chords {
                        let half = f64::from(length) / 2.0;
                        let middle = [from[0] - half * f64::from(y), from[1] + half * f64::from(x)];
                        chords.push(Chord { length, middle });
                    }
                }
                thickness.extend(walls.first(from, [y, -x]));
                next += spacing;
            }
            next -= length;
        }
        let near = gap.iter().filter(|gap| **gap < TOUCHING_UM).count();
        let touching = (!gap.is_empty()).then(|| near as f64 / gap.len() as f64);
        Distances { thickness: Spread::of(thickness), gap: Spread::of(gap), touching, chords }
    }
}

/// Point that moves forward along a closed contour.
struct Walker<'a> {
    ring: &'a [[f32; 2]],
    /// Edge: its index, start, unit vector and length.
    edge: usize,
    start: P2,
    along: P2,
    length: f64,
    /// Distance along the contour to the start of the edge.
    passed: f64,
}

impl<'a> Walker<'a> {
    #[inline(always)]
    fn new(ring: &'a [[f32; 2]]) -> Self {
        let mut walker = Self { ring, edge: 0, start: [0.0; 2], along: [0.0; 2], length: 0.0, passed: 0.0 };
        walker.enter(0);
        walker
    }

    #[inline(always)]
    fn enter(&mut self, edge: usize) {
        self.edge = edge % self.ring.len();
        let ends = [self.edge, (self.edge + 1) % self.ring.len()].map(|i| widen2(self.ring[i]));
        self.start = ends[0];
        (self.along, self.length) = direction(ends);
    }

    /// Point at a distance along the contour. The distance must not decrease between calls.
    #[inline(always)]
    fn at(&mut self, along: f64) -> P2 {
        while along > self.passed + self.length {
            self.passed += self.length;
            self.enter(self.edge + 1);
        }
        let rest = along - self.passed;
        [self.start[0] + rest * self.along[0], self.start[1] + rest * self.along[1]]
    }
}

/// Unit vector from one point to another (zero if they are equal), and their distance.
#[inline(always)]
fn direction([a, b]: [P2; 2]) -> (P2, f64) {
    let length = distance(a, b);
    let unit = if length > 0.0 { [(b[0] - a[0]) / length, (b[1] - a[1]) / length] } else { [0.0; 2] };
    (unit, length)
}
