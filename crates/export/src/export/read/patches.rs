//! Groups from the numbers that some formats hold for each face.

use super::surface::{Group, Surface};
use std::collections::HashMap;
use std::sync::Arc;

/// Makes a group of each run of triangles with the same number.
#[derive(Default)]
pub(super) struct Patches {
    /// Names by number; `patch 7` and the like where the file has none.
    names: HashMap<i64, Arc<str>>,
    /// Number of the last group.
    last: Option<i64>,
}

impl Patches {
    /// Gives a number a name; the first one holds.
    pub(super) fn name(&mut self, number: i64, name: &str) {
        self.names.entry(number).or_insert_with(|| name.into());
    }

    /// Puts the triangles from `first` on into the patch of a number.
    pub(super) fn add(&mut self, surface: &mut Surface, first: usize, number: i64) {
        let end = surface.triangles.len();
        if first == end {
            return;
        }
        if let Some(group) = surface.groups.last_mut()
            && self.last == Some(number)
            && group.triangles.end == first
        {
            group.triangles.end = end;
            return;
        }
        let name = self.names.entry(number).or_insert_with(|| format!("patch {number}").into());
        surface.groups.push(Group { name: name.clone(), triangles: first..end });
        self.last = Some(number);
    }
}
