//! Improves the triangles of a sheet: even edge lengths and good angles, within the tolerance.

use super::field::LengthField;
use super::sheet::Sheet;
use super::web::Web;
use crate::geometry::distance::squared_distance;
use crate::geometry::vector::{cross, distance, dot, lerp, squared_distance_to_segment, sub};

/// Edges longer than `LONG` times their desired length are divided; edges shorter than `SHORT`
/// times that length are collapsed.
const LONG: f64 = 1.35;
const SHORT: f64 = 0.7;
// Thresholds of angles are squares of their sines.
/// Angle that needs no smoothing: 32°.
const GOOD: f64 = 0.28;
/// Angle that needs no polishing: 27°.
const FAIR: f64 = 0.2;
/// Angle that collapsing an edge may leave: 22°.
const POOR: f64 = 0.14;
/// Minimum gain for which an edge is flipped.
const GAIN: f64 = 1e-3;
/// Maximum distance between the heights at which a triangle is compared with the sheet, µm, and
/// minimum distance of those that are levels.
const PITCH: f64 = 15.0;
const CLOSE: f64 = 6.0;

/// Directions in which a vertex is moved by trial.
const WAYS: [[f64; 2]; 8] =
    [[1.0, 0.0], [0.7, 0.7], [0.0, 1.0], [-0.7, 0.7], [-1.0, 0.0], [-0.7, -0.7], [0.0, -1.0], [0.7, -0.7]];

/// The triangles of a sheet while they are improved.
pub(super) struct Weave<'a> {
    pub(super) sheet: &'a Sheet,
    pub(super) field: &'a LengthField,
    pub(super) web: Web,
    /// Desired edge length at each vertex.
    aims: Vec<f64>,
    star: Vec<(u32, usize)>,
    other: Vec<(u32, usize)>,
}

/// Place on the sheet and point in space.
type Spot = ([f64; 2], [f64; 3]);

impl<'a> Weave<'a> {
    pub(super) fn new(sheet: &'a Sheet, field: &'a LengthField, web: Web) -> Self {
        let aims = web.places.iter().map(|&place| field.length(sheet, place)).collect();
        Self { sheet, field, web, aims, star: Vec::new(), other: Vec::new() }
    }

    /// Divides long edges, collapses short ones, flips edges and moves vertices, in each of several
    /// passes.
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

    /// Place halfway between two vertices.
    fn middle(&self, a: u32, b: u32) -> Spot {
        let ([u, z], [v, w]) = (self.web.places[a as usize], self.web.places[b as usize]);
        let place = [0.5 * (u + self.sheet.near(v, u)), 0.5 * (z + w)];
        (place, self.sheet.point(place))
    }

    fn divide(&mut self) {
        let mut t = 0;
        while t < self.web.triangles.len() {
            let Some(k) = self.longest_to_divide(t as u32) else {
                t += 1;
                continue;
            };
            let corners = self.web.triangles[t];
            let (place, point) = self.middle(corners[k], corners[(k + 1) % 3]);
            if !self.can_split(t as u32, k, place) {
                t += 1;
                continue;
            }
            self.web.split(t as u32, k, point, place);
            self.aims.push(self.field.length(self.sheet, place));
        }
    }

    /// True if the triangles on both sides of an edge keep an area when it is split at a place.
    /// Triangles without area could be divided for ever.
    fn can_split(&self, t: u32, k: usize, place: [f64; 2]) -> bool {
        let Some((n, j)) = self.web.beyond(t, k) else { return false };
        let corner = |t: u32, k: usize| self.web.places[self.web.triangles[t as usize][k % 3] as usize];
        let [a, b, c, d] = [corner(t, k), corner(t, k + 1), corner(t, k + 2), corner(n, j + 2)];
        [[a, place, c], [place, b, c], [place, a, d], [b, place, d]].iter().all(|&s| self.is_upright(s))
    }

    /// Longest inner edge of a triangle that is too long.
    fn longest_to_divide(&self, t: u32) -> Option<usize> {
        let (mut longest, mut chosen) = (0.0, None);
        for k in (0..3).filter(|_| self.web.has_triangle(t)) {
            let (length, aim) = self.length_and_aim(t, k);
            if length > LONG * aim && length > longest && self.web.beyond(t, k).is_some() {
                (longest, chosen) = (length, Some(k));
            }
        }
        chosen
    }

    /// Length of edge `k` of `t`, and its desired length.
    fn length_and_aim(&self, t: u32, k: usize) -> (f64, f64) {
        let corners = self.web.triangles[t as usize];
        let [a, b] = [corners[k], corners[(k + 1) % 3]].map(|v| v as usize);
        (distance(self.web.points[a], self.web.points[b]), 0.5 * (self.aims[a] + self.aims[b]))
    }

