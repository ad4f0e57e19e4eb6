//! Choice of the vertices of a row.

use super::sagitta::{BLOCK, squared_distance};
use crate::model::Row;
use glam::DVec3;

/// Minimum number of vertices of a whole row.
const LEAST: usize = 4;

/// What a level keeps.
pub(super) struct Choice {
    /// Maximum distance, m.
    pub(super) tolerance: f64,
}

/// The vertices that a row keeps, by their index in the row.
#[derive(Debug, PartialEq)]
pub(super) enum Kept {
    /// The row goes all the way round.
    Whole(Vec<usize>),
    /// Parts of the row, in its order. Indices continue beyond the end of the row, so that they
    /// ascend; they are less than one turn above the first. There may be no parts.
    Parts(Vec<Vec<usize>>),
}

impl Choice {
    /// The vertices that a row keeps. `sagittas` are its distances by block, and `front` the
    /// columns of the last row that is kept below it.
    pub(super) fn of_row(&self, positions: &[[f32; 3]], row: Row<'_>, sagittas: &[f32], front: &[u32]) -> Kept {
        let parts = self.parts(row, sagittas);
        if parts.is_empty() {
            return Kept::Parts(Vec::new());
        }
        let contour = Contour::new(positions, row, self.tolerance);
        if parts == [(0, row.len())] {
            return Kept::Whole(contour.turn());
        }
        let parts: Vec<_> = parts.into_iter().map(|(from, to)| contour.chords(from, to - 1)).collect();
        Gaps::new(&contour, front).close(&parts).map_or_else(|| Kept::Whole(contour.turn()), Kept::Parts)
    }

    /// Number of vertices that a row keeps, without regard to the row below it.
    pub(super) fn estimated(&self, positions: &[[f32; 3]], row: Row<'_>, sagittas: &[f32]) -> usize {
        let parts = self.parts(row, sagittas);
        let contour = Contour::new(positions, row, self.tolerance);
        parts.into_iter().map(|(from, to)| contour.chords(from, to - 1).len()).sum()
    }

    /// Parts of the row beyond the tolerance. Those are joined that are at most one block apart, or
    /// have no vertices between them.
    fn parts(&self, row: Row<'_>, sagittas: &[f32]) -> Vec<(usize, usize)> {
        let mut parts: Vec<(usize, usize)> = Vec::new();
        // The last block beyond the tolerance.
        let mut before: Option<u32> = None;
        let mut from = 0;
        for own in row.columns.chunk_by(|a, b| a / BLOCK == b / BLOCK) {
            let (block, to) = (own[0] / BLOCK, from + own.len());
            if f64::from(sagittas[block as usize]) > self.tolerance {
                match parts.last_mut() {
                    Some(last) if last.1 == from || before.is_some_and(|before| block - before <= 2) => last.1 = to,
                    _ => parts.push((from, to)),
                }
                before = Some(block);
            }
            from = to;
        }
        parts
    }
}

/// The contour of a row. Indices continue beyond its end.
struct Contour<'a> {
    points: Vec<DVec3>,
    row: Row<'a>,
    tolerance: f64,
}

impl<'a> Contour<'a> {
    fn new(positions: &[[f32; 3]], row: Row<'a>, tolerance: f64) -> Self {
        let point = |&v: &u32| DVec3::from_array(positions[v as usize].map(f64::from));
        Self { points: row.vertices.iter().map(point).collect(), row, tolerance }
    }

    fn len(&self) -> usize {
        self.points.len()
    }

    /// True if the chord between two vertices may stand for those between them.
    fn is_straight(&self, from: usize, to: usize) -> bool {
        let n = self.len();
        let start = self.points[from % n];
        let chord = self.points[to % n] - start;
        let limit = self.tolerance * self.tolerance;
        (from + 1..to).all(|k| {
            let k = k % n;
            squared_distance(self.points[k] - start, chord) <= limit
        })
    }

    /// The end of a long chord from a vertex towards another one, in either direction.
    fn step(&self, from: usize, to: usize) -> usize {
        let at = |steps: usize| if to > from { from + steps } else { from - steps };
        let is_straight = |steps: usize| {
            let end = at(steps);
            self.is_straight(from.min(end), from.max(end))
        };
        let most = from.abs_diff(to);
        let (mut good, mut bad) = (1, 2);
        while bad <= most && is_straight(bad) {
            good = bad;
            bad *= 2;
        }
        bad = bad.min(most + 1);
        while bad - good > 1 {
            let middle = usize::midpoint(good, bad);
            if is_straight(middle) { good = middle } else { bad = middle }
        }
        at(good)
    }

    /// The ends of long chords from a vertex to another one, with both.
    fn chords(&self, from: usize, to: usize) -> Vec<usize> {
        let next = |&k: &usize| (k < to).then(|| self.step(k, to));
        std::iter::successors(Some(from), next).collect()
    }

