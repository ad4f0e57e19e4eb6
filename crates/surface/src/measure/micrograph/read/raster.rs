//! Paints polygons as pixels: a pixel is inside if its centre is within an odd number of the rings
//! of a polygon.

use super::super::error::MicrographError;

/// Place in pixels of the image, y down.
pub(super) type Point = [f64; 2];

/// A polygon: its rings, of which all but the first are holes.
pub(super) type Polygon = Vec<Vec<Point>>;

/// Maximum number of places where rows cross edges. It bounds time and memory.
const MOST_CROSSINGS: usize = 8 << 20;
/// Number of values along the longer side of polygons that do not follow the sides of pixels.
const FINE: f64 = 4096.0;

/// Values around all polygons.
pub(super) struct Raster {
    pub(super) width: usize,
    pub(super) values: Vec<u16>,
    /// Side of a value, in pixels of the image.
    pub(super) step: f64,
    /// Place of the upper left corner.
    origin: Point,
    /// Crossings that may still be found.
    room: usize,
}

impl Raster {
    /// Values of 0 around the polygons, with a margin, at most `side` a side.
    pub(super) fn around<'a>(polygons: impl Iterator<Item = &'a Polygon> + Clone, side: u32) -> Self {
        let points = polygons.clone().flatten().flatten();
        let fold = |start: f64, pick: fn(f64, f64) -> f64, axis: usize| {
            points.clone().map(|point| point[axis]).fold(start, pick)
        };
        let least = [0, 1].map(|axis| fold(f64::MAX, f64::min, axis));
        let most = [0, 1].map(|axis| fold(f64::MIN, f64::max, axis));
        let longer = (most[0] - least[0]).max(most[1] - least[1]).max(1e-6);
        let room = f64::from(side.saturating_sub(4).max(1));
        let step = match grid(polygons, least) {
            // A contour that follows the sides of pixels is smoothed only if a value is a pixel.
            Some(pitch) => pitch * (longer / pitch / room).ceil().max(1.0),
            None => longer / room.min(FINE),
        };
        let counts = [0, 1].map(|axis| ((most[axis] - least[axis]) / step).ceil() as usize + 4);
        let origin = least.map(|place| place - 2.0 * step);
        Self { width: counts[0], values: vec![0; counts[0] * counts[1]], step, origin, room: MOST_CROSSINGS }
    }

    /// Gives a value to all pixels within a polygon.
    pub(super) fn paint(&mut self, polygon: &Polygon, value: u16) -> Result<(), MicrographError> {
        let height = self.values.len() / self.width;
        // Row and place of each crossing.
        let mut crossings: Vec<(u32, f64)> = Vec::new();
        for ring in polygon {
            let next = ring.iter().cycle().skip(1);
            for (a, b) in ring.iter().zip(next) {
                let [a, b] = [a, b].map(|p| [0, 1].map(|axis| (p[axis] - self.origin[axis]) / self.step));
                let (low, high) = if a[1] < b[1] { (a, b) } else { (b, a) };
                // Rows whose centres are in the half-open range of the edge.
                let rows =
                    (low[1] - 0.5).ceil().max(0.0) as usize..((high[1] - 0.5).ceil().max(0.0) as usize).min(height);
                self.room = self.room.checked_sub(rows.len()).ok_or(MicrographError::Rough)?;
                crossings.extend(rows.map(|row| {
                    let y = row as f64 + 0.5;
                    (row as u32, low[0] + (y - low[1]) / (high[1] - low[1]) * (high[0] - low[0]))
                }));
            }
        }
        crossings.sort_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
        for pair in crossings.chunks_exact(2) {
            let row = &mut self.values[pair[0].0 as usize * self.width..][..self.width];
            let [from, to] = [pair[0].1, pair[1].1].map(|x| ((x - 0.5).ceil().max(0.0) as usize).min(self.width));
            row[from..to.max(from)].fill(value);
        }
        Ok(())
    }
}

/// Distance of the lines on which all edges lie, if all edges are parallel to an axis.
fn grid<'a>(polygons: impl Iterator<Item = &'a Polygon>, least: Point) -> Option<f64> {
    let mut pitch = 0_u64;
    for ring in polygons.flatten() {
        for (a, b) in ring.iter().zip(ring.iter().cycle().skip(1)) {
            if a[0] != b[0] && a[1] != b[1] {
                return None;
            }
        }
        for place in ring.iter().flat_map(|point| [point[0] - least[0], point[1] - least[1]]) {
            if place.fract() != 0.0 {
                return None;
            }
            let (mut a, mut b) = (pitch, place as u64);
            while b > 0 {
                (a, b) = (b, a % b);
            }
            pitch = a;
        }
    }
    (pitch > 0).then_some(pitch as f64)
}
