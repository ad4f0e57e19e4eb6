//! Region that contains the folds: an ellipse, or any closed curve that each ray from the axis
//! intersects once.
//!
//! A point belongs to the region if its gauge in the flattened plane (x, y/squash) is at most
//! `R_in`. The gauge of the ellipse is the distance from the axis. Gauges of other regions are
//! tables ([`crate::geometry::star`]). The functions use only additions, multiplications, divisions
//! and comparisons, so the shaders compute the same numbers.

use super::layout::StepRow;
use super::maths::{cos_turns, max, min};
use crate::geometry::star::{self, DIRECTIONS};
use crate::spec::Parameters;
use std::f64::consts::{PI, TAU};

/// Number of directions in a quadrant.
const QUADRANT: f32 = (DIRECTIONS / 4) as f32;

/// Components of the gauges of all steps in one direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spoke {
    /// Gauge of the ellipse.
    pub ellipse: f32,
    /// Addition for the outline at full strength.
    pub outline: f32,
    /// Height of the transverse folds divided by their maximum height.
    pub fold: f32,
    /// Distance by which the direction is ahead along the period of the folds, turns.
    pub turn: f32,
}

/// Spokes of a model; empty if the region is the ellipse at every step.
pub(super) fn spokes(p: &Parameters, row_turn: impl Fn(u32) -> f64) -> Vec<Spoke> {
    if p.is_elliptic() {
        return Vec::new();
    }
    let (outline, folds) = (p.outline.gauge().ok().flatten(), &p.folds);
    let spoke = |i: usize| {
        let [x, y] = star::direction(i);
        let ellipse = (x * x + y * y).sqrt();
        let around = f64::from(folds.rows) * (libm::atan2(y, x) / TAU).rem_euclid(1.0);
        let row = (around.floor() as u32).min(folds.rows - 1);
        // Bands lie between two rows.
        let within = ((around - f64::from(row) - 0.5 * folds.band) / (1.0 - folds.band)).clamp(0.0, 1.0);
        Spoke {
            ellipse: ellipse as f32,
            outline: outline.as_ref().map_or(0.0, |gauge| (gauge[i] - ellipse) as f32),
            fold: libm::sin(0.5 * TAU * within) as f32,
            turn: row_turn(row) as f32,
        }
    };
    (0..DIRECTIONS).map(spoke).collect()
}

/// Region at a step, or the curve that the wall follows.
#[derive(Clone, Debug)]
pub enum Region {
    /// An ellipse.
    Ellipse,
    /// A tabulated gauge.
    Shaped(Box<Gauge>),
}

impl Region {
    /// The region of a row.
    pub(super) fn inner(spokes: &[Spoke], row: &StepRow) -> Self {
        Self::with(spokes, row, row.fold)
    }

    /// The region without the part of the folds that the wall does not follow. The target of the
    /// wall, and its minimum distance from the inner loop, are enlarged copies of this region.
    pub(super) fn wall(spokes: &[Spoke], row: &StepRow) -> Self {
        Self::with(spokes, row, row.fold * row.fold_of_wall)
    }

    fn with(spokes: &[Spoke], row: &StepRow, depth: f32) -> Self {
        if spokes.is_empty() { Self::Ellipse } else { Self::Shaped(Box::new(Gauge::new(spokes, row, depth))) }
    }

    /// Distance from the axis to the boundary in a direction of the flattened plane, in units of
    /// `R_in`.
    pub fn boundary(&self, unit: [f32; 2]) -> f32 {
        match self {
            Self::Ellipse => 1.0,
            Self::Shaped(gauge) => gauge.boundary(unit),
        }
    }

    /// Area in the flattened plane, in units of `R_in`².
    #[must_use]
    pub fn area(&self) -> f64 {
        match self {
            Self::Ellipse => PI,
            Self::Shaped(gauge) => gauge.area(),
        }
    }

    /// Minimum distance from the axis to the boundary in the flattened plane, in units of `R_in`.
    #[must_use]
    pub fn narrowest(&self) -> f32 {
        match self {
            Self::Ellipse => 1.0,
            Self::Shaped(gauge) => (0..DIRECTIONS).map(|i| gauge.distance(i)).fold(f32::INFINITY, f32::min),
        }
    }

