//! Distances along the normals of the lumen's boundary to the first wall met: tissue thickness and lumen gap. Each point counts by the
//! length of boundary next to it, so that the distributions do not depend on how the points are spread.

use super::shape::{Shape, distance};
use super::spread::Spread;

type P2 = [f64; 2];

/// From every point of the boundary of the lumen along its normal.
pub(super) struct Distances {
    /// Into the tissue.
    pub(super) thickness: Option<Spread>,
    /// Into the lumen.
    pub(super) gap: Option<Spread>,
}

pub(super) fn distances(shape: &Shape<'_>) -> Distances {
    let walls = Walls::new(shape);
    let points: usize = shape.lumen.iter().map(|ring| ring.len()).sum();
    let (mut thickness, mut gap) = (Vec::with_capacity(points), Vec::with_capacity(points));
    for (i, edge) in walls.edges[..points].iter().enumerate() {
        let (along, length) = direction(edge);
        if length == 0.0 {
            continue;
        }
        let middle = [0, 1].map(|k| 0.5 * (edge[0][k] + edge[1][k]));
        let normal = [-along[1], along[0]];
        let weight = length as f32;
        gap.extend(walls.first(middle, normal, i).map(|distance| (distance, weight)));
        thickness.extend(walls.first(middle, normal.map(|x| -x), i).map(|distance| (distance, weight)));
    }
    Distances { thickness: Spread::of(&mut thickness), gap: Spread::of(&mut gap) }
}

/// Unit vector along an edge, zero if it has no length; and its length.
fn direction([a, b]: &[P2; 2]) -> (P2, f64) {
    let length = distance(*a, *b);
    let unit = if length > 0.0 { [(b[0] - a[0]) / length, (b[1] - a[1]) / length] } else { [0.0; 2] };
    (unit, length)
}

/// All edges of a section in a grid of square cells, about one edge a cell.
struct Walls {
    edges: Vec<[P2; 2]>,
    corner: P2,
    cell: f64,
    columns: usize,
    rows: usize,
    /// First entry of each cell in `items`, and the end.
    starts: Vec<u32>,
    items: Vec<u32>,
}

impl Walls {
    fn new(shape: &Shape<'_>) -> Self {
        let rings = shape.lumen.iter().copied().chain([shape.outer]);
        let edges: Vec<[P2; 2]> = rings.flat_map(|ring| super::shape::edges(ring).map(|(a, b)| [a, b])).collect();
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for point in edges.iter().flatten() {
            for k in 0..2 {
                low[k] = low[k].min(point[k]);
                high[k] = high[k].max(point[k]);
            }
        }
        let extent = [high[0] - low[0], high[1] - low[1]].map(|x| x.max(1e-3));
        let cell = (extent[0] * extent[1] / edges.len().max(1) as f64).sqrt().max(extent[0].max(extent[1]) / 4096.0);
        let count = |extent: f64| (extent / cell) as usize + 1;
        let (columns, rows) = (count(extent[0]), count(extent[1]));
        let mut walls =
            Self { edges, corner: low, cell, columns, rows, starts: vec![0; columns * rows + 1], items: Vec::new() };
        walls.fill();
        walls
    }

    fn fill(&mut self) {
        let mut starts = std::mem::take(&mut self.starts);
        for edge in &self.edges {
            self.cells(edge, |cell| starts[cell + 1] += 1);
        }
        for i in 1..starts.len() {
            starts[i] += starts[i - 1];
        }
        let mut items = vec![0; starts[starts.len() - 1] as usize];
        let mut next = starts.clone();
        for (i, edge) in self.edges.iter().enumerate() {
            self.cells(edge, |cell| {
                items[next[cell] as usize] = i as u32;
                next[cell] += 1;
            });
        }
        (self.starts, self.items) = (starts, items);
    }

    /// The column or row of a coordinate.
    #[inline]
    fn index(&self, axis: usize, x: f64) -> usize {
        let most = [self.columns, self.rows][axis] - 1;
        (((x - self.corner[axis]) / self.cell) as usize).min(most)
    }

    /// The cells that the bounds of an edge meet.
    #[inline]
    fn cells(&self, [a, b]: &[P2; 2], mut visit: impl FnMut(usize)) {
        let range = |axis: usize| self.index(axis, a[axis].min(b[axis]))..=self.index(axis, a[axis].max(b[axis]));
        for row in range(1) {
            for column in range(0) {
                visit(row * self.columns + column);
            }
        }
    }

    /// Distance from a point along a unit vector to the first edge but its own.
    fn first(&self, from: P2, along: P2, own: usize) -> Option<f32> {
        let mut at = [self.index(0, from[0]), self.index(1, from[1])];
        // Distance along the ray to the next border of a cell, and between two such borders, on each axis.
        let mut border = [f64::INFINITY; 2];
        for k in 0..2 {
            if along[k] != 0.0 {
                let line = self.corner[k] + self.cell * (at[k] as f64 + if along[k] > 0.0 { 1.0 } else { 0.0 });
                border[k] = (line - from[k]) / along[k];
            }
        }
        let between = along.map(|x| self.cell / x.abs());
        let ends = [self.columns, self.rows];
        let mut nearest = f64::INFINITY;
        loop {
            let cell = at[1] * self.columns + at[0];
            for &edge in &self.items[self.starts[cell] as usize..self.starts[cell + 1] as usize] {
                let edge = edge as usize;
                if edge != own {
                    nearest = nearest.min(meeting(from, along, &self.edges[edge]));
                }
            }
            let axis = usize::from(border[1] < border[0]);
            if nearest <= border[axis] {
                return Some(nearest as f32);
            }
            if along[axis] > 0.0 {
                at[axis] += 1;
                if at[axis] == ends[axis] {
                    break;
                }
            } else {
                at[axis] = at[axis].checked_sub(1)?;
            }
            border[axis] += between[axis];
        }
        nearest.is_finite().then_some(nearest as f32)
    }
}

/// Part of an edge by which it is longer at both ends, for rays through a common point of two edges.
const SLACK: f64 = 1e-9;

/// Distance along a ray to a segment; infinite if they do not meet.
#[inline]
fn meeting(from: P2, along: P2, [a, b]: &[P2; 2]) -> f64 {
    let (edge, to) = ([b[0] - a[0], b[1] - a[1]], [a[0] - from[0], a[1] - from[1]]);
    let cross = |u: P2, v: P2| u[0] * v[1] - u[1] * v[0];
    let across = cross(along, edge);
    // Multiplied by the sign of `across`, so that a division is made for a hit only.
    let (t, s) = (cross(to, edge) * across.signum(), cross(to, along) * across.signum());
    let width = across.abs();
    if t > 0.0 && s >= -SLACK * width && s <= (1.0 + SLACK) * width { t / width } else { f64::INFINITY }
}
