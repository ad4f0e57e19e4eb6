//! Folds and clefts from one section to the next: folds that split or join, clefts that end blind.
//!
//! A fold is a connected part of the tissue within the counting ring that reaches the ring. A cleft
//! is a connected part of the lumen outside the ring. Both are sets of pixels of one frame, so they
//! can be compared between sections without knowing their points.

use super::mask::{Bits, bounds, lumen_within};
use super::ring::SHARE;
use super::shape::{Ellipse, Shape};
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Side of a pixel, µm. Larger if the lumen is wider than [`MAX_SIDE`] pixels.
pub(super) const PIXEL_UM: f64 = 8.0;
const MAX_SIDE: f64 = 1024.0;
/// Minimum area of a fold and of a cleft, µm²: the square of the minimum height of a fold.
const LEAST_UM2: f64 = 1600.0;
/// Part of the smaller of two folds that both must have in common to be one.
const COMMON: f64 = 0.5;
/// Distance by which a cleft may move sideways and still continue, µm; a third of a usual gap.
const REACH_UM: f64 = 24.0;
/// Part of a cleft below which the lumen of the next section covers too little of it to continue.
const COVERED: f64 = 0.25;

/// Pixels that the sections of a tube have in common.
#[derive(Clone, Copy, Debug)]
pub(super) struct Frame {
    corner: [f64; 2],
    pixel: f64,
    extent: [usize; 2],
}

impl Frame {
    /// Frame around the lumens of all sections.
    pub(super) fn around<'a>(shapes: impl Iterator<Item = &'a Shape<'a>>) -> Self {
        let all = shapes.map(bounds);
        let whole = all.fold([[f64::INFINITY; 2], [f64::NEG_INFINITY; 2]], |[low, high], [least, most]| {
            [[low[0].min(least[0]), low[1].min(least[1])], [high[0].max(most[0]), high[1].max(most[1])]]
        });
        Self::of(whole)
    }

    /// Frame between two corners.
    pub(super) fn of([low, high]: [[f64; 2]; 2]) -> Self {
        let sides =
            [0, 1].map(|axis| (high[axis] - low[axis]).max(0.0)).map(|side| if side.is_finite() { side } else { 0.0 });
        let pixel = PIXEL_UM.max(sides[0].max(sides[1]) / MAX_SIDE);
        let corner = if low.iter().all(|x| x.is_finite()) { low } else { [0.0; 2] };
        Self { corner, pixel, extent: sides.map(|side| (side / pixel).ceil() as usize + 1) }
    }

    fn least_pixels(&self) -> u32 {
        (LEAST_UM2 / (self.pixel * self.pixel)).ceil() as u32
    }
}

/// Pixels of a row in a connected part.
#[derive(Clone, Copy, Debug)]
struct Run {
    row: u32,
    from: u32,
    to: u32,
    part: u32,
}

/// Connected parts of a set of pixels.
#[derive(Clone, Debug)]
struct Parts {
    /// Runs by row and column.
    runs: Vec<Run>,
    /// Pixels of each part; 0 for a part that does not count.
    pixels: Vec<u32>,
}

impl Parts {
    /// Joins runs, sorted by row and column, that share a side. `counts` selects parts by their
    /// number of pixels and by whether one of their runs is marked.
    fn new(mut runs: Vec<Run>, marked: &[bool], counts: impl Fn(u32, bool) -> bool) -> Self {
        let mut roots: Vec<u32> = (0..runs.len() as u32).collect();
        let mut above = 0;
        for at in 0..runs.len() {
            let run = runs[at];
            while above < at
                && (runs[above].row + 1 < run.row || runs[above].row + 1 == run.row && runs[above].to <= run.from)
            {
                above += 1;
            }
            let mut other = above;
            while other < at && runs[other].row + 1 == run.row && runs[other].from < run.to {
                let (a, b) = (root(&mut roots, at as u32), root(&mut roots, other as u32));
                roots[a.max(b) as usize] = a.min(b);
                other += 1;
            }
        }
        let mut pixels = vec![0; runs.len()];
        let mut is_marked = vec![false; runs.len()];
        for at in 0..runs.len() {
            let part = root(&mut roots, at as u32);
            runs[at].part = part;
            pixels[part as usize] += runs[at].to - runs[at].from;
            is_marked[part as usize] |= marked[at];
        }
        for (count, is_marked) in pixels.iter_mut().zip(is_marked) {
            if !counts(*count, is_marked) {
                *count = 0;
            }
        }
        Self { runs, pixels }
    }

