//! Points at even distances, so that measures of which every point has a share favour no direction: the middles of the sides of pixels are
//! closer along a diagonal.

use crate::geometry::blocks::{Blocks, Rect};
use crate::geometry::predicates::widen2;
use crate::geometry::segment::{on_segment, segments_meet};

/// Contours with fewer points than this are left as they are.
const FEWEST: usize = 12;

/// The contours with points about `step` apart. Those that would cut a corner so that it meets another edge are left as they are; as
/// given, none meet.
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

/// Points on a contour at even distances along it.
fn along(contour: &[[f32; 2]], step: f64) -> Option<Vec<[f32; 2]>> {
    let ends = contour.iter().cycle().skip(1);
    let edges = || contour.iter().zip(ends.clone()).map(|(&a, &b)| (widen2(a), widen2(b)));
    let length = |(a, b): ([f64; 2], [f64; 2])| ((b[0] - a[0]).powi(2) + (b[1] - a[1]).powi(2)).sqrt();
    let whole: f64 = edges().map(length).sum();
    let count = (whole / step).round() as usize;
    if count < FEWEST || contour.len() < FEWEST {
        return None;
    }
    let mut points = Vec::with_capacity(count);
    let mut passed = 0.0;
    for (a, b) in edges() {
        let edge = length((a, b));
        while points.len() < count {
            let share = (points.len() as f64 * whole / count as f64 - passed) / edge;
            if share >= 1.0 || !share.is_finite() {
                break;
            }
            points.push([0, 1].map(|axis| (a[axis] + share * (b[axis] - a[axis])) as f32));
        }
        passed += edge;
    }
    Some(points)
}

/// The contours of which an edge meets another edge, other than a neighbour at their common point.
fn meeting(contours: &[&[[f32; 2]]]) -> Vec<usize> {
    // Ends of every edge, its contour, and the number of the next edge.
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
