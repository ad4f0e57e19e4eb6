//! Triangles with their neighbours, and the local changes that remeshing consists of.
//!
//! Invariant: triangles are counter-clockwise in (u, z). Every edge belongs to two triangles,
//! except edges on the border, whose vertices are fixed.

/// No triangle, or no vertex.
pub(super) const NONE: u32 = u32::MAX;

/// A triangulated sheet.
#[derive(Default)]
pub(super) struct Web {
    /// Positions, µm.
    pub(super) points: Vec<[f64; 3]>,
    /// Places on the sheet: u and z.
    pub(super) places: Vec<[f64; 2]>,
    /// One triangle of each vertex; [`NONE`] for a removed vertex.
    first: Vec<u32>,
    /// Corners of each triangle; [`NONE`] for a removed triangle.
    pub(super) triangles: Vec<[u32; 3]>,
    /// Neighbours across the edges 0–1, 1–2 and 2–0.
    across: Vec<[u32; 3]>,
    /// Number of border vertices. These come first and never move.
    pub(super) fixed: usize,
}

impl Web {
    /// Links triangles that share edges.
    pub(super) fn new(points: Vec<[f64; 3]>, places: Vec<[f64; 2]>, triangles: Vec<[u32; 3]>, fixed: usize) -> Self {
        let mut first = vec![NONE; points.len()];
        let mut edges = Vec::with_capacity(3 * triangles.len());
        for (t, corners) in (0u32..).zip(&triangles) {
            for k in 0..3 {
                first[corners[k] as usize] = t;
                let (a, b) = (corners[k], corners[(k + 1) % 3]);
                edges.push((a.min(b), a.max(b), t, k as u32));
            }
        }
        edges.sort_unstable();
        let mut across = vec![[NONE; 3]; triangles.len()];
        for pair in edges.windows(2) {
            let ((a, b, t, i), (c, d, s, j)) = (pair[0], pair[1]);
            if (a, b) == (c, d) {
                across[t as usize][i as usize] = s;
                across[s as usize][j as usize] = t;
            }
        }
        Self { points, places, first, triangles, across, fixed }
    }

    pub(super) fn is_fixed(&self, v: u32) -> bool {
        (v as usize) < self.fixed
    }

    pub(super) fn has_vertex(&self, v: u32) -> bool {
        self.first[v as usize] != NONE
    }

    pub(super) fn has_triangle(&self, t: u32) -> bool {
        self.triangles[t as usize][0] != NONE
    }

    /// Neighbour across edge `k` of `t`, and the number of that edge in the neighbour. `None` on
    /// the border.
    #[inline]
    pub(super) fn beyond(&self, t: u32, k: usize) -> Option<(u32, usize)> {
        let other = self.across[t as usize][k];
        if other == NONE {
            return None;
        }
        let start = self.triangles[t as usize][(k + 1) % 3];
        Some((other, corner_of(self.triangles[other as usize], start)))
    }

    /// Collects the triangles around a vertex in order, each with the number of the vertex's
    /// corner. Around a border vertex the order is counter-clockwise from the border.
    pub(super) fn star(&self, v: u32, star: &mut Vec<(u32, usize)>) {
        star.clear();
        let begin = self.first[v as usize];
        let corner = |t: u32| corner_of(self.triangles[t as usize], v);
        let mut t = begin;
        // A border vertex: clockwise to the border.
        if self.is_fixed(v) {
            loop {
                let next = self.across[t as usize][corner(t)];
                if next == NONE || next == begin {
                    break;
                }
                t = next;
            }
        }
        let begin = t;
        loop {
            let k = corner(t);
            star.push((t, k));
            t = self.across[t as usize][(k + 2) % 3];
            if t == NONE || t == begin {
                return;
            }
        }
    }

    fn link(&mut self, t: u32, k: usize, to: u32, old: u32) {
        self.across[t as usize][k] = to;
        self.relink(to, old, t);
    }

    /// Replaces the neighbour `old` of a triangle; does nothing beyond the border.
    fn relink(&mut self, t: u32, old: u32, new: u32) {
        if t != NONE
            && let Some(slot) = self.across[t as usize].iter().position(|&x| x == old)
        {
            self.across[t as usize][slot] = new;
        }
    }

    /// Corners a, b, c, d of the two triangles at the edge ab, which is edge `k` of `t` = abc and
    /// edge `j` of `n` = bad; and the neighbours across the edges bc, ca, ad, db.
    fn around(&self, t: u32, k: usize, n: u32, j: usize) -> ([u32; 4], [u32; 4]) {
        let (here, there) = (self.triangles[t as usize], self.triangles[n as usize]);
        let (across, beyond) = (self.across[t as usize], self.across[n as usize]);
        (
            [here[k % 3], here[(k + 1) % 3], here[(k + 2) % 3], there[(j + 2) % 3]],
            [across[(k + 1) % 3], across[(k + 2) % 3], beyond[(j + 1) % 3], beyond[(j + 2) % 3]],
        )
    }

