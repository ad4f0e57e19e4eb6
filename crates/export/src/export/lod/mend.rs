//! Mends a simplified surface, so that it is closed: each edge belongs to exactly two triangles,
//! and the triangles around each vertex form one fan.
//!
//! The simplifier does not test the link condition, so it may collapse an edge whose ends have a
//! common neighbour besides the two opposite corners. Two edges then join the same two vertices.
//! Flipping one of them within its two triangles removes the duplicate. The flip keeps the topology
//! if it joins the fans of both ends into one cycle each.

use super::full::PatchTriangles;
use crate::model::Mesh;
use std::collections::HashSet;

/// Maximum number of rounds. A round skips edges near an edge that it has flipped.
const ROUNDS: usize = 8;

/// Flips edges until the surface is closed and has the Euler number of its body. Returns false on
/// failure.
pub(super) fn mend(level: &mut PatchTriangles<'_>, mesh: &Mesh) -> bool {
    for _ in 0..ROUNDS {
        let fans = Fans::new(level, mesh.positions.len());
        let open: Vec<u32> = (0..mesh.positions.len() as u32).filter(|&v| !is_cycle(&fans.link(v))).collect();
        if open.is_empty() {
            let used = fans.first.windows(2).filter(|pair| pair[0] < pair[1]).count() as i64;
            // Euler's formula for a closed surface, which has 3/2 edges per triangle.
            return used - fans.triangles.len() as i64 / 2 == mesh.body.euler();
        }
        let mut flipped = HashSet::new();
        for v in open {
            fans.flip_at(v, level, &mut flipped);
        }
        if flipped.is_empty() {
            return false;
        }
    }
    false
}

/// A triangle of a fan.
#[derive(Clone, Copy)]
struct FanTriangle {
    /// Index of the patch, and of the triangle in the patch.
    place: (usize, usize),
    /// Vertices of the triangle, the centre of the fan first.
    vertices: [u32; 3],
}

/// Triangles around each vertex.
struct Fans {
    /// Vertex `v` is a corner of the triangles `around[first[v]..first[v + 1]]`.
    first: Vec<u32>,
    around: Vec<u32>,
    /// Triangles of all patches.
    triangles: Vec<[u32; 3]>,
    /// End of each patch in `triangles`.
    patch_ends: Vec<usize>,
}

impl Fans {
    fn new(level: &PatchTriangles<'_>, count: usize) -> Self {
        let triangles: Vec<[u32; 3]> = level.iter().flat_map(|patch| patch.iter().copied()).collect();
        let mut first = vec![0; count + 1];
        triangles.as_flattened().iter().for_each(|&v| first[v as usize + 1] += 1);
        for v in 0..count {
            first[v + 1] += first[v];
        }
        let (mut next, mut around) = (first.clone(), vec![0; triangles.len() * 3]);
        for (i, t) in triangles.iter().enumerate() {
            for &v in t {
                around[next[v as usize] as usize] = i as u32;
                next[v as usize] += 1;
            }
        }
        let patch_ends = level.iter().scan(0, |end, patch| {
            *end += patch.len();
            Some(*end)
        });
        Self { first, around, triangles, patch_ends: patch_ends.collect() }
    }

    /// Indices of the triangles around a vertex.
    fn of(&self, v: u32) -> &[u32] {
        &self.around[self.first[v as usize] as usize..self.first[v as usize + 1] as usize]
    }

    /// Directed edges opposite to a vertex.
    fn link(&self, v: u32) -> Vec<[u32; 2]> {
        self.of(v).iter().map(|&i| opposite_edge(self.triangles[i as usize], v)).collect()
    }

    /// Fan of a vertex.
    fn fan(&self, v: u32) -> Vec<FanTriangle> {
        let triangle = |&i: &u32| {
            let patch = self.patch_ends.partition_point(|&end| end <= i as usize);
            let begin = if patch == 0 { 0 } else { self.patch_ends[patch - 1] };
            let place = (patch, i as usize - begin);
            let [b, c] = opposite_edge(self.triangles[i as usize], v);
            FanTriangle { place, vertices: [v, b, c] }
        };
        self.of(v).iter().map(triangle).collect()
    }

    /// Flips a duplicate edge of `a`, if that joins the fans of both ends into one cycle each.
    fn flip_at(&self, a: u32, level: &mut PatchTriangles<'_>, flipped: &mut HashSet<u32>) {
        let fan = self.fan(a);
        for t in &fan {
            let [_, b, c] = t.vertices;
            if fan.iter().filter(|other| other.vertices[1] == b).count() < 2 {
                continue;
            }
            for s in fan.iter().filter(|s| s.vertices[2] == b && s.place.0 == t.place.0) {
                let d = s.vertices[1];
                let apart = c != d && !self.link(c).iter().any(|edge| edge.contains(&d));
                if !apart || [a, b, c, d].iter().any(|v| flipped.contains(v)) {
                    continue;
                }
                let at_a = replaced(self.link(a), [[b, c], [d, b]], [d, c]);
                let at_b = replaced(self.link(b), [[c, a], [a, d]], [c, d]);
                if is_connected(&at_a) && is_connected(&at_b) {
                    level[t.place.0].to_mut()[t.place.1] = [a, d, c];
                    level[s.place.0].to_mut()[s.place.1] = [d, b, c];
                    flipped.extend([a, b, c, d]);
                    return;
                }
            }
        }
    }
}

/// Edge of a triangle opposite to one of its vertices.
fn opposite_edge([a, b, c]: [u32; 3], v: u32) -> [u32; 2] {
    if v == a {
        [b, c]
    } else if v == b {
        [c, a]
    } else {
        [a, b]
    }
}

fn replaced(mut link: Vec<[u32; 2]>, old: [[u32; 2]; 2], new: [u32; 2]) -> Vec<[u32; 2]> {
    for edge in old {
        if let Some(at) = link.iter().position(|e| *e == edge) {
            link.swap_remove(at);
        }
    }
    link.push(new);
    link
}

/// True if directed edges form one cycle, or there are none.
fn is_cycle(link: &[[u32; 2]]) -> bool {
    let Some(&[start, mut at]) = link.first() else { return true };
    let mut steps = 1;
    while at != start && steps <= link.len() {
        let mut next = link.iter().filter(|edge| edge[0] == at);
        let (Some(edge), None) = (next.next(), next.next()) else { return false };
        at = edge[1];
        steps += 1;
    }
    steps == link.len()
}

/// True if edges are connected, regardless of their directions.
fn is_connected(link: &[[u32; 2]]) -> bool {
    let mut rest = link.to_vec();
    let mut reached: Vec<u32> = rest.pop().into_iter().flatten().collect();
    while let Some(at) = rest.iter().position(|edge| edge.iter().any(|v| reached.contains(v))) {
        reached.extend(rest.swap_remove(at));
    }
    rest.is_empty()
}
