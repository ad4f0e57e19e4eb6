//! The surface that every reader returns.

use super::error::ReadError;
use super::limits;
use std::ops::Range;
use std::sync::Arc;

/// A surface as read, with the exact coordinates of the file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Surface {
    /// Vertex positions in units of the file.
    pub positions: Vec<[f64; 3]>,
    /// Vertex indices of each triangle. A face with more corners becomes triangles that cover it.
    pub triangles: Vec<[u32; 3]>,
    /// Named parts in the order of the file. Triangles may belong to none.
    pub groups: Vec<Group>,
    /// Unit of the positions.
    pub unit: Unit,
    /// Sentences about parts of the file that were passed over or read with an assumption.
    pub notes: Vec<String>,
}

/// A named part of a surface.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Group {
    /// Name in the file. All instances of a part have the same name.
    pub name: Arc<str>,
    /// Triangles of the part.
    pub triangles: Range<usize>,
}

/// The unit of length of a file.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Unit {
    /// The file does not state its unit; metres are assumed.
    #[default]
    Assumed,
    /// Metres per unit, stated by the format or by the file (a comment such as `units: mm`).
    Stated(f64),
}

impl Unit {
    /// Metres per unit.
    #[must_use]
    pub fn metres(self) -> f64 {
        match self {
            Self::Assumed => 1.0,
            Self::Stated(metres) => metres,
        }
    }
}

impl Surface {
    /// Adds a note, unless the surface has the same note already.
    pub(super) fn note(&mut self, note: impl Into<String>) {
        let note = note.into();
        if !self.notes.contains(&note) {
            self.notes.push(note);
        }
    }

    /// Adds a vertex.
    ///
    /// # Errors
    /// [`ReadError::TooLarge`].
    #[inline]
    pub(super) fn add_vertex(&mut self, point: [f64; 3]) -> Result<(), ReadError> {
        limits::vertices("surface", self.positions.len() as u64 + 1)?;
        self.positions.push(point);
        Ok(())
    }

    /// Adds a face of at least three corners as a fan around its first corner.
    ///
    /// # Errors
    /// [`ReadError::TooLarge`].
    #[inline]
    pub(super) fn add_face(&mut self, corners: &[u32]) -> Result<(), ReadError> {
        limits::triangles("surface", (self.triangles.len() + corners.len()) as u64 - 2)?;
        for pair in corners.windows(2).skip(1) {
            self.triangles.push([corners[0], pair[0], pair[1]]);
        }
        Ok(())
    }

    /// Removes vertices that no triangle uses and of which a coordinate is not finite: the
    /// triangles are sound without them. A note states their number.
    pub(super) fn drop_unused_not_finite(&mut self) {
        let finite = |p: &[f64; 3]| p.iter().all(|x| x.is_finite());
        if self.positions.iter().all(finite) {
            return;
        }
        let mut keep: Vec<bool> = self.positions.iter().map(finite).collect();
        for &vertex in self.triangles.as_flattened() {
            keep[vertex as usize] = true;
        }
        let mut kept = 0;
        let number: Vec<u32> = (keep.iter())
            .map(|&keep| {
                kept += u32::from(keep);
                kept.saturating_sub(1)
            })
            .collect();
        let before = self.positions.len();
        let mut kept = keep.iter().copied();
        self.positions.retain(|_| kept.next().unwrap_or(true));
        for vertex in self.triangles.as_flattened_mut() {
            *vertex = number[*vertex as usize];
        }
        match before - self.positions.len() {
            0 => {}
            1 => self.note("1 vertex has a coordinate that is not finite, belongs to no triangle and is left out"),
            dropped => self.note(format!(
                "{dropped} vertices have a coordinate that is not finite, belong to no triangle and are left out"
            )),
        }
    }

    /// Adds the triangles of a strip.
    ///
    /// # Errors
    /// [`ReadError::TooLarge`].
    pub(super) fn add_strip(&mut self, strip: &[u32]) -> Result<(), ReadError> {
        for ([a, b, c], reversed) in strip_triangles(strip) {
            self.add_face(&if reversed { [b, a, c] } else { [a, b, c] })?;
        }
        Ok(())
    }

    /// Ends the last group, and begins another if there is a `name`. Empty groups are removed.
    pub(super) fn begin_group(&mut self, name: Option<&str>) {
        let now = self.triangles.len();
        if let Some(last) = self.groups.last_mut() {
            last.triangles.end = now;
            if last.triangles.is_empty() {
                self.groups.pop();
            }
        }
        if let Some(name) = name {
            self.groups.push(Group { name: name.into(), triangles: now..now });
        }
    }
}

/// Triangles of a strip, each with its vertices in the order of the strip. The flag is true for
/// every other triangle, which has the opposite orientation. A triangle that repeats a vertex only
/// joins two strips, so it is omitted.
pub(super) fn strip_triangles(strip: &[u32]) -> impl Iterator<Item = ([u32; 3], bool)> {
    let triangles = strip.array_windows().enumerate().map(|(i, &corners)| (corners, i % 2 == 1));
    triangles.filter(|([a, b, c], _)| a != b && b != c && c != a)
}
