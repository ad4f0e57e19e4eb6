//! Clefts between primary folds: fixed directions at which the mucosa is held at the wall.

use crate::sim::layout::StepRow;
use crate::sim::maths::{max, min};
use crate::sim::plan::Plan;
use crate::sim::state::InnerLoop;

/// Squared distance, in widths of a cleft, beyond which a cleft does not act.
pub(super) const FAR: f32 = 80.0;

/// Computes the shares of clefts of all particles. Called at the start and at growth events only,
/// because anchors never move.
pub(super) fn update(plan: &Plan, time: i64, state: &mut InnerLoop) {
    let row = plan.at(time);
    let number = min(row.clefts, plan.clefts.len() as f32);
    let whole = number as usize;
    let (full, rest) = plan.clefts.split_at(whole);
    let growing = rest.first().map(|&direction| (direction, number - whole as f32)).filter(|(_, part)| *part > 0.0);
    let anchors = state.anchor_x.iter().zip(&state.anchor_y);
    for (cleft, (&x, &y)) in state.cleft.iter_mut().zip(anchors) {
        let distance = |direction: [f32; 2]| min(distance([x, y], direction, row), FAR);
        let least = full.iter().fold(FAR, |least, &direction| min(least, distance(direction)));
        let share = if full.is_empty() { 0.0 } else { libm::expf(-least) };
        *cleft = growing.map_or(share, |(direction, part)| max(share, part * libm::expf(-distance(direction))));
    }
}

/// Squared distance of an anchor from a cleft, in widths of a cleft.
fn distance(anchor: [f32; 2], cleft: [f32; 2], row: &StepRow) -> f32 {
    let [x, y] = [0, 1].map(|axis| (anchor[axis] - cleft[axis]) / row.cleft_width);
    x * x + y * y
}

/// Direction of the mean of two anchors.
pub(super) fn mean_anchor([x, y]: [f32; 2]) -> [f32; 2] {
    let length = max((x * x + y * y).sqrt(), 1e-6);
    [x / length, y / length]
}
