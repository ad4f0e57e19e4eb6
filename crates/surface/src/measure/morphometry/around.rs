//! Distribution of the mucosa around the tube.

use super::shape::{Ellipse, Shape, edges};
use crate::geometry::vector::distance;

/// Maximum order of the Fourier series around the tube.
const ORDERS: usize = 6;

/// Differences between the sides of a section.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Around {
    /// Length of the vector sum of the directions of all parts of the mucosa, seen from the centre
    /// of the tube, relative to the length of the mucosa.
    pub asymmetry: f64,
    /// Coefficient of variation of the length of mucosa by direction, from its Fourier series up to
    /// order six.
    pub angular_cv: f64,
}

/// Measures the distribution of the boundary of the lumen. Angles are taken in the plane in which
/// the base ellipse is a circle. `None` without a lumen.
pub(super) fn around(shape: &Shape<'_>, base: &Ellipse) -> Option<Around> {
    let (mut sums, mut total) = ([[0.0; 2]; ORDERS], 0.0);
    for (a, b) in shape.lumen.iter().flat_map(|ring| edges(ring)) {
        let middle = [(a[0] + b[0]) / 2.0, (a[1] + b[1]) / 2.0].map(|x| x as f32);
        let [x, y] = base.flattened(middle);
        let (length, radius) = (distance(a, b), (x * x + y * y).sqrt());
        total += length;
        if radius == 0.0 {
            continue;
        }
        let (cos, sin) = (x / radius, y / radius);
        let mut turn = [1.0, 0.0];
        for sum in &mut sums {
            turn = [turn[0] * cos - turn[1] * sin, turn[1] * cos + turn[0] * sin];
            sum[0] += length * turn[0];
            sum[1] += length * turn[1];
        }
    }
    let squares = sums.map(|[x, y]| (x * x + y * y) / (total * total));
    (total > 0.0)
        .then(|| Around { asymmetry: squares[0].sqrt(), angular_cv: (2.0 * squares.iter().sum::<f64>()).sqrt() })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Outer contour of a tube that is slightly wider along x than along y, so that its axes are
    /// known.
    fn outside() -> Vec<[f32; 2]> {
        circle(1000.0, 0.0).into_iter().map(|[x, y]| [1.001 * x, y]).collect()
    }

    /// Circle around a point on the x axis.
    fn circle(radius: f32, x: f32) -> Vec<[f32; 2]> {
        (0..7200)
            .map(|i| {
                let (sin, cos) = (std::f32::consts::TAU * i as f32 / 7200.0).sin_cos();
                [x + radius * cos, radius * sin]
            })
            .collect()
    }

    fn measured(lumen: &[[f32; 2]]) -> Around {
        let outer = outside();
        let shape = Shape { outer: &outer, lumen: vec![lumen] };
        around(&shape, &shape.base_ellipse()).unwrap()
    }

    #[test]
    fn a_lumen_in_the_middle_is_even_on_all_sides() {
        let Around { asymmetry, angular_cv } = measured(&circle(400.0, 0.0));
        assert!(asymmetry < 1e-4 && angular_cv < 0.01, "{asymmetry} {angular_cv}");
    }

    #[test]
    fn a_lumen_to_the_side_is_seen_as_far_from_the_centre_as_it_is() {
        let Around { asymmetry, angular_cv } = measured(&circle(100.0, 700.0));
        // Directions differ by up to asin(1/7) from the direction of the centre of the lumen. Their
        // mean is their mean cosine.
        let expected = 1.0 - (1.0 / 7.0_f64).powi(2) / 4.0;
        assert!((asymmetry - expected).abs() < 1e-3, "{asymmetry} {expected}");
        // All mucosa in about one direction: six terms of 2·1², slightly less because directions
        // differ.
        let most = 12.0_f64.sqrt();
        assert!(angular_cv < most && angular_cv > 0.9 * most, "{angular_cv}");
    }

    #[test]
    fn more_mucosa_in_some_directions_is_unevenness_without_asymmetry() {
        // The radius r = 300 + 60·cos(2θ) varies by a fifth, and the length with it.
        let lumen: Vec<[f32; 2]> = (0..7200)
            .map(|i| {
                let angle = std::f32::consts::TAU * i as f32 / 7200.0;
                let radius = 300.0 + 60.0 * (2.0 * angle).cos();
                [radius * angle.cos(), radius * angle.sin()]
            })
            .collect();
        let Around { asymmetry, angular_cv } = measured(&lumen);
        assert!(asymmetry < 1e-3 && angular_cv > 0.1 && angular_cv < 0.3, "{asymmetry} {angular_cv}");
    }

    #[test]
    fn nothing_is_measured_without_a_lumen() {
        let shape = Shape { outer: &outside(), lumen: Vec::new() };
        assert_eq!(around(&shape, &shape.base_ellipse()), None);
    }
}
