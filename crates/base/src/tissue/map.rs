//! The tissue of each pixel of a grid, and where in its layer the pixel lies.

use super::contour::Edge;
use super::wall::{Wall, WallLayer};
use super::{Contour, Grid, Layers, Tissue};
use crate::model::Border;
use std::ops::Range;

/// Columns of a tile, in which the nearest edges of the outside are searched together.
const TILE: usize = 32;

/// A pixel: its tissue, and its place in the layer. Lengths in µm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// The tissue of its middle.
    pub tissue: Tissue,
    /// Distance of its middle from the surface of the mucosa; infinite beyond [`TissueMap::reach_um`].
    pub lumen_um: f32,
    /// Arc length along the surface of the mucosa of the nearest point; 0 beyond the reach.
    pub along_um: f32,
    /// Distance from the outside of the tube; 0 unless it is serosa, muscle or lamina propria.
    pub depth_um: f32,
    /// Arc length along the outside of the nearest point; 0 unless it is serosa, muscle or lamina propria.
    pub around_um: f32,
}

const OUTSIDE: Place =
    Place { tissue: Tissue::Outside, lumen_um: f32::INFINITY, along_um: 0.0, depth_um: 0.0, around_um: 0.0 };

/// The layers of one section.
#[derive(Clone, Debug)]
pub struct TissueMap {
    lumen: Contour,
    wall: Wall,
    /// Edges in the ends of the tube that close the lumen, and the whole.
    ends: [Vec<Edge>; 2],
    layers: Layers,
}

impl TissueMap {
    /// The layers between the surface of the mucosa and the outside of the wall.
    #[must_use]
    pub fn new(mucosa: &Border, outside: &Border, layers: &Layers) -> Self {
        let lumen = Contour::new(mucosa);
        let wall = Wall::new(Contour::new(outside), &lumen, layers);
        Self { ends: [mucosa, outside].map(ends), lumen, wall, layers: *layers }
    }

    /// The surface of the mucosa.
    #[must_use]
    pub fn lumen(&self) -> &Contour {
        &self.lumen
    }

    /// The outside of the wall.
    #[must_use]
    pub fn outside(&self) -> &Contour {
        &self.wall.outside
    }

    /// The heights of the layers.
    #[must_use]
    pub fn layers(&self) -> &Layers {
        &self.layers
    }

    /// Distance from the surface of the mucosa up to which [`Place::lumen_um`] is known.
    #[must_use]
    pub fn reach_um(&self, grid: &Grid) -> f64 {
        self.layers.epithelium_um.max(1.5 * grid.um_per_pixel)
    }

    /// The values of [`Tissue`] of all pixels, row by row.
    #[must_use]
    pub fn labels(&self, grid: &Grid) -> Vec<u8> {
        let mut labels = Vec::with_capacity(grid.width as usize * grid.height as usize);
        for band in bands(grid) {
            labels.extend(self.band(grid, band).iter().map(|place| place.tissue as u8));
        }
        labels
    }

    /// The pixels of some rows, row by row. Any division into bands gives the same pixels.
    #[must_use]
    pub fn band(&self, grid: &Grid, rows: Range<u32>) -> Vec<Place> {
        let mut band = Band::new(grid, rows);
        let [lumen_ends, outside_ends] = &self.ends;
        band.fill(self.wall.outside.edges.iter().chain(outside_ends), Tissue::LaminaPropria);
        band.fill(self.lumen.edges.iter().chain(lumen_ends), Tissue::Lumen);
        band.measure(&self.lumen.edges, self.reach_um(grid));
        band.divide(&self.wall, self.layers.epithelium_um as f32);
        band.places
    }
}

fn ends(border: &Border) -> Vec<Edge> {
    let finite = |edge: &&[[f32; 2]; 2]| edge.as_flattened().iter().all(|c| c.is_finite());
    let edge = |[from, to]: &[[f32; 2]; 2]| Edge::new(from.map(f64::from), to.map(f64::from), 0.0);
    border.closing.iter().filter(finite).map(edge).collect()
}

/// Bands of rows that cover a grid, for work in parallel.
pub fn bands(grid: &Grid) -> impl Iterator<Item = Range<u32>> + use<> {
    let (step, height) = (TILE as u32, grid.height);
    (0..height.div_ceil(step)).map(move |k| k * step..((k + 1) * step).min(height))
}

/// Some rows of a grid.
struct Band<'a> {
    grid: &'a Grid,
    rows: Range<u32>,
    places: Vec<Place>,
}

impl<'a> Band<'a> {
    fn new(grid: &'a Grid, rows: Range<u32>) -> Self {
        let places = vec![OUTSIDE; rows.len() * grid.width as usize];
        Self { grid, rows, places }
    }

    /// The middles of the first and the last row.
    fn y_range(&self) -> [f64; 2] {
        [self.grid.y(self.rows.end.max(1) - 1), self.grid.y(self.rows.start)]
    }

