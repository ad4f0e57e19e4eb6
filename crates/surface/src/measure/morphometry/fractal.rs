//! Box-counting dimension and lacunarity of a mask.

use super::mask::Bits;
use serde::Serialize;

/// A fractal dimension, with the standard error of the fitted slope.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema))]
pub struct Dimension {
    /// Negative slope of ln N over ln of the box size.
    pub value: f64,
    /// Standard error of the slope.
    pub error: f64,
}

/// Sides of the boxes are 2 to 2^`LEVELS` pixels.
pub(super) const LEVELS: u32 = 7;
/// Minimum number of sizes in a fit.
const LEAST_SIZES: usize = 4;

/// Box-counting dimension of the set bits, from boxes of 2, 4, … 128 pixels that are at most half
/// as large as the extent.
///
/// The number of boxes is the minimum of four grids, shifted by half a box in each direction.
pub(super) fn dimension(bits: &Bits) -> Option<Dimension> {
    let largest = bits.extent[0].max(bits.extent[1]) / 2;
    let mut counts = Vec::new();
    let mut level = bits.clone();
    for k in 1..=LEVELS {
        if 1 << k > largest {
            break;
        }
        counts.push((f64::from(k) * std::f64::consts::LN_2, (least_boxes(&level) as f64).ln()));
        level = level.halved();
    }
    if counts.len() < LEAST_SIZES || counts.iter().any(|(_, y)| !y.is_finite()) {
        return None;
    }
    let n = counts.len() as f64;
    let mean = |of: fn(&(f64, f64)) -> f64| counts.iter().map(of).sum::<f64>() / n;
    let (mx, my) = (mean(|c| c.0), mean(|c| c.1));
    let xx: f64 = counts.iter().map(|(x, _)| (x - mx).powi(2)).sum();
    let xy: f64 = counts.iter().map(|(x, y)| (x - mx) * (y - my)).sum();
    let slope = xy / xx;
    let rest: f64 = counts.iter().map(|(x, y)| (y - my - slope * (x - mx)).powi(2)).sum();
    Some(Dimension { value: -slope, error: (rest / (n - 2.0) / xx).sqrt() })
}

/// Number of boxes of two by two bits with a set bit, minimum over the four grids.
fn least_boxes(bits: &Bits) -> u64 {
    let mut counts = [0_u64; 4];
    for shift_y in 0..2 {
        let mut row = 0;
        while row < bits.rows() {
            // In a shifted grid the first row is alone in its boxes.
            let pair = row..(row + if row == 0 && shift_y == 1 { 1 } else { 2 }).min(bits.rows());
            let mut carry = 0;
            for w in 0..bits.words {
                let word = pair.clone().fold(0, |word, row| word | bits.row(row)[w]);
                let shifted = word << 1 | carry;
                carry = word >> 63;
                let boxes = |word: u64| u64::from(((word | word >> 1) & 0x5555_5555_5555_5555).count_ones());
                counts[shift_y] += boxes(word);
                counts[2 + shift_y] += boxes(shifted);
            }
            counts[2 + shift_y] += carry;
            row = pair.end;
        }
    }
    counts.into_iter().min().unwrap_or(0)
}

/// Sides of the boxes for the lacunarity, pixels.
const LACUNARITY_BOXES: [usize; 4] = [8, 16, 32, 64];
/// Minimum number of boxes in a mean.
const LEAST_BOXES: usize = 16;

/// Lacunarity of the set bits: ⟨m²⟩/⟨m⟩² of the mass of boxes, averaged over boxes of 8, 16, 32 and
/// 64 pixels that lie entirely within the extent (Allain and Cloitre 1991, with adjacent instead of
/// gliding boxes). 1 for an even distribution.
pub(super) fn lacunarity(bits: &Bits) -> Option<f64> {
    let mut masses = bytes(bits);
    let mut found = Vec::new();
    for side in LACUNARITY_BOXES {
        let [columns, rows] = bits.extent.map(|extent| extent / side);
        if columns * rows >= LEAST_BOXES {
            let (mut sum, mut squares) = (0.0, 0.0);
            for mass in masses.data.chunks_exact(masses.columns).take(rows).flat_map(|row| &row[..columns]) {
                let mass = f64::from(*mass);
                sum += mass;
                squares += mass * mass;
            }
            if sum > 0.0 {
                found.push(squares * (columns * rows) as f64 / (sum * sum));
            }
        }
        masses = masses.halved();
    }
    (!found.is_empty()).then(|| found.iter().sum::<f64>() / found.len() as f64)
}

/// Number of set bits in adjacent boxes.
struct Masses {
    columns: usize,
    data: Vec<u32>,
}

fn bytes(bits: &Bits) -> Masses {
    let columns = bits.words * 8;
    let mut data = vec![0; columns * bits.rows().div_ceil(8)];
    for row in 0..bits.rows() {
        let out = &mut data[row / 8 * columns..][..columns];
        for (w, word) in bits.row(row).iter().enumerate() {
            for (out, byte) in out[w * 8..].iter_mut().zip(word.to_le_bytes()) {
                *out += byte.count_ones();
            }
        }
    }
    Masses { columns, data }
}

impl Masses {
    fn halved(&self) -> Self {
        let columns = self.columns.div_ceil(2);
        let rows = self.data.len() / self.columns.max(1);
        let mut data = vec![0; columns * rows.div_ceil(2)];
        for (row, masses) in self.data.chunks_exact(self.columns.max(1)).enumerate() {
            for (column, mass) in masses.iter().enumerate() {
                data[row / 2 * columns + column / 2] += mass;
            }
        }
        Self { columns, data }
    }
}
