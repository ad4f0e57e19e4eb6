//! Bends a finished surface along a course.
//!
//! Inside the tube the bending map is injective, so a smooth surface cannot intersect itself after
//! bending. Flat triangles can, and they show as facets in tight bends. Edges farther from their
//! image than the tolerance (`image`) are therefore split. Where two triangles still intersect
//! (`intersection`, exact), their edges and those of their neighbours are split at the midpoints.
//! The straight surface stays the same, and the bent triangles follow the map more closely. Where a
//! leaning surface comes so close to itself that finer triangles do not help, its lean is damped.

mod image;

pub use image::PART_OF_RADIUS;

use super::intersection::{IntersectionSearch, middle_of};
use super::lean::{Centre, Lean};
use crate::geometry::course::Course;
use crate::model::{Mesh, Patch};
use glam::{DVec3, Vec3};
use image::{Tolerance, bent, middle, off, place};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::HashSet;

/// Maximum number of rounds.
const ROUNDS: u32 = 60;
/// Rounds after which the whole lean is halved, and after which it is removed. Without a lean,
/// parts of a surface are far enough apart.
const HALVED: u32 = 20;
const DROPPED: u32 = 40;
/// Edges of a triangle are split if their distance from their image exceeds this fraction of the
/// maximum of the three.
const PART: f64 = 0.3;
/// Distance of an edge from its image below which finer triangles do not help, µm: a few units in
/// the last place of positions.
const FINE_UM: f64 = 0.02;
/// Fraction of the lean that a place loses per round.
const DAMPING: f64 = 0.3;

/// Statistics of the bending: intersecting triangles, and the changes that separated them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Refined {
    /// Number of pairs of triangles that intersected at first.
    pub met: usize,
    /// Number of edges that were split.
    pub split: usize,
    /// Number of places at which the lean was damped.
    pub damped: usize,
    /// Number of rounds of splitting and damping.
    pub rounds: u32,
}

/// Lean of a surface, as needed for damping.
pub struct Leaning<'a> {
    /// Parameters of the lean.
    pub lean: &'a Lean,
    /// z of the vertices before the lean, m.
    pub z: Vec<f32>,
}

/// Bends a surface without changing its triangles.
#[must_use]
pub fn bend(mesh: &Mesh, course: &Course) -> Mesh {
    Mesh { positions: bent(&mesh.positions, course), ..mesh.clone() }
}

/// Bends a straight surface so that its edges are near their images and its triangles do not
/// intersect. Splits edges of the straight surface as needed, and damps its lean as a last resort.
///
/// New vertices follow the others; none lies on an edge in a plane across the tube. Returns the
/// bent surface, the statistics, and the edges whose midpoints the new vertices are, in order.
/// `stop` is called between rounds; if it returns true, the surface stays as it is.
pub fn bend_apart(
    straight: &mut Mesh,
    mut leaning: Option<Leaning<'_>>,
    course: &Course,
    stop: &dyn Fn() -> bool,
) -> (Mesh, Refined, Vec<(u32, u32)>) {
    let (mut done, mut split) = (Refined::default(), Vec::new());
    let mut found = bend(straight, course);
    let tolerance = Tolerance::of(straight, course);
    let mut is_new: Option<Vec<bool>> = None;
    loop {
        let edges = with_longest(straight, tolerance.far_edges(straight, &found, course, is_new.as_deref()));
        if edges.is_empty() || stop() {
            break;
        }
        done.split += edges.len();
        let parts = halve(straight, &edges);
        // All other triangles keep their edges, none of which is far.
        is_new = Some((0..parts.len()).map(|t| is_part(&parts, t)).collect());
        split.extend_from_slice(&edges);
        leaning.iter_mut().for_each(|leaning| leaning.halve(&edges));
        found = extended(found, straight, course);
    }
    let mut pairs = IntersectionSearch::new(&found).all_pairs(&found);
    done.met = pairs.len();
    while !pairs.is_empty() && done.rounds < ROUNDS && !stop() {
        let (mut edges, mut centres) = (Vec::new(), Vec::new());
        for pair in &pairs {
            let before = edges.len();
            pair.iter().for_each(|&t| edges.extend(coarse(straight, course, straight.triangles[t as usize])));
            if let Some(leaning) = leaning.as_ref().filter(|_| edges.len() == before) {
                Centre::add_to_lean(
                    &mut centres,
                    middle_of(straight, *pair, |v| leaning.place(straight, v as usize)),
                    leaning.lean,
                );
            }
        }
        edges.extend(coarse_around(straight, course, &edges));
        let edges = with_longest(straight, edges);
        done.rounds += 1;
        done.split += edges.len();
        done.damped += centres.len();
        let mut is_met = vec![false; straight.triangles.len()];
        pairs.as_flattened().iter().for_each(|&t| is_met[t as usize] = true);
        let parts = halve(straight, &edges);
        split.extend_from_slice(&edges);
        let mut is_moved = vec![false; straight.positions.len()];
        if let Some(leaning) = &mut leaning {
            leaning.halve(&edges);
            let all = match done.rounds {
                HALVED => 0.5,
                DROPPED => 0.0,
                _ => 1.0,
            };
            is_moved = leaning.damp(straight, &centres, all);
        }
        if edges.is_empty() && !is_moved.contains(&true) {
            break;
        }
        found = if is_moved.contains(&true) { bend(straight, course) } else { extended(found, straight, course) };
        let is_changed: Vec<bool> = (0..parts.len())
            .map(|t| {
                is_met[parts[t] as usize]
                    || is_part(&parts, t)
                    || straight.triangles[t].iter().any(|&v| is_moved[v as usize])
            })
            .collect();
        pairs = IntersectionSearch::new(&found).pairs_touching(&found, |t| is_changed[t]);
    }
    (found, done, split)
}