    fn remove(&mut self) {
        let (mut star, mut other) = (std::mem::take(&mut self.star), std::mem::take(&mut self.other));
        for t in 0..self.web.triangles.len() as u32 {
            for k in 0..3 {
                if !self.web.has_triangle(t) {
                    break;
                }
                let (length, aim) = self.length_and_aim(t, k);
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

    /// True if the triangles stay good when the end of an edge moves to its start.
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
            if distance(point, q.1) > LONG * aim || self.strain([(place, point), q, r]).0 > 1.0 {
                return false;
            }
        }
        after >= before.min(POOR)
    }

    /// Flips edges if the other diagonal gives better angles.
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

    /// Moves vertices towards the centres of their stars.
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
                let weight = squared_area(sub(points[1], points[0]), sub(points[2], points[0])).sqrt() / (aim * aim);
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

    /// Moves vertices of bad triangles to the best of several places: the one that maximizes the
    /// minimum angle around them.
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
                for [x, y] in WAYS {
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

    /// Moves a vertex to a place if no angle below `enough` shrinks and the triangles stay near the
    /// sheet.
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

    /// Adds vertices where triangles are too far from the sheet; returns their number.
    pub(super) fn approach(&mut self) -> usize {
        let mut added = 0;
        for t in 0..self.web.triangles.len() as u32 {
            if !self.web.has_triangle(t) {
                continue;
            }
            let corners = self.web.triangles[t as usize];
            let (strain, (place, point)) = self.strain(corners.map(|v| self.spot(v)));
            if strain > 1.0 {
                added += usize::from(self.add(t, place, point));
            }
        }
        added
    }

    /// Adds a vertex at a place of a triangle: on the nearest edge if one is close, otherwise
    /// inside.
    fn add(&mut self, t: u32, place: [f64; 2], point: [f64; 3]) -> bool {
        let corners = self.web.triangles[t as usize];
        let places = corners.map(|v| self.web.places[v as usize]);
        let whole = self.doubled_area(places);
        let parts = [0, 1, 2].map(|k| self.doubled_area([places[k], places[(k + 1) % 3], place]) / whole);
        let k = (0..3).min_by(|&i, &j| parts[i].total_cmp(&parts[j])).unwrap_or(0);
        if parts[k] < 0.2 && self.can_split(t, k, place) {
            self.web.split(t, k, point, place);
            self.aims.push(self.field.length(self.sheet, place));
            return true;
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

    /// Distance between a triangle and its part of the sheet, in both directions, as a fraction of
    /// the tolerance, and the place to add there. Returns 0 if the distance is within the tolerance.
    /// Compares the edges, and lines at levels and at heights between them.
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
        let mut slice =
            |z: f64| compare(cut(low, high, z), if z <= mid.0[1] { cut(low, mid, z) } else { cut(mid, high, z) });
        let mut last = low.0[1];
        for bound in self.sheet.heights_between(low.0[1], high.0[1]).chain([high.0[1]]) {
            // Levels that are very close to the slice below them are left out.
            if bound < high.0[1] && bound - last < CLOSE {
                continue;
            }
            let parts = ((bound - last) / PITCH).ceil() as usize;
            (1..parts).for_each(|i| slice(last + (bound - last) * i as f64 / parts as f64));
            if bound < high.0[1] {
                slice(bound);
            }
            last = bound;
        }
        worst.1.map_or((0.0, low), |spot| (worst.0.sqrt() / tolerance, spot))
    }

    /// Squared distance between a line on a triangle and the path between its ends on the sheet, in
    /// both directions, and the place on the path that is farthest from the line. `None` if the
    /// distance is at most `limit`.
    #[inline]
    fn farthest(&self, from: Spot, to: Spot, triangle: [[f64; 3]; 3], limit: f64) -> Option<(f64, Spot)> {
        let (from, to) = if from.0[0] <= to.0[0] { (from, to) } else { (to, from) };
        let mut farthest = (limit, None);
        self.sheet.crossed(from.0, to.0, |place, point| {
            let square = squared_distance_to_segment(point, from.1, to.1);
            if square > farthest.0 {
                farthest = (square, Some((place, point)));
            }
        });
        // If every edge of the path is within the limit of the line, every point of the line is within
        // the limit of the path.
        let spot = farthest.1?;
        let samples = [0.25, 0.5, 0.75].map(|t| lerp(from.1, to.1, t));
        let (mut nearest, mut greatest, mut last) = ([f64::INFINITY; 3], limit, from.1);
        let mut pass = |next: [f64; 3]| {
            greatest = greatest.max(squared_distance(next, triangle));
            for (sample, nearest) in samples.iter().zip(&mut nearest) {
                *nearest = nearest.min(squared_distance_to_segment(*sample, last, next));
            }
            last = next;
        };
        self.sheet.crossed(from.0, to.0, |_, point| pass(point));
        pass(to.1);
        let greatest = nearest.into_iter().fold(greatest, f64::max);
        (greatest > limit).then_some((greatest, spot))
    }
}

/// Point of an edge at height `z`.
fn cut(a: Spot, b: Spot, z: f64) -> Spot {
    let t = if b.0[1] > a.0[1] { (z - a.0[1]) / (b.0[1] - a.0[1]) } else { 1.0 };
    ([lerp(a.0, b.0, t)[0], z], lerp(a.1, b.1, t))
}

/// Squared sine of the smallest angle of a triangle: squared double area over the squares of the
/// two longest sides.
#[inline]
fn shape([a, b, c]: [[f64; 3]; 3]) -> f64 {
    let (u, v, w) = (sub(b, a), sub(c, a), sub(c, b));
    let (uu, vv, ww) = (dot(u, u), dot(v, v), dot(w, w));
    let longest = (uu * vv).max(vv * ww).max(ww * uu);
    if longest > 0.0 { squared_area(u, v) / longest } else { 0.0 }
}

/// Square of twice the area between two sides.
#[inline]
fn squared_area(u: [f64; 3], v: [f64; 3]) -> f64 {
    let n = cross(u, v);
    dot(n, n)
}
