//! Triangles with their neighbours, and the local changes that remeshing is made of.
//!
//! Invariant: the triangles are counter-clockwise in (u, z), and every edge belongs to two of them, except those on the
//! border, whose vertices are fixed.

/// No triangle, or no vertex.
pub(super) const NONE: u32 = u32::MAX;

/// A triangulated sheet.
#[derive(Default)]
pub(super) struct Web {
    /// Positions, micrometres.
    pub(super) points: Vec<[f64; 3]>,
    /// Places on the sheet: u and z.
    pub(super) places: Vec<[f64; 2]>,
    /// A triangle of each vertex; none for a vertex that was removed.
    first: Vec<u32>,
    /// Corners of each triangle; none for one that was removed.
    pub(super) triangles: Vec<[u32; 3]>,
    /// The triangles across the edges 0–1, 1–2 and 2–0.
    across: Vec<[u32; 3]>,
    /// The first vertices are those of the border, and fixed.
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

    /// The triangle across edge `k` of `t`, and which edge that is there; none on the border.
    #[inline]
    pub(super) fn beyond(&self, t: u32, k: usize) -> Option<(u32, usize)> {
        let other = self.across[t as usize][k];
        if other == NONE {
            return None;
        }
        let start = self.triangles[t as usize][(k + 1) % 3];
        let corners = self.triangles[other as usize];
        Some((
            other,
            if corners[0] == start {
                0
            } else if corners[1] == start {
                1
            } else {
                2
            },
        ))
    }

    /// The triangles around a vertex, in order, with the number of its corner in each. Around a vertex of the border the order is
    /// counter-clockwise from the border.
    pub(super) fn star(&self, v: u32, star: &mut Vec<(u32, usize)>) {
        star.clear();
        let begin = self.first[v as usize];
        let corner = |t: u32| {
            let c = self.triangles[t as usize];
            if c[0] == v {
                0
            } else if c[1] == v {
                1
            } else {
                2
            }
        };
        let mut t = begin;
        // Clockwise to the border.
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
        if to != NONE {
            let slot = self.across[to as usize].iter().position(|&x| x == old);
            if let Some(slot) = slot {
                self.across[to as usize][slot] = t;
            }
        }
    }

    /// The corners a, b, c, d of the two triangles at the edge ab, which is `k` of `t` = abc and `j` of `n` = bad; and what is beyond
    /// the edges bc, ca, ad, db.
    fn around(&self, t: u32, k: usize, n: u32, j: usize) -> ([u32; 4], [u32; 4]) {
        let (here, there) = (self.triangles[t as usize], self.triangles[n as usize]);
        let (across, beyond) = (self.across[t as usize], self.across[n as usize]);
        (
            [here[k % 3], here[(k + 1) % 3], here[(k + 2) % 3], there[(j + 2) % 3]],
            [across[(k + 1) % 3], across[(k + 2) % 3], beyond[(j + 1) % 3], beyond[(j + 2) % 3]],
        )
    }

    /// Replaces the edge `k` of `t` by the other diagonal of its two triangles.
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

    /// Divides the edge `k` of `t` by a new vertex.
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

    /// Puts a new vertex inside `t`.
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

    /// Moves the end of edge `k` of `t` to its start, which removes that vertex and two triangles. Whether this keeps the
    /// web sound is for the caller to know ([`Self::can_collapse`]).
    pub(super) fn collapse(&mut self, t: u32, k: usize, star: &[(u32, usize)]) {
        let Some((n, j)) = self.beyond(t, k) else { return };
        let (a, b) = (self.triangles[t as usize][k], self.triangles[t as usize][(k + 1) % 3]);
        let (c, d) = (self.triangles[t as usize][(k + 2) % 3], self.triangles[n as usize][(j + 2) % 3]);
        let (bc, ca) = (self.across[t as usize][(k + 1) % 3], self.across[t as usize][(k + 2) % 3]);
        let (ad, db) = (self.across[n as usize][(j + 1) % 3], self.across[n as usize][(j + 2) % 3]);
        for &(s, corner) in star {
            self.triangles[s as usize][corner] = a;
        }
        for gone in [t, n] {
            self.triangles[gone as usize] = [NONE; 3];
        }
        self.first[b as usize] = NONE;
        for (x, y, old_x, old_y) in [(bc, ca, t, t), (ad, db, n, n)] {
            for (this, other, old) in [(x, y, old_x), (y, x, old_y)] {
                if this != NONE
                    && let Some(slot) = self.across[this as usize].iter().position(|&s| s == old)
                {
                    self.across[this as usize][slot] = other;
                }
            }
        }
        // The triangles beyond the edges of b remain, since b is not on the border.
        for (v, t) in [(a, bc), (c, bc), (d, db)] {
            self.first[v as usize] = t;
        }
    }

    /// Whether the end of edge `k` of `t` is free, and it and the start have only the two corners opposite to the edge
    /// as common neighbours. `star` is that of the end.
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
