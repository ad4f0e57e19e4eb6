//! Time per step as a function of the number of particles, interpolated between measured points.

/// A measured point: particles of both loops, and seconds per step.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub(super) struct Point {
    pub(super) particles: f64,
    pub(super) seconds_per_step: f64,
}

/// Returns the seconds per step at `particles`: a power law between adjacent points, extrapolated
/// beyond the first and the last. `points` ascend in particles.
pub(super) fn at(points: &[Point], particles: f64) -> f64 {
    let [first, .., last] = points else {
        return points.first().map_or(0.0, |p| p.seconds_per_step);
    };
    let (a, b) = if particles <= first.particles {
        (first, &points[1])
    } else if particles >= last.particles {
        (&points[points.len() - 2], last)
    } else {
        let next = points.iter().position(|p| p.particles > particles).unwrap_or(points.len() - 1);
        (&points[next - 1], &points[next])
    };
    let span = (b.particles / a.particles).ln();
    let share = if span > 0.0 { (particles / a.particles).ln() / span } else { 0.0 };
    (a.seconds_per_step.ln() + share * (b.seconds_per_step / a.seconds_per_step).ln()).exp()
}

/// Returns the seconds of a run from the number of particles in each of its steps.
pub(super) fn integrate(points: &[Point], particles: impl IntoIterator<Item = u32>) -> f64 {
    particles.into_iter().map(|n| at(points, f64::from(n))).sum()
}

/// Points whose numbers of particles differ by less than this fraction are merged.
const TELL_APART: f64 = 0.01;

/// Returns means over `width` consecutive steps, and over consecutive steps with almost the same
/// number of particles.
pub(super) fn smooth(steps: &[Point], width: usize) -> Vec<Point> {
    let mean = |run: &[Point]| {
        let of = |value: fn(&Point) -> f64| run.iter().map(value).sum::<f64>() / run.len() as f64;
        Point { particles: of(|p| p.particles), seconds_per_step: of(|p| p.seconds_per_step) }
    };
    let means: Vec<Point> = steps.chunks(width).map(mean).collect();
    means.chunk_by(|a, b| b.particles - a.particles < TELL_APART * a.particles).map(mean).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_power_law_is_met_exactly() {
        let law = |n: f64| 3e-9 * n * n;
        let points: Vec<Point> =
            [710.0, 2000.0, 8300.0].map(|n| Point { particles: n, seconds_per_step: law(n) }).into();
        for n in [300.0, 710.0, 1000.0, 2000.0, 5000.0, 8300.0, 9000.0] {
            assert!((at(&points, n) / law(n) - 1.0).abs() < 1e-9, "{n}");
        }
        let total = integrate(&points, [710, 1000, 8300]);
        assert!((total / (law(710.0) + law(1000.0) + law(8300.0)) - 1.0).abs() < 1e-9);
    }

    #[test]
    fn one_point_is_a_constant() {
        let point = Point { particles: 10.0, seconds_per_step: 2.0 };
        assert_eq!(at(&[point], 99.0), 2.0);
        assert_eq!(smooth(&[point; 5], 2), [point]);
    }

    #[test]
    fn smoothing_keeps_what_grows() {
        let steps: Vec<Point> =
            (0..6).map(|k| Point { particles: f64::from(100 + 10 * k), seconds_per_step: f64::from(k) }).collect();
        let smoothed = smooth(&steps, 2);
        assert_eq!(smoothed.iter().map(|p| p.particles).collect::<Vec<_>>(), [105.0, 125.0, 145.0]);
        assert_eq!(smoothed[1].seconds_per_step, 2.5);
    }
}
