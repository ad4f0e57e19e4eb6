//! Minimum distances of segments, to which all parts of the loop contribute.

use super::pairs::CLEARANCE_CAP;
use std::sync::atomic::{AtomicU32, Ordering};

/// Bits of the square of the cap, from which distances are lowered.
const CAP: u32 = (CLEARANCE_CAP * CLEARANCE_CAP).to_bits();

/// Minimum squared distance of each segment to the particles, as the bits of the number. The bits
/// of numbers that are not negative have the order of the numbers.
#[derive(Debug, Default)]
pub(super) struct SegmentDistances(Vec<AtomicU32>);

impl SegmentDistances {
    /// Begins anew with `n` segments.
    pub(super) fn resize(&mut self, n: usize) {
        self.0.clear();
        self.0.resize_with(n, || AtomicU32::new(CAP));
    }

    /// Lowers the distance of segment `j` to `square`, from any thread.
    #[inline(always)]
    pub(super) fn lower(&self, j: usize, square: f32) {
        let (distance, bits) = (&self.0[j], square.to_bits());
        if bits < distance.load(Ordering::Relaxed) {
            distance.fetch_min(bits, Ordering::Relaxed);
        }
    }

    /// Moves the distances to `to`, and begins anew.
    pub(super) fn take(&mut self, to: &mut Vec<f32>) {
        to.clear();
        to.extend(self.0.iter_mut().map(|distance| f32::from_bits(std::mem::replace(distance.get_mut(), CAP))));
    }
}
