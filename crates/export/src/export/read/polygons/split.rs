//! Splits one face into triangles, in its plane.
//!
//! A fan around the first corner is kept wherever it covers the face. Other faces are triangulated
//! with their edges as constraints. All decisions use exact predicates on the coordinates of the
//! file, of which the axis nearest to the normal is dropped. A face that is not flat is projected
//! on its best plane instead, which rounds.

use crate::geometry::predicates::orient2d;
use crate::geometry::triangulate::{PolygonError, polygon};
use crate::geometry::vector::{cross, dot, norm, sub};

/// Largest distance of a corner from the plane of a flat face, per extent of the face.
const FLAT: f64 = 1e-3;
/// Areas below this fraction of a square over the extent of a face may be due to rounding.
const NO_AREA: f64 = 1e-12;
/// Most corners of a face that is triangulated. The certificate of more thin triangles takes too
/// long. A fan may have more.
const MOST: usize = 30_000;
/// Magnitudes for which orientations are exact. The triangulation takes no smaller ones but zero.
const EXACT: f64 = 1e60;
const TINY: f64 = 1e-42;

/// Splits faces; keeps its memory for the next one.
#[derive(Default)]
pub(super) struct Splitter {
    corners: Vec<u32>,
    points: Vec<[f64; 3]>,
    flat: Vec<[f64; 2]>,
    triangles: Vec<[u32; 3]>,
}

/// Place at which a flat face is unsound.
#[derive(Debug)]
pub(super) struct Fault {
    pub(super) at: [f64; 3],
    /// Predicate of a sentence.
    pub(super) what: &'static str,
}

impl Splitter {
    /// Triangles of a face, and whether it is flat.
    ///
    /// A face without an area, or with a coordinate that is not finite, remains a fan, as does one
    /// that is neither flat nor simple in its best plane.
    ///
    /// # Errors
    /// Returns the place where a flat face crosses or touches itself.
    pub(super) fn split(&mut self, corners: &[u32], positions: &[[f64; 3]]) -> Result<(&[[u32; 3]], bool), Fault> {
        self.load(corners, positions);
        self.triangles.clear();
        let [first, second, rest @ ..] = &self.points[..] else { return Ok((&self.triangles, true)) };
        if rest.iter().all(|p| p == first || p == second) {
            return Ok((&self.triangles, true));
        }
        let mut is_flat = true;
        if self.points.len() > 3
            && let Some(plane) = Plane::of(&self.points)
        {
            is_flat = plane.off(&self.points) <= FLAT * plane.extent;
            self.flat.clear();
            self.flat.extend(self.points.iter().map(|&p| plane.project(p, is_flat).map(without_tiny)));
            let many = self.points.len() > MOST;
            // Triangles of a fan with many corners are small.
            let least = if many { 0.0 } else { NO_AREA * plane.extent * plane.extent };
            // A quadrilateral has one other fan; longer faces are left to the triangulation.
            let fans = if self.points.len() == 4 { 2 } else { 1 };
            if let Some(start) = (0..fans).find(|&start| fan_covers(&self.flat, start, least)) {
                self.fan(start);
                return Ok((&self.triangles, is_flat));
            }
            if many && is_flat {
                let what = "is concave, and at most 30000 corners of a concave face are read; it begins";
                return Err(Fault { at: self.points[0], what });
            }
            match if many { Err(PolygonError::Coordinate) } else { polygon(&self.flat) } {
                Ok(found) => {
                    self.triangles.extend(found.into_iter().map(|t| t.map(|k| self.corners[k as usize])));
                    return Ok((&self.triangles, is_flat));
                }
                Err(error) if is_flat => {
                    if let Some((corner, what)) = fault(error) {
                        return Err(Fault { at: self.points[corner], what });
                    }
                }
                Err(_) => {}
            }
        }
        self.fan(0);
        Ok((&self.triangles, is_flat))
    }

    /// Loads the corners without those at the position of the one before.
    fn load(&mut self, corners: &[u32], positions: &[[f64; 3]]) {
        self.corners.clear();
        self.points.clear();
        for &corner in corners {
            let point = positions[corner as usize];
            if self.points.last() != Some(&point) {
                self.points.push(point);
                self.corners.push(corner);
            }
        }
        while self.points.len() > 1 && self.points.first() == self.points.last() {
            self.points.pop();
            self.corners.pop();
        }
    }

