//! Largest disc in the lumen.

use super::shape::Shape;
use crate::model::Border;
use crate::tissue::Contour;

type P2 = [f64; 2];

/// Number of places from which the widest one is looked for.
const STARTS: usize = 4;
/// First and last step of this search, relative to the radius. A step stays inside the disc, so the
/// search never leaves the lumen.
const STEPS: [f64; 2] = [0.25, 0.002];

/// Ray through the lumen from one wall to the next one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Chord {
    pub(super) length: f32,
    pub(super) middle: P2,
}

/// Radius of the largest disc in the lumen, µm; 0 without chords.
///
/// No disc around the middle of a chord is wider than the chord. The widest such discs are moved
/// until they do not grow any more.
pub(super) fn largest_radius(shape: &Shape<'_>, mut chords: Vec<Chord>) -> f64 {
    let order = |a: &Chord, b: &Chord| {
        let [p, q] = [a.middle, b.middle];
        b.length.total_cmp(&a.length).then(p[0].total_cmp(&q[0])).then(p[1].total_cmp(&q[1]))
    };
    chords.sort_unstable_by(order);
    let border = Border::closed(shape.lumen.iter().map(|ring| ring.to_vec()).collect());
    let contour = Contour::new(&border);
    let mut starts: Vec<(f64, P2)> = Vec::with_capacity(STARTS + 1);
    for chord in chords {
        let least = if starts.len() < STARTS { 0.0 } else { starts[STARTS - 1].0 };
        if f64::from(chord.length) / 2.0 <= least {
            break;
        }
        if let Some(radius) = contour.distance_beyond(chord.middle, least)
            // The normal at a sharp tip can leave the lumen.
            && shape.has_in_lumen(chord.middle)
        {
            let place = starts.partition_point(|start| start.0 >= radius);
            starts.insert(place, (radius, chord.middle));
            starts.truncate(STARTS);
        }
    }
    starts.into_iter().map(|start| widened(&contour, start)).fold(0.0, f64::max)
}

/// Radius of a disc that was moved until it does not grow any more.
fn widened(contour: &Contour, (mut radius, mut middle): (f64, P2)) -> f64 {
    let mut step = STEPS[0];
    while step >= STEPS[1] && radius > 0.0 && radius.is_finite() {
        let turns = (0..8).map(|k| libm::sincos(std::f64::consts::FRAC_PI_4 * f64::from(k)));
        let moved = turns.map(|(sin, cos)| [middle[0] + step * radius * cos, middle[1] + step * radius * sin]);
        let discs = moved.filter_map(|middle| Some((contour.distance_beyond(middle, radius)?, middle)));
        match discs.reduce(|best, one| if one.0 > best.0 { one } else { best }) {
            Some(best) => (radius, middle) = best,
            None => step /= 2.0,
        }
    }
    radius
}

#[cfg(test)]
mod tests {
    use super::super::rays::distances;
    use super::*;

    fn circle(radius: f32, at: [f32; 2]) -> Vec<[f32; 2]> {
        let turn = |i: i32| (std::f32::consts::TAU * i as f32 / 720.0).sin_cos();
        (0..720).map(turn).map(|(sin, cos)| [at[0] + radius * cos, at[1] + radius * sin]).collect()
    }

    #[test]
    fn the_disc_avoids_islands_and_chooses_the_widest_place() {
        let outer = circle(1000.0, [0.0; 2]);
        let radius = |lumen: Vec<&[[f32; 2]]>| {
            let shape = Shape { outer: &outer, lumen };
            largest_radius(&shape, distances(&shape, 5.0, true).chords)
        };
        let within = |found: f64, expected: f64| assert!((found / expected - 1.0).abs() < 0.006, "{found} {expected}");
        let whole = circle(400.0, [70.0, -30.0]);
        within(radius(vec![&whole]), 400.0);
        // An island in the middle leaves a ring 300 µm wide.
        let mut island = circle(100.0, [70.0, -30.0]);
        island.reverse();
        within(radius(vec![&whole, &island]), 150.0);
        // A pocket that is wider than the slit beside it.
        let slit = [[-900.0, 0.0], [-500.0, 0.0], [-500.0, 60.0], [-900.0, 60.0]];
        within(radius(vec![&slit, &circle(40.0, [300.0, 0.0])]), 40.0);
        within(radius(vec![&slit]), 30.0);
        // The inscribed circle of a triangle is not around the middle of any chord.
        let triangle = [[-300.0, 0.0], [300.0, 0.0], [0.0, 400.0]];
        within(radius(vec![&triangle]), 150.0);
        assert_eq!(radius(Vec::new()), 0.0);
    }

    #[test]
    fn a_chord_through_the_tissue_does_not_count() {
        let outer = circle(1000.0, [0.0; 2]);
        let lumen = circle(100.0, [0.0; 2]);
        let shape = Shape { outer: &outer, lumen: vec![&lumen] };
        let mut chords = distances(&shape, 5.0, true).chords;
        chords.push(Chord { length: 800.0, middle: [500.0, 0.0] });
        assert!((largest_radius(&shape, chords) - 100.0).abs() < 0.6);
    }
}
