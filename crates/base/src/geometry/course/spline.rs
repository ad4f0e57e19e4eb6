//! Cubic splines with continuous second derivatives.

use glam::DVec3;

/// A cubic spline through points. The not-a-knot condition at the ends keeps an arc an arc up to
/// its ends.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Spline {
    knots: Vec<f64>,
    points: Vec<DVec3>,
    second_derivatives: Vec<DVec3>,
}

/// Position and derivatives at one parameter.
#[derive(Clone, Copy, Debug)]
pub(super) struct Jet {
    pub(super) position: DVec3,
    pub(super) first: DVec3,
    pub(super) second: DVec3,
}

impl Spline {
    /// Spline through at least two points at strictly ascending knots.
    pub(super) fn new(knots: Vec<f64>, points: Vec<DVec3>) -> Self {
        let second_derivatives = second_derivatives(&knots, &points);
        Self { knots, points, second_derivatives }
    }

    /// Spline whose knots are as far apart as its points.
    pub(super) fn by_chords(points: &[DVec3]) -> Self {
        let mut sum = 0.0;
        let rest = points.windows(2).map(|pair| {
            sum += pair[0].distance(pair[1]);
            sum
        });
        let knots = std::iter::once(0.0).chain(rest).collect();
        Self::new(knots, points.to_vec())
    }

    pub(super) fn knots(&self) -> &[f64] {
        &self.knots
    }

    pub(super) fn points(&self) -> &[DVec3] {
        &self.points
    }

    /// Index of the span that contains `t`, and the fraction of the span before `t`.
    pub(super) fn span(&self, t: f64) -> (usize, f64) {
        let i = self.knots.partition_point(|&knot| knot <= t).clamp(1, self.knots.len() - 1) - 1;
        (i, (t - self.knots[i]) / (self.knots[i + 1] - self.knots[i]))
    }

    pub(super) fn at(&self, t: f64) -> Jet {
        let (i, b) = self.span(t);
        let a = 1.0 - b;
        let width = self.knots[i + 1] - self.knots[i];
        let ([p, q], [m, n]) =
            ([self.points[i], self.points[i + 1]], [self.second_derivatives[i], self.second_derivatives[i + 1]]);
        Jet {
            position: a * p + b * q + ((a * a * a - a) * m + (b * b * b - b) * n) * (width * width / 6.0),
            first: (q - p) / width + ((3.0 * b * b - 1.0) * n - (3.0 * a * a - 1.0) * m) * (width / 6.0),
            second: a * m + b * n,
        }
    }
}

/// Solves the tridiagonal equations for the second derivatives.
fn second_derivatives(knots: &[f64], points: &[DVec3]) -> Vec<DVec3> {
    let last = points.len() - 1;
    if last < 2 {
        return vec![DVec3::ZERO; points.len()];
    }
    let widths: Vec<f64> = knots.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let slopes: Vec<DVec3> = (0..last).map(|i| (points[i + 1] - points[i]) / widths[i]).collect();
    if last == 2 {
        return vec![(slopes[1] - slopes[0]) * 2.0 / (widths[0] + widths[1]); 3];
    }
    // Rows of the inner knots. At the ends, the third derivative equals the one of the adjacent
    // span.
    let ends = [widths[0] / widths[1], widths[last - 1] / widths[last - 2]];
    let mut rows: Vec<([f64; 3], DVec3)> = (1..last)
        .map(|i| ([widths[i - 1], 2.0 * (widths[i - 1] + widths[i]), widths[i]], 6.0 * (slopes[i] - slopes[i - 1])))
        .collect();
    let count = rows.len();
    let [before, diagonal, after] = &mut rows[0].0;
    *diagonal += *before * (1.0 + ends[0]);
    *after -= *before * ends[0];
    let [before, diagonal, after] = &mut rows[count - 1].0;
    *diagonal += *after * (1.0 + ends[1]);
    *before -= *after * ends[1];
    for i in 1..count {
        let ([_, diagonal, after], right) = rows[i - 1];
        let factor = rows[i].0[0] / diagonal;
        rows[i].0[1] -= factor * after;
        rows[i].1 -= factor * right;
    }
    let mut found = vec![DVec3::ZERO; points.len()];
    for i in (0..count).rev() {
        let ([_, diagonal, after], right) = rows[i];
        let next = if i + 1 < count { after * found[i + 2] } else { DVec3::ZERO };
        found[i + 1] = (right - next) / diagonal;
    }
    found[0] = found[1] * (1.0 + ends[0]) - found[2] * ends[0];
    found[last] = found[last - 1] * (1.0 + ends[1]) - found[last - 2] * ends[1];
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cubic_is_its_own_spline() {
        let cubic = |t: f64| DVec3::new(t * t * t - t, 2.0 - t * t, 0.5 * t);
        let knots = vec![0.0, 0.7, 1.0, 2.5, 3.0];
        let spline = Spline::new(knots.clone(), knots.iter().map(|&t| cubic(t)).collect());
        for t in [-0.1, 0.0, 0.3, 0.7, 1.9, 2.99, 3.0, 3.2] {
            let jet = spline.at(t);
            assert!(jet.position.distance(cubic(t)) < 1e-12, "{t}: {}", jet.position);
            assert!(jet.first.distance(DVec3::new(3.0 * t * t - 1.0, -2.0 * t, 0.5)) < 1e-11);
            assert!(jet.second.distance(DVec3::new(6.0 * t, -2.0, 0.0)) < 1e-10);
        }
    }

    #[test]
    fn few_points_give_a_line_and_a_parabola() {
        let line = Spline::by_chords(&[DVec3::ZERO, DVec3::new(3.0, 0.0, 4.0)]);
        assert_eq!((line.at(2.5).position, line.at(1.0).second), (DVec3::new(1.5, 0.0, 2.0), DVec3::ZERO));
        let parabola = |t: f64| DVec3::new(t, t * t, 0.0);
        let spline = Spline::new(vec![0.0, 1.0, 3.0], [0.0, 1.0, 3.0].map(parabola).to_vec());
        assert!(spline.at(2.0).position.distance(parabola(2.0)) < 1e-12);
    }
}
