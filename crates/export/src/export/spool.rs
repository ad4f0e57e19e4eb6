//! A surface on the scratch disk, for surfaces too large for memory: written as they grow, then read by the writers of
//! files as a [`Source`](super::Source).
//!
//! Positions and the triangles of each patch are in plain temporary files, 18 bytes a triangle together. Beside them is
//! kept, for each call of [`SpoolWriter::push`], how many there were and which vertex was the first in use: so a reader
//! need hold only the vertices between that and the last. Everything else (numbers within patches, normals) writers
//! compute as they read, which takes less time than it takes to write and read it.
//!
//! The files are in the byte order of this machine; they never leave it.

mod reader;

pub use reader::SpooledShape;

use crate::model::{BodyKind, PatchKind};
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;
use tempfile::{NamedTempFile, TempPath};

/// Size of the buffer of each file.
const BUFFER: usize = 1 << 18;

/// Takes a surface as it grows. If it is dropped, its files are removed.
///
/// After an error it must not be used again.
#[derive(Debug)]
pub struct SpoolWriter {
    positions: BufWriter<File>,
    /// The triangles of each patch.
    triangles: Vec<BufWriter<File>>,
    /// No triangle may use a vertex before it any more.
    retired: u32,
    /// What is in the files.
    spool: Spool,
}

/// A whole surface in temporary files, which are removed when it is dropped.
#[derive(Debug)]
pub struct Spool {
    body: BodyKind,
    vertices: u32,
    batches: Vec<Batch>,
    positions: TempPath,
    patches: Vec<TempPath>,
}

/// What was pushed at once.
#[derive(Debug)]
struct Batch {
    /// First vertex that its triangles may use.
    first: u32,
    /// Vertices so far, with its own.
    vertices: u32,
    /// Number of its triangles in each patch.
    triangles: Vec<usize>,
}

impl SpoolWriter {
    /// Begins the surface of a body, with files in a folder.
    ///
    /// # Errors
    /// Those of creating its files.
    pub fn new(folder: &Path, body: BodyKind) -> io::Result<Self> {
        let create = || {
            let (file, path) = NamedTempFile::with_suffix_in(".spool", folder)?.into_parts();
            io::Result::Ok((BufWriter::with_capacity(BUFFER, file), path))
        };
        let (positions, path) = create()?;
        let mut spool = Spool { body, vertices: 0, batches: Vec::new(), positions: path, patches: Vec::new() };
        let mut triangles = Vec::new();
        for _ in body.patches() {
            let (file, path) = create()?;
            triangles.push(file);
            spool.patches.push(path);
        }
        Ok(Self { positions, triangles, retired: 0, spool })
    }

    /// Adds vertices (in metres, numbered on from the last) and triangles of patches, in the order of each patch. No later
    /// triangle will use a vertex before `retired`. A vertex is in one wall at most, or else in one other patch at most, or
    /// its normal may differ in the last bit from that of the same surface in memory.
    ///
    /// # Errors
    /// Those of the files; [`io::ErrorKind::InvalidInput`] if a triangle names a vertex that is retired or unknown, or is of
    /// a patch that the body lacks, `retired` decreases or is beyond the last vertex, or there are more vertices than 32-bit
    /// numbers.
    #[inline(never)] // counted by scripts/counts
    pub fn push(
        &mut self,
        positions: &[[f32; 3]],
        triangles: &[(PatchKind, &[[u32; 3]])],
        retired: u32,
    ) -> io::Result<()> {
        let spool = &mut self.spool;
        let vertices = u32::try_from(positions.len()).ok().and_then(|new| spool.vertices.checked_add(new));
        let vertices = vertices.ok_or_else(|| invalid("more vertices than 32-bit numbers".into()))?;
        let in_use = self.retired..vertices;
        if !(self.retired..=vertices).contains(&retired) {
            let message = format!("vertices before {retired} cannot retire: those in use are {in_use:?}");
            return Err(invalid(message));
        }
        let mut counts = vec![0; self.triangles.len()];
        for &(kind, triangles) in triangles {
            if let Some(vertex) = triangles.as_flattened().iter().find(|vertex| !in_use.contains(vertex)) {
                let name = kind.name();
                let message = format!("a triangle of {name} names vertex {vertex}; those in use are {in_use:?}");
                return Err(invalid(message));
            }
            let Some(patch) = spool.body.patches().iter().position(|&patch| patch == kind) else {
                return Err(invalid(format!("the {} has no patch {}", spool.body.name(), kind.name())));
            };
            self.triangles[patch].write_all(bytemuck::cast_slice(triangles))?;
            counts[patch] += triangles.len();
        }
        self.positions.write_all(bytemuck::cast_slice(positions))?;
        spool.batches.push(Batch { first: self.retired, vertices, triangles: counts });
        (spool.vertices, self.retired) = (vertices, retired);
        Ok(())
    }

    /// Ends the surface.
    ///
    /// # Errors
    /// Those of the files.
    pub fn finish(self) -> io::Result<Spool> {
        let Self { mut positions, mut triangles, spool, .. } = self;
        positions.flush()?;
        triangles.iter_mut().try_for_each(Write::flush)?;
        Ok(spool)
    }
}

fn invalid(message: String) -> io::Error {
    io::Error::new(io::ErrorKind::InvalidInput, message)
}

#[cfg(test)]
mod tests;
