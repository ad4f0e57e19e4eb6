//! Topology of the triangles: edges, fans around vertices, components and their Euler numbers.
//!
//! Edges are not stored. A counting sort lists the triangles at each vertex, and each edge is
//! examined at the smaller of its two vertices. Triangles that share a vertex may intersect
//! elsewhere. For nearly all vertices `Fan::is_spread` proves that they do not.

use super::components::{ComponentCounts, components, number, root};
use super::shape::{TriangleMeasures, Turns};
use super::surface::{Coordinate, Surface, Tally, few};
use super::types::{FailureKind, Failures};
use rayon::prelude::*;

/// Number of vertices per task.
const RUN: usize = 8192;

/// Findings on the topology.
pub(super) struct Topology {
    pub(super) connectivity: Connectivity,
    pub(super) faults: Faults,
    /// Triangles with the same three vertices.
    pub(super) copies: Copies,
    /// Vertices at which triangles may intersect, with these triangles.
    pub(super) crowded: Vec<(u32, Box<[u32]>)>,
}

/// Components of a surface.
pub(super) struct Connectivity {
    /// Components in the order of their smallest vertices. [`examine`] counts their edges.
    pub(super) bodies: Vec<ComponentCounts>,
    /// Component of each vertex; unspecified for a vertex without triangles.
    label: Vec<u32>,
}

/// Faults of edges and vertices.
pub(super) struct Faults {
    pub(super) open_edges: Tally,
    pub(super) bad_edges: Tally,
    pub(super) disoriented_edges: Tally,
    pub(super) bad_vertices: Tally,
}

impl Faults {
    fn of<C: Coordinate>(surface: &Surface<'_, C>, found: &[FanFindings]) -> Self {
        let edges = |list: fn(&FanFindings) -> &Vec<[u32; 2]>| Tally {
            count: found.iter().map(|f| list(f).len() as u64).sum(),
            places: few(found.iter().flat_map(list), |edge| surface.place_of_vertex(edge[0])),
        };
        Self {
            open_edges: edges(|f| &f.open),
            bad_edges: edges(|f| &f.bad),
            disoriented_edges: edges(|f| &f.disoriented),
            bad_vertices: Tally {
                count: found.iter().map(|f| f.bad_vertices.len() as u64).sum(),
                places: few(found.iter().flat_map(|f| &f.bad_vertices), |&v| surface.place_of_vertex(v)),
            },
        }
    }

    pub(super) fn report(&self, failures: &mut Failures) {
        self.open_edges.report(FailureKind::OpenEdges, "edges belong to one triangle only", failures);
        let what = "edges belong to more than two triangles";
        self.bad_edges.report(FailureKind::NonManifoldEdges, what, failures);
        let what = "edges have both their triangles running along them in the same direction";
        self.disoriented_edges.report(FailureKind::Orientation, what, failures);
        let what = "vertices join several fans of triangles";
        self.bad_vertices.report(FailureKind::NonManifoldVertices, what, failures);
    }

    /// True if the surface encloses a volume: every edge has two triangles of the same orientation.
    pub(super) fn has_volume(&self) -> bool {
        self.open_edges.count + self.bad_edges.count + self.disoriented_edges.count == 0
    }
}

/// Triangles with the same three vertices as another triangle, in either orientation. Excludes
/// triangles with a repeated vertex.
#[derive(Default)]
pub(super) struct Copies {
    /// Pairs of the smallest triangle of a group and each triangle of that group, sorted. A group
    /// is a run of equal first items.
    pairs: Vec<[u32; 2]>,
}

impl Copies {
    fn among(found: &[FanFindings]) -> Self {
        let mut pairs: Vec<[u32; 2]> = found.iter().flat_map(|f| &f.copies).copied().collect();
        pairs.par_sort_unstable();
        Self { pairs }
    }

    /// Groups in ascending order, each as pairs of (smallest triangle, triangle).
    pub(super) fn groups(&self) -> impl Iterator<Item = &[[u32; 2]]> {
        self.pairs.chunk_by(|a, b| a[0] == b[0])
    }

    pub(super) fn is_empty(&self) -> bool {
        self.pairs.is_empty()
    }

