//! The topology of the triangles: edges, fans around vertices, components and their Euler numbers.
//!
//! Edges are not stored. A counting sort lists the triangles at each vertex, and each edge is examined at the lesser of its
//! two vertices.

use super::surface::{Coordinate, Surface, few};
use super::types::{Component, FailureKind, Failures};
use rayon::prelude::*;

/// Findings on the topology.
pub(super) struct Topology {
    pub(super) open_edges: u64,
    pub(super) bad_edges: u64,
    pub(super) bad_vertices: u64,
    pub(super) disoriented_edges: u64,
    /// Components in the order of their least vertices.
    pub(super) bodies: Vec<Body>,
    /// Triangles with the same three vertices.
    pub(super) copies: Copies,
    /// Component of each vertex; unspecified for vertices without triangles.
    label: Vec<u32>,
}

/// Triangles that have the same three vertices as another one, in either orientation; not those of which two vertices are
/// the same.
#[derive(Default)]
pub(super) struct Copies {
    /// For each such triangle the least one of its group and itself, sorted: a group is a run of equal first items.
    pairs: Vec<[u32; 2]>,
}

impl Copies {
    /// The groups in ascending order, each as (least triangle, triangle) for all its triangles in ascending order.
    pub(super) fn groups(&self) -> impl Iterator<Item = &[[u32; 2]]> {
        self.pairs.chunk_by(|a, b| a[0] == b[0])
    }

    pub(super) fn is_empty(&self) -> bool {
        self.pairs.is_empty()
    }

    /// How many triangles have the vertices of `triangle`, which must be the least of its group or have no copies.
    pub(super) fn of(&self, triangle: u32) -> u64 {
        let begin = self.pairs.partition_point(|pair| pair[0] < triangle);
        let count = self.pairs[begin..].partition_point(|pair| pair[0] == triangle);
        count.max(1) as u64
    }
}

/// A component.
#[derive(Clone, Default)]
pub(super) struct Body {
    pub(super) vertices: u64,
    pub(super) edges: u64,
    pub(super) triangles: u64,
    /// Its least vertex.
    pub(super) vertex: u32,
}

impl Topology {
    /// Component that a triangle belongs to.
    #[inline]
    pub(super) fn body_of(&self, triangle: [u32; 3]) -> usize {
        if self.bodies.len() == 1 { 0 } else { self.label[triangle[0] as usize] as usize }
    }
}

impl Body {
    pub(super) fn euler(&self) -> i64 {
        self.vertices as i64 - self.edges as i64 + self.triangles as i64
    }

    pub(super) fn report(&self, volume_mm3: f64) -> Component {
        Component { vertices: self.vertices, triangles: self.triangles, euler: self.euler(), volume_mm3 }
    }
}

/// Findings at a run of vertices.
#[derive(Default)]
struct Found {
    /// Edges whose lesser vertex is in the run, by component.
    edges: Vec<(u32, u64)>,
    open: Vec<[u32; 2]>,
    bad: Vec<[u32; 2]>,
    disoriented: Vec<[u32; 2]>,
    bad_vertices: Vec<u32>,
    copies: Vec<[u32; 2]>,
}

