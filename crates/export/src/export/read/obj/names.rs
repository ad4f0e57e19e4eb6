//! Names of parts: groups, objects and materials, of which a file may have any.

use super::super::surface::Group;
use std::sync::Arc;

/// Statement that names what follows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Kind {
    /// `g`
    Group,
    /// `o`
    Object,
    /// `usemtl`
    Material,
}

/// Names in the order of the file.
#[derive(Default)]
pub(super) struct Names(Vec<Name>);

struct Name {
    kind: Kind,
    /// First triangle that follows.
    first: usize,
    name: Arc<str>,
}

impl Names {
    /// Begins a part with the triangle `first`.
    pub(super) fn begin(&mut self, kind: Kind, first: usize, name: &str) {
        self.0.push(Name { kind, first, name: name.into() });
    }

    /// Groups of the `triangles` in all.
    ///
    /// If a group has a name, groups and objects make the groups. Otherwise the objects do, unless
    /// there is only one of them and the materials distinguish more.
    pub(super) fn groups(&self, triangles: usize) -> Vec<Group> {
        let named = |group: &Group| !["", "default", "(null)", "off"].contains(&&*group.name);
        if self.of(&[Kind::Group], triangles).iter().any(named) {
            return self.of(&[Kind::Group, Kind::Object], triangles);
        }
        let (objects, materials) = (self.of(&[Kind::Object], triangles), self.of(&[Kind::Material], triangles));
        if objects.is_empty() || objects.len() == 1 && materials.len() > 1 {
            return if materials.is_empty() { self.of(&[Kind::Group], triangles) } else { materials };
        }
        objects
    }

    /// Groups that begin with statements of some kinds.
    fn of(&self, kinds: &[Kind], triangles: usize) -> Vec<Group> {
        let mut groups: Vec<Group> = Vec::new();
        for Name { first, name, .. } in self.0.iter().filter(|name| kinds.contains(&name.kind)) {
            end(&mut groups, *first);
            groups.push(Group { name: Arc::clone(name), triangles: *first..*first });
        }
        end(&mut groups, triangles);
        groups
    }
}

/// Ends the last group, or removes it if it is empty.
fn end(groups: &mut Vec<Group>, triangles: usize) {
    if let Some(last) = groups.last_mut() {
        last.triangles.end = triangles;
        if last.triangles.is_empty() {
            groups.pop();
        }
    }
}