    /// Gives the pixels that edges enclose a tissue: those that a ray to the left leaves through an odd number of edges.
    fn fill<'e>(&mut self, edges: impl Iterator<Item = &'e Edge>, tissue: Tissue) {
        let [low, high] = self.y_range();
        let (width, first) = (self.grid.width as usize, self.rows.start);
        let mut crossings: Vec<Vec<f64>> = vec![Vec::new(); self.rows.len()];
        for edge in edges {
            let (y0, y1) = (edge.from[1], edge.to[1]);
            let (least, most) = (y0.min(y1), y0.max(y1));
            if most < low || least > high {
                continue;
            }
            for row in self.grid.rows(least, most) {
                let row = row as u32;
                let y = self.grid.y(row);
                if self.rows.contains(&row) && (y0 <= y) != (y1 <= y) {
                    let x = edge.from[0] + (y - y0) / (y1 - y0) * (edge.to[0] - edge.from[0]);
                    crossings[(row - first) as usize].push(x);
                }
            }
        }
        for (xs, row) in crossings.iter_mut().zip(self.places.chunks_mut(width.max(1))) {
            xs.sort_unstable_by(f64::total_cmp);
            for pair in xs.chunks_exact(2) {
                for place in &mut row[self.grid.columns(pair[0], pair[1])] {
                    place.tissue = tissue;
                }
            }
        }
    }

    /// Measures the distance from a line up to `reach`.
    fn measure(&mut self, edges: &[Edge], reach: f64) {
        let [low, high] = self.y_range();
        let width = self.grid.width as usize;
        let first = self.rows.start as usize;
        // Squared while they are compared.
        let limit = reach * reach;
        let mut squares = vec![f64::INFINITY; self.places.len()];
        for edge in edges {
            let range = |axis: usize| {
                let (a, b) = (edge.from[axis], edge.to[axis]);
                [a.min(b) - reach, a.max(b) + reach]
            };
            let [y0, y1] = range(1);
            if y1 < low || y0 > high {
                continue;
            }
            let [x0, x1] = range(0);
            let columns = self.grid.columns(x0, x1);
            for row in self.grid.rows(y0, y1) {
                if !self.rows.contains(&(row as u32)) {
                    continue;
                }
                let y = self.grid.y(row as u32);
                let start = (row - first) * width;
                for column in columns.clone() {
                    let (square, along) = edge.nearest([self.grid.x(column as u32), y]);
                    // Of edges equally near, the first.
                    if square <= limit && square < squares[start + column] {
                        squares[start + column] = square;
                        self.places[start + column].along_um = along as f32;
                    }
                }
            }
        }
        for (place, square) in self.places.iter_mut().zip(squares) {
            place.lumen_um = square.sqrt() as f32;
        }
    }

    /// Divides the tissue into layers.
    fn divide(&mut self, wall: &Wall, epithelium_um: f32) {
        let width = self.grid.width as usize;
        let [low, high] = self.y_range();
        let mut near = Vec::new();
        for tile in (0..width).step_by(TILE) {
            let columns = tile..(tile + TILE).min(width);
            let (x0, x1) = (self.grid.x(tile as u32), self.grid.x(columns.end as u32 - 1));
            let mut searched = false;
            for row in 0..self.rows.len() {
                let y = self.grid.y(self.rows.start + row as u32);
                for column in columns.clone() {
                    let place = &mut self.places[row * width + column];
                    if place.tissue != Tissue::LaminaPropria {
                        continue;
                    }
                    if place.lumen_um <= epithelium_um {
                        place.tissue = Tissue::Epithelium;
                        continue;
                    }
                    if !searched {
                        let middle = [(x0 + x1) / 2.0, (low + high) / 2.0];
                        let (half_x, half_y) = ((x1 - x0) / 2.0, (high - low) / 2.0);
                        wall.outside.near(middle, (half_x * half_x + half_y * half_y).sqrt(), &mut near);
                        searched = true;
                    }
                    let (square, around) = nearest(&near, [self.grid.x(column as u32), y]);
                    let depth = square.sqrt();
                    place.depth_um = depth as f32;
                    place.around_um = around as f32;
                    place.tissue = match wall.layer(depth, around) {
                        WallLayer::Serosa => Tissue::Serosa,
                        WallLayer::Longitudinal => Tissue::LongitudinalMuscle,
                        WallLayer::Circular => Tissue::CircularMuscle,
                        WallLayer::Mucosa => Tissue::LaminaPropria,
                    };
                }
            }
        }
    }
}

/// Squared distance of a point from the nearest of some edges, and the arc length of the nearest point.
fn nearest(edges: &[Edge], p: [f64; 2]) -> (f64, f64) {
    let mut best = (f64::INFINITY, 0.0);
    for edge in edges {
        let found = edge.nearest(p);
        if found.0 < best.0 {
            best = found;
        }
    }
    best
}
