//! Blocks, the parts of a wall between two planes, and the rows of vertices at the planes.

use super::error::RemeshError;
use super::field::{LengthField, RemeshLimits, Spot};
use super::row::{resampled, stitched};
use super::sheet::Sheet;
use super::weave::Weave;
use super::web::Web;
use crate::geometry::curve::morton;
use crate::model::Ring;

/// Minimum distance between the initial rows, as a fraction of the mean edge length.
const ROWS: f64 = 0.7;
/// Passes that even out the edge lengths.
const PASSES: usize = 3;
/// Maximum number of passes that add vertices where triangles are too far from the sheet.
const APPROACHES: usize = 12;

/// Vertices at a section plane.
#[derive(Clone, Default)]
pub(super) struct Row {
    /// For each vertex, the index of the particle before it in the ring and the fraction of the way
    /// to the next particle.
    anchors: Vec<(usize, f64)>,
    /// Positions, micrometres.
    pub(super) points: Vec<[f64; 3]>,
}

impl Row {
    /// Resamples the contour of section `k` of consecutive sections. The other sections make the
    /// lengths change gradually along the tube.
    pub(super) fn new(
        rings: &[(&Ring, f64)],
        k: usize,
        limits: RemeshLimits,
        spots: &[Spot],
    ) -> Result<Self, RemeshError> {
        let sheet = Sheet::new(rings)?;
        let field = LengthField::new(&sheet, limits, spots);
        let level = &sheet.levels[k];
        let row = resampled(&sheet, &field, k);
        let anchors = row
            .iter()
            .map(|&u| {
                let i = level.find(u);
                let end = level.u.get(i + 1).copied().unwrap_or(sheet.period);
                ((i + level.turn) % level.u.len(), (u - level.u[i]) / (end - level.u[i]))
            })
            .collect();
        let points = row.iter().map(|&u| level.point(u)).collect();
        Ok(Self { anchors, points })
    }

    /// Vertices at a level of a sheet as pairs of number, counted from `first`, and u; sorted by u.
    fn on(&self, sheet: &Sheet, k: usize, first: u32) -> Vec<(u32, f64)> {
        let level = &sheet.levels[k];
        let n = level.u.len();
        let place = |&(index, share): &(usize, f64)| {
            let i = (index + n - level.turn) % n;
            let end = level.u.get(i + 1).copied().unwrap_or(sheet.period);
            level.u[i] + (end - level.u[i]) * share
        };
        let mut row: Vec<(u32, f64)> = (first..).zip(self.anchors.iter().map(place)).collect();
        row.sort_by(|a, b| a.1.total_cmp(&b.1));
        row
    }
}

/// Triangles between two rows. Their vertices are those of the lower row, those of the upper row,
/// and then `points`.
#[derive(Clone, Default)]
pub(super) struct Block {
    /// Positions, micrometres.
    pub(super) points: Vec<[f64; 3]>,
    /// Triangles, facing away from the axis.
    pub(super) triangles: Vec<[u32; 3]>,
}

impl Block {
    pub(super) fn new(
        rings: &[(&Ring, f64)],
        rows: [&Row; 2],
        limits: RemeshLimits,
        spots: &[Spot],
    ) -> Result<Self, RemeshError> {
        let sheet = Sheet::new(rings)?;
        let field = LengthField::new(&sheet, limits, spots);
        let web = begin(&sheet, &field, rows);
        let mut weave = Weave::new(&sheet, &field, web);
        weave.even_out(PASSES);
        for _ in 0..APPROACHES {
            let added = weave.approach();
            weave.flip();
            weave.polish();
            weave.flip();
            if added == 0 {
                break;
            }
        }
        Ok(packed(&weave.web, sheet.period))
    }
}

/// Joins rows of vertices into the initial triangles of a block.
fn begin(sheet: &Sheet, field: &LengthField, [lower, upper]: [&Row; 2]) -> Web {
    let length = field.mean();
    let mut points = [&lower.points[..], &upper.points].concat();
    let last = sheet.levels.len() - 1;
    let first = lower.on(sheet, 0, 0);
    let end = upper.on(sheet, last, lower.points.len() as u32);
    let mut places = vec![[0.0; 2]; points.len()];
    for (row, k) in [(&first, 0), (&end, last)] {
        for &(v, u) in row {
            places[v as usize] = [u, sheet.levels[k].z];
        }
    }
    let fixed = points.len();
    let (mut below, mut z) = (first, sheet.levels[0].z);
    let mut triangles = Vec::new();
    let top = sheet.levels[last].z;
    for (k, pair) in sheet.levels.windows(2).enumerate() {
        let (low, high) = (pair[0].z, pair[1].z);
        // Between distant sections, intermediate rows are inserted, because long triangles divide
        // badly.
        let parts = ((high - low) / length).round().max(1.0);
        let heights = (0..parts as usize).map(|part| low + (high - low) * part as f64 / parts);
        for height in heights.filter(|&height| top - height >= ROWS * length) {
            if height - z < ROWS * length {
                continue;
            }
            z = height;
            let row: Vec<(u32, f64)> = (points.len() as u32..).zip(resampled(sheet, field, k)).collect();
            for &(_, u) in &row {
                places.push([u, z]);
                points.push(sheet.point([u, z]));
            }
            triangles.extend(stitched(sheet, &below, &row, |v| points[v as usize]));
            below = row;
        }
    }
    triangles.extend(stitched(sheet, &below, &end, |v| points[v as usize]));
    Web::new(points, places, triangles, fixed)
}

/// Remaining triangles of a web, ordered so that neighbours are close to each other.
fn packed(web: &Web, period: f64) -> Block {
    let low = web.places.iter().map(|p| p[1]).fold(f64::INFINITY, f64::min);
    let key = |t: &[u32; 3]| {
        let [u, z] = web.places[t[0] as usize];
        let scale = |x: f64| (x / period) as f32;
        morton([scale(u.rem_euclid(period)), scale(z - low), 0.0])
    };
    let mut triangles: Vec<[u32; 3]> = web.triangles.iter().copied().filter(|t| t[0] != super::web::NONE).collect();
    triangles.sort_by_cached_key(key);
    let mut number = vec![u32::MAX; web.points.len()];
    for (v, number) in (0..web.fixed as u32).zip(&mut number) {
        *number = v;
    }
    let mut points = Vec::new();
    for v in triangles.iter_mut().flatten() {
        let slot = &mut number[*v as usize];
        if *slot == u32::MAX {
            *slot = (web.fixed + points.len()) as u32;
            points.push(web.points[*v as usize]);
        }
        *v = *slot;
    }
    Block { points, triangles }
}
