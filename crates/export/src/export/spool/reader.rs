//! Reads a spool from its beginning to its end, as often as writers need, and by as many at a time.

use super::{BUFFER, Spool};
use crate::export::Metadata;
use crate::export::shape::{Head, NamedPatch, Piece, Source};
use crate::model::{LengthUnit, Mesh, Patch, PatchKind};
use std::borrow::Cow;
use std::fs::File;
use std::io::{self, BufReader, Read};
use std::path::Path;

/// Most positions that are read at a time where no triangles need them.
const POSITIONS: u32 = 1 << 14;

/// A surface in a spool as the writers take it.
#[derive(Clone, Copy, Debug)]
pub struct SpooledShape<'a> {
    spool: &'a Spool,
    unit: LengthUnit,
    meta: &'a Metadata,
}

impl Spool {
    /// All of the surface, in metres.
    ///
    /// # Errors
    /// Those of reading.
    pub fn mesh(&self) -> io::Result<Mesh> {
        let mut positions = vec![[0.0f32; 3]; self.vertices as usize];
        File::open(&self.positions)?.read_exact(bytemuck::cast_slice_mut(&mut positions))?;
        let patches = self.ranges();
        let mut triangles = vec![[0; 3]; patches.last().map_or(0, |last| last.triangles.end)];
        for (file, patch) in self.patches.iter().zip(&patches) {
            File::open(file)?.read_exact(bytemuck::cast_slice_mut(&mut triangles[patch.triangles.clone()]))?;
        }
        Ok(Mesh { body: self.body, positions, triangles, patches })
    }

    /// The patches, one after another.
    fn ranges(&self) -> Vec<Patch> {
        let mut end = 0;
        let of_patch = |(patch, &kind): (usize, &PatchKind)| {
            let start = end;
            end += self.batches.iter().map(|batch| batch.triangles[patch]).sum::<usize>();
            Patch { kind, triangles: start..end }
        };
        self.body.patches().iter().enumerate().map(of_patch).collect()
    }

    /// The surface with positions in `unit`, rounded as [`LengthUnit::of_metres`] does.
    #[must_use]
    pub fn shape<'a>(&'a self, unit: LengthUnit, meta: &'a Metadata) -> SpooledShape<'a> {
        SpooledShape { spool: self, unit, meta }
    }
}

impl Source for SpooledShape<'_> {
    fn head(&self) -> Head<'_> {
        let ranges = self.spool.ranges();
        let triangles = ranges.last().map_or(0, |last| last.triangles.end);
        let named = |Patch { kind, triangles }| NamedPatch { name: kind.name(), triangles };
        let patches = ranges.into_iter().map(named).collect();
        let vertices = self.spool.vertices as usize;
        Head { name: self.spool.body.name(), vertices, triangles, patches, unit: self.unit, meta: Some(self.meta) }
    }

    fn positions(&self, each: &mut dyn FnMut(&[[f32; 3]]) -> io::Result<()>) -> io::Result<()> {
        let mut window = Window::open(&self.spool.positions, self.unit)?;
        while window.end() < self.spool.vertices {
            let first = window.end();
            window.advance(first, self.spool.vertices.min(first.saturating_add(POSITIONS)))?;
            each(&window.positions)?;
        }
        Ok(())
    }

    fn walk(&self, patches: &[usize], each: &mut dyn FnMut(&Piece<'_>) -> io::Result<()>) -> io::Result<()> {
        let mut window = Window::open(&self.spool.positions, self.unit)?;
        let opened = |&patch: &usize| Ok((patch, open(&self.spool.patches[patch])?));
        let mut files = patches.iter().map(opened).collect::<io::Result<Vec<_>>>()?;
        let mut triangles = Vec::new();
        for batch in &self.spool.batches {
            for (patch, file) in &mut files {
                if batch.triangles[*patch] == 0 {
                    continue;
                }
                window.advance(batch.first, batch.vertices)?;
                triangles.resize(batch.triangles[*patch], [0; 3]);
                file.read_exact(bytemuck::cast_slice_mut(&mut triangles))?;
                let (first, positions) = (window.first, &window.positions);
                each(&Piece { patch: *patch, first, positions, triangles: &triangles })?;
            }
        }
        Ok(())
    }

    fn is_in_memory(&self) -> bool {
        false
    }
}

fn open(path: &Path) -> io::Result<BufReader<File>> {
    Ok(BufReader::with_capacity(BUFFER, File::open(path)?))
}

/// Positions of the vertices in use.
struct Window {
    file: BufReader<File>,
    unit: LengthUnit,
    /// Number of the first.
    first: u32,
    positions: Vec<[f32; 3]>,
}

impl Window {
    fn open(positions: &Path, unit: LengthUnit) -> io::Result<Self> {
        Ok(Self { file: open(positions)?, unit, first: 0, positions: Vec::new() })
    }

    /// The number of the first vertex that is not read yet.
    fn end(&self) -> u32 {
        self.first + self.positions.len() as u32
    }

    /// Drops the vertices before `first` and reads those before `end`; neither is less than before.
    fn advance(&mut self, first: u32, end: u32) -> io::Result<()> {
        let skipped = first.saturating_sub(self.end());
        self.file.seek_relative(i64::from(skipped) * size_of::<[f32; 3]>() as i64)?;
        let done = first - self.first - skipped;
        self.positions.drain(..done as usize);
        self.first = first;
        let kept = self.positions.len();
        self.positions.resize((end - first) as usize, [0.0; 3]);
        let read = &mut self.positions[kept..];
        self.file.read_exact(bytemuck::cast_slice_mut(read))?;
        if let Cow::Owned(in_unit) = self.unit.of_metres(read) {
            read.copy_from_slice(&in_unit);
        }
        Ok(())
    }
}
