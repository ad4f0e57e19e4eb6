//! The tissue of each pixel of a grid, and the position of the pixel within its layer.

use super::contour::Edge;
use super::fill::inside;
use super::wall::Wall;
use super::{Contour, Grid, Layers, Tissue};
use crate::geometry::vector::distance;
use crate::model::Border;
use std::ops::Range;

/// Rows of a band.
const BAND: u32 = 32;
/// Columns and rows of a tile. The pixels of a tile share one search for the nearest edges of the
/// outer wall.
const TILE: u32 = 8;
/// Nodes per side of the grid of distances for pictures and label images, and for areas.
const FINE: f64 = 320.0;
const COARSE: f64 = 160.0;

/// A pixel: its tissue, and its position within the layer. Lengths in µm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// Tissue at the centre of the pixel.
    pub tissue: Tissue,
    /// Distance of the centre from the inner wall; infinite beyond [`TissueMap::reach_um`].
    pub lumen_um: f32,
    /// Arc length of the nearest point of the inner wall; 0 beyond the reach.
    pub along_um: f32,
    /// Distance from the outer wall. 0 in epithelium and outside tissue.
    pub depth_um: f32,
    /// Arc length of the nearest point of the outer wall. 0 in epithelium and outside tissue.
    pub around_um: f32,
    /// Distance from the border of the vessel that contains the centre. 0 unless the tissue is
    /// vessel.
    pub within_um: f32,
}

const OUTSIDE: Place = Place {
    tissue: Tissue::Outside,
    lumen_um: f32::INFINITY,
    along_um: 0.0,
    depth_um: 0.0,
    around_um: 0.0,
    within_um: 0.0,
};

/// The layers of one section.
#[derive(Clone, Debug)]
pub struct TissueMap {
    lumen: Contour,
    wall: Wall,
    /// Edges in the planes of the caps that close the lumen, and the whole section.
    closing: [Vec<Edge>; 2],
    layers: Layers,
}

impl TissueMap {
    /// Computes the layers between the borders of the inner wall (`mucosa`) and the outer wall
    /// (`outside`).
    #[must_use]
    pub fn new(mucosa: &Border, outside: &Border, layers: &Layers) -> Self {
        Self::with_nodes(mucosa, outside, layers, FINE)
    }

    /// Computes the layers with a quarter of the nodes, which suffices for areas and thicknesses.
    #[must_use]
    pub fn coarse(mucosa: &Border, outside: &Border, layers: &Layers) -> Self {
        Self::with_nodes(mucosa, outside, layers, COARSE)
    }

    fn with_nodes(mucosa: &Border, outside: &Border, layers: &Layers, side: f64) -> Self {
        let lumen = Contour::new(mucosa);
        let closing = [mucosa, outside].map(closing_edges);
        let wall = Wall::new(Contour::new(outside), &lumen, &closing[0], layers, side);
        Self { closing, lumen, wall, layers: *layers }
    }

    /// Border of the inner wall.
    #[must_use]
    pub fn lumen(&self) -> &Contour {
        &self.lumen
    }

    /// Border of the outer wall.
    #[must_use]
    pub fn outside(&self) -> &Contour {
        &self.wall.outside
    }

    /// Heights of the layers.
    #[must_use]
    pub fn layers(&self) -> &Layers {
        &self.layers
    }

    /// Distance from a point of the mucosa to the muscle beyond it, along a unit vector out of the
    /// lumen, µm. 0 at most if there is no mucosa in between.
    #[must_use]
    pub fn muscle_beyond_um(&self, p: [f64; 2], out: [f64; 2]) -> f64 {
        self.wall.muscle_beyond(p, out)
    }

    /// Maximum distance from the inner wall at which [`Place::lumen_um`] is finite.
    #[must_use]
    pub fn reach_um(&self, grid: &Grid) -> f64 {
        self.layers.epithelium_um.max(1.5 * grid.um_per_pixel)
    }

    /// [`Tissue`] values of all pixels, row by row.
    #[must_use]
    pub fn labels(&self, grid: &Grid) -> Vec<u8> {
        let mut labels = Vec::with_capacity(grid.width as usize * grid.height as usize);
        for band in bands(grid) {
            labels.extend(self.band(grid, band).iter().map(|place| place.tissue as u8));
        }
        labels
    }

