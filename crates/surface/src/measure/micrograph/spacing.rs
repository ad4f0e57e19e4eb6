//! Resamples contours at equal distances. Midpoints of pixel sides are closer along a diagonal;
//! without resampling, diagonal borders would weigh more in measures that count points.

use crate::geometry::blocks::{Blocks, Rect};
use crate::geometry::predicates::widen2;
use crate::geometry::segment::{on_segment, segments_meet};
use crate::geometry::vector::{distance, lerp};
use crate::measure::morphometry::edges;

/// Contours with fewer points are not resampled.
const FEWEST: usize = 12;

/// Resamples contours at distances of about `step`. A contour whose resampled edges would cut a
/// corner and meet another edge stays as given; the given contours do not intersect.
pub(super) fn spaced(contours: Vec<Vec<[f32; 2]>>, step: f64) -> Vec<Vec<[f32; 2]>> {
    let mut even: Vec<Option<Vec<[f32; 2]>>> = contours.iter().map(|contour| along(contour, step)).collect();
    loop {
        let now: Vec<&[[f32; 2]]> =
            even.iter().zip(&contours).map(|(even, given)| even.as_deref().unwrap_or(given)).collect();
        let meeting = meeting(&now);
        let mut changed = false;
        for contour in meeting {
            changed |= even[contour].take().is_some();
        }
        if !changed {
            return even.into_iter().zip(contours).map(|(even, given)| even.unwrap_or(given)).collect();
        }
    }
}

/// Points at equal distances along a contour; `None` if there are too few.
fn along(contour: &[[f32; 2]], step: f64) -> Option<Vec<[f32; 2]>> {
    let whole: f64 = edges(contour).map(|(a, b)| distance(a, b)).sum();
    let count = (whole / step).round() as usize;
    if count < FEWEST || contour.len() < FEWEST {
        return None;
    }
    let mut points = Vec::with_capacity(count);
    let mut passed = 0.0;
    for (a, b) in edges(contour) {
        let edge = distance(a, b);
        while points.len() < count {
            let share = (points.len() as f64 * whole / count as f64 - passed) / edge;
            if share >= 1.0 || !share.is_finite() {
                break;
            }
            points.push(lerp(a, b, share).map(|x| x as f32));
        }
        passed += edge;
    }
    Some(points)
}

/// Contours with an edge that meets another edge, except a neighbour at their common point.
fn meeting(contours: &[&[[f32; 2]]]) -> Vec<usize> {
    // Ends of every edge, its contour, and the index of the next edge.
    let mut edges = Vec::with_capacity(contours.iter().map(|contour| contour.len()).sum());
    for (number, contour) in contours.iter().enumerate() {
        let (n, base) = (contour.len(), edges.len());
        edges.extend((0..n).map(|i| (contour[i], contour[(i + 1) % n], number, base + (i + 1) % n)));
    }
    let rects: Vec<Rect> = edges.iter().map(|&(a, b, ..)| Rect::around(&[a, b])).collect();
    let mut found = Vec::new();
    Blocks::new(&rects).pairs(|i, j| {
        let (i, j) = if edges[j].3 == i { (j, i) } else { (i, j) };
        let [(a, b, one, next), (c, d, other, _)] = [edges[i], edges[j]];
        let [a, b, c, d] = [a, b, c, d].map(widen2);
        let meet = if next == j { on_segment(a, b, d) || on_segment(c, d, a) } else { segments_meet(a, b, c, d) };
        if meet {
            found.extend([one, other]);
        }
    });
    found
}
