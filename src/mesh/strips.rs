//! Triangle strips (paper, section 3.1): the same triangles in fewer indices.
//!
//! A strip v₀ v₁ v₂ v₃ … stands for the triangles (v₀, v₁, v₂), (v₂, v₁, v₃), (v₂, v₃, v₄), … as in
//! OpenGL and glTF: every second one is turned, so all keep the orientation of the mesh. Nothing is
//! repeated and no degenerate triangles are used; where the run of diagonals breaks, a new strip begins.

/// Covers the triangles, in their order, with strips. The walls of a loft are in an order in which
/// cells split alike continue each other.
#[must_use]
pub fn strips(triangles: &[[u32; 3]]) -> Vec<Vec<u32>> {
    let mut strips = Vec::new();
    let mut rest = triangles;
    while let Some(&[a, b, c]) = rest.first() {
        // The turn of the first triangle decides how far the strip goes.
        let mut best = ([a, b, c], 1);
        for turn in [[a, b, c], [b, c, a], [c, a, b]] {
            let reach = 1 + run(turn, &rest[1..]).count();
            if reach > best.1 {
                best = (turn, reach);
            }
        }
        let (first, reach) = best;
        let mut strip = first.to_vec();
        strip.extend(run(first, &rest[1..]));
        strips.push(strip);
        rest = &rest[reach..];
    }
    strips
}

/// The triangles of a strip, in order.
#[must_use]
pub fn strip_triangles(strip: &[u32]) -> Vec<[u32; 3]> {
    strip
        .windows(3)
        .enumerate()
        .map(|(k, w)| match k % 2 {
            0 => [w[0], w[1], w[2]],
            _ => [w[1], w[0], w[2]],
        })
        .collect()
}

/// The vertices that continue a strip begun with `first` as long as the triangles follow it.
fn run(first: [u32; 3], triangles: &[[u32; 3]]) -> impl Iterator<Item = u32> + '_ {
    let (mut older, mut newer) = (first[1], first[2]);
    triangles.iter().enumerate().map_while(move |(k, &t)| {
        // The triangle must run along the last edge of the strip, turned every second time.
        let (from, to) = if k % 2 == 0 { (newer, older) } else { (older, newer) };
        let corner = (0..3).find(|&i| t[i] == from && t[(i + 1) % 3] == to)?;
        let next = t[(corner + 2) % 3];
        (older, newer) = (newer, next);
        Some(next)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn canonical(t: [u32; 3]) -> [u32; 3] {
        let [a, b, c] = t;
        [[a, b, c], [b, c, a], [c, a, b]].into_iter().min().unwrap()
    }

    #[test]
    fn a_row_of_like_quads_is_one_strip() {
        let triangles: Vec<[u32; 3]> = (0..5).flat_map(|i| [[i, i + 11, i + 10], [i, i + 1, i + 11]]).collect();
        let found = strips(&triangles);
        assert_eq!(found.len(), 1);
        assert_eq!(found[0].len(), 12);
    }

    proptest! {
        #[test]
        fn strips_hold_exactly_the_triangles(
            picks in prop::collection::vec((0u32..12, any::<bool>()), 0..60)
        ) {
            // Quads of a row with either diagonal, in a wild order.
            let triangles: Vec<[u32; 3]> = picks
                .iter()
                .flat_map(|&(i, forward)| if forward {
                    [[i, i + 21, i + 20], [i, i + 1, i + 21]]
                } else {
                    [[i, i + 1, i + 20], [i + 1, i + 21, i + 20]]
                })
                .collect();
            let unrolled: Vec<[u32; 3]> = strips(&triangles)
                .iter()
                .flat_map(|strip| strip_triangles(strip))
                .map(canonical)
                .collect();
            let expected: Vec<[u32; 3]> = triangles.into_iter().map(canonical).collect();
            prop_assert_eq!(unrolled, expected);
        }
    }
}