    /// Common pixels of each pair of parts that count, sorted by pair.
    fn common(&self, other: &Self) -> Vec<([u32; 2], u32)> {
        let mut found = Vec::new();
        let mut first = 0;
        for run in self.runs.iter().filter(|run| self.pixels[run.part as usize] > 0) {
            let is_before = |one: &Run| (one.row, one.to) <= (run.row, run.from);
            while other.runs.get(first).is_some_and(is_before) {
                first += 1;
            }
            let same = other.runs[first..].iter().take_while(|one| one.row == run.row && one.from < run.to);
            for one in same.filter(|one| other.pixels[one.part as usize] > 0) {
                found.push(([run.part, one.part], run.to.min(one.to) - run.from.max(one.from)));
            }
        }
        found.sort_unstable();
        let pairs = found.chunk_by(|a, b| a.0 == b.0);
        pairs.map(|same| (same[0].0, same.iter().map(|(_, pixels)| pixels).sum())).collect()
    }
}

fn root(roots: &mut [u32], mut at: u32) -> u32 {
    while roots[at as usize] != at {
        roots[at as usize] = roots[roots[at as usize] as usize];
        at = roots[at as usize];
    }
    at
}

/// Folds and clefts of a section.
#[derive(Clone, Debug)]
pub(super) struct Traced {
    /// The lumen, extended by [`REACH_UM`].
    reached: Bits,
    folds: Parts,
    clefts: Parts,
}

/// Changes from a section to the next one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Changes {
    /// Folds that split: each adds one less than the number of folds in which it continues.
    pub(super) splits: u32,
    /// Folds that join, counted in the same way from the next section.
    pub(super) joins: u32,
    /// Clefts of either section that have no continuation in the other one.
    pub(super) blind: u32,
}

/// Compares sections with their successors. Sections are added in portions, so that few of them are
/// in memory.
#[derive(Default)]
pub(super) struct Following {
    last: Option<Traced>,
    changes: Vec<Changes>,
}

impl Following {
    /// Number of sections of a portion.
    pub(super) const PORTION: usize = 48;

    /// Adds the next sections.
    pub(super) fn add(&mut self, next: Vec<Traced>) {
        let all: Vec<Traced> = self.last.take().into_iter().chain(next).collect();
        self.changes.par_extend(all.par_windows(2).map(|pair| pair[0].changes(&pair[1])));
        self.last = all.into_iter().next_back();
    }

    /// Changes from each section to the next one.
    pub(super) fn into_changes(self) -> Vec<Changes> {
        self.changes
    }
}

impl<'a> std::iter::Sum<&'a Self> for Changes {
    fn sum<I: Iterator<Item = &'a Self>>(all: I) -> Self {
        all.fold(Self::default(), |sum, one| Self {
            splits: sum.splits + one.splits,
            joins: sum.joins + one.joins,
            blind: sum.blind + one.blind,
        })
    }
}

/// Changes per length of tube from each place to the next one; the last place has none.
pub(super) fn per_mm(changes: &[Changes], z_mm: &[f64]) -> BTreeMap<String, Vec<Option<f64>>> {
    let of = |count: fn(&Changes) -> u32| -> Vec<Option<f64>> {
        let lengths = z_mm.windows(2).map(|z| z[1] - z[0]);
        let all = changes.iter().zip(lengths).map(|(one, length)| Some(f64::from(count(one)) / length));
        all.chain(z_mm.last().map(|_| None)).collect()
    };
    [
        ("fold_splits_per_mm".to_owned(), of(|of| of.splits)),
        ("fold_joins_per_mm".to_owned(), of(|of| of.joins)),
        ("blind_pockets_per_mm".to_owned(), of(|of| of.blind)),
    ]
    .into()
}

