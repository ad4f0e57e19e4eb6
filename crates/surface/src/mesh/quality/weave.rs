//! Improves the triangles of a sheet: even lengths, good angles, within the tolerance of the sheet.

use super::field::Field;
use super::row::length;
use super::sheet::Sheet;
use super::web::Web;
use crate::geometry::distance::squared_distance;

/// An edge longer than this times its aim is divided, and one shorter is removed.
const LONG: f64 = 1.35;
const SHORT: f64 = 0.7;
// Angles are compared by the squares of their sines.
/// An angle that is good enough: 32°.
const GOOD: f64 = 0.28;
/// An angle that needs no improvement by trials: 27°.
const FAIR: f64 = 0.2;
/// An angle to which others may be reduced by removing vertices: 22°.
const POOR: f64 = 0.14;
/// Least gain for which an edge is flipped.
const GAIN: f64 = 1e-3;
/// Distance between the heights at which a triangle is compared with the sheet, micrometres.
const PITCH: f64 = 10.0;

/// A web on its sheet.
pub(super) struct Weave<'a> {
    pub(super) sheet: &'a Sheet,
    pub(super) field: &'a Field,
    pub(super) web: Web,
    /// Aim for the length of edges at each vertex.
    aims: Vec<f64>,
    star: Vec<(u32, usize)>,
    other: Vec<(u32, usize)>,
}

/// A point of the sheet.
type Spot = ([f64; 2], [f64; 3]);

impl<'a> Weave<'a> {
    pub(super) fn new(sheet: &'a Sheet, field: &'a Field, web: Web) -> Self {
        let aims = web.places.iter().map(|&place| field.length(sheet, place)).collect();
        Self { sheet, field, web, aims, star: Vec::new(), other: Vec::new() }
    }

    /// Divides long edges, removes short ones, flips and moves, several times.
    pub(super) fn even_out(&mut self, passes: usize) {
        for _ in 0..passes {
            self.divide();
            self.remove();
            self.flip();
            self.smooth();
        }
    }

    fn spot(&self, v: u32) -> Spot {
        (self.web.places[v as usize], self.web.points[v as usize])
    }

    /// Half way between two vertices on the sheet.
    fn middle(&self, a: u32, b: u32) -> Spot {
        let ([u, z], [v, w]) = (self.web.places[a as usize], self.web.places[b as usize]);
        let place = [0.5 * (u + self.sheet.near(v, u)), 0.5 * (z + w)];
        (place, self.sheet.point(place))
    }

    fn divide(&mut self) {
        let mut t = 0;
        while t < self.web.triangles.len() {
            let Some((k, _)) = self.edge(t as u32, |length, aim, longest| length > LONG * aim && length > longest)
            else {
                t += 1;
                continue;
            };
            let corners = self.web.triangles[t];
            let (place, point) = self.middle(corners[k], corners[(k + 1) % 3]);
            self.web.split(t as u32, k, point, place);
            self.aims.push(self.field.length(self.sheet, place));
        }
    }

    /// The last inner edge of a triangle that is chosen by its length, its aim and the length of the one chosen before.
    fn edge(&self, t: u32, choose: impl Fn(f64, f64, f64) -> bool) -> Option<(usize, f64)> {
        if !self.web.has_triangle(t) {
            return None;
        }
        let corners = self.web.triangles[t as usize];
        let mut chosen: Option<(usize, f64)> = None;
        for k in 0..3 {
            let (a, b) = (corners[k], corners[(k + 1) % 3]);
            let length = length(self.web.points[a as usize], self.web.points[b as usize]);
            let aim = 0.5 * (self.aims[a as usize] + self.aims[b as usize]);
            if choose(length, aim, chosen.map_or(0.0, |(_, length)| length)) && self.web.beyond(t, k).is_some() {
                chosen = Some((k, length));
            }
        }
        chosen
    }

    fn remove(&mut self) {
        let (mut star, mut other) = (std::mem::take(&mut self.star), std::mem::take(&mut self.other));
        for t in 0..self.web.triangles.len() as u32 {
            for k in 0..3 {
                if !self.web.has_triangle(t) {
                    break;
                }
                let corners = self.web.triangles[t as usize];
                let (a, b) = (corners[k], corners[(k + 1) % 3]);
                let aim = 0.5 * (self.aims[a as usize] + self.aims[b as usize]);
                let length = length(self.web.points[a as usize], self.web.points[b as usize]);
                if length >= SHORT * aim {
                    continue;
                }
                let Some((n, j)) = self.web.beyond(t, k) else { continue };
                for (t, k) in [(t, k), (n, j)] {
                    let end = self.web.triangles[t as usize][(k + 1) % 3];
                    if self.web.is_fixed(end) {
                        continue;
                    }
                    self.web.star(end, &mut star);
                    if self.web.can_collapse(t, k, &star, &mut other) && self.may_collapse(t, k, &star) {
                        self.web.collapse(t, k, &star);
                        break;
                    }
                }
            }
        }
        (self.star, self.other) = (star, other);
    }