pub(super) fn examine<C: Coordinate>(surface: &Surface<'_, C>, failures: &mut Failures) -> Topology {
    let stars = Stars::of(surface);
    let label = components(surface);
    let (label, mut bodies) = number(&label, &stars);
    for t in surface.triangles {
        bodies[label[t[0] as usize] as usize].triangles += 1;
    }
    let vertices: Vec<u32> = (0..surface.positions.len() as u32).collect();
    let found: Vec<Found> = vertices
        .par_chunks(8192)
        .map(|run| {
            let (mut found, mut fan) = (Found::default(), Fan::default());
            for &vertex in run {
                let edges = fan.examine(surface, vertex, stars.at(vertex), &mut found);
                let body = label[vertex as usize];
                match found.edges.last_mut() {
                    Some((last, sum)) if *last == body => *sum += edges,
                    _ => found.edges.push((body, edges)),
                }
            }
            found
        })
        .collect();
    for (body, edges) in found.iter().flat_map(|f| &f.edges).filter(|(_, edges)| *edges > 0) {
        bodies[*body as usize].edges += edges;
    }
    let count = |list: fn(&Found) -> usize| found.iter().map(|f| list(f) as u64).sum::<u64>();
    let mut pairs: Vec<[u32; 2]> = found.iter().flat_map(|f| &f.copies).copied().collect();
    pairs.par_sort_unstable();
    let topology = Topology {
        open_edges: count(|f| f.open.len()),
        bad_edges: count(|f| f.bad.len()),
        bad_vertices: count(|f| f.bad_vertices.len()),
        disoriented_edges: count(|f| f.disoriented.len()),
        bodies,
        copies: Copies { pairs },
        label,
    };
    let mut edges = |kind, count: u64, what: &str, list: fn(&Found) -> &Vec<[u32; 2]>| {
        let places = few(found.iter().flat_map(list), |edge| surface.place_of_vertex(edge[0]));
        failures.add(kind, count, format!("{count} {what}"), places);
    };
    edges(FailureKind::OpenEdges, topology.open_edges, "edges belong to one triangle only", |f| &f.open);
    edges(FailureKind::NonManifoldEdges, topology.bad_edges, "edges belong to more than two triangles", |f| &f.bad);
    let what = "edges have both their triangles running along them in the same direction";
    edges(FailureKind::Orientation, topology.disoriented_edges, what, |f| &f.disoriented);
    let places = few(found.iter().flat_map(|f| &f.bad_vertices), |&v| surface.place_of_vertex(v));
    let detail = format!("{} vertices join several fans of triangles", topology.bad_vertices);
    failures.add(FailureKind::NonManifoldVertices, topology.bad_vertices, detail, places);
    topology
}

/// The triangles at each vertex.
struct Stars {
    /// Where the list of each vertex begins; one more at the end.
    begin: Vec<u32>,
    triangles: Vec<u32>,
}

impl Stars {
    fn of<C>(surface: &Surface<'_, C>) -> Self {
        let mut begin = vec![0u32; surface.positions.len() + 1];
        for &v in surface.triangles.iter().flatten() {
            begin[v as usize] += 1;
        }
        let mut sum = 0;
        for b in &mut begin {
            sum += *b;
            *b = sum;
        }
        // Each list is filled from its end, which leaves `begin` at the beginnings and the lists in order.
        let mut triangles = vec![0u32; sum as usize];
        for (t, corners) in surface.triangles.iter().enumerate().rev() {
            for &v in corners {
                let slot = &mut begin[v as usize];
                *slot -= 1;
                triangles[*slot as usize] = t as u32;
            }
        }
        Self { begin, triangles }
    }

    #[inline]
    fn at(&self, vertex: u32) -> &[u32] {
        let v = vertex as usize;
        &self.triangles[self.begin[v] as usize..self.begin[v + 1] as usize]
    }
}

/// Buffers for the examination of vertices, one after the other.
#[derive(Default)]
struct Fan {
    /// For each triangle at the vertex, its next and its last corner after it.
    spokes: Vec<[u32; 2]>,
    /// The other two corners of each triangle, the lesser first, and the triangle.
    others: Vec<([u32; 2], u32)>,
    ends: Vec<(u32, u32, bool)>,
    group: Vec<u32>,
}

impl Fan {
    /// Examines a vertex and the edges to greater vertices; returns the number of these edges.
    fn examine<C>(&mut self, surface: &Surface<'_, C>, vertex: u32, star: &[u32], found: &mut Found) -> u64 {
        self.spokes.clear();
        for &t in star {
            let [a, b, c] = surface.triangles[t as usize];
            self.spokes.push(if a == vertex {
                [b, c]
            } else if b == vertex {
                [c, a]
            } else {
                [a, b]
            });
        }
        // In a cycle of three and more triangles no two have the same vertices.
        let is_cycle = self.is_cycle();
        if !is_cycle || star.len() == 2 {
            self.find_copies(vertex, star, &mut found.copies);
        }
        if is_cycle {
            return self.spokes.iter().filter(|spoke| spoke[0] > vertex).count() as u64;
        }
        self.examine_closely(vertex, found)
    }