impl Traced {
    pub(super) fn new(shape: &Shape<'_>, base: &Ellipse, frame: &Frame) -> Self {
        let lumen = lumen_within(shape, frame.pixel, frame.corner, frame.extent);
        let reach = SHARE * base.semi_major;
        let column =
            |x: f64| ((x - frame.corner[0]) / frame.pixel - 0.5).ceil().clamp(0.0, frame.extent[0] as f64) as u32;
        let ring: Vec<[u32; 2]> = (0..lumen.rows())
            .map(|row| {
                let y = frame.corner[1] + (row as f64 + 0.5) * frame.pixel;
                base.chord(y, reach).map_or([0; 2], |ends| ends.map(column))
            })
            .collect();
        let (mut folds, mut at_ring, mut clefts) = (Vec::new(), Vec::new(), Vec::new());
        for (row, &[begin, end]) in ring.iter().enumerate() {
            // A run reaches the ring at its own ends, or beyond the ends of a neighbouring row.
            let beside = |row: usize| ring.get(row).copied().unwrap_or([0; 2]);
            let [below, above] = [row.checked_sub(1).map_or([0; 2], beside), beside(row + 1)];
            let (begins, ends) = (begin.max(below[0]).max(above[0]), end.min(below[1]).min(above[1]));
            let mut add_fold = |from: u32, to: u32| {
                if from < to {
                    folds.push(Run { row: row as u32, from, to, part: 0 });
                    at_ring.push(from <= begins || to >= ends);
                }
            };
            let mut next = begin;
            lumen.runs(row, |from, to| {
                let (from, to) = (from as u32, to as u32);
                for (from, to) in [(from, to.min(begin)), (from.max(end), to)] {
                    if from < to {
                        clefts.push(Run { row: row as u32, from, to, part: 0 });
                    }
                }
                add_fold(next, from.min(end));
                next = next.max(to);
            });
            add_fold(next, end);
        }
        let least = frame.least_pixels();
        let unmarked = vec![false; clefts.len()];
        Self {
            folds: Parts::new(folds, &at_ring, |pixels, is_at_ring| is_at_ring && pixels >= least),
            clefts: Parts::new(clefts, &unmarked, |pixels, _| pixels >= least),
            reached: lumen.dilated((REACH_UM / frame.pixel).round() as usize),
        }
    }

    /// Compares a section with the next one.
    pub(super) fn changes(&self, next: &Self) -> Changes {
        let mut pairs = self.folds.common(&next.folds);
        pairs.retain(|&([own, other], common)| {
            let smaller = self.folds.pixels[own as usize].min(next.folds.pixels[other as usize]);
            f64::from(common) >= COMMON * f64::from(smaller)
        });
        let more = |mut parts: Vec<u32>| {
            parts.sort_unstable();
            parts.len() as u32 - parts.chunk_by(|a, b| a == b).count() as u32
        };
        Changes {
            splits: more(pairs.iter().map(|([own, _], _)| *own).collect()),
            joins: more(pairs.iter().map(|([_, other], _)| *other).collect()),
            blind: self.blind(next) + next.blind(self),
        }
    }

