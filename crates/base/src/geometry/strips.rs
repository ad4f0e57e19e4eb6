//! Triangle strips: the same triangles with about one index per triangle instead of three.
//!
//! The strip `v0 v1 v2 v3 …` contains the triangles (v0 v1 v2), (v2 v1 v3), (v2 v3 v4), …. Every
//! second one is reversed, so all have the same orientation. Strips are joined by degenerate
//! triangles (two equal corners), which every reader drops; glTF has no restart index.

/// Covers each triangle exactly once by strips and keeps its orientation.
///
/// The method is greedy: from the first triangle that is not covered, it takes the longest of the
/// three possible walks across shared edges. The time is linear in the number of triangles if the
/// valence is bounded. The result depends only on the input. Degenerate triangles are covered, too.
#[must_use]
pub fn strips(triangles: &[[u32; 3]]) -> Vec<Vec<u32>> {
    let edges = DirectedEdges::new(triangles);
    let mut covered = Covered { visit: vec![Covered::FREE; triangles.len()], walk: Covered::FREE };
    let mut found = Vec::new();
    let mut walk = Walk::default();
    let mut best = Walk::default();
    for (seed, corners) in triangles.iter().enumerate() {
        if covered.is_done(seed) {
            continue;
        }
        best.clear();
        for turn in 0..3 {
            let start = [corners[turn], corners[(turn + 1) % 3], corners[(turn + 2) % 3]];
            walk.follow(seed as u32, start, triangles, &edges, &mut covered);
            if walk.triangles.len() > best.triangles.len() {
                std::mem::swap(&mut walk, &mut best);
            }
        }
        for &triangle in &best.triangles {
            covered.visit[triangle as usize] = Covered::DONE;
        }
        found.push(best.indices.clone());
    }
    found
}

/// Joins strips by degenerate triangles.
#[must_use]
pub fn join_strips(strips: &[Vec<u32>]) -> Vec<u32> {
    let mut joined: Vec<u32> = Vec::with_capacity(strips.iter().map(|s| s.len() + 3).sum());
    for strip in strips {
        let Some(&first) = strip.first() else { continue };
        if let Some(&last) = joined.last() {
            joined.extend([last, first]);
            if joined.len() % 2 == 1 {
                joined.push(first);
            }
        }
        joined.extend_from_slice(strip);
    }
    joined
}

/// Triangles of a strip, without degenerate ones.
pub fn triangles_of_strip(strip: &[u32]) -> impl Iterator<Item = [u32; 3]> + '_ {
    strip
        .windows(3)
        .enumerate()
        .map(|(k, w)| if k % 2 == 0 { [w[0], w[1], w[2]] } else { [w[1], w[0], w[2]] })
        .filter(|t| t[0] != t[1] && t[1] != t[2] && t[2] != t[0])
}

/// Marks triangles of finished strips and of the current walk.
struct Covered {
    visit: Vec<u32>,
    walk: u32,
}

impl Covered {
    const FREE: u32 = 0;
    const DONE: u32 = u32::MAX;

    fn is_done(&self, triangle: usize) -> bool {
        self.visit[triangle] == Self::DONE
    }

    /// Marks the triangle as part of the current walk. Returns false if it was marked already.
    fn enter(&mut self, triangle: u32) -> bool {
        let visit = &mut self.visit[triangle as usize];
        let free = *visit != Self::DONE && *visit != self.walk;
        if free {
            *visit = self.walk;
        }
        free
    }
}

/// A strip under construction.
#[derive(Default)]
struct Walk {
    indices: Vec<u32>,
    triangles: Vec<u32>,
}

impl Walk {
    fn clear(&mut self) {
        self.indices.clear();
        self.triangles.clear();
    }