    /// Replaces edge `k` of `t` by the other diagonal of its two triangles.
    pub(super) fn flip(&mut self, t: u32, k: usize) {
        let Some((n, j)) = self.beyond(t, k) else { return };
        let ([a, b, c, d], [bc, ca, ad, db]) = self.around(t, k, n, j);
        self.triangles[t as usize] = [a, d, c];
        self.triangles[n as usize] = [d, b, c];
        self.across[t as usize] = [ad, n, ca];
        self.across[n as usize] = [db, bc, t];
        self.link(t, 0, ad, n);
        self.link(n, 1, bc, t);
        for (v, t) in [(a, t), (b, n), (c, t), (d, t)] {
            self.first[v as usize] = t;
        }
    }

    /// Divides edge `k` of `t` by a new vertex.
    pub(super) fn split(&mut self, t: u32, k: usize, point: [f64; 3], place: [f64; 2]) {
        let Some((n, j)) = self.beyond(t, k) else { return };
        let ([a, b, c, d], [bc, ca, ad, db]) = self.around(t, k, n, j);
        let m = self.points.len() as u32;
        self.points.push(point);
        self.places.push(place);
        let (t2, n2) = (self.triangles.len() as u32, self.triangles.len() as u32 + 1);
        self.triangles[t as usize] = [a, m, c];
        self.triangles[n as usize] = [m, a, d];
        self.triangles.extend([[m, b, c], [b, m, d]]);
        self.across[t as usize] = [n, t2, ca];
        self.across[n as usize] = [t, ad, n2];
        self.across.extend([[n2, bc, t], [t2, n, db]]);
        self.link(t2, 1, bc, t);
        self.link(n2, 2, db, n);
        self.first.push(t);
        for (v, t) in [(a, t), (b, t2), (c, t), (d, n)] {
            self.first[v as usize] = t;
        }
    }

    /// Inserts a new vertex inside `t`.
    pub(super) fn insert(&mut self, t: u32, point: [f64; 3], place: [f64; 2]) {
        let [a, b, c] = self.triangles[t as usize];
        let [_, bc, ca] = self.across[t as usize];
        let m = self.points.len() as u32;
        self.points.push(point);
        self.places.push(place);
        let (t2, t3) = (self.triangles.len() as u32, self.triangles.len() as u32 + 1);
        self.triangles[t as usize] = [a, b, m];
        self.triangles.extend([[b, c, m], [c, a, m]]);
        self.across[t as usize][1] = t2;
        self.across[t as usize][2] = t3;
        self.across.extend([[bc, t3, t], [ca, t, t2]]);
        self.link(t2, 0, bc, t);
        self.link(t3, 0, ca, t);
        self.first.push(t);
        for (v, t) in [(a, t), (b, t), (c, t2)] {
            self.first[v as usize] = t;
        }
    }

    /// Moves the end of edge `k` of `t` to its start, which removes that vertex and two triangles.
    /// The caller must check [`Self::can_collapse`] first. `star` is the star of the end.
    pub(super) fn collapse(&mut self, t: u32, k: usize, star: &[(u32, usize)]) {
        let Some((n, j)) = self.beyond(t, k) else { return };
        let ([a, b, c, d], [bc, ca, ad, db]) = self.around(t, k, n, j);
        for &(s, corner) in star {
            self.triangles[s as usize][corner] = a;
        }
        for gone in [t, n] {
            self.triangles[gone as usize] = [NONE; 3];
        }
        self.first[b as usize] = NONE;
        for (t, old, new) in [(bc, t, ca), (ca, t, bc), (ad, n, db), (db, n, ad)] {
            self.relink(t, old, new);
        }
        // The neighbours across the edges of b exist, because b is not on the border.
        for (v, t) in [(a, bc), (c, bc), (d, db)] {
            self.first[v as usize] = t;
        }
    }

    /// True if the end of edge `k` of `t` is not fixed, and the ends of the edge have only the two
    /// opposite corners as common neighbours. `star` is the star of the end; `other` is a buffer.
    pub(super) fn can_collapse(&self, t: u32, k: usize, star: &[(u32, usize)], other: &mut Vec<(u32, usize)>) -> bool {
        let (a, b) = (self.triangles[t as usize][k], self.triangles[t as usize][(k + 1) % 3]);
        if self.is_fixed(b) || star.len() < 4 {
            return false;
        }
        self.star(a, other);
        let neighbours =
            |star: &[(u32, usize)], v: u32| star.iter().any(|&(t, _)| self.triangles[t as usize].contains(&v));
        let common = star.iter().filter(|&&(t, k)| {
            let v = self.triangles[t as usize][(k + 1) % 3];
            v != a && neighbours(other, v)
        });
        common.count() == 2
    }
}

/// Number of the corner of a triangle at one of its vertices.
#[inline]
fn corner_of(triangle: [u32; 3], v: u32) -> usize {
    triangle.iter().position(|&corner| corner == v).unwrap_or(2)
}
