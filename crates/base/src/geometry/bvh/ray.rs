//! Search of the first item along a ray.

use super::{AXES, Block, Bvh, WIDTH};

/// A ray from a point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// Start of the ray.
    pub origin: [f64; 3],
    /// Direction, of any length; distances are multiples of it.
    pub direction: [f64; 3],
}

impl Bvh {
    /// Finds the first item along a ray, and its distance. `distance(item)` returns the distance
    /// at which the ray meets an item; `None` if it misses the item.
    pub fn first_along(&self, ray: &Ray, mut distance: impl FnMut(usize) -> Option<f64>) -> Option<(usize, f64)> {
        let (mut first, mut best) = (None, f64::INFINITY);
        let mut pending = vec![(0.0, self.levels.len().checked_sub(1)?, 0)];
        while let Some((bound, level, node)) = pending.pop() {
            let Some(block) = self.levels[level].get(node).filter(|_| bound < best) else { continue };
            let begin = pending.len();
            for (lane, bound) in block.entries(ray).into_iter().enumerate() {
                if bound >= best {
                    continue;
                }
                let child = node * WIDTH + lane;
                if level > 0 {
                    pending.push((bound, level - 1, child));
                } else if let Some(at) = distance(child).filter(|at| *at < best) {
                    (first, best) = (Some(child), at);
                }
            }
            // The nearest child is searched first.
            pending[begin..].sort_unstable_by(|a, b| b.0.total_cmp(&a.0));
        }
        first.map(|item| (item, best))
    }
}

impl Block {
    /// Distances at which a ray enters the bounds along x, y and z of the items; infinite if it
    /// misses them.
    fn entries(&self, ray: &Ray) -> [f64; WIDTH] {
        // Bounds are rounded in the last places of f32.
        const ROUNDING: f64 = 2.5e-7;
        let (mut entries, mut exits) = ([0.0_f64; WIDTH], [f64::INFINITY; WIDTH]);
        for axis in 0..3 {
            let (origin, inverse) = (ray.origin[axis], 1.0 / ray.direction[axis]);
            for lane in 0..WIDTH {
                let (low, high) = (-f64::from(self.0[AXES + axis][lane]), f64::from(self.0[axis][lane]));
                if low > high {
                    entries[lane] = f64::INFINITY;
                    continue;
                }
                let margin = ROUNDING * low.abs().max(high.abs());
                let ends = [low - margin, high + margin].map(|end| (end - origin) * inverse);
                entries[lane] = entries[lane].max(ends[0].min(ends[1]));
                exits[lane] = exits[lane].min(ends[0].max(ends[1]));
            }
        }
        for (entry, exit) in entries.iter_mut().zip(exits) {
            if *entry > exit {
                *entry = f64::INFINITY;
            }
        }
        entries
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::bvh::Bounds;

    #[test]
    fn the_first_of_many_boxes_is_found() {
        // Unit squares across x at 0, 3, 6, …, and one far away that the ray does not meet.
        for count in [1, 8, 9, 70, 600] {
            let at = |i: usize| 3.0 * ((i * 7) % count) as f64;
            let bvh = Bvh::build(count, |i| Bounds::of([[at(i), 0.0, 0.0], [at(i), 1.0, 1.0]]));
            let first = |origin: [f64; 3], direction: [f64; 3]| {
                let ray = Ray { origin, direction };
                let distance = |i: usize| Some((at(i) - origin[0]) / direction[0]).filter(|at| *at >= 0.0);
                bvh.first_along(&ray, distance).map(|(item, distance)| (at(item), distance))
            };
            assert_eq!(first([-1.0, 0.5, 0.5], [2.0, 0.0, 0.0]), Some((0.0, 0.5)), "{count}");
            assert_eq!(first([-1.0, 1.5, 0.5], [1.0, 0.0, 0.0]), None);
            if count == 600 {
                assert_eq!(first([601.0, 0.5, 0.5], [1.0, 0.0, 0.0]), Some((603.0, 2.0)));
                assert_eq!(first([601.0, 0.5, 0.5], [-0.5, 0.0, 0.0]), Some((600.0, 2.0)));
            }
        }
        let none = Bvh::build(0, |_| Bounds::EMPTY);
        assert_eq!(none.first_along(&Ray { origin: [0.0; 3], direction: [1.0; 3] }, |_| Some(1.0)), None);
    }
}
