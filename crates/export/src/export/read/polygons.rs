//! Faces with more than three corners. They are read as fans, because a face may come before its
//! vertices, and split once all vertices are known.

mod split;

use super::error::ReadError;
use super::surface::Surface;
use split::Splitter;

/// The faces of a surface that have other than three corners.
#[derive(Default)]
pub(super) struct Polygons {
    faces: Vec<Face>,
    too_few: Tally,
    not_flat: Tally,
}

/// A face of which the surface has the fan.
struct Face {
    /// First triangle of the fan.
    first: usize,
    corners: usize,
    place: u64,
}

/// Number of faces of a kind.
#[derive(Default)]
struct Tally {
    count: usize,
    /// Place of the first of them.
    first: u64,
}

impl Tally {
    fn count(&mut self, place: u64) {
        self.first = if self.count == 0 { place } else { self.first.min(place) };
        self.count += 1;
    }

    /// Sentence about these faces, with its predicate for one and for several, and the first place.
    fn sentence(&self, predicates: [&str; 2], name: &impl Fn(u64) -> String) -> Option<String> {
        let first = || name(self.first);
        match self.count {
            0 => None,
            1 => Some(format!("1 face {} (first: {})", predicates[0], first())),
            count => Some(format!("{count} faces {} (first: {})", predicates[1], first())),
        }
    }
}

const TOO_FEW: [&str; 2] = [
    "has fewer than three different corners and is passed over",
    "have fewer than three different corners and are passed over",
];
const NOT_FLAT: [&str; 2] = [
    "is not flat: a corner lies more than a thousandth of the face's size off the plane of the face",
    "are not flat: a corner lies more than a thousandth of the face's size off the plane of the face",
];

/// Triangles that replace a fan of another length.
struct Replacement {
    first: usize,
    length: usize,
    triangles: Vec<[u32; 3]>,
}

impl Polygons {
    /// Adds a face of any number of corners to the surface. `place` stands for its place in the
    /// file. A face with fewer than three corners adds nothing.
    ///
    /// # Errors
    /// [`ReadError::TooLarge`].
    #[inline]
    pub(super) fn add(&mut self, surface: &mut Surface, corners: &[u32], place: u64) -> Result<(), ReadError> {
        match *corners {
            [] | [_] | [_, _] => {
                self.too_few.count(place);
                return Ok(());
            }
            // A triangle stays as it is; the certificate judges one that repeats a vertex.
            [_, _, _] => {}
            _ => self.faces.push(Face { first: surface.triangles.len(), corners: corners.len(), place }),
        }
        surface.add_face(corners)
    }

    /// Splits all faces into triangles that cover them, and adds notes about unusual faces. `name`
    /// turns a place into a part of the file, such as `line 7`.
    ///
    /// # Errors
    /// Returns the first face that crosses or touches itself.
    ///
    /// # Panics
    /// If a corner names no vertex.
    pub(super) fn split(mut self, surface: &mut Surface, name: impl Fn(u64) -> String) -> Result<(), ReadError> {
        let (mut splitter, mut corners) = (Splitter::default(), Vec::new());
        let mut replacements = Vec::new();
        for face in std::mem::take(&mut self.faces) {
            let length = face.corners - 2;
            let fan = &mut surface.triangles[face.first..face.first + length];
            corners.clear();
            corners.extend(fan.iter().take(1).flat_map(|t| [t[0], t[1]]).chain(fan.iter().map(|t| t[2])));
            let found = splitter.split(&corners, &surface.positions);
            let (triangles, flat) = found.map_err(|fault| {
                let [x, y, z] = fault.at;
                let detail = format!("the face of {} corners {} at ({x}, {y}, {z})", face.corners, fault.what);
                ReadError::document(name(face.place), detail)
            })?;
            if !flat {
                self.not_flat.count(face.place);
            }
            if triangles.is_empty() {
                self.too_few.count(face.place);
            }
            if triangles.len() == length {
                fan.copy_from_slice(triangles);
            } else {
                replacements.push(Replacement { first: face.first, length, triangles: triangles.to_vec() });
            }
        }
        replace(surface, &replacements);
        let notes = [self.too_few.sentence(TOO_FEW, &name), self.not_flat.sentence(NOT_FLAT, &name)];
        notes.into_iter().flatten().for_each(|note| surface.note(note));
        Ok(())
    }
}

/// Replaces fans, which are in order, and moves the groups along.
fn replace(surface: &mut Surface, replacements: &[Replacement]) {
    if replacements.is_empty() {
        return;
    }
    let old = std::mem::take(&mut surface.triangles);
    let mut new = Vec::with_capacity(old.len());
    let mut copied = 0;
    // Old and new number of the triangle after each replacement.
    let mut moved = vec![(0, 0)];
    for Replacement { first, length, triangles } in replacements {
        new.extend_from_slice(&old[copied..*first]);
        new.extend_from_slice(triangles);
        copied = first + length;
        moved.push((copied, new.len()));
    }
    new.extend_from_slice(&old[copied..]);
    surface.triangles = new;
    let new_number = |number: usize| {
        let (old, new) = moved[moved.partition_point(|&(old, _)| old <= number) - 1];
        new + (number - old)
    };
    for group in &mut surface.groups {
        group.triangles = new_number(group.triangles.start)..new_number(group.triangles.end);
    }
    surface.groups.retain(|group| !group.triangles.is_empty());
}

#[cfg(test)]
mod tests;