/// Bent surface after edges of the straight surface were split.
fn extended(before: Mesh, straight: &Mesh, course: &Course) -> Mesh {
    let mut positions = before.positions;
    positions.extend(bent(&straight.positions[positions.len()..], course));
    Mesh { positions, body: straight.body, triangles: straight.triangles.clone(), patches: straight.patches.clone() }
}

/// True if a triangle is one of several parts of an old triangle, given the old triangle of each.
fn is_part(parts: &[u32], t: usize) -> bool {
    let is_of = |other: Option<&u32>| other == Some(&parts[t]);
    is_of(parts.get(t + 1)) || (t > 0 && is_of(parts.get(t - 1)))
}

impl Leaning<'_> {
    /// Position of a vertex before the lean, µm.
    fn place(&self, mesh: &Mesh, v: usize) -> [f64; 3] {
        let [x, y, _] = mesh.positions[v];
        [x, y, self.z[v]].map(|x| f64::from(x) * 1e6)
    }

    /// Appends the midpoints of edges, as [`halve`] does.
    fn halve(&mut self, edges: &[(u32, u32)]) {
        for &(v, w) in edges {
            let [a, b] = [v, w].map(|v| f64::from(self.z[v as usize]));
            self.z.push((0.5 * (a + b)) as f32);
        }
    }

    /// Keeps the fraction `all` of the lean, and less near the centres. Returns which vertices
    /// moved.
    fn damp(&self, mesh: &mut Mesh, centres: &[Centre], all: f64) -> Vec<bool> {
        let mut is_moved = vec![false; self.z.len()];
        for (v, is_moved) in is_moved.iter_mut().enumerate() {
            let place = self.place(mesh, v);
            let left = all * centres.iter().filter_map(|centre| centre.remainder(place, DAMPING)).product::<f64>();
            let (before, now) = (f64::from(self.z[v]), f64::from(mesh.positions[v][2]));
            *is_moved = left < 1.0 && now != before;
            if *is_moved {
                mesh.positions[v][2] = (before + left * (now - before)) as f32;
            }
        }
        is_moved
    }
}

/// Edges of a triangle that are far from their image. None of them lies across the tube.
fn coarse(mesh: &Mesh, course: &Course, triangle: [u32; 3]) -> impl Iterator<Item = (u32, u32)> {
    let edges = edges_of(triangle);
    let image = |v: u32| DVec3::from(place(course, mesh.positions[v as usize].map(f64::from)));
    let off = edges.map(|edge| off(mesh, course, edge, image));
    let least = (PART * off.into_iter().fold(0.0, f64::max)).max(FINE_UM);
    edges.into_iter().zip(off).filter(move |(_, off)| *off > least).map(|(edge, _)| edge)
}

/// Edges far from their image, of all triangles that share a vertex with the given edges.
fn coarse_around(mesh: &Mesh, course: &Course, edges: &[(u32, u32)]) -> Vec<(u32, u32)> {
    let mut is_near = vec![false; mesh.positions.len()];
    edges.iter().for_each(|&(v, w)| [v, w].iter().for_each(|&v| is_near[v as usize] = true));
    let around = mesh.triangles.par_iter().filter(|triangle| triangle.iter().any(|&v| is_near[v as usize]));
    around.flat_map_iter(|&triangle| coarse(mesh, course, triangle)).collect()
}

