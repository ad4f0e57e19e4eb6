//! PolyData of VTK in XML, as VTK, ParaView and oviduct write it: polygons (as fans) and triangle
//! strips of all pieces. Vertices and lines are skipped.
//!
//! The cell data `patch` define groups, the field data `patch_names` their names, and the field
//! data `units` the unit.

mod array;
mod document;
mod encoding;

use super::error::ReadError;
use super::limits;
use super::patches::Patches;
use super::surface::{Surface, Unit, strip_triangles};
use super::text::unit;
use array::{Array, File, Values};
use document::Piece;

pub(super) fn parse(bytes: &[u8]) -> Result<Surface, ReadError> {
    let document = document::parse(bytes)?;
    let file = &document.file;
    let mut surface = Surface::default();
    if let Some(units) = &document.units
        && let Some(name) = file.strings(units)?.first()
    {
        surface.unit = unit(&format!("units: {name}")).unwrap_or(Unit::Assumed);
    }
    let mut patches = Patches::default();
    if let Some(names) = &document.patch_names {
        for (number, name) in (0..).zip(file.strings(names)?) {
            patches.name(number, &name);
        }
    }
    for (number, piece) in document.pieces.iter().enumerate() {
        PieceReader { file, piece, number, patches: &mut patches, surface: &mut surface }.read()?;
    }
    Ok(surface)
}

/// Adds a piece to the surface.
struct PieceReader<'a, 'b> {
    file: &'b File<'a>,
    piece: &'b Piece<'a>,
    /// Index of the piece in the file, from 0.
    number: usize,
    patches: &'b mut Patches,
    surface: &'b mut Surface,
}

impl<'a> PieceReader<'a, '_> {
    fn read(mut self) -> Result<(), ReadError> {
        let (piece, path) = (self.piece, format!("piece {}", self.number));
        let base = self.surface.positions.len() as u64;
        limits::vertices(&path, base.saturating_add(piece.points))?;
        let cells = piece.polys.saturating_add(piece.strips);
        limits::triangles(&path, (self.surface.triangles.len() as u64).saturating_add(cells))?;
        if piece.points > 0 {
            let mut points = self.file.floats(self.needed(piece.points_array.as_deref(), "Points")?)?;
            for _ in 0..piece.points {
                self.surface.add_vertex([points.float()?, points.float()?, points.float()?])?;
            }
        }
        if cells == 0 {
            return Ok(());
        }
        let mut patch = piece.patch.as_ref().map(|array| self.file.integers(array)).transpose()?;
        if let Some(patch) = &mut patch {
            // Cell data are in the order of vertices, lines, polygons and strips.
            for _ in 0..piece.verts.saturating_add(piece.lines) {
                patch.integer()?;
            }
        }
        self.cells(false, base as u32, patch.as_mut())?;
        self.cells(true, base as u32, patch.as_mut())
    }

    /// Reads the polygons or the strips.
    fn cells(&mut self, strips: bool, base: u32, mut patch: Option<&mut Values<'_, 'a>>) -> Result<(), ReadError> {
        let (count, cells, name) = match strips {
            false => (self.piece.polys, &self.piece.polys_arrays, "Polys"),
            true => (self.piece.strips, &self.piece.strips_arrays, "Strips"),
        };
        if count == 0 {
            return Ok(());
        }
        let path = format!("piece {}, {name}", self.number);
        let wrong = |detail: String| Err(ReadError::document(path.clone(), detail));
        let mut offsets = self.file.integers(self.needed(cells.offsets.as_deref(), &format!("{name}, offsets"))?)?;
        let connectivity = self.needed(cells.connectivity.as_deref(), &format!("{name}, connectivity"))?;
        let mut corners = self.file.integers(connectivity)?;
        let (mut begin, mut cell) = (0_i64, Vec::new());
        for number in 0..count {
            let end = offsets.integer()?;
            let Some(length) = end.checked_sub(begin).and_then(|length| u64::try_from(length).ok()) else {
                return wrong(format!("the offset of cell {number} is less than the one before"));
            };
            begin = end;
            if length < 3 {
                return wrong(format!("cell {number} has fewer than three corners"));
            }
            let first = self.surface.triangles.len();
            limits::triangles(&path, (first as u64).saturating_add(length - 2))?;
            cell.clear();
            for _ in 0..length {
                let corner = corners.integer()?;
                match u64::try_from(corner) {
                    Ok(vertex) if vertex < self.piece.points => cell.push(base + vertex as u32),
                    _ => return wrong(format!("cell {number}: there is no vertex {corner}")),
                }
            }
            if strips {
                for ([a, b, c], reversed) in strip_triangles(&cell) {
                    self.surface.add_face(&if reversed { [b, a, c] } else { [a, b, c] })?;
                }
            } else {
                self.surface.add_face(&cell)?;
            }
            if let Some(patch) = &mut patch {
                self.patches.add(self.surface, first, patch.integer()?);
            }
        }
        Ok(())
    }

    fn needed<'c>(&self, array: Option<&'c Array<'a>>, name: &str) -> Result<&'c Array<'a>, ReadError> {
        array.ok_or_else(|| ReadError::document(format!("piece {}, {name}", self.number), "the array is missing"))
    }
}

#[cfg(test)]
mod tests;
