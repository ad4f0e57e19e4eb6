//! Voxels of a label volume, and its files.

use serde::Serialize;

/// File names.
pub const FILES: [&str; 2] = ["labels.ome.tif", "labels.nii.gz"];
/// Media types of [`FILES`].
pub const MEDIA_TYPES: [&str; 2] = ["image/tiff", "application/gzip"];

/// Piece of the tube to be labelled, and size of the voxels.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LabelVolume {
    /// Side of a voxel in the plane of a section, µm.
    pub voxel_um: f64,
    /// Distance of slices, µm.
    pub slice_um: f64,
    /// Beginning of the first slice, µm from the isthmus end.
    pub from_um: f64,
    /// Number of slices.
    pub slices: u32,
}

impl LabelVolume {
    /// z of the middle of a slice, µm.
    #[must_use]
    pub fn z_um(&self, slice: u32) -> f64 {
        self.from_um + (f64::from(slice) + 0.5) * self.slice_um
    }
}

/// A label volume.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct LabelReport {
    /// Number of voxels along x, y and z.
    pub size: [u32; 3],
    /// Sides of a voxel along x, y and z, micrometres.
    pub voxel_um: [f64; 3],
    /// Centre of the voxel of column 0, row 0 and slice 0, micrometres. The next row has a smaller
    /// y.
    pub first_um: [f64; 3],
}