    /// The ends of long chords all the way round.
    fn turn(&self) -> Vec<usize> {
        let n = self.len();
        let mut kept = self.chords(0, n);
        kept.pop();
        if kept.len() < LEAST {
            let least = LEAST.min(n);
            kept.extend((0..least).map(|k| k * n / least));
            kept.sort_unstable();
            kept.dedup();
        }
        kept
    }
}

/// The gaps between the parts of a row, where a row below stays.
///
/// Triangles join the end of a part to the next vertex of the front. They must not cut off what is
/// between, so a part is continued until its chord to that vertex is straight.
struct Gaps<'a> {
    contour: &'a Contour<'a>,
    /// Indices of the columns of the front in the row.
    front: Vec<usize>,
}

/// The vertices that continue the parts before and after a gap.
struct Gap {
    right: Vec<usize>,
    left: Vec<usize>,
    is_closed: bool,
}

impl<'a> Gaps<'a> {
    fn new(contour: &'a Contour<'a>, front: &[u32]) -> Self {
        let columns = contour.row.columns;
        let mut k = 0;
        let index = |column: &u32| {
            k += columns[k..].iter().take_while(|other| *other < column).count();
            k
        };
        Self { contour, front: front.iter().map(index).collect() }
    }

    /// Continues parts into the gaps between them, and joins them where no vertex of the front is
    /// left. `None` if nothing is left of the front.
    fn close(&self, parts: &[Vec<usize>]) -> Option<Vec<Vec<usize>>> {
        let (n, count) = (self.contour.len(), parts.len());
        let of_part = |g: usize| {
            let end = parts[g][parts[g].len() - 1];
            let start = parts.get(g + 1).map_or(parts[0][0] + n, |next| next[0]);
            // The front is also searched before the first turn.
            self.gap(end + n, start + n)
        };
        let gaps: Vec<Gap> = (0..count).map(of_part).collect();
        let open = gaps.iter().position(|gap| !gap.is_closed)?;
        let (mut kept, mut current) = (Vec::new(), Vec::new());
        for g in (open + 1..count).chain(count..=open + count) {
            let turn = g / count * n;
            let (gap, before) = (&gaps[g % count], &gaps[(g - 1) % count]);
            // The gap before the first part is that of the last one, a turn later.
            let before_turn = (g - 1) / count * n;
            current.extend(before.left.iter().map(|k| k - n + before_turn));
            current.extend(parts[g % count].iter().map(|k| k + turn));
            current.extend(gap.right.iter().map(|k| k - n + turn));
            if !gap.is_closed {
                kept.push(std::mem::take(&mut current));
            }
        }
        let left = || self.front.iter().filter(|other| !kept.iter().any(|part| self.is_in(**other, part))).count();
        // Two vertices do not go round the tube.
        let vertices: usize = kept.iter().map(Vec::len).sum();
        (vertices > 2 || vertices + left() > 2).then_some(kept)
    }

    /// True if a vertex lies between the ends of a part.
    fn is_in(&self, k: usize, part: &[usize]) -> bool {
        let n = self.contour.len();
        let (first, last) = (part[0], part[part.len() - 1]);
        (k + n - first % n) % n <= last - first
    }

    /// Continues the part that ends at `end` to the right, and the part that begins at `start` to
    /// the left.
    fn gap(&self, mut end: usize, mut start: usize) -> Gap {
        let (mut right, mut left) = (Vec::new(), Vec::new());
        loop {
            let other = self.after(end);
            if other >= start || self.contour.is_straight(end, other) {
                break;
            }
            end = self.contour.step(end, other);
            right.push(end);
        }
        let is_closed = loop {
            let other = self.before(start);
            if other <= end {
                let between = self.contour.chords(end, start);
                right.extend(&between[1..between.len() - 1]);
                break true;
            }
            if self.contour.is_straight(other, start) {
                break false;
            }
            start = self.contour.step(start, other);
            left.push(start);
        };
        left.reverse();
        Gap { right, left, is_closed }
    }

    /// The first vertex of the front after a vertex.
    fn after(&self, k: usize) -> usize {
        let n = self.contour.len();
        self.turned(self.front.partition_point(|&other| other <= k % n) + k / n * self.front.len())
    }

    /// The last vertex of the front before a vertex that is not of the first turn.
    fn before(&self, k: usize) -> usize {
        let n = self.contour.len();
        self.turned(self.front.partition_point(|&other| other < k % n) + k / n * self.front.len() - 1)
    }

    /// Index of the i-th vertex of the front, which goes round repeatedly.
    fn turned(&self, i: usize) -> usize {
        let count = self.front.len();
        self.front[i % count] + i / count * self.contour.len()
    }
}
