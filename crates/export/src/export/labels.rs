//! Label volumes: the tissue of every voxel of a piece of the tube, as OME-TIFF and as NIfTI-1.
//!
//! A slice is an exact cut of the finished surface by the plane through its middle. Slices are cut,
//! classified and compressed in parallel, a few at a time, and written in order. Neither the memory
//! nor the bytes depend on the number of threads. Both files contain the same array: columns along
//! x, rows along y with row 0 at the maximum y, slices along z from the isthmus end.

mod nifti;
mod ome;
#[cfg(test)]
mod tests;
mod volume;

pub use volume::{FILES, LabelReport, LabelVolume, MEDIA_TYPES};

use super::Metadata;
use crate::geometry::cut::Slicer;
use crate::model::{Border, Mesh, PatchKind};
use crate::tissue::{Grid, Layers, TissueMap};
use flate2::Compression;
use flate2::write::ZlibEncoder;
use rayon::prelude::*;
use std::io::{self, Seek, Write};

/// Number of slices in memory at a time. `generate/cost` predicts the memory from it.
pub const SLICES_AT_A_TIME: usize = 16;

/// Labels of a slice, plain and compressed.
struct LabelSlice {
    labels: Vec<u8>,
    deflated: Vec<u8>,
}

/// Writes both files. `layers` returns the layers at a place along the tube, µm. Calls `cancelled`
/// before each slice and stops if it returns true.
///
/// # Errors
/// Returns any error of writing, and:
///
/// - [`io::ErrorKind::InvalidData`] if a cut of the outer wall is not one closed line. The cuts of
///   a certified surface are.
/// - [`io::ErrorKind::Interrupted`] if it was cancelled.
/// - [`io::ErrorKind::InvalidInput`] if the piece lies outside the tube, or a side of a slice has
///   more than 32,767 voxels.
pub fn write_labels(
    surface: &Mesh,
    layers: &(dyn Fn(f64) -> Layers + Sync),
    volume: &LabelVolume,
    meta: &Metadata,
    outputs: (impl Write + Seek + Send, impl Write + Send),
    cancelled: &(dyn Fn() -> bool + Sync),
) -> io::Result<LabelReport> {
    let walls = Walls::new(surface)?;
    let grid = walls.grid(volume)?;
    let report = LabelReport {
        size: [grid.width, grid.height, volume.slices],
        voxel_um: [volume.voxel_um, volume.voxel_um, volume.slice_um],
        first_um: [grid.x(0), grid.y(0), volume.z_um(0)],
    };
    let mut tiff = ome::OmeTiff::new(outputs.0, &report, meta)?;
    let mut nifti = nifti::Nifti::new(outputs.1, &report, meta)?;
    let all: Vec<u32> = (0..volume.slices).collect();
    for some in all.chunks(SLICES_AT_A_TIME) {
        let slices = some
            .par_iter()
            .map(|&slice| {
                if cancelled() {
                    return Err(io::ErrorKind::Interrupted.into());
                }
                let z_um = volume.z_um(slice);
                walls.slice(z_um, &grid, &layers(z_um))
            })
            .collect::<io::Result<Vec<LabelSlice>>>()?;
        let (tiff, nifti) = rayon::join(
            || slices.iter().try_for_each(|slice| tiff.write(&slice.deflated)),
            || slices.iter().try_for_each(|slice| nifti.write(&slice.labels)),
        );
        tiff.and(nifti)?;
    }
    nifti.finish()?;
    Ok(report)
}

/// A surface and slicers of its walls.
struct Walls<'a> {
    surface: &'a Mesh,
    inner: Slicer<'a>,
    outer: Slicer<'a>,
}

impl<'a> Walls<'a> {
    fn new(surface: &'a Mesh) -> io::Result<Self> {
        let wall = |kind: PatchKind| {
            let patch = surface.patches.iter().find(|patch| patch.kind == kind);
            let patch = patch.ok_or_else(|| io::Error::new(io::ErrorKind::InvalidData, "a wall is missing"))?;
            Ok::<_, io::Error>(Slicer::new(&surface.positions, &surface.triangles[patch.triangles.clone()]))
        };
        Ok(Self { surface, inner: wall(PatchKind::InnerWall)?, outer: wall(PatchKind::OuterWall)? })
    }

    /// Grid of a slice that covers the whole piece, with a margin of at least one voxel on each
    /// side. The borders of voxels are multiples of their side, so that the volumes of two pieces
    /// fit together.
    fn grid(&self, volume: &LabelVolume) -> io::Result<Grid> {
        // Includes the corners of slabs that lie only partly in the piece.
        let slab_um = f64::from(self.outer.height()) * 1e6;
        let piece = volume.from_um - slab_um..=volume.from_um + f64::from(volume.slices) * volume.slice_um + slab_um;
        let mut range = [[f64::INFINITY, f64::NEG_INFINITY]; 2];
        for p in self.surface.positions.iter().map(|p| p.map(|c| f64::from(c) * 1e6)).filter(|p| piece.contains(&p[2]))
        {
            for axis in 0..2 {
                range[axis] = [range[axis][0].min(p[axis]), range[axis][1].max(p[axis])];
            }
        }
        let [[left, right], [bottom, top]] = range.map(|of| of.map(|um| (um / volume.voxel_um).floor()));
        let count = |least: f64, most: f64| most - least + 3.0;
        let (width, height) = (count(left, right), count(bottom, top));
        let sides = 1.0..=f64::from(i16::MAX);
        if !sides.contains(&width) || !sides.contains(&height) {
            let text = format!("a slice of {width} × {height} voxels; a side has from 1 to {}", i16::MAX);
            return Err(io::Error::new(io::ErrorKind::InvalidInput, text));
        }
        Ok(Grid {
            width: width as u32,
            height: height as u32,
            um_per_pixel: volume.voxel_um,
            left_um: (left - 1.0) * volume.voxel_um,
            top_um: (top + 2.0) * volume.voxel_um,
        })
    }

    fn slice(&self, z_um: f64, grid: &Grid, layers: &Layers) -> io::Result<LabelSlice> {
        let [mucosa, outside] = [&self.inner, &self.outer].map(|wall| wall.cut(z_um * 1e-6, 1e6));
        // The cut of the inner wall may have islands.
        if mucosa.is_empty() || outside.len() != 1 {
            let lines = [mucosa.len(), outside.len()];
            let text =
                format!("the cut at {z_um} µm has {} lines in the inner wall and {} in the outer", lines[0], lines[1]);
            return Err(io::Error::new(io::ErrorKind::InvalidData, text));
        }
        let labels = TissueMap::new(&Border::closed(mucosa), &Border::closed(outside), layers).labels(grid);
        let mut encoder = ZlibEncoder::new(Vec::new(), Compression::default());
        encoder.write_all(&labels)?;
        Ok(LabelSlice { labels, deflated: encoder.finish()? })
    }
}