    /// Maximum change of the gauge per length of a move in the flattened plane.
    pub(super) fn slope(&self) -> f32 {
        match self {
            Self::Ellipse => 1.0,
            Self::Shaped(gauge) => gauge.slope(),
        }
    }

    /// Direction, in the flattened plane, of the point of the boundary nearest to `p`.
    pub fn nearest(&self, p: [f32; 2], row: &StepRow) -> [f32; 2] {
        match self {
            Self::Ellipse => super::maths::nearest_on_ellipse(p, row.r_in, row.squash),
            Self::Shaped(gauge) => gauge.nearest(p, row.r_in, row.squash),
        }
    }
}

/// Gauge in all directions.
#[derive(Clone, Debug)]
pub struct Gauge {
    /// Gauge by direction; the first entry is repeated at the end.
    at: [f32; DIRECTIONS + 1],
}

impl Gauge {
    fn new(spokes: &[Spoke], row: &StepRow, depth: f32) -> Self {
        // Relative increase of the gauge at a fold.
        let raised = depth / (1.0 - depth);
        let mut at = [0.0; DIRECTIONS + 1];
        for (at, spoke) in at.iter_mut().zip(spokes) {
            let wave = 0.5 + 0.5 * cos_turns(spoke.turn + row.fold_phase);
            let pulse = wave * wave * (wave * wave);
            *at = (spoke.ellipse + row.outline * spoke.outline) * (1.0 + raised * spoke.fold * pulse);
        }
        at[DIRECTIONS] = at[0];
        Self { at }
    }

    /// The gauge of a point of the flattened plane.
    #[inline(always)]
    pub fn radius(&self, p: [f32; 2]) -> f32 {
        let place = place(p);
        let i = (place as usize).min(DIRECTIONS - 1);
        let part = place - i as f32;
        (p[0].abs() + p[1].abs()) * (self.at[i] + part * (self.at[i + 1] - self.at[i]))
    }

    /// See [`Region::boundary`].
    #[inline(always)]
    pub fn boundary(&self, unit: [f32; 2]) -> f32 {
        1.0 / max(self.radius(unit), 1e-6)
    }

    /// Minimum and maximum gauge on the segment from `a` to `b`. Both occur at the ends of the
    /// segment, or where the segment crosses a tabulated direction.
    pub fn extent(&self, a: [f32; 2], b: [f32; 2]) -> [f32; 2] {
        let ends = [self.radius(a), self.radius(b)];
        let [mut least, mut most] = [min(ends[0], ends[1]), max(ends[0], ends[1])];
        let (a, b) = if cross(a, b) < 0.0 { (b, a) } else { (a, b) };
        let first = place(a) as usize + 1;
        let crossed = (place(b) as usize + 1 + DIRECTIONS - first) % DIRECTIONS;
        for i in first..first + crossed {
            let d = direction(i % DIRECTIONS);
            let (from, to) = (cross(a, d), cross(d, b));
            if from >= 0.0 && to >= 0.0 && from + to > 0.0 {
                let t = from / (from + to);
                let p = [a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])];
                let gauge = (p[0].abs() + p[1].abs()) * self.at[i % DIRECTIONS];
                (least, most) = (min(least, gauge), max(most, gauge));
            }
        }
        [least, most]
    }

    fn area(&self) -> f64 {
        let of = |i: usize| {
            let (a, b) = (star::direction(i), star::direction(i + 1));
            0.5 * (a[0] * b[1] - a[1] * b[0]) / (f64::from(self.at[i]) * f64::from(self.at[i + 1]))
        };
        (0..DIRECTIONS).map(of).sum()
    }

    /// Distance from the axis to the boundary in a tabulated direction.
    fn distance(&self, i: usize) -> f32 {
        let [x, y] = direction(i);
        (x * x + y * y).sqrt() / self.at[i]
    }

    fn nearest(&self, p: [f32; 2], r_in: f32, squash: f32) -> [f32; 2] {
        let corner = |i: usize| {
            let [x, y] = direction(i % DIRECTIONS);
            let scale = r_in / self.at[i];
            [scale * x, scale * squash * y]
        };
        let (mut best, mut at) = (f32::INFINITY, [r_in, 0.0]);
        let mut a = corner(0);
        for i in 0..DIRECTIONS {
            let b = corner(i + 1);
            let edge = [b[0] - a[0], b[1] - a[1]];
            let along = (p[0] - a[0]) * edge[0] + (p[1] - a[1]) * edge[1];
            let t = min(max(along / max(edge[0] * edge[0] + edge[1] * edge[1], 1e-12), 0.0), 1.0);
            let q = [a[0] + t * edge[0], a[1] + t * edge[1]];
            let distance = (p[0] - q[0]) * (p[0] - q[0]) + (p[1] - q[1]) * (p[1] - q[1]);
            if distance < best {
                (best, at) = (distance, q);
            }
            a = b;
        }
        let flat = [at[0], at[1] / squash];
        let length = max((flat[0] * flat[0] + flat[1] * flat[1]).sqrt(), 1e-6);
        [flat[0] / length, flat[1] / length]
    }

    fn slope(&self) -> f32 {
        let of = |i: usize| {
            let (a, b) = (direction(i), direction((i + 1) % DIRECTIONS));
            // The vector g with g·a and g·b the gauges of a and b.
            let area = cross(a, b);
            let g = [
                (self.at[i] * b[1] - self.at[i + 1] * a[1]) / area,
                (self.at[i + 1] * a[0] - self.at[i] * b[0]) / area,
            ];
            (g[0] * g[0] + g[1] * g[1]).sqrt()
        };
        (0..DIRECTIONS).map(of).fold(1.0, f32::max)
    }
}