    /// Whether the triangles stay good if the end of an edge moves to its start.
    fn may_collapse(&self, t: u32, k: usize, star: &[(u32, usize)]) -> bool {
        let start = self.web.triangles[t as usize][k];
        let (place, point) = self.spot(start);
        let (mut before, mut after) = (f64::INFINITY, f64::INFINITY);
        for &(s, corner) in star {
            let corners = self.web.triangles[s as usize];
            let (q, r) = (corners[(corner + 1) % 3], corners[(corner + 2) % 3]);
            before = before.min(shape(corners.map(|v| self.web.points[v as usize])));
            if q == start || r == start {
                continue;
            }
            let (q, r) = (self.spot(q), self.spot(r));
            if !self.is_upright([place, q.0, r.0]) {
                return false;
            }
            after = after.min(shape([point, q.1, r.1]));
            let aim = self.aims[start as usize];
            if length(point, q.1) > LONG * aim || self.strain([(place, point), q, r]).0 > 1.0 {
                return false;
            }
        }
        after >= before.min(POOR)
    }

    /// Flips edges whose other diagonal has better angles.
    pub(super) fn flip(&mut self) {
        for _ in 0..3 {
            let mut flips = 0;
            for t in 0..self.web.triangles.len() as u32 {
                for k in 0..3 {
                    if self.web.has_triangle(t)
                        && let Some((n, j)) = self.web.beyond(t, k)
                        && t < n
                        && self.should_flip([(t, k), (n, j)])
                    {
                        self.web.flip(t, k);
                        flips += 1;
                    }
                }
            }
            if flips == 0 {
                return;
            }
        }
    }

    fn should_flip(&self, [(t, k), (n, j)]: [(u32, usize); 2]) -> bool {
        let (here, there) = (self.web.triangles[t as usize], self.web.triangles[n as usize]);
        let [a, b, c, d] = [here[k], here[(k + 1) % 3], here[(k + 2) % 3], there[(j + 2) % 3]].map(|v| self.spot(v));
        let good = |s: [Spot; 3]| shape(s.map(|(_, p)| p));
        let (before, after) = (good([a, b, c]).min(good([b, a, d])), good([a, d, c]).min(good([d, b, c])));
        if after <= before + GAIN {
            return false;
        }
        if !self.is_upright([a.0, d.0, c.0]) || !self.is_upright([d.0, b.0, c.0]) {
            return false;
        }
        let new = self.strain([a, d, c]).0.max(self.strain([d, b, c]).0);
        new <= 1.0 || new <= self.strain([a, b, c]).0.max(self.strain([b, a, d]).0)
    }

    /// Moves vertices toward the middle of their stars.
    pub(super) fn smooth(&mut self) {
        let mut star = std::mem::take(&mut self.star);
        for v in self.web.fixed as u32..self.web.points.len() as u32 {
            if !self.web.has_vertex(v) {
                continue;
            }
            self.web.star(v, &mut star);
            let [u, z] = self.web.places[v as usize];
            let (mut sum, mut weights) = ([0.0; 2], 0.0);
            for &(t, k) in &star {
                let corners = self.web.triangles[t as usize];
                let (q, r) = (corners[(k + 1) % 3], corners[(k + 2) % 3]);
                let [p, s] = [q, r].map(|w| self.web.places[w as usize]);
                let aim = self.aims[q as usize] + self.aims[r as usize] + self.aims[v as usize];
                let points = corners.map(|w| self.web.points[w as usize]);
                let weight =
                    squared_area(minus(points[1], points[0]), minus(points[2], points[0])).sqrt() / (aim * aim);
                sum[0] += weight * (self.sheet.near(p[0], u) + self.sheet.near(s[0], u) + u) / 3.0;
                sum[1] += weight * (p[1] + s[1] + z) / 3.0;
                weights += weight;
            }
            let aim = [sum[0] / weights, sum[1] / weights];
            for share in [1.0, 0.5, 0.25] {
                if self.try_move(v, [u + (aim[0] - u) * share, z + (aim[1] - z) * share], GOOD, &star) {
                    break;
                }
            }
        }
        self.star = star;
    }

