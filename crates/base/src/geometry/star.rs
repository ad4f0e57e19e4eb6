//! Star-shaped closed curves, represented by gauges.
//!
//! Every ray from the origin intersects such a curve once. Its gauge is the function that is 1 on
//! the curve and grows in proportion to the distance along each ray. A gauge is tabulated at
//! [`DIRECTIONS`] equidistant points of the diamond |x| + |y| = 1 and is linear in between, so the
//! tabulated curve is a polygon.

use super::vector::{cross2, sub};

/// Directions in a table. A multiple of four, so the table includes the corners of the diamond.
pub const DIRECTIONS: usize = 256;

const DIRECTIONS_PER_QUADRANT: usize = DIRECTIONS / 4;
/// Samples along a ray per cell of a grid.
const SAMPLES_PER_CELL: f64 = 8.0;
/// Bisection steps that locate a crossing between two samples.
const BISECTIONS: u32 = 40;

/// Reasons why a curve has no gauge.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum NotStar {
    /// An edge of the polygon passes through the origin or turns back around it.
    TurnsBack {
        /// Index of the first corner of the edge.
        corner: usize,
    },
    /// The polygon goes around the origin more than once.
    WindsRepeatedly,
    /// The function on a grid does not change its sign exactly once along a ray.
    Crossings {
        /// Direction of the ray, degrees.
        angle_deg: f64,
        /// Number of sign changes.
        count: usize,
    },
    /// The origin is not inside the curve.
    Outside,
}

/// Point of the diamond in a direction.
#[must_use]
pub fn direction(index: usize) -> [f64; 2] {
    let along = (index % DIRECTIONS_PER_QUADRANT) as f64 / DIRECTIONS_PER_QUADRANT as f64;
    match index / DIRECTIONS_PER_QUADRANT % 4 {
        0 => [1.0 - along, along],
        1 => [-along, 1.0 - along],
        2 => [along - 1.0, -along],
        _ => [along, along - 1.0],
    }
}

/// Distance from the origin to the curve in each direction.
pub fn radii(gauge: &[f64]) -> impl Iterator<Item = f64> + '_ {
    (0..).zip(gauge).map(|(i, gauge)| {
        let [x, y] = direction(i);
        (x * x + y * y).sqrt() / gauge
    })
}

/// Gauge of the superellipse |x|ⁿ + |y|ⁿ = 1.
#[must_use]
pub fn superellipse(exponent: f64) -> Vec<f64> {
    let gauge = |i| {
        let [x, y] = direction(i);
        libm::pow(libm::pow(x.abs(), exponent) + libm::pow(y.abs(), exponent), 1.0 / exponent)
    };
    (0..DIRECTIONS).map(gauge).collect()
}

/// Gauge of a polygon, clockwise or counter-clockwise.
///
/// # Errors
/// Returns an error if a ray from the origin does not intersect the polygon exactly once.
pub fn polygon(corners: &[[f64; 2]]) -> Result<Vec<f64>, NotStar> {
    let n = corners.len();
    let edges = || (0..n).map(|i| (i, corners[i], corners[(i + 1) % n]));
    let area: f64 = edges().map(|(_, a, b)| cross2(a, b)).sum();
    let sense = if area < 0.0 { -1.0 } else { 1.0 };
    if let Some((corner, ..)) = edges().find(|&(_, a, b)| sense * cross2(a, b) <= 0.0) {
        return Err(NotStar::TurnsBack { corner });
    }
    let winds = edges().filter(|&(_, a, b)| (a[1] < 0.0) != (b[1] < 0.0)).count();
    if winds != 2 {
        return Err(NotStar::WindsRepeatedly);
    }
    let gauge = |i| {
        let d = direction(i);
        let within = |a: [f64; 2], b: [f64; 2]| sense * cross2(a, d) >= 0.0 && sense * cross2(d, b) >= 0.0;
        let (_, a, b) = edges().find(|&(_, a, b)| within(a, b)).ok_or(NotStar::WindsRepeatedly)?;
        Ok(cross2(d, sub(b, a)) / cross2(a, b))
    };
    (0..DIRECTIONS).map(gauge).collect()
}

