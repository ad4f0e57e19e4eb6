//! PolyData of VTK in XML, as VTK, ParaView, SimVascular and oviduct write it: polygons and
//! triangle strips of all pieces. Vertices and lines are skipped.
//!
//! The cell data `patch` define groups, the field data `patch_names` their names, and the field
//! data `units` the unit. Without patches, the cell data `ModelFaceID` define groups. Arrays of
//! these names that other programs use for something else are skipped.

mod array;
mod document;
mod encoding;

use super::error::ReadError;
use super::limits;
use super::patches::{Numbered, Patches};
use super::polygons::Polygons;
use super::surface::Surface;
use super::text::{quoted, unit};
use array::{Array, File, Kind, Values};
use document::Piece;

pub(super) fn parse(bytes: &[u8]) -> Result<Surface, ReadError> {
    let document = document::parse(bytes)?;
    let file = &document.file;
    let mut surface = Surface::default();
    if let Some(name) = strings(file, document.units.as_deref(), &mut surface)?.first() {
        match unit(&format!("units: {name}")) {
            Some(unit) => surface.unit = unit,
            None => surface.note(format!("the field data \"units\" say {}, which is not a known unit", quoted(name))),
        }
    }
    let mut patches = Patches::default();
    for (number, name) in (0..).zip(strings(file, document.patch_names.as_deref(), &mut surface)?) {
        patches.name((PATCH, number), &name);
    }
    let mut polygons = Polygons::default();
    let (mut verts, mut lines) = (0_u64, 0_u64);
    for (number, piece) in document.pieces.iter().enumerate() {
        let (patches, polygons) = (&mut patches, &mut polygons);
        PieceReader { file, piece, number, patches, polygons, surface: &mut surface }.read()?;
        verts = verts.saturating_add(piece.verts);
        lines = lines.saturating_add(piece.lines);
    }
    polygons.split(&mut surface, |place| format!("piece {}, Polys: cell {}", place >> 32, place & 0xffff_ffff))?;
    for (count, kind) in [(verts, "vertices"), (lines, "lines")] {
        if count > 0 {
            surface.note(format!("cells that are {kind} ({count}) are passed over"));
        }
    }
    Ok(surface)
}

/// Strings of field data, or none with a note if the array has no strings.
fn strings(file: &File<'_>, array: Option<&Array<'_>>, surface: &mut Surface) -> Result<Vec<String>, ReadError> {
    match array {
        None => Ok(Vec::new()),
        Some(array) if array.kind == Kind::String => file.strings(array),
        Some(array) => {
            surface.note(format!("the field data {} are not strings and are passed over", quoted(&array.name)));
            Ok(Vec::new())
        }
    }
}

/// Kinds of groups.
const PATCH: &str = "patch";
const FACE: &str = "face";

/// Adds a piece to the surface.
struct PieceReader<'a, 'b> {
    file: &'b File<'a>,
    piece: &'b Piece<'a>,
    /// Index of the piece in the file, from 0.
    number: usize,
    patches: &'b mut Patches,
    polygons: &'b mut Polygons,
    surface: &'b mut Surface,
}

impl<'a, 'b> PieceReader<'a, 'b> {
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
        let mut numbers = self.numbers();
        if let Some((_, values)) = &mut numbers {
            // Cell data are in the order of vertices, lines, polygons and strips.
            for _ in 0..piece.verts.saturating_add(piece.lines) {
                values.integer()?;
            }
        }
        self.cells(false, base as u32, numbers.as_mut())?;
        self.cells(true, base as u32, numbers.as_mut())
    }

    /// Cell data that define groups, with the kind of the groups.
    fn numbers(&mut self) -> Option<(&'static str, Values<'b, 'a>)> {
        let (file, piece) = (self.file, self.piece);
        let all = [piece.verts, piece.lines, piece.polys, piece.strips].into_iter().fold(0, u64::saturating_add);
        for (array, kind, fractions) in [(&piece.patch, PATCH, false), (&piece.model_face, FACE, true)] {
            let Some(array) = array else { continue };
            if let Some(values) = file.cell_numbers(array, all, fractions) {
                return Some((kind, values));
            }
            self.surface
                .note(format!("the cell data {} do not number patches and are passed over", quoted(&array.name)));
        }
        None
    }

    /// Reads the polygons or the strips.
    fn cells(
        &mut self,
        strips: bool,
        base: u32,
        mut numbers: Option<&mut (&'static str, Values<'_, 'a>)>,
    ) -> Result<(), ReadError> {
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
            let first = self.surface.triangles.len();
            limits::triangles(&path, (first as u64).saturating_add(length.saturating_sub(2)))?;
            cell.clear();
            for _ in 0..length {
                let corner = corners.integer()?;
                match u64::try_from(corner) {
                    Ok(vertex) if vertex < self.piece.points => cell.push(base + vertex as u32),
                    _ => return wrong(format!("cell {number}: there is no vertex {corner}")),
                }
            }
            if strips {
                self.surface.add_strip(&cell)?;
            } else {
                self.polygons.add(self.surface, &cell, (self.number as u64) << 32 | number)?;
            }
            if let Some((kind, values)) = &mut numbers {
                let patch: Numbered = (kind, values.integer()?);
                self.patches.add(self.surface, first, patch);
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