    /// Pixels of some rows, row by row. The division into bands does not affect the pixels.
    #[must_use]
    pub fn band(&self, grid: &Grid, rows: Range<u32>) -> Vec<Place> {
        let mut band = Band::new(grid, rows);
        let [lumen_closing, outside_closing] = &self.closing;
        band.fill(self.wall.outside.edges.iter().chain(outside_closing), Tissue::LaminaPropria);
        band.fill(self.lumen.edges.iter().chain(lumen_closing), Tissue::Lumen);
        band.measure_lumen_distance(&self.lumen.edges, self.reach_um(grid));
        band.assign_wall_layers(&self.wall, self.layers.epithelium_um as f32);
        band.places
    }
}

fn closing_edges(border: &Border) -> Vec<Edge> {
    let finite = |edge: &&[[f32; 2]; 2]| edge.as_flattened().iter().all(|c| c.is_finite());
    let edge = |[from, to]: &[[f32; 2]; 2]| Edge::new(from.map(f64::from), to.map(f64::from), 0.0);
    border.closing.iter().filter(finite).map(edge).collect()
}

/// Bands of rows that cover a grid, for parallel work.
pub fn bands(grid: &Grid) -> impl Iterator<Item = Range<u32>> + use<> {
    spans(0..grid.height, BAND)
}

/// Divides a range into parts of a length; the last one may be shorter.
fn spans(all: Range<u32>, length: u32) -> impl Iterator<Item = Range<u32>> {
    all.clone().step_by(length as usize).map(move |start| start..(start + length).min(all.end))
}

/// A band of rows under construction.
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

    /// y of the centres of the last and the first row.
    fn y_range(&self) -> [f64; 2] {
        [self.grid.y(self.rows.end.max(1) - 1), self.grid.y(self.rows.start)]
    }

    /// Assigns `tissue` to the pixels inside closed edges.
    fn fill<'e>(&mut self, edges: impl Iterator<Item = &'e Edge>, tissue: Tissue) {
        let width = self.grid.width as usize;
        let places = &mut self.places;
        inside(self.grid, self.rows.clone(), edges, |row, columns| {
            places[row * width..][columns].iter_mut().for_each(|place| place.tissue = tissue);
        });
    }

    /// Sets the distance from the inner wall of all pixels within `reach`.
    fn measure_lumen_distance(&mut self, edges: &[Edge], reach: f64) {
        let [low, high] = self.y_range();
        let width = self.grid.width as usize;
        let first = self.rows.start as usize;
        // Distances stay squared until all edges are compared.
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
                    // Of equally near edges, the first wins.
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

    /// Divides the tissue between the walls into layers.
    fn assign_wall_layers(&mut self, wall: &Wall, epithelium_um: f32) {
        let (grid, width) = (self.grid, self.grid.width as usize);
        let mut near = Vec::new();
        for rows in spans(self.rows.clone(), TILE) {
            for columns in spans(0..grid.width, TILE) {
                let ends = |range: &Range<u32>| [range.start, range.end - 1];
                let ([x0, x1], [y0, y1]) = (ends(&columns).map(|k| grid.x(k)), ends(&rows).map(|k| grid.y(k)));
                let mut searched = false;
                for (row, column) in rows.clone().flat_map(|row| columns.clone().map(move |column| (row, column))) {
                    let place = &mut self.places[(row - self.rows.start) as usize * width + column as usize];
                    if place.tissue != Tissue::LaminaPropria {
                        continue;
                    }
                    if place.lumen_um <= epithelium_um {
                        place.tissue = Tissue::Epithelium;
                        continue;
                    }
                    if !searched {
                        let middle = [(x0 + x1) / 2.0, (y0 + y1) / 2.0];
                        wall.outside.near(middle, distance([x0, y0], middle), &mut near);
                        searched = true;
                    }
                    let p = [grid.x(column), grid.y(row)];
                    let (square, around) = nearest(&near, p);
                    let depth = square.sqrt();
                    (place.depth_um, place.around_um) = (depth as f32, around as f32);
                    let (tissue, within) = wall.tissue(p, depth);
                    (place.tissue, place.within_um) = (tissue, within as f32);
                }
            }
        }
    }
}

/// Squared distance of a point from the nearest edge, and the arc length of the nearest point.
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