/// Adds the longest edge of each triangle that loses an edge, so that triangles do not become ever
/// flatter (Rivara, 1984). Returns the edges in order.
fn with_longest(mesh: &Mesh, edges: Vec<(u32, u32)>) -> Vec<(u32, u32)> {
    let mut is_near = vec![false; mesh.positions.len()];
    let mut found: HashSet<(u32, u32)> = HashSet::with_capacity(2 * edges.len());
    let mut added = edges;
    while !added.is_empty() {
        added.iter().for_each(|&(v, w)| [v, w].iter().for_each(|&v| is_near[v as usize] = true));
        found.extend(added);
        let losing = mesh.triangles.par_iter().map(|&triangle| edges_of(triangle)).filter(|edges| {
            edges.iter().any(|&(v, w)| is_near[v as usize] && is_near[w as usize] && found.contains(&(v, w)))
        });
        added = losing.filter_map(|edges| longest(mesh, edges)).filter(|edge| !found.contains(edge)).collect();
    }
    let mut all: Vec<_> = found.into_iter().collect();
    all.sort_unstable();
    all
}

/// Longest of three edges; `None` if it lies across the tube.
fn longest(mesh: &Mesh, edges: [(u32, u32); 3]) -> Option<(u32, u32)> {
    let ends = |(v, w): (u32, u32)| [v, w].map(|v| Vec3::from(mesh.positions[v as usize]));
    let length = |edge: &(u32, u32)| {
        let [p, q] = ends(*edge);
        p.distance_squared(q)
    };
    let longest = edges.into_iter().max_by(|a, b| length(a).total_cmp(&length(b)).then(a.cmp(b)))?;
    let [p, q] = ends(longest);
    (p.z != q.z).then_some(longest)
}

/// Edges of a triangle, the smaller index first.
fn edges_of([a, b, c]: [u32; 3]) -> [(u32, u32); 3] {
    [(a, b), (b, c), (c, a)].map(|(v, w)| (v.min(w), v.max(w)))
}

/// Splits the given edges, which must be sorted, at their midpoints. Returns for each new triangle
/// the old one of which it is a part.
fn halve(mesh: &mut Mesh, edges: &[(u32, u32)]) -> Vec<u32> {
    let first = mesh.positions.len() as u32;
    // Index of the first edge of each vertex. Hashing is slower by far for many edges.
    let mut starts = vec![0_u32; mesh.positions.len() + 1];
    edges.iter().for_each(|&(v, _)| starts[v as usize + 1] += 1);
    (1..starts.len()).for_each(|v| starts[v] += starts[v - 1]);
    for &(v, w) in edges {
        let [p, q] = [v, w].map(|v| mesh.positions[v as usize].map(f64::from));
        mesh.positions.push(middle(p, q).map(|x| x as f32));
    }
    let middle_of = |v: u32, w: u32| {
        let (v, w) = (v.min(w), v.max(w));
        let own = starts[v as usize]..starts[v as usize + 1];
        let other = |edge: &u32| edges[*edge as usize].1 == w;
        own.into_iter().find(other).map(|edge| first + edge)
    };
    let mut triangles = Vec::with_capacity(mesh.triangles.len() + 2 * edges.len());
    let mut parts = Vec::with_capacity(mesh.triangles.len() + 2 * edges.len());
    let patches = mesh.patches.iter().map(|patch| {
        let from = triangles.len();
        for t in patch.triangles.clone() {
            let [a, b, c] = mesh.triangles[t];
            match [middle_of(a, b), middle_of(b, c), middle_of(c, a)] {
                [None, None, None] => triangles.push([a, b, c]),
                [Some(m), None, None] => triangles.extend(one([a, b, c], m)),
                [None, Some(m), None] => triangles.extend(one([b, c, a], m)),
                [None, None, Some(m)] => triangles.extend(one([c, a, b], m)),
                [Some(m), Some(n), None] => triangles.extend(two(&mesh.positions, [a, b, c], m, n)),
                [None, Some(m), Some(n)] => triangles.extend(two(&mesh.positions, [b, c, a], m, n)),
                [Some(n), None, Some(m)] => triangles.extend(two(&mesh.positions, [c, a, b], m, n)),
                [Some(l), Some(m), Some(n)] => triangles.extend([[a, l, n], [l, b, m], [m, c, n], [l, m, n]]),
            }
            parts.resize(triangles.len(), t as u32);
        }
        Patch { kind: patch.kind, triangles: from..triangles.len() }
    });
    mesh.patches = patches.collect();
    mesh.triangles = triangles;
    parts
}

/// Parts of a triangle whose first edge is split.
fn one([a, b, c]: [u32; 3], m: u32) -> [[u32; 3]; 2] {
    [[a, m, c], [m, b, c]]
}

/// Parts of a triangle whose first two edges are split. The longer edge is split first.
fn two(positions: &[[f32; 3]], [a, b, c]: [u32; 3], m: u32, n: u32) -> [[u32; 3]; 3] {
    let square = |v: u32, w: u32| Vec3::from(positions[v as usize]).distance_squared(Vec3::from(positions[w as usize]));
    if square(a, b) >= square(b, c) { [[m, b, n], [m, n, c], [a, m, c]] } else { [[m, b, n], [a, m, n], [a, n, c]] }
}

#[cfg(test)]
mod tests;
