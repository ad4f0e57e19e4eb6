//! Sections for tests: a folded, growing tube in closed form, and random motions without contact by
//! the rule of the simulation.

use std::f64::consts::TAU;

use crate::geometry::polygon::next_on_rings;
use crate::model::{Ring, Section};

/// A splitmix64 sequence.
pub(super) struct Dice(pub(super) u64);

impl Dice {
    pub(super) fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut x = self.0;
        x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        x ^ (x >> 31)
    }

    /// Uniform in [0, 1).
    pub(super) fn unit(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1u64 << 53) as f64
    }

    pub(super) fn below(&mut self, n: usize) -> usize {
        (self.next() % n as u64) as usize
    }
}

/// A tube with radial folds that deepen and swirl along it. Vertices have fixed angles; new
/// vertices appear halfway between two old ones.
pub(super) struct Folds {
    pub(super) lobes: f64,
    pub(super) steps: f64,
    pub(super) inner: Vec<(u32, f64)>,
    pub(super) outer: Vec<(u32, f64)>,
}

impl Folds {
    pub(super) fn new(inner: usize, outer: usize, lobes: f64, steps: f64) -> Self {
        let ring = |n: usize| {
            let angle = |i: usize| (i as u32, TAU * i as f64 / n as f64);
            (0..n).map(angle).collect()
        };
        Self { lobes, steps, inner: ring(inner), outer: ring(outer) }
    }

    /// Splits `inner` and `outer` distinct edges of the rings, one random edge in each of equally
    /// long runs.
    pub(super) fn grow(&mut self, inner: usize, outer: usize, dice: &mut Dice) {
        for (ring, count) in [(&mut self.inner, inner), (&mut self.outer, outer)] {
            let n = ring.len();
            let mut split: Vec<usize> = (0..count)
                .map(|k| {
                    let (from, to) = (k * n / count, (k + 1) * n / count);
                    from + dice.below(to - from)
                })
                .collect();
            split.dedup();
            for (k, &edge) in split.iter().enumerate().rev() {
                let a = ring[edge].1;
                let b = ring.get(edge + 1).map_or(TAU, |next| next.1);
                ring.insert(edge + 1, ((n + k) as u32, 0.5 * (a + b)));
            }
        }
    }

    pub(super) fn section(&self, step: f64) -> Section {
        let t = step / self.steps;
        let radius = 500.0 + 1000.0 * t;
        let ring = |vertices: &[(u32, f64)], radius: f64, depth: f64, swirl: f64| Ring {
            ids: vertices.iter().map(|v| v.0).collect(),
            points: vertices
                .iter()
                .map(|&(_, angle)| {
                    let r = radius * (1.0 + depth * (self.lobes * angle).sin());
                    let angle = angle + swirl * r / radius;
                    [(r * angle.cos()) as f32, (r * angle.sin()) as f32]
                })
                .collect(),
        };
        Section {
            step,
            z_um: 7.5 * step,
            added: false,
            inner: ring(&self.inner, 0.6 * radius, 0.05 + 0.55 * t, 0.8 * t),
            outer: ring(&self.outer, radius + 50.0, 0.0, 0.0),
        }
    }
}

/// Two rings under random forces. No vertex moves farther in a step than docs/physics.md ("Walls
/// that cannot cross") allows.
pub(super) struct Jostle {
    section: Section,
    dice: Dice,
}

impl Jostle {
    pub(super) fn new(inner: usize, outer: usize, seed: u64) -> Self {
        Self { section: Folds::new(inner, outer, 0.0, 1.0).section(0.0), dice: Dice(seed) }
    }

    pub(super) fn section(&self) -> Section {
        self.section.clone()
    }

    /// Splits an edge of each ring in one of three steps. Then moves every vertex as far as
    /// allowed, in a random direction that stays the same for several steps.
    pub(super) fn step(&mut self) -> Section {
        if self.dice.below(3) == 0 {
            for ring in [&mut self.section.inner, &mut self.section.outer] {
                split(ring, self.dice.below(ring.points.len()));
            }
        }
        let clear = clearances(&self.section);
        let inner = self.section.inner.len();
        let epoch = (self.section.step / 6.0) as u64;
        let section = &mut self.section;
        for (ring, base, ids) in [(&mut section.inner, 0, 0u64), (&mut section.outer, inner, 1 << 32)] {
            for (i, point) in ring.points.iter_mut().enumerate() {
                let id = ids + u64::from(ring.ids[i]);
                let mut own = Dice(self.dice.0 >> 60 | id << 8 | epoch << 50);
                let angle = TAU * own.unit();
                let limit = (0.45 * (clear[base + i] - 0.05)).max(1e-5);
                point[0] += (limit * angle.cos()) as f32;
                point[1] += (limit * angle.sin()) as f32;
            }
        }
        section.step += 1.0;
        section.z_um += 75.0;
        self.section()
    }
}

fn split(ring: &mut Ring, edge: usize) {
    let (a, b) = (ring.points[edge], ring.points[(edge + 1) % ring.points.len()]);
    let length = f64::from(a[0] - b[0]).hypot(f64::from(a[1] - b[1]));
    if length > 20.0 {
        let middle = [0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])];
        ring.ids.insert(edge + 1, ring.points.len() as u32);
        ring.points.insert(edge + 1, middle);
    }
}

/// Minimum distance of each vertex over the vertex–segment pairs that involve the vertex or its
/// edges.
fn clearances(section: &Section) -> Vec<f64> {
    let inner = section.inner.len();
    let points: Vec<[f64; 2]> =
        section.inner.points.iter().chain(&section.outer.points).map(|p| p.map(f64::from)).collect();
    let next = |i: usize| next_on_rings(i, inner, points.len());
    let mut clear = vec![f64::INFINITY; points.len()];
    for v in 0..points.len() {
        for a in 0..points.len() {
            let b = next(a);
            if v == a || v == b {
                continue;
            }
            let d = distance(points[a], points[b], points[v]);
            for i in [v, a, b] {
                clear[i] = clear[i].min(d);
            }
        }
    }
    clear
}

fn distance(a: [f64; 2], b: [f64; 2], p: [f64; 2]) -> f64 {
    let (ab, ap) = ([b[0] - a[0], b[1] - a[1]], [p[0] - a[0], p[1] - a[1]]);
    let t = (ap[0] * ab[0] + ap[1] * ab[1]) / (ab[0] * ab[0] + ab[1] * ab[1]);
    let t = t.clamp(0.0, 1.0);
    (ap[0] - t * ab[0]).hypot(ap[1] - t * ab[1])
}
