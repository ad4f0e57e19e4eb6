//! The inner border of the muscle, as a signed distance on a grid of its own.
//!
//! Muscle fills every place of the wall that a disc can cover without coming nearer to the lumen
//! than epithelium and lamina propria. The disc's radius is `opening_um`, and its centre can move
//! there from outside the tube. The centres form the set *E*: all points that are at least
//! epithelium + lamina propria + radius away from the lumen and connected to the outside. A point
//! is then muscle if its distance from E is at most the radius.

use super::contour::Edge;
use super::fill::inside;
use super::{Contour, Grid, Layers};

/// Maximum number of nodes along the longer side.
const MAX_SIDE: f64 = 8192.0;

/// Signed distance from the set E, positive inside it, µm.
#[derive(Clone, Debug)]
pub(super) struct Field {
    grid: Grid,
    values: Vec<f64>,
}

impl Field {
    /// Computes the field of a section. `lumen` are closed edges around the lumen; those of `wall`
    /// are the mucosa, from which distances are measured. A square grid has `side` nodes per side;
    /// others have about as many nodes.
    pub(super) fn new<'e>(
        mucosa: &Contour,
        lumen: impl Iterator<Item = &'e Edge>,
        outside: &Contour,
        layers: &Layers,
        side: f64,
    ) -> Self {
        let reach = layers.mucosa_um() + layers.opening_um;
        let grid = grid(outside, reach, side);
        let (width, height) = (grid.width as usize, grid.height as usize);
        let mut open = vec![false; width * height];
        inside(&grid, 0..grid.height, lumen, |row, columns| {
            open[row * width..][columns].iter_mut().for_each(|node| *node = true);
        });
        let limit = reach + 2.0 * grid.um_per_pixel;
        let depth: Vec<f64> = distances(&grid, &mucosa.edges, &open, limit)
            .into_iter()
            .zip(&open)
            .map(|(distance, open)| if *open { -reach.max(1.0) } else { distance.min(limit) - reach })
            .collect();
        let centres = connected(&depth, width, height);
        let border = border(&grid, &depth, &centres);
        let mut values = distances(&grid, &border, &open, f64::INFINITY);
        for ((value, centre), open) in values.iter_mut().zip(&centres).zip(&open) {
            if *open {
                *value = -reach;
            } else if !centre {
                *value = -*value;
            }
        }
        Self { grid, values }
    }

    /// Distance between neighbouring nodes, µm.
    pub(super) fn side_um(&self) -> f64 {
        self.grid.um_per_pixel
    }

    /// Value at a point, interpolated between nodes; that of the nearest node outside the grid.
    pub(super) fn at(&self, p: [f64; 2]) -> f64 {
        let grid = &self.grid;
        let side = grid.um_per_pixel;
        let u = ((p[0] - grid.x(0)) / side).clamp(0.0, f64::from(grid.width - 1));
        let v = ((grid.y(0) - p[1]) / side).clamp(0.0, f64::from(grid.height - 1));
        let (width, i, j) = (grid.width as usize, u as usize, v as usize);
        let (s, t) = (u - i as f64, v - j as f64);
        let right = usize::from(i + 1 < width);
        let below = if j + 1 < grid.height as usize { width } else { 0 };
        let first = j * width + i;
        let mix = |a: f64, b: f64, t: f64| if t > 0.0 { a + (b - a) * t } else { a };
        let upper = mix(self.values[first], self.values[first + right], s);
        let lower = mix(self.values[first + below], self.values[first + below + right], s);
        let value = mix(upper, lower, t);
        if value.is_nan() { f64::NEG_INFINITY } else { value }
    }
}

/// Grid over a section, with room for the disc outside it.
fn grid(outside: &Contour, reach: f64, side: f64) -> Grid {
    let mut range = [[f64::INFINITY, f64::NEG_INFINITY]; 2];
    for p in outside.edges.iter().flat_map(|edge| [edge.from, edge.to]) {
        for axis in 0..2 {
            range[axis] = [range[axis][0].min(p[axis]), range[axis][1].max(p[axis])];
        }
    }
    let extent = range.map(|[least, most]| (most - least).max(0.0));
    let longer = extent[0].max(extent[1]);
    if !(longer.is_finite() && longer > 0.0) {
        return Grid { width: 1, height: 1, um_per_pixel: 1.0, left_um: 0.0, top_um: 0.0 };
    }
    let margin = reach.min(longer);
    // A section with almost no extent in one direction is mostly margin.
    let shorter = extent[0].min(extent[1]).max(margin);
    let um_per_pixel = ((longer * shorter).sqrt() / side).max(longer / MAX_SIDE);
    let margin = margin + 3.0 * um_per_pixel;
    let count = |axis: usize| ((extent[axis] + 2.0 * margin) / um_per_pixel).ceil().max(1.0) as u32;
    Grid {
        width: count(0),
        height: count(1),
        um_per_pixel,
        left_um: range[0][0] - margin,
        top_um: range[1][1] + margin,
    }
}

