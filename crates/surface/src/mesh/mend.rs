//! Finds intersecting walls of a slab and separates them by flipping diagonals, if possible.
//!
//! Bounding boxes in the plane select the cells that can intersect, a separating line excludes most
//! of these, and exact tests decide the rest.
//!
//! Invariant: after [`settle`] succeeded on all cells, no two triangles of the slab intersect
//! outside their shared vertices and edges.

use super::slab::{Diagonal, Slab};
use crate::geometry::blocks::Blocks;
use crate::geometry::tri_tri::{Triangle, meet_in_mesh};

/// Maximum number of cells of one group for which all combinations of diagonals are tried. A larger
/// group needs a new section.
const MOST_CELLS: usize = 6;
/// Number of contacts at which flipping is not tried; the slab needs a new section.
const MOST_CONTACTS: usize = 1000;

/// Tests a slab and flips diagonals where walls intersect. `blocks` are the boxes of its cells.
/// `changed` is `None` to test a whole unrefined slab; otherwise only the neighbourhood of these
/// cells (ascending) is tested.
///
/// Returns the number of flipped diagonals, or a point (m) near a contact that no flip removes. The
/// slab must then be discarded.
pub(super) fn settle(slab: &mut Slab, blocks: &Blocks, changed: Option<&[usize]>) -> Result<usize, [f32; 2]> {
    let contacts = match changed {
        None => all_contacts(slab, blocks),
        Some(changed) => contacts_of(slab, blocks, changed),
    };
    if contacts.len() >= MOST_CONTACTS {
        return Err(slab.lower.points[contacts[0].0]);
    }
    let mut flipped = 0;
    for cells in groups(&contacts) {
        flipped += part(slab, blocks, &cells).ok_or_else(|| slab.lower.points[cells[0]])?;
    }
    Ok(flipped)
}

/// All pairs of cells in contact, or the first [`MOST_CONTACTS`]. A cell is paired with itself if
/// its own triangles overlap.
fn all_contacts(slab: &Slab, blocks: &Blocks) -> Vec<(usize, usize)> {
    let parted = slab.parted_from_next();
    let mut contacts = Vec::new();
    for cell in (0..slab.len()).filter(|&cell| !parted[cell]) {
        for cell in [cell, slab.lower.next(cell)] {
            if folded(slab, cell) {
                contacts.push((cell, cell));
            }
        }
    }
    blocks.pairs(|i, j| {
        if contacts.len() >= MOST_CONTACTS {
            return;
        }
        let clear = (parted[i] && slab.lower.next(i) == j) || (parted[j] && slab.lower.next(j) == i);
        if !clear && cells_meet(slab, i, j) {
            contacts.push((i, j));
        }
    });
    contacts
}

/// Pairs in contact that contain at least one of the `changed` cells.
fn contacts_of(slab: &Slab, blocks: &Blocks, changed: &[usize]) -> Vec<(usize, usize)> {
    let mut contacts = Vec::new();
    for &i in changed {
        let parted = slab.is_parted_from_next(i);
        if !parted && folded(slab, i) {
            contacts.push((i, i));
        }
        blocks.query(&blocks.rect(i), |j| {
            let once = j > i || changed.binary_search(&j).is_err();
            if j == i || !once {
                return;
            }
            let clear = (slab.lower.next(i) == j && parted) || (slab.lower.next(j) == i && slab.is_parted_from_next(j));
            if !clear && cells_meet(slab, i, j) {
                contacts.push((i, j));
            }
        });
    }
    contacts
}

/// True if triangles of one cell overlap or one of them has no area.
fn folded(slab: &Slab, cell: usize) -> bool {
    let count = slab.edges(cell) + 1;
    let is_met = |k: usize| {
        let first = slab.triangle_in_space(cell, k);
        (k + 1..count).any(|l| triangles_meet(&first, &slab.triangle_in_space(cell, l)))
    };
    slab.degenerate(cell) || (0..count).any(is_met)
}