    fn follow(
        &mut self,
        seed: u32,
        start: [u32; 3],
        triangles: &[[u32; 3]],
        edges: &DirectedEdges,
        covered: &mut Covered,
    ) {
        self.clear();
        // At most three walks per triangle, so `walk` stays below DONE for fewer than 1.4e9
        // triangles.
        covered.walk += 1;
        covered.enter(seed);
        self.triangles.push(seed);
        self.indices.extend(start);
        loop {
            let n = self.indices.len();
            let (b, c) = (self.indices[n - 2], self.indices[n - 1]);
            // After an even number of triangles the last one is not reversed, and its edge is b →
            // c.
            let (from, to) = if n % 2 == 1 { (c, b) } else { (b, c) };
            let next = edges.from(from).iter().find(|&&(end, t)| end == to && covered.enter(t));
            let Some(&(_, triangle)) = next else { return };
            let corners = triangles[triangle as usize];
            let start = (0..3).find(|&k| corners[k] == from && corners[(k + 1) % 3] == to);
            let start = start.expect("the edge was listed for this triangle");
            self.indices.push(corners[(start + 2) % 3]);
            self.triangles.push(triangle);
        }
    }
}

/// Directed edges by start vertex, as pairs (end, triangle) in compressed rows.
struct DirectedEdges {
    rows: Vec<u32>,
    edges: Vec<(u32, u32)>,
}

impl DirectedEdges {
    fn new(triangles: &[[u32; 3]]) -> Self {
        let vertices = triangles.iter().flatten().max().map_or(0, |&v| v as usize + 1);
        let mut rows = vec![0u32; vertices + 1];
        for &v in triangles.iter().flatten() {
            rows[v as usize + 1] += 1;
        }
        for v in 0..vertices {
            rows[v + 1] += rows[v];
        }
        let mut edges = vec![(0, 0); triangles.len() * 3];
        let mut next = rows.clone();
        for (t, corners) in triangles.iter().enumerate() {
            for k in 0..3 {
                let slot = &mut next[corners[k] as usize];
                edges[*slot as usize] = (corners[(k + 1) % 3], t as u32);
                *slot += 1;
            }
        }
        Self { rows, edges }
    }

    fn from(&self, vertex: u32) -> &[(u32, u32)] {
        let v = vertex as usize;
        &self.edges[self.rows[v] as usize..self.rows[v + 1] as usize]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn turned(t: [u32; 3]) -> [u32; 3] {
        let least = (0..3).min_by_key(|&k| t[k]).unwrap();
        [t[least], t[(least + 1) % 3], t[(least + 2) % 3]]
    }

    fn sorted(triangles: impl Iterator<Item = [u32; 3]>) -> Vec<[u32; 3]> {
        let mut all: Vec<_> = triangles.map(turned).collect();
        all.sort_unstable();
        all
    }

    fn check(triangles: &[[u32; 3]]) {
        let found = strips(triangles);
        let expected = sorted(triangles.iter().copied());
        assert_eq!(sorted(found.iter().flat_map(|s| triangles_of_strip(s))), expected);
        assert_eq!(sorted(triangles_of_strip(&join_strips(&found))), expected);
    }

    #[test]
    fn a_ring_of_quads_is_one_strip() {
        let n = 40;
        let mut triangles = Vec::new();
        for i in 0..n {
            let j = (i + 1) % n;
            triangles.extend([[i, j, n + i], [j, n + j, n + i]]);
        }
        assert_eq!(strips(&triangles).len(), 1);
        check(&triangles);
    }

    #[test]
    fn odd_strips_join_without_turning_over() {
        check(&[[0, 1, 2], [3, 4, 5], [5, 4, 6], [7, 8, 9]]);
        check(&[]);
    }

    proptest! {
        #[test]
        fn any_triangles_are_covered_once(
            corners in prop::collection::vec((0u32..12, 1u32..6, 6u32..12), 0..60),
        ) {
            let triangles: Vec<_> = corners.iter().map(|&(a, d, e)| [a, (a + d) % 12, (a + e) % 12]).collect();
            check(&triangles);
        }
    }
}