/// Gauge of the curve on which a function is 0.
///
/// The function is negative inside the curve. It is given at the nodes of a square grid from
/// −`half` to `half` with at least two rows, and is bilinear between the nodes. Rows are ordered by
/// y, and values in a row by x, both ascending.
///
/// # Errors
/// Returns an error if the origin is not inside or a ray does not cross 0 exactly once.
pub fn level(rows: &[Vec<f64>], half: f64) -> Result<Vec<f64>, NotStar> {
    let cells = rows.len() - 1;
    let value = |[x, y]: [f64; 2]| {
        let [u, v] = [x, y].map(|c| ((c / half + 1.0) * 0.5 * cells as f64).clamp(0.0, cells as f64));
        let [i, j] = [u, v].map(|c| (c as usize).min(cells - 1));
        let (u, v) = (u - i as f64, v - j as f64);
        let row = |j: usize| rows[j][i] + u * (rows[j][i + 1] - rows[j][i]);
        row(j) + v * (row(j + 1) - row(j))
    };
    if value([0.0; 2]) >= 0.0 {
        return Err(NotStar::Outside);
    }
    let gauge = |index| {
        let [x, y] = direction(index);
        // The ray leaves the square here, in units of the diamond.
        let end = half / x.abs().max(y.abs());
        let at = |t: f64| value([t * x, t * y]) < 0.0;
        let steps = (SAMPLES_PER_CELL * cells as f64).ceil() as u32;
        let place = |k: u32| end * f64::from(k) / f64::from(steps);
        let crossings: Vec<u32> = (1..=steps).filter(|&k| at(place(k)) != at(place(k - 1))).collect();
        let [crossing] = crossings[..] else {
            let angle_deg = libm::atan2(y, x).to_degrees().rem_euclid(360.0);
            return Err(NotStar::Crossings { angle_deg, count: crossings.len() });
        };
        let (mut inside, mut outside) = (place(crossing - 1), place(crossing));
        for _ in 0..BISECTIONS {
            let middle = 0.5 * (inside + outside);
            if at(middle) {
                inside = middle;
            } else {
                outside = middle;
            }
        }
        Ok(2.0 / (inside + outside))
    };
    (0..DIRECTIONS).map(gauge).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    fn ring(n: usize, radius: impl Fn(f64) -> f64) -> Vec<[f64; 2]> {
        let angle = |i: usize| TAU * i as f64 / n as f64;
        (0..n).map(|i| [radius(angle(i)) * angle(i).cos(), radius(angle(i)) * angle(i).sin()]).collect()
    }

    fn worst(gauge: &[f64], expected: impl Fn(f64) -> f64) -> f64 {
        let angle = |i| direction(i)[1].atan2(direction(i)[0]);
        radii(gauge).enumerate().map(|(i, radius)| (radius - expected(angle(i))).abs()).fold(0.0, f64::max)
    }

    #[test]
    fn directions_go_once_around() {
        for i in 0..DIRECTIONS {
            let (a, b) = (direction(i), direction(i + 1));
            assert!((a[0].abs() + a[1].abs() - 1.0).abs() < 1e-15 && cross2(a, b) > 0.0, "{i}");
        }
        assert_eq!([0, 64, 128, 192].map(direction), [[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]]);
    }

    #[test]
    fn a_superellipse_lies_between_circle_and_square() {
        assert!(worst(&superellipse(2.0), |_| 1.0) < 1e-12);
        let square = |angle: f64| 1.0 / angle.cos().abs().max(angle.sin().abs());
        assert!(worst(&superellipse(20.0), square) < 0.06);
        assert!(worst(&polygon(&[[1.0, -1.0], [1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0]]).unwrap(), square) < 1e-12);
    }

    #[test]
    fn a_polygon_may_be_given_in_either_sense() {
        let flower = |angle: f64| 1.0 + 0.3 * (3.0 * angle).cos();
        let mut corners = ring(720, flower);
        let gauge = polygon(&corners).unwrap();
        assert!(worst(&gauge, flower) < 1e-4);
        corners.reverse();
        let reversed = polygon(&corners).unwrap();
        assert_eq!(reversed.len(), gauge.len());
        assert!(reversed.iter().zip(&gauge).all(|(a, b)| (a - b).abs() < 1e-12));
    }

    #[test]
    fn curves_that_rays_meet_more_than_once_are_refused() {
        let hook = [[1.0, -1.0], [1.0, 1.0], [0.3, 0.2], [0.4, 1.0], [-1.0, 1.0], [-1.0, -1.0]];
        assert_eq!(polygon(&hook), Err(NotStar::TurnsBack { corner: 1 }));
        assert!(matches!(polygon(&[[1.0, 1.0], [2.0, 1.0], [1.5, 2.0]]), Err(NotStar::TurnsBack { .. })));
        let twice: Vec<[f64; 2]> =
            ring(10, |_| 1.0).into_iter().step_by(3).chain(ring(10, |_| 1.1).into_iter().skip(2).step_by(3)).collect();
        assert!(polygon(&twice).is_err());
        let star = ring(5, |_| 1.0);
        let pentagram: Vec<[f64; 2]> = (0..5).map(|i| star[2 * i % 5]).collect();
        assert_eq!(polygon(&pentagram), Err(NotStar::WindsRepeatedly));
    }

    fn grid(side: usize, half: f64, value: impl Fn(f64, f64) -> f64) -> Vec<Vec<f64>> {
        let place = |i: usize| half * (2.0 * i as f64 / (side - 1) as f64 - 1.0);
        (0..side).map(|j| (0..side).map(|i| value(place(i), place(j))).collect()).collect()
    }

    #[test]
    fn the_level_of_a_grid_is_found() {
        let off = grid(65, 1.5, |x, y| (x - 0.2).hypot(y) - 1.0);
        let circle = |angle: f64| 0.2 * angle.cos() + (1.0 - (0.2 * angle.sin()).powi(2)).sqrt();
        assert!(worst(&level(&off, 1.5).unwrap(), circle) < 2e-3);
        assert_eq!(level(&grid(9, 1.0, |x, y| 1.0 - x.hypot(y)), 1.0), Err(NotStar::Outside));
        let open = level(&grid(9, 1.0, |x, y| x.hypot(y) - 3.0), 1.0);
        assert_eq!(open, Err(NotStar::Crossings { angle_deg: 0.0, count: 0 }));
        // Two separate circles.
        let two = grid(65, 2.0, |x, y| (x.hypot(y) - 0.5).min(x.hypot(y - 1.4) - 0.3));
        let Err(NotStar::Crossings { angle_deg, count: 3 }) = level(&two, 2.0) else {
            panic!("{:?}", level(&two, 2.0))
        };
        assert!((70.0..110.0).contains(&angle_deg));
    }
}