    /// Number of clefts that the lumen of another section hardly covers.
    fn blind(&self, other: &Self) -> u32 {
        let mut covered = vec![0; self.clefts.pixels.len()];
        for run in self.clefts.runs.iter().filter(|run| self.clefts.pixels[run.part as usize] > 0) {
            covered[run.part as usize] += other.reached.count(run.row as usize, run.from as usize, run.to as usize);
        }
        let is_blind = |(all, covered): (&u32, u32)| *all > 0 && f64::from(covered) < COVERED * f64::from(*all);
        self.clefts.pixels.iter().zip(covered).filter(|&pair| is_blind(pair)).count() as u32
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f32::consts::TAU;

    fn circle(radius: f32) -> Vec<[f32; 2]> {
        (0..720).map(|i| (TAU * i as f32 / 720.0).sin_cos()).map(|(sin, cos)| [radius * cos, radius * sin]).collect()
    }

    /// Lumen of radius 800 µm between folds from 200 µm outwards, given by the middle and the half
    /// width of their angle, in degrees and in ascending order.
    fn lumen(folds: &[[f32; 2]]) -> Vec<[f32; 2]> {
        let radius = |degrees: f32| {
            let within = |[middle, half]: &[f32; 2]| (degrees - middle).abs() < *half;
            if folds.iter().any(within) { 200.0 } else { 800.0 }
        };
        let degrees = (0..3600).map(|i| 0.1 * i as f32);
        degrees
            .map(|degrees| (radius(degrees), degrees.to_radians()))
            .map(|(r, t)| [r * t.cos(), r * t.sin()])
            .collect()
    }

    fn changes(before: &[Vec<[f32; 2]>], after: &[Vec<[f32; 2]>]) -> Changes {
        let outer = circle(1200.0);
        let shapes =
            [before, after].map(|rings| Shape { outer: &outer, lumen: rings.iter().map(Vec::as_slice).collect() });
        let frame = Frame::around(shapes.iter());
        let [before, after] = shapes.each_ref().map(|shape| Traced::new(shape, &shape.base_ellipse(), &frame));
        before.changes(&after)
    }

    #[test]
    fn a_fold_that_splits_upwards_joins_downwards() {
        let one = [lumen(&[[60.0, 20.0], [180.0, 20.0], [300.0, 20.0]])];
        let two = [lumen(&[[50.0, 8.0], [70.0, 8.0], [180.0, 20.0], [300.0, 20.0]])];
        assert_eq!(changes(&one, &one), Changes::default());
        // The cleft between both parts of the fold begins there as well.
        assert_eq!(changes(&one, &two), Changes { splits: 1, joins: 0, blind: 1 });
        assert_eq!(changes(&two, &one), Changes { splits: 0, joins: 1, blind: 1 });
    }

    #[test]
    fn a_fold_that_moves_a_little_neither_splits_nor_ends() {
        let at = |turn: f32| [lumen(&[[60.0 + turn, 20.0], [180.0 + turn, 20.0], [300.0 + turn, 20.0]])];
        assert_eq!(changes(&at(0.0), &at(3.0)), Changes::default());
    }

    #[test]
    fn portions_do_not_change_what_is_found() {
        let outer = circle(1200.0);
        let folds = |wide: f32| lumen(&[[60.0, 20.0], [180.0, 20.0], [300.0, wide]]);
        let two = lumen(&[[50.0, 8.0], [70.0, 8.0], [180.0, 20.0], [300.0, 20.0]]);
        let lumens = [folds(20.0), two.clone(), folds(18.0), folds(20.0), two];
        let shapes = lumens.each_ref().map(|lumen| Shape { outer: &outer, lumen: vec![lumen] });
        let frame = Frame::around(shapes.iter());
        let found = |portions: &[usize]| {
            let (mut following, mut start) = (Following::default(), 0);
            for &count in portions {
                let some = shapes[start..start + count].iter();
                following.add(some.map(|shape| Traced::new(shape, &shape.base_ellipse(), &frame)).collect());
                start += count;
            }
            following.into_changes()
        };
        let whole = found(&[5]);
        assert_eq!(whole.iter().map(|of| [of.splits, of.joins]).collect::<Vec<_>>(), [[1, 0], [0, 1], [0, 0], [1, 0]]);
        assert_eq!(found(&[1, 2, 2]), whole);
        assert_eq!(per_mm(&whole, &[0.0, 0.5, 1.0, 1.5, 2.0])["fold_splits_per_mm"][..2], [Some(2.0), Some(0.0)]);
    }

    #[test]
    fn a_new_fold_is_no_split() {
        let three = [lumen(&[[60.0, 20.0], [180.0, 20.0], [300.0, 20.0]])];
        let four = [lumen(&[[60.0, 20.0], [120.0, 6.0], [180.0, 20.0], [300.0, 20.0]])];
        let found = changes(&three, &four);
        assert_eq!((found.splits, found.joins, found.blind), (0, 0, 0));
    }

    #[test]
    fn a_pocket_without_continuation_is_blind() {
        let folds = lumen(&[[60.0, 20.0], [180.0, 20.0], [300.0, 20.0]]);
        let pocket: Vec<[f32; 2]> = circle(50.0).iter().map(|[x, y]| [x - 700.0, *y]).collect();
        let (without, with) = ([folds.clone()], [folds, pocket]);
        assert_eq!(changes(&without, &with), Changes { splits: 0, joins: 0, blind: 1 });
        assert_eq!(changes(&with, &without).blind, 1);
        assert_eq!(changes(&with, &with), Changes::default());
    }

    #[test]
    fn an_island_is_no_fold() {
        let folds = lumen(&[[60.0, 20.0], [180.0, 20.0], [300.0, 20.0]]);
        let mut island: Vec<[f32; 2]> = circle(60.0).iter().map(|[x, y]| [x + 300.0, *y]).collect();
        island.reverse();
        let without = [folds.clone()];
        assert_eq!(changes(&without, &[folds, island]), Changes::default());
    }

    #[test]
    fn nothing_changes_without_a_lumen() {
        assert_eq!(changes(&[], &[]), Changes::default());
    }
}
