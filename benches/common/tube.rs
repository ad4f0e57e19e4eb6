//! A synthetic folded tube of any size that cannot intersect itself. Every section is star-shaped
//! around its centre, lines along the tube keep their angle, and the centre only shifts sideways
//! from section to section (a shear).

use std::f64::consts::TAU;

/// Points of a closed contour.
type Ring = Vec<[f32; 2]>;

/// A tube: sections in micrometres, surface in metres.
pub(crate) struct Tube {
    /// Position along the tube, inner contour and outer contour of each section.
    pub(crate) sections: Vec<(f64, Ring, Ring)>,
    /// Vertices of the tissue.
    pub(crate) positions: Vec<[f32; 3]>,
    /// Triangles, counter-clockwise seen from outside.
    pub(crate) triangles: Vec<[u32; 3]>,
}

/// Builds a tube of `sections` sections with `inner` and `outer` points per contour and `folds`
/// folds.
#[must_use]
pub(crate) fn tube(sections: usize, inner: usize, outer: usize, folds: usize) -> Tube {
    let length = 300.0 * (sections - 1) as f64;
    let (low, high, wall) = (0.2, 1.0, 1.4);
    let radius = inner as f64 * 8.0 / (folds as f64 * 1.6 + TAU);
    let at = |section: usize, angle: f64, r: f64| {
        let t = section as f64;
        let centre = [40.0 * (0.21 * t).sin(), 40.0 * (0.17 * t).cos()];
        [(centre[0] + r * angle.cos()) as f32, (centre[1] + r * angle.sin()) as f32]
    };
    // The points are closer in angle where the contour is nearly radial.
    let angle = |i: usize, n: usize| {
        let u = i as f64 / n as f64;
        TAU * u + 0.45 / folds as f64 * (2.0 * TAU * folds as f64 * u).sin()
    };
    let fold = |t: f64, a: f64| {
        let depth = 0.5 + 0.5 * (folds as f64 * a).cos();
        radius * (low + (high - low) * depth * (0.9 + 0.1 * (3.0 * a + 0.05 * t).sin()))
    };
    let mut tube = Tube { sections: Vec::new(), positions: Vec::new(), triangles: Vec::new() };
    for s in 0..sections {
        let inner_ring: Vec<_> = (0..inner).map(|i| at(s, angle(i, inner), fold(s as f64, angle(i, inner)))).collect();
        let outer_ring: Vec<_> = (0..outer).map(|i| at(s, TAU * i as f64 / outer as f64, wall * radius)).collect();
        tube.sections.push((length * s as f64 / (sections - 1) as f64, inner_ring, outer_ring));
    }
    let metres = |x: f64| (x * 1e-6) as f32;
    for (z, inner_ring, outer_ring) in &tube.sections {
        for p in inner_ring.iter().chain(outer_ring) {
            tube.positions.push([metres(f64::from(p[0])), metres(f64::from(p[1])), metres(*z)]);
        }
    }
    let mut triangles = Vec::new();
    let stride = inner + outer;
    for (first, count, inward) in [(0, inner, true), (inner, outer, false)] {
        for s in 0..sections - 1 {
            for i in 0..count {
                let j = (i + 1) % count;
                let [a, b] = [i, j].map(|k| (s * stride + first + k) as u32);
                let [c, d] = [a, b].map(|v| v + stride as u32);
                for t in [[a, b, d], [a, d, c]] {
                    triangles.push(if inward { [t[0], t[2], t[1]] } else { t });
                }
            }
        }
    }
    for (section, up) in [(0, false), (sections - 1, true)] {
        cap(&mut tube, &mut triangles, section, inner, outer, up, 1.15 * radius, &at, &angle);
    }
    tube.triangles = triangles;
    tube
}

/// Closes one end: triangles from the inner contour to a circle with as many points, and from this
/// circle to the outer contour. The triangles are then shuffled, because a triangulation returns
/// them in no useful order.
#[expect(clippy::too_many_arguments, reason = "a part of `tube`, cut off for length")]
fn cap(
    tube: &mut Tube,
    triangles: &mut Vec<[u32; 3]>,
    section: usize,
    inner: usize,
    outer: usize,
    up: bool,
    radius: f64,
    at: &impl Fn(usize, f64, f64) -> [f32; 2],
    angle: &impl Fn(usize, usize) -> f64,
) {
    let base = (section * (inner + outer)) as u32;
    let circle = tube.positions.len() as u32;
    let z = tube.positions[base as usize][2];
    for i in 0..inner {
        let p = at(section, angle(i, inner), radius);
        tube.positions.push([(f64::from(p[0]) * 1e-6) as f32, (f64::from(p[1]) * 1e-6) as f32, z]);
    }
    let mut ends = Vec::new();
    for i in 0..inner {
        let j = (i + 1) % inner;
        let [a, b] = [i, j].map(|k| base + k as u32);
        let [c, d] = [i, j].map(|k| circle + k as u32);
        ends.extend([[a, c, d], [a, d, b]]);
    }
    let (mut i, mut j) = (0, 0);
    while i < inner || j < outer {
        let [a, b] = [circle + (i % inner) as u32, base + (inner + j % outer) as u32];
        let (next_i, next_j) = (angle(i + 1, inner), TAU * (j + 1) as f64 / outer as f64);
        if j == outer || (i < inner && next_i < next_j) {
            i += 1;
            ends.push([a, b, circle + (i % inner) as u32]);
        } else {
            j += 1;
            ends.push([a, b, base + (inner + j % outer) as u32]);
        }
    }
    let mut state = 12_345u32;
    for k in (1..ends.len()).rev() {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        ends.swap(k, (state >> 8) as usize % (k + 1));
    }
    triangles.extend(ends.into_iter().map(|t| if up { t } else { [t[0], t[2], t[1]] }));
}