    /// Number of triangles with the vertices of `triangle`, which must be the smallest of its group
    /// or have no copies.
    pub(super) fn of(&self, triangle: u32) -> u64 {
        let begin = self.pairs.partition_point(|pair| pair[0] < triangle);
        let count = self.pairs[begin..].partition_point(|pair| pair[0] == triangle);
        count.max(1) as u64
    }
}

impl Connectivity {
    pub(super) fn of<C: Coordinate>(surface: &Surface<'_, C>, stars: &Stars) -> Self {
        let least = components(surface.positions.len() as u32, surface.triangles);
        let (label, mut bodies) = number(&least, |v| !stars.at(v).is_empty());
        for t in surface.triangles {
            bodies[label[t[0] as usize] as usize].triangles += 1;
        }
        Self { bodies, label }
    }

    /// Component of a triangle.
    #[inline]
    pub(super) fn body_of(&self, triangle: [u32; 3]) -> usize {
        if self.bodies.len() == 1 { 0 } else { self.label[triangle[0] as usize] as usize }
    }
}

/// Findings at a run of vertices.
#[derive(Default)]
struct FanFindings {
    /// Number of edges whose smaller vertex is in the run, by component.
    edges: Vec<(u32, u64)>,
    open: Vec<[u32; 2]>,
    bad: Vec<[u32; 2]>,
    disoriented: Vec<[u32; 2]>,
    bad_vertices: Vec<u32>,
    copies: Vec<[u32; 2]>,
    /// Vertices whose triangles may intersect outside their shared vertices and edges, with these
    /// triangles.
    crowded: Vec<(u32, Box<[u32]>)>,
}

/// Examines a surface whose triangles have the orientations `turns`. `stars` takes much memory,
/// which is freed as early as possible.
pub(super) fn examine<C: Coordinate>(
    surface: &Surface<'_, C>,
    stars: Stars,
    mut connectivity: Connectivity,
    turns: &[Turns],
    failures: &mut Failures,
) -> Topology {
    let mut found = fans(surface, &stars, &connectivity, turns);
    drop(stars);
    for (body, edges) in found.iter().flat_map(|f| &f.edges).filter(|(_, edges)| *edges > 0) {
        connectivity.bodies[*body as usize].edges += edges;
    }
    let faults = Faults::of(surface, &found);
    faults.report(failures);
    let crowded = found.iter_mut().flat_map(|f| std::mem::take(&mut f.crowded)).collect();
    Topology { connectivity, faults, copies: Copies::among(&found), crowded }
}

/// Examines a surface whose measures are not needed.
pub(super) fn examine_alone<C: Coordinate>(surface: &Surface<'_, C>, failures: &mut Failures) -> Topology {
    let mut turns = vec![Turns::ANY; surface.triangles.len()];
    TriangleMeasures::of(surface, [0.0; 3], |_| 0, &mut turns);
    let stars = Stars::of(surface);
    let connectivity = Connectivity::of(surface, &stars);
    examine(surface, stars, connectivity, &turns, failures)
}

/// Examines all vertices and the edges from each vertex to larger ones.
fn fans<C: Coordinate>(
    surface: &Surface<'_, C>,
    stars: &Stars,
    connectivity: &Connectivity,
    turns: &[Turns],
) -> Vec<FanFindings> {
    let vertices = surface.positions.len() as u32;
    let starts: Vec<u32> = (0..vertices).step_by(RUN).collect();
    let examine = |&start: &u32| {
        let (mut found, mut fan) = (FanFindings::default(), Fan::default());
        for vertex in start..vertices.min(start + RUN as u32) {
            let edges = fan.examine(surface, vertex, stars.at(vertex), turns, &mut found);
            let body = connectivity.label[vertex as usize];
            match found.edges.last_mut() {
                Some((last, sum)) if *last == body => *sum += edges,
                _ => found.edges.push((body, edges)),
            }
        }
        found
    };
    starts.par_iter().map(examine).collect()
}

/// Triangles at each vertex.
pub(super) struct Stars {
    /// Start of the list of each vertex, and the end.
    begin: Vec<u32>,
    triangles: Vec<u32>,
}

