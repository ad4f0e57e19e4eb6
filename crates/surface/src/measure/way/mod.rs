//! The way through the lumen of a surface: a polyline that touches nothing, with its clearance.
//!
//! Some rows of the loft have *gates*: straight lines across the lumen between two vertices of the
//! mucosa. A gate continues from row to row between the same two columns, also where the surface
//! leans or is bent. The search goes from the middle of a gate to that of a neighbour, or up the
//! tube along a gate. The way is then moved to the middle of the lumen and straightened. Gates only
//! propose: exact distances from the surface decide which lines are free.

mod clearance;
mod gates;
mod point;
mod search;
mod smooth;

pub use point::Bend;

use crate::geometry::cut::Body;
use crate::geometry::polygon::{Containment, locate_wide};
use crate::model::{Cut, Plane, WallRows};
use clearance::Walls;
use point::{P3, length, minus};
use rayon::prelude::*;
use search::Lumen;

/// Distance of the ends of a way from the ends of the tube, µm.
const FROM_ENDS_UM: f64 = 2.0;
/// Accuracy of places, µm, and the number of steps to reach it.
const PLACE_ACCURACY_UM: f64 = 1e-3;
const PLACE_STEPS: usize = 100;

/// A way from the isthmus end to the ampulla end.
#[derive(Clone, Debug, PartialEq)]
pub struct Way {
    /// Points, in order.
    pub points: Vec<WayPoint>,
    /// Distance that every point of the polyline keeps from the surface, µm.
    pub clearance_um: f64,
}

/// A point of a way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WayPoint {
    /// Place along the tube, or along its centre line if it is bent, µm.
    pub place_um: f64,
    /// Position in the model, µm.
    pub position_um: [f64; 3],
    /// Direction of the way, a unit vector.
    pub tangent: [f64; 3],
    /// Distance from the surface, µm.
    pub clearance_um: f64,
}

impl Way {
    /// Length of the polyline, µm.
    #[must_use]
    pub fn length_um(&self) -> f64 {
        self.points.windows(2).map(|pair| length(minus(pair[1].position_um, pair[0].position_um))).sum()
    }
}

/// No way was found.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("no way through the lumen was found beyond {place_um:.1} µm along the tube")]
pub struct NoWay {
    /// Place up to which ways lead, µm.
    pub place_um: f64,
}

/// A surface, and the loft that it was made from.
pub struct Source<'a> {
    /// The surface that the way must not touch.
    pub body: &'a Body<'a>,
    /// Rows of the inner wall of the loft.
    pub rows: &'a WallRows,
    /// Vertices of the loft: of the straight tube before it leans, m.
    pub straight: &'a [[f32; 3]],
    /// The same vertices after it leans, µm.
    pub positions_um: &'a [[f64; 3]],
    /// How the tube is bent after that; `None` if it is straight.
    pub bend: Option<Bend<'a>>,
    /// Places of the ends of the tube, µm.
    pub ends_um: [f64; 2],
    /// Plane across the tube at a place between its ends, µm.
    pub plane_at: &'a (dyn Fn(f64) -> Option<Plane> + Sync),
}

impl Source<'_> {
    /// Finds a way, and certifies that it lies in the lumen.
    ///
    /// # Errors
    /// Returns [`NoWay`] if the search finds no way.
    pub fn way(&self) -> Result<Way, NoWay> {
        let walls = Walls::new(self.body);
        let lumen =
            Lumen { rows: self.rows, straight: self.straight, positions_um: self.positions_um, bend: self.bend };
        let found = search::points(&lumen, &walls).map_err(|row| NoWay { place_um: self.place_of_row(row) })?;
        let mut positions = smooth::smooth(&found, &walls);
        move_inside(&mut positions);
        let places = self.ascending(&mut positions, &walls).ok_or_else(|| NoWay { place_um: self.place_of_row(0) })?;
        let lines = positions.par_windows(2).map(|pair| walls.certified(pair[0], pair[1]));
        let clearances: Vec<f64> = lines.collect();
        let point = |(k, (&position_um, &place_um)): (usize, (&P3, &f64))| {
            let ahead = minus(positions[(k + 1).min(positions.len() - 1)], positions[k.saturating_sub(1)]);
            let scale = 1.0 / length(ahead);
            let clearance_um = walls.distance(position_um, &mut None);
            WayPoint { place_um, position_um, tangent: ahead.map(|x| x * scale), clearance_um }
        };
        let points: Vec<WayPoint> = positions.iter().zip(&places).enumerate().map(point).collect();
        if let Some(k) = clearances.iter().position(|&clearance| clearance == 0.0) {
            return Err(NoWay { place_um: points[k].place_um });
        }
        // Lines that touch nothing stay in the lumen if the first one begins there.
        let is_inside = (self.plane_at)(points[0].place_um)
            .is_some_and(|plane| is_in_lumen(&self.body.cut(&plane), plane.coordinates(positions[0])));
        if !is_inside {
            return Err(NoWay { place_um: points[0].place_um });
        }
        Ok(Way { points, clearance_um: clearances.into_iter().fold(f64::INFINITY, f64::min) })
    }

    fn place_of_row(&self, row: usize) -> f64 {
        1e6 * f64::from(self.straight[self.rows.row(row).vertices[0] as usize][2])
    }

    /// Places of points. Leaves out points that are not ahead of the one before, where the way
    /// without them is as wide.
    fn ascending(&self, positions: &mut Vec<P3>, walls: &Walls<'_>) -> Option<Vec<f64>> {
        let (mut places, mut kept): (Vec<f64>, Vec<P3>) = (Vec::new(), Vec::new());
        for (k, &here) in positions.iter().enumerate() {
            let place = self.place(here, places.last().copied().unwrap_or(self.ends_um[0]))?;
            let goes_back = places.last().is_some_and(|&last| place <= last);
            let last = kept.last().copied().unwrap_or(here);
            let is_bridged = |&next: &P3| {
                let around = || walls.certified(last, here).min(walls.certified(here, next));
                goes_back && walls.certified(last, next) >= around()
            };
            if !positions.get(k + 1).is_some_and(is_bridged) {
                places.push(place);
                kept.push(here);
            }
        }
        *positions = kept;
        Some(places)
    }

    /// Place of the plane across the tube through a point, looked for near another place.
    fn place(&self, point: P3, near_um: f64) -> Option<f64> {
        let mut place = near_um;
        for _ in 0..PLACE_STEPS {
            let plane = (self.plane_at)(place)?;
            let ahead = plane.height_of(point) - plane.height_um();
            if ahead.abs() < PLACE_ACCURACY_UM {
                return Some(place);
            }
            place = (place + ahead).clamp(self.ends_um[0], self.ends_um[1]);
        }
        None
    }
}

/// Moves the first and the last point from the planes of the ends into the tube.
fn move_inside(positions: &mut [P3]) {
    let last = positions.len() - 1;
    for (end, next) in [(0, 1), (last, last - 1)] {
        let along = minus(positions[next], positions[end]);
        let by = (FROM_ENDS_UM / length(along)).min(0.5);
        positions[end] = [0, 1, 2].map(|k| positions[end][k] + by * along[k]);
    }
}

/// True if an odd number of the rings within the tissue surrounds a point.
fn is_in_lumen(cut: &Cut, uv: [f64; 2]) -> bool {
    let within = cut.rings.iter().filter(|ring| ring.parent.is_some());
    within.filter(|ring| locate_wide(&ring.points, uv) == Containment::Inside).count() % 2 == 1
}
