//! Makes a simplified surface sound again: closed, each edge between exactly two triangles, each vertex with one fan.
//!
//! The simplifier may collapse an edge whose ends have a common neighbour besides the two opposite corners (it does not test
//! the link condition). Two edges then join the same two vertices. Turning one of them, within the two triangles beside it,
//! leaves one; the surface keeps its topology if it is the right pair of triangles, which shows in the fans of both ends.

use super::full::Level;
use crate::model::Mesh;
use std::collections::HashSet;

/// Rounds of mending. A round leaves out edges that are near others it has turned.
const ROUNDS: usize = 8;

/// Turns edges until the surface is sound and has the Euler number of its body; false if that cannot be achieved.
pub(super) fn mend(level: &mut Level<'_>, mesh: &Mesh) -> bool {
    for _ in 0..ROUNDS {
        let fans = Fans::new(level, mesh.positions.len());
        let unsound: Vec<u32> = (0..mesh.positions.len() as u32).filter(|&v| !is_cycle(&fans.link(v))).collect();
        if unsound.is_empty() {
            let used = fans.first.windows(2).filter(|pair| pair[0] < pair[1]).count() as i64;
            // A closed surface has three edges for two triangles.
            return used - fans.triangles.len() as i64 / 2 == mesh.body.euler();
        }
        let mut turned = HashSet::new();
        for v in unsound {
            fans.turn_at(v, level, &mut turned);
        }
        if turned.is_empty() {
            return false;
        }
    }
    false
}

/// A triangle that begins at a vertex: place of the triangle, and its vertices from that one on.
#[derive(Clone, Copy)]
struct Blade {
    place: (usize, usize),
    vertices: [u32; 3],
}

/// The triangles around each vertex.
struct Fans {
    /// Vertex `v` is a corner of the triangles `around[first[v]..first[v + 1]]`.
    first: Vec<u32>,
    around: Vec<u32>,
    /// All triangles, and where those of each patch end.
    triangles: Vec<[u32; 3]>,
    places: Vec<usize>,
}

impl Fans {
    fn new(level: &Level<'_>, count: usize) -> Self {
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
        let places = level.iter().scan(0, |end, patch| {
            *end += patch.len();
            Some(*end)
        });
        Self { first, around, triangles, places: places.collect() }
    }

    /// The triangles around a vertex, by index.
    fn of(&self, v: u32) -> &[u32] {
        &self.around[self.first[v as usize] as usize..self.first[v as usize + 1] as usize]
    }

    /// The directed edges opposite to a vertex.
    fn link(&self, v: u32) -> Vec<[u32; 2]> {
        self.of(v).iter().map(|&i| after(self.triangles[i as usize], v)).collect()
    }

    /// The triangles around a vertex with their places.
    fn blades(&self, v: u32) -> Vec<Blade> {
        let blade = |&i: &u32| {
            let patch = self.places.partition_point(|&end| end <= i as usize);
            let begin = if patch == 0 { 0 } else { self.places[patch - 1] };
            let place = (patch, i as usize - begin);
            let [b, c] = after(self.triangles[i as usize], v);
            Blade { place, vertices: [v, b, c] }
        };
        self.of(v).iter().map(blade).collect()
    }

    /// Turns an edge of `a` that another edge doubles, if that joins the fans of both ends into one cycle each.
    fn turn_at(&self, a: u32, level: &mut Level<'_>, turned: &mut HashSet<u32>) {
        let blades = self.blades(a);
        for t in &blades {
            let [_, b, c] = t.vertices;
            if blades.iter().filter(|other| other.vertices[1] == b).count() < 2 {
                continue;
            }
            for s in blades.iter().filter(|s| s.vertices[2] == b && s.place.0 == t.place.0) {
                let d = s.vertices[1];
                let apart = c != d && !self.link(c).iter().any(|edge| edge.contains(&d));
                if !apart || [a, b, c, d].iter().any(|v| turned.contains(v)) {
                    continue;
                }
                let at_a = replaced(self.link(a), [[b, c], [d, b]], [d, c]);
                let at_b = replaced(self.link(b), [[c, a], [a, d]], [c, d]);
                if is_connected(&at_a) && is_connected(&at_b) {
                    level[t.place.0].to_mut()[t.place.1] = [a, d, c];
                    level[s.place.0].to_mut()[s.place.1] = [d, b, c];
                    turned.extend([a, b, c, d]);
                    return;
                }
            }
        }
    }
}

/// The edge of a triangle opposite to one of its vertices.
fn after([a, b, c]: [u32; 3], v: u32) -> [u32; 2] {
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

/// Whether directed edges form one cycle, or there are none.
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

/// Whether edges are connected, whatever their directions.
fn is_connected(link: &[[u32; 2]]) -> bool {
    let mut rest = link.to_vec();
    let mut reached: Vec<u32> = rest.pop().into_iter().flatten().collect();
    while let Some(at) = rest.iter().position(|edge| edge.iter().any(|v| reached.contains(v))) {
        reached.extend(rest.swap_remove(at));
    }
    rest.is_empty()
}
