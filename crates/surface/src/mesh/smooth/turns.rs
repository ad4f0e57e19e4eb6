//! How the turns at the corners of a contour are divided among the corners and the points on the edges.
//!
//! A corner leaves shares of its turn to the two points beside it, and a point has the sum of the shares of the two corners beside it.
//! All turns are to be as equal as possible, so a sharp corner takes what its neighbours leave. Turns the other way cancel.

use std::f64::consts::PI;

/// Rounds of relaxation, and by how much of the way to its best shares a corner goes in each.
const ROUNDS: usize = 8;
const PACE: f64 = 0.6;
/// Greatest part of the angle at a point that a share may be, so that a corner does not reach the line between its two points.
const OF_ANGLE: f64 = 0.72;
/// Greatest share. The way to a corner must not turn back.
const GREATEST: f64 = 1.4;
/// A share and the angle on the other side of the point are less than a half turn by this.
const APART: f64 = 0.25;

/// For each corner the shares for the point before and the point after it, with the sign of its turn. `base`: the angles at those
/// points if the corner moved onto the line between them.
pub(super) fn divide(turns: &[f64], base: &[[f64; 2]]) -> Vec<[f64; 2]> {
    let n = turns.len();
    let (before, after) =
        (|i: usize| if i == 0 { n - 1 } else { i - 1 }, |i: usize| if i + 1 == n { 0 } else { i + 1 });
    let bounds: Vec<[f64; 2]> = (0..n)
        .map(|i| {
            let others = [base[before(i)][1], base[after(i)][0]];
            [0, 1].map(|k| (PI - APART - others[k].abs()).clamp(0.0, GREATEST).min(OF_ANGLE * base[i][k].abs()))
        })
        .collect();
    let mut shares: Vec<[f64; 2]> =
        (0..n).map(|i| bounds[i].map(|most| (0.25 * turns[i]).clamp(-most, most))).collect();
    let mut next = shares.clone();
    for _ in 0..ROUNDS {
        for i in 0..n {
            let sign = 1f64.copysign(turns[i]);
            let others = [sign * shares[before(i)][1], sign * shares[after(i)][0]];
            let best = level(turns[i].abs(), others, bounds[i]);
            next[i] = [0, 1].map(|k| shares[i][k] + PACE * (sign * best[k] - shares[i][k]));
        }
        std::mem::swap(&mut shares, &mut next);
    }
    shares
}

/// The shares of a corner within bounds, so that its turn and those of the points, which are `others` without it, are as equal as
/// possible.
fn level(turn: f64, others: [f64; 2], bounds: [f64; 2]) -> [f64; 2] {
    let [a, b] = others;
    let first = ((turn + b - 2.0 * a) / 3.0).clamp(0.0, bounds[0]);
    let second = (0.5 * (turn - first - b)).clamp(0.0, bounds[1]);
    let first = (0.5 * (turn - second - a)).clamp(0.0, bounds[0]);
    [first, second]
}
