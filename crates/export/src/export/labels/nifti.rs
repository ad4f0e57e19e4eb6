//! NIfTI-1: a header of 348 bytes, then the voxels, all in one gzip stream.
//!
//! The crate `nifti` writes only whole arrays in memory, so the header is written here,
//! little-endian. The standard is nifti1.h of the NIfTI Data Format Working Group.

use super::volume::LabelReport;
use crate::export::Metadata;
use flate2::Compression;
use flate2::write::GzEncoder;
use std::io::{self, Write};

const HEADER: usize = 348;
/// Offset of the voxels: the header, and four bytes that state that no extension follows.
const VOXELS: usize = HEADER + 4;
/// Codes of the standard: 8-bit unsigned numbers, micrometres, labels, coordinates of a scanner.
const UINT8: i16 = 2;
const MICRON: u8 = 3;
const LABEL: i16 = 1002;
const SCANNER: i16 = 1;

/// A file under construction.
pub(super) struct Nifti<W: Write>(GzEncoder<W>);

impl<W: Write> Nifti<W> {
    pub(super) fn new(out: W, report: &LabelReport, meta: &Metadata) -> io::Result<Self> {
        let mut encoder = GzEncoder::new(out, Compression::default());
        encoder.write_all(&header(report, meta)?)?;
        Ok(Self(encoder))
    }

    /// Writes the next slice, row by row.
    pub(super) fn write(&mut self, labels: &[u8]) -> io::Result<()> {
        self.0.write_all(labels)
    }

    pub(super) fn finish(self) -> io::Result<()> {
        self.0.finish()?.flush()
    }
}

/// Builds the header. Coordinates are those of the surface in micrometres: x to the right, y up, z
/// from the isthmus end. y decreases from row to row, so the matrix has a negative sign for y.
fn header(report: &LabelReport, meta: &Metadata) -> io::Result<[u8; VOXELS]> {
    let mut bytes = [0; VOXELS];
    let mut put = |at: usize, value: &[u8]| bytes[at..at + value.len()].copy_from_slice(value);
    let floats = |values: &[f64]| values.iter().flat_map(|v| (*v as f32).to_le_bytes()).collect::<Vec<u8>>();
    put(0, &(HEADER as i32).to_le_bytes());
    put(40, &3_i16.to_le_bytes());
    for (axis, size) in report.size.into_iter().enumerate() {
        let size = i16::try_from(size).map_err(|_| {
            io::Error::new(io::ErrorKind::InvalidInput, format!("{size} voxels along an axis: over 32,767"))
        })?;
        put(42 + 2 * axis, &size.to_le_bytes());
    }
    for unused in 4..8 {
        put(40 + 2 * unused, &1_i16.to_le_bytes());
    }
    put(68, &LABEL.to_le_bytes());
    put(70, &UINT8.to_le_bytes());
    put(72, &8_i16.to_le_bytes());
    let [dx, dy, dz] = report.voxel_um;
    // The first number is the sign of the third column of the quaternion's matrix.
    put(76, &floats(&[-1.0, dx, dy, dz]));
    put(108, &floats(&[VOXELS as f64, 1.0, 0.0]));
    put(123, &[MICRON]);
    let about: Vec<u8> = format!("oviduct {}: {} seed {}", meta.engine, meta.preset, meta.seed).into_bytes();
    put(148, &about[..about.len().min(79)]);
    put(252, &SCANNER.to_le_bytes());
    put(254, &SCANNER.to_le_bytes());
    let [x, y, z] = report.first_um;
    // Half a turn around x with the third column negated, the same matrix as below.
    put(256, &floats(&[1.0, 0.0, 0.0, x, y, z]));
    put(280, &floats(&[dx, 0.0, 0.0, x, 0.0, -dy, 0.0, y, 0.0, 0.0, dz, z]));
    put(328, b"tissues");
    put(344, b"n+1\0");
    Ok(bytes)
}