    /// Moves vertices of bad triangles to where the least angle around them is greatest, among some places tried.
    pub(super) fn polish(&mut self) {
        let mut star = std::mem::take(&mut self.star);
        for v in self.web.fixed as u32..self.web.points.len() as u32 {
            if !self.web.has_vertex(v) {
                continue;
            }
            self.web.star(v, &mut star);
            if self.least(&star) > FAIR {
                continue;
            }
            let mut reach = 0.3 * self.aims[v as usize];
            for _ in 0..3 {
                let [u, z] = self.web.places[v as usize];
                let ways = [
                    [1.0, 0.0],
                    [0.7, 0.7],
                    [0.0, 1.0],
                    [-0.7, 0.7],
                    [-1.0, 0.0],
                    [-0.7, -0.7],
                    [0.0, -1.0],
                    [0.7, -0.7],
                ];
                for [x, y] in ways {
                    self.try_move(v, [u + x * reach, z + y * reach], 1.0, &star);
                }
                reach *= 0.5;
            }
        }
        self.star = star;
    }

    fn least(&self, star: &[(u32, usize)]) -> f64 {
        let of = |&(t, _): &(u32, usize)| shape(self.web.triangles[t as usize].map(|w| self.web.points[w as usize]));
        star.iter().map(of).fold(f64::INFINITY, f64::min)
    }

    /// Moves a vertex to a place if angles below `enough` do not become less there, and the triangles stay near the sheet.
    fn try_move(&mut self, v: u32, place: [f64; 2], enough: f64, star: &[(u32, usize)]) -> bool {
        let moved = (place, self.sheet.point(place));
        let corners = |&(t, k): &(u32, usize)| {
            let corners = self.web.triangles[t as usize];
            (self.spot(corners[(k + 1) % 3]), self.spot(corners[(k + 2) % 3]))
        };
        let before = self.least(star).min(enough);
        for entry in star {
            let (q, r) = corners(entry);
            if shape([moved.1, q.1, r.1]) <= before || !self.is_upright([place, q.0, r.0]) {
                return false;
            }
        }
        let strained = |spot: Spot| {
            let strain = |entry| {
                let (q, r) = corners(entry);
                self.strain([spot, q, r]).0
            };
            star.iter().map(strain).fold(0.0, f64::max)
        };
        let new = strained(moved);
        if new > 1.0 && new > strained(self.spot(v)) {
            return false;
        }
        (self.web.places[v as usize], self.web.points[v as usize]) = moved;
        self.aims[v as usize] = self.field.length(self.sheet, place);
        true
    }

    /// Adds vertices where triangles are too far from the sheet; returns how many.
    pub(super) fn approach(&mut self) -> usize {
        let mut added = 0;
        for t in 0..self.web.triangles.len() as u32 {
            if !self.web.has_triangle(t) {
                continue;
            }
            let corners = self.web.triangles[t as usize];
            let (strain, (place, point)) = self.strain(corners.map(|v| self.spot(v)));
            if strain <= 1.0 {
                continue;
            }
            added += usize::from(self.add(t, place, point));
        }
        added
    }

    /// Adds a vertex at a place of a triangle: on its nearest edge if there is one, else inside.
    fn add(&mut self, t: u32, place: [f64; 2], point: [f64; 3]) -> bool {
        let corners = self.web.triangles[t as usize];
        let places = corners.map(|v| self.web.places[v as usize]);
        let whole = self.doubled_area(places);
        let parts = [0, 1, 2].map(|k| self.doubled_area([places[k], places[(k + 1) % 3], place]) / whole);
        let k = (0..3).min_by(|&i, &j| parts[i].total_cmp(&parts[j])).unwrap_or(0);
        if parts[k] < 0.2
            && let Some((n, j)) = self.web.beyond(t, k)
        {
            let [a, b, c] = [places[k], places[(k + 1) % 3], places[(k + 2) % 3]];
            let d = self.web.places[self.web.triangles[n as usize][(j + 2) % 3] as usize];
            if [[a, place, c], [place, b, c], [place, a, d], [b, place, d]].iter().all(|&s| self.is_upright(s)) {
                self.web.split(t, k, point, place);
                self.aims.push(self.field.length(self.sheet, place));
                return true;
            }
        }
        if parts[k] > 1e-3 {
            self.web.insert(t, point, place);
            self.aims.push(self.field.length(self.sheet, place));
            return true;
        }
        false
    }

    fn doubled_area(&self, [a, b, c]: [[f64; 2]; 3]) -> f64 {
        let from = |p: [f64; 2]| [self.sheet.near(p[0], a[0]) - a[0], p[1] - a[1]];
        let (p, q) = (from(b), from(c));
        p[0] * q[1] - p[1] * q[0]
    }

    fn is_upright(&self, places: [[f64; 2]; 3]) -> bool {
        self.doubled_area(places) > 1e-3
    }