    fn fan(&mut self, start: usize) {
        let corner = |k: usize| self.corners[(start + k) % self.corners.len()];
        self.triangles.extend((2..self.corners.len()).map(|k| [corner(0), corner(k - 1), corner(k)]));
    }
}

/// Corner and predicate for a message about a polygon that could not be triangulated.
fn fault(error: PolygonError) -> Option<(usize, &'static str)> {
    match error {
        PolygonError::Coordinate => None,
        PolygonError::Crossing { corner } => Some((corner, "crosses or touches itself on the edge that begins")),
        PolygonError::Overlap { corner } => Some((corner, "overlaps itself")),
    }
}

fn without_tiny(x: f64) -> f64 {
    if x.abs() < TINY { 0.0 } else { x }
}

/// True if the fan around a corner covers the polygon: all triangles have more than the `least`
/// area, and together they turn less than once around the corner.
fn fan_covers(points: &[[f64; 2]], start: usize, least: f64) -> bool {
    let point = |k: usize| points[(start + k) % points.len()];
    let (centre, second) = (point(0), point(1));
    let mut beyond_half = false;
    (2..points.len()).all(|k| {
        // The directions turn counter-clockwise. Beyond a half turn they must not reach the first
        // one again.
        let side = orient2d(centre, second, point(k));
        let once = side < 0.0 || !beyond_half;
        beyond_half |= side < 0.0;
        once && orient2d(centre, point(k - 1), point(k)) > least
    })
}

/// Best plane of a face.
struct Plane {
    /// Normal of length 1: by Newell's method, unless the face has no area.
    normal: [f64; 3],
    middle: [f64; 3],
    /// Largest extent along an axis.
    extent: f64,
}

impl Plane {
    /// `None` if the corners lie on a line, or have coordinates beyond exact arithmetic.
    fn of(points: &[[f64; 3]]) -> Option<Self> {
        let origin = *points.first()?;
        let (mut low, mut high, mut sum, mut last) = (origin, origin, [0.0; 3], [0.0; 3]);
        // The area of the face, and the largest triangle of its fan.
        let (mut area, mut largest) = ([0.0; 3], [0.0; 3]);
        for &point in points {
            if !point.iter().all(|x| x.abs() < EXACT) {
                return None;
            }
            let next = sub(point, origin);
            let turn = cross(last, next);
            for axis in 0..3 {
                low[axis] = low[axis].min(point[axis]);
                high[axis] = high[axis].max(point[axis]);
                area[axis] += turn[axis];
                sum[axis] += next[axis];
            }
            if dot(turn, turn) > dot(largest, largest) {
                largest = turn;
            }
            last = next;
        }
        let extent = sub(high, low).into_iter().fold(0.0, f64::max);
        let middle = [0, 1, 2].map(|axis| origin[axis] + sum[axis] / points.len() as f64);
        // The parts of a face that crosses itself may cancel.
        let normal = [area, largest].into_iter().find(|&normal| norm(normal) > NO_AREA * extent * extent)?;
        let length = norm(normal);
        Some(Self { normal: normal.map(|x| x / length), middle, extent })
    }

    /// Largest distance of a point from the plane.
    fn off(&self, points: &[[f64; 3]]) -> f64 {
        points.iter().map(|&p| dot(self.normal, sub(p, self.middle)).abs()).fold(0.0, f64::max)
    }

    /// Coordinates in which the face is counter-clockwise: those of the file if `exact`, else those
    /// in the plane.
    fn project(&self, p: [f64; 3], exact: bool) -> [f64; 2] {
        let size = self.normal.map(f64::abs);
        let axis = (1..3).fold(0, |axis, k| if size[k] > size[axis] { k } else { axis });
        let (u, v) = ((axis + 1) % 3, (axis + 2) % 3);
        if exact {
            return if self.normal[axis] > 0.0 { [p[u], p[v]] } else { [p[v], p[u]] };
        }
        let mut along = [0.0; 3];
        along[u] = 1.0;
        let first = cross(along, self.normal);
        let relative = sub(p, self.middle);
        [dot(first, relative), dot(cross(self.normal, first), relative)]
    }
}