/// Distance of each node from the nearest edge; infinite at nodes of `open` and beyond `limit`.
/// Nodes near an edge find their nearest point exactly, and pass it on to their neighbours.
fn distances(grid: &Grid, edges: &[Edge], open: &[bool], limit: f64) -> Vec<f64> {
    let (width, height) = (grid.width as usize, grid.height as usize);
    let (near, limit) = (1.5 * grid.um_per_pixel, limit * limit);
    let mut found = vec![(f64::INFINITY, [f64::INFINITY; 2]); width * height];
    let xs: Vec<f64> = (0..grid.width).map(|column| grid.x(column)).collect();
    let ys: Vec<f64> = (0..grid.height).map(|row| grid.y(row)).collect();
    let offer = |node: &mut (f64, [f64; 2]), p: [f64; 2], point: [f64; 2]| {
        let (dx, dy) = (p[0] - point[0], p[1] - point[1]);
        let square = dx * dx + dy * dy;
        if square < node.0 && square <= limit {
            *node = (square, point);
        }
    };
    for edge in edges {
        let range = |axis: usize| {
            let (a, b) = (edge.from[axis], edge.to[axis]);
            (a.min(b) - near, a.max(b) + near)
        };
        let ((x0, x1), (y0, y1)) = (range(0), range(1));
        for row in grid.rows(y0, y1) {
            for column in grid.columns(x0, x1) {
                let (i, p) = (row * width + column, [xs[column], ys[row]]);
                if !open[i] {
                    offer(&mut found[i], p, edge.nearest_point(p));
                }
            }
        }
    }
    let mut blank = vec![(f64::INFINITY, [f64::INFINITY; 2]); width];
    for down in [true, false] {
        let mut before = blank.clone();
        for k in 0..height {
            let row = if down { k } else { height - 1 - k };
            let (nodes, open) = (&mut found[row * width..][..width], &open[row * width..][..width]);
            let y = ys[row];
            for i in (0..width).filter(|&i| !open[i]) {
                let (mut node, p) = (nodes[i], [xs[i], y]);
                let other = &before[i.saturating_sub(1)..(i + 2).min(width)];
                other.iter().for_each(|other| offer(&mut node, p, other.1));
                if i > 0 {
                    offer(&mut node, p, nodes[i - 1].1);
                }
                nodes[i] = node;
            }
            for i in (0..width.saturating_sub(1)).rev().filter(|&i| !open[i]) {
                let next = nodes[i + 1].1;
                offer(&mut nodes[i], [xs[i], y], next);
            }
            blank.copy_from_slice(nodes);
            std::mem::swap(&mut blank, &mut before);
        }
        blank.fill((f64::INFINITY, [f64::INFINITY; 2]));
    }
    found.into_iter().map(|(square, _)| square.sqrt()).collect()
}

/// Nodes with a positive value that are connected to the border of the grid.
fn connected(depth: &[f64], width: usize, height: usize) -> Vec<bool> {
    let mut reached = vec![false; depth.len()];
    let is_rim = |i: &usize| [0, width - 1].contains(&(i % width)) || [0, height - 1].contains(&(i / width));
    let mut next: Vec<usize> = (0..depth.len()).filter(|i| is_rim(i) && depth[*i] >= 0.0).collect();
    next.iter().for_each(|&i| reached[i] = true);
    while let Some(i) = next.pop() {
        let (column, row) = (i % width, i / width);
        for row in row.saturating_sub(1)..(row + 2).min(height) {
            for k in row * width + column.saturating_sub(1)..row * width + (column + 2).min(width) {
                if !reached[k] && depth[k] >= 0.0 {
                    reached[k] = true;
                    next.push(k);
                }
            }
        }
    }
    reached
}

/// Edges at which `depth` changes its sign beside nodes of `centres` (marching squares).
fn border(grid: &Grid, depth: &[f64], centres: &[bool]) -> Vec<Edge> {
    let width = grid.width as usize;
    let mut edges = Vec::new();
    for row in 0..grid.height.saturating_sub(1) {
        for column in 0..grid.width.saturating_sub(1) {
            let corners = [(0, 0), (1, 0), (1, 1), (0, 1)].map(|(x, y)| (column + x, row + y));
            let index = corners.map(|(column, row)| row as usize * width + column as usize);
            if index.iter().all(|&i| centres[i]) || !index.iter().any(|&i| centres[i]) {
                continue;
            }
            let mut crossings = [[0.0; 2]; 4];
            let mut count = 0;
            for k in 0..4 {
                let (a, b) = (k, (k + 1) % 4);
                if centres[index[a]] != centres[index[b]] {
                    let (from, to) = (depth[index[a]], depth[index[b]]);
                    let t = if from == to { 0.5 } else { (from / (from - to)).clamp(0.0, 1.0) };
                    let at = |(column, row): (u32, u32)| [grid.x(column), grid.y(row)];
                    let (p, q) = (at(corners[a]), at(corners[b]));
                    crossings[count] = [p[0] + t * (q[0] - p[0]), p[1] + t * (q[1] - p[1])];
                    count += 1;
                }
            }
            for pair in crossings[..count].chunks_exact(2) {
                edges.push(Edge::new(pair[0], pair[1], 0.0));
            }
        }
    }
    edges
}