impl Stars {
    pub(super) fn of<C>(surface: &Surface<'_, C>) -> Self {
        let mut begin = vec![0; surface.positions.len() + 1];
        for &v in surface.triangles.as_flattened() {
            begin[v as usize] += 1;
        }
        let mut sum = 0;
        for b in &mut begin {
            sum += *b;
            *b = sum;
        }
        // Each list is filled from its end. Afterwards `begin` contains the starts, and the lists
        // are sorted.
        let mut triangles = vec![0; sum as usize];
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

/// Buffers for examining one vertex after the other.
#[derive(Default)]
struct Fan {
    /// The two other corners of each triangle at the vertex, in the order of the triangle.
    spokes: Vec<[u32; 2]>,
    /// Sorted spokes of a vertex that has many.
    sorted: Vec<[u32; 2]>,
    /// Other ends of the edges at the vertex, in order, if its triangles form a cycle.
    ring: Vec<u32>,
    /// The two other corners of each triangle, the smaller first, and the triangle.
    others: Vec<([u32; 2], u32)>,
    ends: Vec<(u32, u32, bool)>,
    group: Vec<u32>,
}

impl Fan {
    /// Examines a vertex and the edges to larger vertices. Returns the number of these edges.
    fn examine<C: Coordinate>(
        &mut self,
        surface: &Surface<'_, C>,
        vertex: u32,
        star: &[u32],
        turns: &[Turns],
        found: &mut FanFindings,
    ) -> u64 {
        let spoke = |&t: &u32| {
            let [a, b, c] = surface.triangles[t as usize];
            if a == vertex {
                [b, c]
            } else if b == vertex {
                [c, a]
            } else {
                [a, b]
            }
        };
        self.spokes.clear();
        self.spokes.extend(star.iter().map(spoke));
        let all = star.iter().fold(Turns::ANY, |all, &t| all.and(turns[t as usize]));
        // In a cycle of three or more triangles, no two have the same vertices.
        let is_cycle = self.is_cycle();
        if !is_cycle || star.len() == 2 {
            self.find_copies(vertex, star, &mut found.copies);
        }
        if star.len() > 1 && !(is_cycle && self.is_spread(surface, vertex, all)) {
            found.crowded.push((vertex, star.into()));
        }
        if is_cycle {
            return self.spokes.iter().filter(|spoke| spoke[0] > vertex).count() as u64;
        }
        self.examine_closely(vertex, found)
    }

    /// True if the fan is one closed cycle of triangles with the same orientation. `ring` is then
    /// in order.
    fn is_cycle(&mut self) -> bool {
        let Self { spokes, sorted, ring, .. } = self;
        ring.clear();
        if spokes.len() < 2 {
            return false;
        }
        // Few spokes are searched linearly.
        let are_many = spokes.len() > 24;
        if are_many {
            sorted.clone_from(spokes);
            sorted.sort_unstable();
        }
        let [begin, mut at] = spokes[0];
        ring.push(begin);
        for _ in 1..spokes.len() {
            let next = if are_many {
                sorted.get(sorted.partition_point(|spoke| spoke[0] < at)).filter(|spoke| spoke[0] == at)
            } else {
                spokes.iter().find(|spoke| spoke[0] == at)
            };
            match next {
                // The first triangle comes too early, so there is another cycle.
                None => return false,
                Some(_) if at == begin => return false,
                Some(spoke) => {
                    ring.push(at);
                    at = spoke[1];
                }
            }
        }
        at == begin
    }

    /// True if the triangles of a cycle provably have no common points except the vertex and their
    /// common edges: seen along some axis, all turn the same way, and together they go around the
    /// vertex once. This holds for nearly every vertex of smooth walls.
    fn is_spread<C: Coordinate>(&self, surface: &Surface<'_, C>, vertex: u32, turns: Turns) -> bool {
        let centre = surface.point(vertex);
        (0..3).filter(|&axis| turns.agree(axis)).any(|axis| {
            let (x, y) = ((axis + 1) % 3, (axis + 2) % 3);
            let is_upper = |&v: &u32| {
                let p = surface.point(v);
                p[y] > centre[y] || (p[y] == centre[y] && p[x] > centre[x])
            };
            // From each edge to the next is less than half a turn, so every revolution enters this
            // half-plane once.
            let mut entered = 0;
            let mut was_upper = self.ring.last().is_some_and(is_upper);
            for v in &self.ring {
                let upper = is_upper(v);
                entered += u32::from(upper && !was_upper);
                was_upper = upper;
            }
            entered == 1
        })
    }

    /// Finds triangles with the same vertices, of which `vertex` is the smallest.
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

    fn examine_closely(&mut self, vertex: u32, found: &mut FanFindings) -> u64 {
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
