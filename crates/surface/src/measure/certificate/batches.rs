//! Area and volume of a lofted tissue, summed in batches of sections. The order of a sum determines
//! its last digits. Version 0.3.0 certified straight surfaces in such batches, and models of one
//! version must have the same bytes.

use super::shape::{RUN, Turns, part};
use super::surface::Surface;
use crate::model::{Mesh, Patch, Section};
use rayon::prelude::*;

/// Minimum number of points of the sections of a batch.
const POINTS: usize = 1 << 15;

/// Area and volume of a surface lofted through `sections`, in the units of `positions`.
pub(super) fn sums(positions: &[[f32; 3]], mesh: &Mesh, sections: &[Section]) -> [f64; 2] {
    let whole = Surface { positions, triangles: &mesh.triangles, unit_um: 1.0 };
    let origin = whole.corners(0)[0];
    let (mut area, mut volume) = (0.0, 0.0);
    let mut starts: Vec<usize> = mesh.patches.iter().map(|patch| patch.triangles.start).collect();
    for ends in ends(sections, &mesh.patches) {
        let mut triangles = Vec::new();
        for (start, end) in starts.iter_mut().zip(ends) {
            triangles.extend_from_slice(&mesh.triangles[std::mem::replace(start, end)..end]);
        }
        let batch = Surface { triangles: &triangles, ..whole };
        let sum = |run: &[[u32; 3]], first: usize| {
            let found = part(&batch, origin, |_| 0, first, &mut vec![Turns::ANY; run.len()]);
            (found.area, found.volumes.iter().map(|(_, volume)| volume / 6.0).sum::<f64>())
        };
        let runs: Vec<_> = triangles.par_chunks(RUN).enumerate().map(|(k, run)| sum(run, k * RUN)).collect();
        area = runs.iter().fold(area, |sum, run| sum + run.0);
        volume += runs.iter().fold(0.0, |sum, run| sum + run.1);
    }
    [area, volume]
}

/// End of the triangles of each patch, in each batch.
fn ends(sections: &[Section], patches: &[Patch]) -> Vec<Vec<usize>> {
    let (mut ends, mut points) = (Vec::new(), 0);
    let mut walls = [0, 0];
    let rings = |section: &Section| [section.inner.len(), section.outer.len()];
    for (k, section) in sections.iter().enumerate() {
        // A section settles the slab below the slab that ends at it.
        if k > 1 {
            let (below, above) = (rings(&sections[k - 1]), rings(section));
            walls = [0, 1].map(|wall| walls[wall] + below[wall] + above[wall]);
        }
        points += section.particles();
        if !section.added && points >= POINTS {
            points = 0;
            // The end at the isthmus is closed together with the first slab.
            let cap = if k > 0 { usize::MAX } else { 0 };
            let settled = patches.iter().zip([walls[0], walls[1], cap, 0]);
            ends.push(settled.map(|(patch, count)| patch.triangles.start + count.min(patch.triangles.len())).collect());
        }
    }
    ends.push(patches.iter().map(|patch| patch.triangles.end).collect());
    ends
}