/// Place on the diamond |x| + |y| = 1: index of the tabulated direction at or before `p`, plus the
/// fraction of the distance to the next one.
#[inline(always)]
fn place([x, y]: [f32; 2]) -> f32 {
    let part = y.abs() / max(x.abs() + y.abs(), 1e-12);
    let quadrants = match (x < 0.0, y < 0.0) {
        (false, false) => part,
        (true, false) => 2.0 - part,
        (true, true) => 2.0 + part,
        (false, true) => 4.0 - part,
    };
    QUADRANT * quadrants
}

fn direction(i: usize) -> [f32; 2] {
    star::direction(i).map(|c| c as f32)
}

fn cross(a: [f32; 2], b: [f32; 2]) -> f32 {
    a[0] * b[1] - a[1] * b[0]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sim::Plan;
    use crate::spec::{ModelSpec, preset};
    use serde_json::{Value, json};

    fn plan(patch: &Value) -> Plan {
        Plan::new(&ModelSpec::resolve(preset("paper").unwrap(), patch).unwrap(), 3)
    }

    fn gauge(plan: &Plan, time: i64) -> Gauge {
        match plan.region(time) {
            Region::Shaped(gauge) => *gauge,
            Region::Ellipse => panic!("an ellipse"),
        }
    }

    /// A heart-like polygon with a notch, and folds.
    fn notched() -> Plan {
        let points = [[1.2, 0.0], [0.9, 0.9], [0.1, 0.5], [-0.8, 1.0], [-1.0, -0.6], [0.2, -0.9]];
        plan(&json!({
            "outline": { "kind": "polygon", "points": points },
            "folds": { "depth": 0.4, "rows": 3, "period_mm": 20, "stagger": 0.3 },
        }))
    }

    fn noise(i: u32) -> [f32; 2] {
        let of = |j: u32| crate::random::unit(crate::random::word(1, crate::random::Stream::Start, i, j)) - 0.5;
        [4000.0 * of(0), 4000.0 * of(1)]
    }

    #[test]
    fn only_other_outlines_and_folds_need_a_table() {
        for (patch, is_elliptic) in [
            (json!({}), true),
            (json!({ "outline": { "kind": "superellipse", "strength": 0 } }), true),
            (json!({ "outline": { "kind": "superellipse" } }), false),
            (json!({ "folds": { "depth": 0.1 } }), false),
        ] {
            let spec = ModelSpec::resolve(preset("paper").unwrap(), &patch).unwrap();
            assert_eq!((spec.is_elliptic(), plan(&patch).spokes.is_empty()), (is_elliptic, is_elliptic), "{patch}");
        }
    }

    #[test]
    fn inside_is_where_the_gauge_is_below_the_radius() {
        let square = plan(&json!({ "outline": { "kind": "polygon", "points": [[1, -1], [1, 1], [-1, 1], [-1, -1]] } }));
        let gauge = gauge(&square, 0);
        for p in (0..1000).map(noise) {
            let expected = p[0].abs().max(p[1].abs());
            assert!((gauge.radius(p) - expected).abs() < 1e-3, "{p:?}");
        }
        assert!((gauge.slope() - 1.0).abs() < 1e-5);
        assert!((gauge.area() - 4.0).abs() < 1e-5);
        assert!(
            (plan(&json!({ "outline": { "kind": "superellipse", "exponent": 2 } })).at(5).margin - 20.0).abs() < 0.01
        );
    }

    #[test]
    fn an_edge_is_bounded_by_its_extent() {
        let plan = notched();
        for time in [0, 500, 1999] {
            let gauge = gauge(&plan, time);
            let mut tight = 0;
            for i in 0..2000 {
                let (a, b) = (noise(2 * i), noise(2 * i + 1));
                let b = if i % 2 == 0 { b } else { [a[0] + 0.02 * b[0], a[1] + 0.02 * b[1]] };
                let [least, most] = gauge.extent(a, b);
                let at = |k: u32| {
                    let t = k as f32 / 500.0;
                    gauge.radius([a[0] + t * (b[0] - a[0]), a[1] + t * (b[1] - a[1])])
                };
                let [low, high] = [f32::min, f32::max].map(|of| (0..=500).map(at).reduce(of).unwrap());
                let rounding = 1e-5 * (1.0 + most);
                assert!(
                    least <= low + rounding && high <= most + rounding,
                    "{a:?} {b:?}: {low} {high} in {least} {most}"
                );
                tight += u32::from(most - high < 2.0 && low - least < 2.0);
            }
            assert!(tight > 1500, "{tight}");
        }
    }

    #[test]
    fn the_nearest_point_is_nearest() {
        let plan = notched();
        for time in [0, 700] {
            let (row, region) = (plan.at(time), plan.region(time));
            let point = |unit: [f32; 2]| {
                let r = row.r_in * region.boundary(unit);
                [r * unit[0], r * row.squash * unit[1]]
            };
            let distance = |p: [f32; 2], unit: [f32; 2]| (p[0] - point(unit)[0]).hypot(p[1] - point(unit)[1]);
            for p in (0..200).map(noise) {
                let angle = |k: u32| k as f32 * std::f32::consts::TAU / 20_000.0;
                let best =
                    (0..20_000).map(|k| distance(p, [angle(k).cos(), angle(k).sin()])).fold(f32::INFINITY, f32::min);
                let found = distance(p, region.nearest(p, row));
                assert!(found < best + 0.3, "{p:?}: {found} against {best}");
            }
        }
    }

    #[test]
    fn folds_stand_in_rows_and_pass_by() {
        let plan = plan(&json!({ "folds": {
                "depth": 0.5, "rows": 2, "band": 0.2, "period_mm": 21, "stagger": 0.5, "irregularity": 0, "wall": 0.5,
            } }));
        // In the middle of a row, on either side, and in a band.
        let (mut lows, mut wall) = ([1.0f32; 2], 1.0f32);
        for time in 0..2000 {
            let region = plan.region(time);
            let rows = [region.boundary([0.0, 1.0]), region.boundary([0.0, -1.0])];
            assert!(rows[0].max(rows[1]) > 0.85, "both rows of folds at once");
            assert!((region.boundary([1.0, 0.0]) - 1.0).abs() < 1e-5);
            lows = [lows[0].min(rows[0]), lows[1].min(rows[1])];
            wall = wall.min(plan.wall_region(time).boundary([0.0, 1.0]));
        }
        assert!(lows.iter().all(|low| (low - 0.5).abs() < 0.01) && (wall - 0.75).abs() < 0.01, "{lows:?} {wall}");
    }
}
