//! A space-filling curve. Items in its order are close to their neighbours.

use rayon::prelude::*;

/// Sorts items along a space-filling curve through their centres.
pub fn sort_along_curve(items: &mut [u32], centre: impl Fn(u32) -> [f64; 3] + Sync) {
    let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for c in items.iter().map(|&item| centre(item)) {
        for axis in 0..3 {
            low[axis] = low[axis].min(c[axis]);
            high[axis] = high[axis].max(c[axis]);
        }
    }
    let size = (0..3).map(|axis| high[axis] - low[axis]).fold(f64::MIN_POSITIVE, f64::max);
    items.par_sort_by_cached_key(|&item| {
        let c = centre(item);
        (morton([0, 1, 2].map(|axis| ((c[axis] - low[axis]) / size) as f32)), item)
    });
}

/// Position on the Morton curve, 10 bits per axis, of a point given as fractions (0 to 1) of a box.
#[must_use]
#[inline]
pub fn morton(fraction: [f32; 3]) -> u32 {
    let spread = |f: f32| {
        let mut v = (f.clamp(0.0, 1.0) * 1023.0) as u32;
        v = (v | (v << 16)) & 0x0300_00FF;
        v = (v | (v << 8)) & 0x0300_F00F;
        v = (v | (v << 4)) & 0x030C_30C3;
        (v | (v << 2)) & 0x0924_9249
    };
    spread(fraction[0]) | (spread(fraction[1]) << 1) | (spread(fraction[2]) << 2)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_curve_of_morton_interleaves() {
        assert_eq!(morton([1.0, 1.0, 1.0]), (1 << 30) - 1);
        assert_eq!(morton([0.0, 0.0, 1.0]), 0x2492_4924);
        assert_eq!(morton([0.0; 3]), 0);
    }
}
