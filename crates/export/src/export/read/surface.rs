//! What the readers make of a file.

use super::error::ReadError;
use super::limits;
use std::ops::Range;
use std::sync::Arc;

/// A surface as read: coordinates exactly as they are in the file.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Surface {
    /// Vertex positions in units of the file.
    pub positions: Vec<[f64; 3]>,
    /// Vertex indices of each triangle. Faces with more corners are split into fans.
    pub triangles: Vec<[u32; 3]>,
    /// Named parts in the order of the file; they need not cover all triangles.
    pub groups: Vec<Group>,
    /// Length of the unit of the file.
    pub unit: Unit,
}

/// A named part of a surface.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Group {
    /// Name in the file. Instances of one part share it.
    pub name: Arc<str>,
    /// Its triangles.
    pub triangles: Range<usize>,
}

/// The unit of length of a file.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Unit {
    /// The file does not state it; metres are assumed.
    #[default]
    Assumed,
    /// The file (a comment such as `units: mm`) or its format states the number of metres in a unit.
    Stated(f64),
}

impl Unit {
    /// Metres in a unit.
    #[must_use]
    pub fn metres(self) -> f64 {
        match self {
            Self::Assumed => 1.0,
            Self::Stated(metres) => metres,
        }
    }
}

impl Surface {
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

    /// Ends the last group; with a name, begins another.
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
