//! Groups from patch numbers, which some formats store for each face.

use super::surface::{Group, Surface};
use std::collections::HashMap;
use std::sync::Arc;

/// Creates a group from each run of triangles with the same patch number.
#[derive(Default)]
pub(super) struct Patches {
    /// Names by number. A patch without a name in the file is called `patch 7`, for example.
    names: HashMap<i64, Arc<str>>,
    /// Patch number of the last group.
    last: Option<i64>,
}

impl Patches {
    /// Names a patch, unless it already has a name.
    pub(super) fn name(&mut self, number: i64, name: &str) {
        self.names.entry(number).or_insert_with(|| name.into());
    }

    /// Assigns the triangles from `first` to the end of the surface to a patch.
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
