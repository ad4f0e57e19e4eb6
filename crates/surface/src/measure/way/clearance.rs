//! Exact distances of points and of straight lines from the surface.

use super::point::{P3, length, minus};
use crate::geometry::cut::Body;
use crate::geometry::distance::Triangles;

/// Step along a line, relative to the distance from the surface.
const COARSE_STEP: f64 = 0.5;
const FINE_STEP: f64 = 0.1;
/// Clearance below which a line counts as blocked, µm.
const LEAST_UM: f64 = 0.5;

/// Distance of a point from a surface; see [`Triangles::distance`].
type Distance<'a> = Box<dyn Fn(P3, &mut Option<usize>) -> f64 + Sync + 'a>;

/// The surface that a way must not touch.
pub(super) struct Walls<'a> {
    distance: Distance<'a>,
}

impl<'a> Walls<'a> {
    pub(super) fn new<'b: 'a>(body: &'a Body<'b>) -> Self {
        let triangles: Triangles<_> = body.triangles();
        Self { distance: Box::new(move |point, hint| triangles.distance(point, hint)) }
    }

    /// Distance of a point from the surface, µm. `hint` is as in [`Triangles::distance`].
    pub(super) fn distance(&self, point: P3, hint: &mut Option<usize>) -> f64 {
        (self.distance)(point, hint)
    }

    /// True if no point of a line is closer to the surface than [`LEAST_UM`].
    pub(super) fn is_free(&self, a: P3, b: P3) -> bool {
        self.clearance(a, b, COARSE_STEP) >= LEAST_UM
    }

    /// Lower bound of the clearance of the lines that join three points, µm.
    pub(super) fn around(&self, a: P3, b: P3, c: P3) -> f64 {
        self.clearance(a, b, COARSE_STEP).min(self.clearance(b, c, COARSE_STEP))
    }

    /// Lower bound of the distance of any point of a line from the surface, µm, at most a tenth
    /// below it; 0 if the line is blocked.
    pub(super) fn certified(&self, a: P3, b: P3) -> f64 {
        self.clearance(a, b, FINE_STEP)
    }

    /// Lower bound of the distance of any point of a line. A distance changes at most as much as
    /// the point moves. Between two points, it is therefore at least half of the sum of their
    /// distances without the length between them.
    fn clearance(&self, a: P3, b: P3, relative_step: f64) -> f64 {
        let along = minus(b, a);
        let length = length(along);
        let mut hint = None;
        let mut distance_at = |t: f64| (self.distance)([0, 1, 2].map(|k| a[k] + t * along[k]), &mut hint);
        let (mut gone, mut here) = (0.0, distance_at(0.0));
        let mut least = here;
        while gone < length {
            if least < LEAST_UM {
                return 0.0;
            }
            let step = (relative_step * here).min(length - gone);
            gone += step;
            let next = distance_at(gone / length);
            least = least.min(next).min(0.5 * (here + next - step));
            here = next;
        }
        least
    }
}
