//! Groups from numbers, which some formats store for each face.

use super::surface::{Group, Surface};
use std::collections::HashMap;
use std::sync::Arc;

/// Creates a group from each run of triangles with the same number.
#[derive(Default)]
pub(super) struct Patches {
    /// Names by kind and number. A patch without a name in the file is called `patch 7`, for
    /// example.
    names: HashMap<Numbered, Arc<str>>,
    /// Kind and number of the last group.
    last: Option<Numbered>,
}

/// A kind, such as `patch`, and a number.
pub(super) type Numbered = (&'static str, i64);

impl Patches {
    /// Names a patch, unless it already has a name.
    pub(super) fn name(&mut self, patch: Numbered, name: &str) {
        self.names.entry(patch).or_insert_with(|| name.into());
    }

    /// Assigns the triangles from `first` to the end of the surface to a patch.
    pub(super) fn add(&mut self, surface: &mut Surface, first: usize, patch: Numbered) {
        let end = surface.triangles.len();
        if first == end {
            return;
        }
        if let Some(group) = surface.groups.last_mut()
            && self.last == Some(patch)
            && group.triangles.end == first
        {
            group.triangles.end = end;
            return;
        }
        let (kind, number) = patch;
        let name = self.names.entry(patch).or_insert_with(|| format!("{kind} {number}").into());
        surface.groups.push(Group { name: name.clone(), triangles: first..end });
        self.last = Some(patch);
    }
}
