//! Moves the points of a way to the middle of the lumen, and straightens it.

use super::clearance::Walls;
use super::point::{P3, divided, length, minus};
use rayon::prelude::*;

/// Maximum length of a line, relative to the median clearance, and its range, µm.
const SPACING: f64 = 4.0;
const SPACINGS_UM: [f64; 2] = [30.0, 150.0];
const ROUNDS: usize = 60;
/// Clearance above which more is not better, µm.
const WIDE_UM: f64 = 60.0;
/// Clearance that straightness is worth, per distance from the straight line.
const STRAIGHTNESS: f64 = 0.3;
/// Clearance above which straightness may cost some, µm.
const COMFORT_UM: f64 = 30.0;
/// Lengths of the moves, relative to the clearance.
const MOVES: [f64; 3] = [0.6, 0.3, 0.1];

/// Improves a way whose lines are free; they stay free.
pub(super) fn smooth(way: &[P3], walls: &Walls<'_>) -> Vec<P3> {
    let mut clearances: Vec<f64> = way.par_iter().map(|&point| walls.distance(point, &mut None)).collect();
    clearances.sort_unstable_by(f64::total_cmp);
    let spacing = (SPACING * clearances[clearances.len() / 2]).clamp(SPACINGS_UM[0], SPACINGS_UM[1]);
    let mut points = divided(&merged(way, spacing, walls), spacing);
    for round in 0..ROUNDS {
        // Every other point moves, so that the result does not depend on the number of threads.
        let moved: Vec<(usize, P3)> = (1..points.len() - 1)
            .into_par_iter()
            .filter(|k| k % 2 == round % 2)
            .filter_map(|k| Some((k, better(&points[k - 1..=k + 1], MOVES[round / 2 % MOVES.len()], walls)?)))
            .collect();
        moved.into_iter().for_each(|(k, point)| points[k] = point);
    }
    points
}

/// Leaves out points that are close to the point before, where the way without them is free.
fn merged(way: &[P3], spacing: f64, walls: &Walls<'_>) -> Vec<P3> {
    let mut points = vec![way[0]];
    for (k, &point) in way.iter().enumerate().skip(1) {
        let last = points[points.len() - 1];
        let Some(&next) = way.get(k + 1) else {
            points.push(point);
            break;
        };
        let is_short = length(minus(point, last)) < 0.5 * spacing;
        if !(is_short && walls.is_free(last, next)) {
            points.push(point);
        }
    }
    points
}

/// The best place for the middle one of three points. `None` if it is there.
fn better(points: &[P3], relative_move: f64, walls: &Walls<'_>) -> Option<P3> {
    let &[a, here, b] = points else { return None };
    let straight = [0, 1, 2].map(|k| 0.5 * (a[k] + b[k]));
    let mut hint = None;
    let mut score = |point: P3| {
        let clearance = walls.distance(point, &mut hint);
        (clearance.min(WIDE_UM) - STRAIGHTNESS * length(minus(point, straight)), clearance)
    };
    let (now, clearance) = score(here);
    let step = relative_move * clearance.min(WIDE_UM);
    let aside = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.7, 0.7, 0.0], [0.7, -0.7, 0.0]];
    let around = aside.into_iter().flat_map(|d| [step, -step].map(|step| [0, 1, 2].map(|k| here[k] + step * d[k])));
    let toward = [0, 1, 2].map(|k| 0.5 * (here[k] + straight[k]));
    let mut found: Vec<(f64, P3)> = around.chain([toward, straight]).map(|point| (score(point).0, point)).collect();
    found.sort_by(|a, b| b.0.total_cmp(&a.0));
    let improves = |found: &(f64, P3)| found.0 > now + 1e-3;
    let kept = walls.around(a, here, b).min(COMFORT_UM);
    found.into_iter().take_while(improves).map(|(_, point)| point).find(|&point| walls.around(a, point, b) >= kept)
}