    /// How far a triangle is from its part of the sheet, either way, as a part of the tolerance, and the particle to add there;
    /// zero if it is within the tolerance. Compared are the edges, and lines across at some heights.
    fn strain(&self, corners: [Spot; 3]) -> (f64, Spot) {
        let anchor = corners[0].0[0];
        let mut order = corners.map(|([u, z], point)| ([self.sheet.near(u, anchor), z], point));
        order.sort_unstable_by(|a, b| a.0[1].total_cmp(&b.0[1]));
        let [low, mid, high] = order;
        let triangle = corners.map(|(_, point)| point);
        let centre = [0, 1].map(|k| (low.0[k] + mid.0[k] + high.0[k]) / 3.0);
        let tolerance = self.field.tolerance(self.sheet, centre);
        let mut worst = (tolerance * tolerance, None);
        let mut compare = |from: Spot, to: Spot| {
            let found = self.farthest(from, to, triangle, worst.0);
            worst = found.map_or(worst, |(distance, spot)| (distance, Some(spot)));
        };
        compare(low, mid);
        compare(mid, high);
        compare(low, high);
        let slices = ((high.0[1] - low.0[1]) / PITCH) as usize;
        for i in 0..slices {
            let z = low.0[1] + (high.0[1] - low.0[1]) * (i + 1) as f64 / (slices + 1) as f64;
            compare(cut(low, high, z), if z <= mid.0[1] { cut(low, mid, z) } else { cut(mid, high, z) });
        }
        worst.1.map_or((0.0, low), |spot| (worst.0.sqrt() / tolerance, spot))
    }

    /// The squared distance between a line on a triangle and the way between its ends on the sheet, either way, if it is above
    /// `limit`, with the particle that is farthest from the line.
    #[inline]
    fn farthest(&self, from: Spot, to: Spot, triangle: [[f64; 3]; 3], limit: f64) -> Option<(f64, Spot)> {
        let (from, to) = if from.0[0] <= to.0[0] { (from, to) } else { (to, from) };
        let mut farthest = (limit, None);
        self.sheet.crossed(from.0, to.0, |place, point| {
            let distance = from_segment(point, from.1, to.1);
            if distance > farthest.0 {
                farthest = (distance, Some((place, point)));
            }
        });
        // If no particle is farther from the line, no point of the line is farther from the way.
        let spot = farthest.1?;
        let samples = [0.25, 0.5, 0.75].map(|t| [0, 1, 2].map(|k| from.1[k] + (to.1[k] - from.1[k]) * t));
        let (mut nearest, mut greatest, mut last) = ([f64::INFINITY; 3], limit, from.1);
        let mut pass = |next: [f64; 3]| {
            greatest = greatest.max(squared_distance(next, triangle));
            for (sample, nearest) in samples.iter().zip(&mut nearest) {
                *nearest = nearest.min(from_segment(*sample, last, next));
            }
            last = next;
        };
        self.sheet.crossed(from.0, to.0, |_, point| pass(point));
        pass(to.1);
        let greatest = nearest.into_iter().fold(greatest, f64::max);
        (greatest > limit).then_some((greatest, spot))
    }
}

/// Squared distance of `p` from the segment from `a` to `b`.
#[inline]
fn from_segment(p: [f64; 3], a: [f64; 3], b: [f64; 3]) -> f64 {
    let (ab, ap) = (minus(b, a), minus(p, a));
    let t = (dot(ap, ab) / dot(ab, ab).max(f64::MIN_POSITIVE)).clamp(0.0, 1.0);
    let rest = [0, 1, 2].map(|k| ap[k] - ab[k] * t);
    dot(rest, rest)
}

/// The point at height `z` of an edge.
fn cut(a: Spot, b: Spot, z: f64) -> Spot {
    let t = if b.0[1] > a.0[1] { (z - a.0[1]) / (b.0[1] - a.0[1]) } else { 1.0 };
    let u = a.0[0] + (b.0[0] - a.0[0]) * t;
    ([u, z], [0, 1, 2].map(|k| a.1[k] + (b.1[k] - a.1[k]) * t))
}

/// The squared sine of the least angle of a triangle: the square of twice its area over those of the two longest sides.
#[inline]
fn shape([a, b, c]: [[f64; 3]; 3]) -> f64 {
    let (u, v, w) = (minus(b, a), minus(c, a), minus(c, b));
    let (uu, vv, ww) = (dot(u, u), dot(v, v), dot(w, w));
    let longest = (uu * vv).max(vv * ww).max(ww * uu);
    if longest > 0.0 { squared_area(u, v) / longest } else { 0.0 }
}

/// The square of twice the area between two sides.
#[inline]
fn squared_area(u: [f64; 3], v: [f64; 3]) -> f64 {
    let n = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
    dot(n, n)
}

#[inline]
fn minus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

#[inline]
fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}