/// True if triangles of two cells intersect outside their shared vertices and edges.
fn cells_meet(slab: &Slab, i: usize, j: usize) -> bool {
    let neighbours = slab.lower.next(i) == j || slab.lower.next(j) == i;
    // A cell without area has no exact test; [`folded`] already reports it.
    if (!neighbours && slab.apart(i, j)) || slab.degenerate(i) || slab.degenerate(j) {
        return false;
    }
    (0..=slab.edges(i)).any(|k| {
        let first = slab.triangle_in_space(i, k);
        (0..=slab.edges(j)).any(|l| triangles_meet(&first, &slab.triangle_in_space(j, l)))
    })
}

fn triangles_meet((a, ta): &(Triangle, [u32; 3]), (b, tb): &(Triangle, [u32; 3])) -> bool {
    meet_in_mesh((a, *ta), (b, *tb))
}

/// Groups of cells such that cells of different groups are not in contact; ascending.
fn groups(contacts: &[(usize, usize)]) -> Vec<Vec<usize>> {
    let mut groups: Vec<Vec<usize>> = Vec::new();
    for &(i, j) in contacts {
        let mut merged = if i == j { vec![i] } else { vec![i, j] };
        groups.retain(|group| {
            let touches = group.contains(&i) || group.contains(&j);
            if touches {
                merged.extend(group);
            }
            !touches
        });
        merged.sort_unstable();
        merged.dedup();
        groups.push(merged);
    }
    groups
}

/// Tries the combinations of diagonals of `cells`, fewest flips first, until none of the cells is
/// in contact with any other. Returns the number of flips.
fn part(slab: &mut Slab, blocks: &Blocks, cells: &[usize]) -> Option<usize> {
    if cells.len() > MOST_CELLS {
        return None;
    }
    let mut pairs = Vec::new();
    for &i in cells {
        blocks.query(&blocks.rect(i), |j| {
            if i < j || (i != j && !cells.contains(&j)) {
                pairs.push((i, j));
            }
        });
    }
    let before: Vec<Diagonal> = cells.iter().map(|&cell| slab.diagonals[cell]).collect();
    let mut choices: Vec<u32> = (0..1u32 << cells.len()).collect();
    choices.sort_by_key(|choice| choice.count_ones());
    for choice in choices {
        for (bit, (&cell, &diagonal)) in cells.iter().zip(&before).enumerate() {
            slab.diagonals[cell] = if choice >> bit & 1 == 1 { diagonal.other() } else { diagonal };
        }
        let free = !cells.iter().any(|&cell| folded(slab, cell)) && !pairs.iter().any(|&(i, j)| cells_meet(slab, i, j));
        if free {
            return Some(choice.count_ones() as usize);
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::{MOST_CONTACTS, all_contacts, groups, settle};
    use crate::mesh::slab::{Rim, Slab};

    #[test]
    fn contacts_gather_into_groups() {
        let found = groups(&[(1, 2), (5, 9), (7, 7), (2, 9), (11, 12)]);
        assert_eq!(found, [vec![7], vec![1, 2, 5, 9], vec![11, 12]]);
    }

    /// A star whose upper rim is rotated relative to the lower one: spikes sweep through spikes.
    #[test]
    fn contacts_without_end_are_not_counted() {
        let star = |turn: usize| {
            let point = |i: usize| {
                let radius = if i.is_multiple_of(2) { 5e-4 } else { 1e-3 };
                let angle = std::f32::consts::TAU * ((i + turn) % 3000) as f32 / 3000.0;
                [radius * angle.cos(), radius * angle.sin()]
            };
            Rim { points: (0..3000).map(point).collect(), inner: 3000 }
        };
        let mut slab = Slab::new(star(0), star(300));
        let blocks = slab.blocks();
        assert_eq!(all_contacts(&slab, &blocks).len(), MOST_CONTACTS);
        assert!(settle(&mut slab, &blocks, None).is_err());
    }
}