    /// Whether the fan is one closed cycle of triangles with the same orientation.
    fn is_cycle(&self) -> bool {
        let spokes = &self.spokes;
        if spokes.len() < 2 || spokes.len() > 24 {
            return false;
        }
        let mut at = spokes[0][1];
        for _ in 1..spokes.len() {
            match spokes.iter().find(|spoke| spoke[0] == at) {
                // Back at the first triangle too early: there is another cycle.
                None => return false,
                Some(_) if at == spokes[0][0] => return false,
                Some(spoke) => at = spoke[1],
            }
        }
        at == spokes[0][0]
    }

    /// Finds triangles with the same vertices, the least of which is `vertex`.
    fn find_copies(&mut self, vertex: u32, star: &[u32], copies: &mut Vec<[u32; 2]>) {
        let Self { spokes, others, .. } = self;
        others.clear();
        let proper = spokes.iter().zip(star).filter(|([b, c], _)| *b > vertex && *c > vertex && b != c);
        others.extend(proper.map(|([b, c], &t)| ([*b.min(c), *b.max(c)], t)));
        others.sort_unstable();
        for same in others.chunk_by(|a, b| a.0 == b.0).filter(|same| same.len() > 1) {
            copies.extend(same.iter().map(|(_, triangle)| [same[0].1, *triangle]));
        }
    }

    fn examine_closely(&mut self, vertex: u32, found: &mut Found) -> u64 {
        let Self { spokes, ends, group, .. } = self;
        ends.clear();
        for (i, spoke) in (0u32..).zip(spokes.iter()) {
            ends.push((spoke[0], i, true));
            ends.push((spoke[1], i, false));
        }
        ends.sort_unstable();
        group.clear();
        group.extend(0..spokes.len() as u32);
        let mut fans = spokes.len();
        let mut edges = 0;
        for edge in ends.chunk_by(|a, b| a.0 == b.0) {
            for pair in edge.windows(2) {
                let (a, b) = (root(group, pair[0].1), root(group, pair[1].1));
                if a != b {
                    group[a.max(b) as usize] = a.min(b);
                    fans -= 1;
                }
            }
            let other = edge[0].0;
            if other > vertex {
                edges += 1;
                match edge {
                    [_] => found.open.push([vertex, other]),
                    [a, b] if a.2 == b.2 => found.disoriented.push([vertex, other]),
                    [_, _] => {}
                    _ => found.bad.push([vertex, other]),
                }
            }
        }
        if fans > 1 {
            found.bad_vertices.push(vertex);
        }
        edges
    }
}

fn root(parent: &mut [u32], mut v: u32) -> u32 {
    while parent[v as usize] != v {
        let above = parent[parent[v as usize] as usize];
        parent[v as usize] = above;
        v = above;
    }
    v
}

/// For each vertex a vertex of its component, the same for all of one: the least.
fn components<C>(surface: &Surface<'_, C>) -> Vec<u32> {
    let mut parent: Vec<u32> = (0..surface.positions.len() as u32).collect();
    for t in surface.triangles {
        let mut least = root(&mut parent, t[0]);
        for &v in &t[1..] {
            let other = root(&mut parent, v);
            if other != least {
                let (low, high) = (least.min(other), least.max(other));
                parent[high as usize] = low;
                least = low;
            }
        }
    }
    for v in 0..parent.len() as u32 {
        // The parent is less than the vertex and has its final value already.
        parent[v as usize] = parent[parent[v as usize] as usize];
    }
    parent
}

/// Numbers the components in the order of their least vertices, and counts their vertices.
fn number(least: &[u32], stars: &Stars) -> (Vec<u32>, Vec<Body>) {
    let (mut label, mut bodies) = (vec![0u32; least.len()], Vec::<Body>::new());
    for (v, &first) in (0u32..).zip(least) {
        if stars.at(v).is_empty() {
            continue;
        }
        if first == v {
            label[v as usize] = bodies.len() as u32;
            bodies.push(Body { vertex: v, ..Body::default() });
        } else {
            label[v as usize] = label[first as usize];
        }
        bodies[label[v as usize] as usize].vertices += 1;
    }
    (label, bodies)
}
