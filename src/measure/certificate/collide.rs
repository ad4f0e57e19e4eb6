//! Triangles that meet other than at the vertices and edges they share.
//!
//! Candidates come from a hierarchy over the triangles in their given order where that is coherent (strips of a lofted
//! surface are); stretches that are not, such as the ends, are put in the order of a space-filling curve first.
//! Triangles that share vertices by index are tested for what lies beyond those; two vertices at the same position that
//! are not one therefore count as a meeting. Degenerate triangles are left out (they fail on their own).

use super::types::{FailureKind, Failures};
use super::{Coordinate, Surface, few};
use crate::geometry::bvh::{Bounds, Bvh, WIDTH, morton};
use crate::geometry::tri_tri::{Triangle, meet, meet_beyond_corner, overlap_across_edge};
use rayon::prelude::*;

/// Pairs of triangles that meet.
pub(super) struct Meetings {
    pub(super) count: u64,
    pub(super) duplicates: u64,
}

#[derive(Clone, Copy, PartialEq)]
enum Contact {
    None,
    Meet,
    Duplicate,
}

/// Triangles in a stretch whose coherence is judged as a whole.
const STRETCH: usize = 64 * WIDTH;

pub(super) fn examine<C: Coordinate>(
    surface: &Surface<'_, C>,
    degenerate: &[u32],
    failures: &mut Failures,
) -> Meetings {
    let order = Order::of(surface);
    let bvh = Bvh::build(surface.triangles.len(), |i| Bounds::of(surface.corners(order.triangle(i))));
    let blocks: Vec<usize> = (0..bvh.blocks()).collect();
    let found: Vec<Found> = blocks
        .par_chunks(256)
        .map(|blocks| {
            let mut found = Found::default();
            for &block in blocks {
                collide_block(surface, &order, degenerate, &bvh, block, &mut found);
            }
            found
        })
        .collect();
    let mut all = Found::default();
    for part in found {
        all.count += part.count;
        all.duplicates += part.duplicates;
        all.first.extend(part.first);
        all.first_duplicates.extend(part.first_duplicates);
    }
    all.first.sort_unstable();
    all.first_duplicates.sort_unstable();
    let detail = format!("{} pairs of triangles meet where they share neither vertex nor edge", all.count);
    let places = few(&all.first, |pair| surface.place_of_triangles(pair));
    failures.add(FailureKind::TriangleIntersections, all.count, detail, places);
    let detail = format!("{} pairs of triangles have the same three vertices", all.duplicates);
    let places = few(&all.first_duplicates, |pair| surface.place_of_triangles(pair));
    failures.add(FailureKind::DuplicateTriangles, all.duplicates, detail, places);
    Meetings { count: all.count, duplicates: all.duplicates }
}

#[derive(Default)]
struct Found {
    count: u64,
    duplicates: u64,
    /// The least pairs, not in order.
    first: Vec<[u32; 2]>,
    first_duplicates: Vec<[u32; 2]>,
}

impl Found {
    fn add(&mut self, contact: Contact, pair: [u32; 2]) {
        let list = match contact {
            Contact::None => return,
            Contact::Meet => {
                self.count += 1;
                &mut self.first
            }
            Contact::Duplicate => {
                self.duplicates += 1;
                &mut self.first_duplicates
            }
        };
        list.push(pair);
        if list.len() >= 4 * super::PLACES {
            list.sort_unstable();
            list.truncate(super::PLACES);
        }
    }
}

fn collide_block<C: Coordinate>(
    surface: &Surface<'_, C>,
    order: &Order,
    degenerate: &[u32],
    bvh: &Bvh,
    block: usize,
    found: &mut Found,
) {
    let mut own: [Option<Triangle>; WIDTH] = [None; WIDTH];
    bvh.pairs(block, 0.0, |i, j| {
        let (first, second) = (order.triangle(i), order.triangle(j));
        if !degenerate.is_empty() && [first, second].iter().any(|&t| degenerate.binary_search(&(t as u32)).is_ok()) {
            return;
        }
        let a = own[i % WIDTH].get_or_insert_with(|| Triangle::new(surface.corners(first)));
        let contact = contact(surface, a, first, second);
        if contact != Contact::None {
            found.add(contact, [first.min(second) as u32, first.max(second) as u32]);
        }
    });
}

#[inline]
fn contact<C: Coordinate>(surface: &Surface<'_, C>, a: &Triangle, first: usize, second: usize) -> Contact {
    let (ta, tb) = (surface.triangles[first], surface.triangles[second]);
    // Bit 3i + j: corner i of the first is corner j of the second.
    let mut same = 0u32;
    for (i, a) in ta.iter().enumerate() {
        for (j, b) in tb.iter().enumerate() {
            same |= u32::from(a == b) << (3 * i + j);
        }
    }
    let b = Triangle::new(surface.corners(second));
    let met = match same.count_ones() {
        0 => meet(a, &b),
        1 => {
            let bit = same.trailing_zeros() as usize;
            meet_beyond_corner(a, bit / 3, &b, bit % 3)
        }
        2 => {
            let apart = |mask: u32, step: u32| (0..3).find(|i| same & (mask << (step * i)) == 0).unwrap_or(0) as usize;
            overlap_across_edge(a, apart(0b111, 3), &b, apart(0b1_001_001, 1))
        }
        _ => return Contact::Duplicate,
    };
    if met { Contact::Meet } else { Contact::None }
}

/// The order in which triangles stand in the hierarchy.
struct Order(Option<Vec<u32>>);

impl Order {
    fn triangle(&self, item: usize) -> usize {
        self.0.as_ref().map_or(item, |order| order[item] as usize)
    }

    /// Keeps the given order but for runs of stretches in which successive triangles do not lie together.
    fn of<C: Coordinate>(surface: &Surface<'_, C>) -> Self {
        let count = surface.triangles.len();
        let starts: Vec<usize> = (0..count).step_by(STRETCH).collect();
        let stretch = |start: usize| start..count.min(start + STRETCH);
        let coherent: Vec<bool> = starts.par_iter().map(|&start| is_coherent(surface, stretch(start))).collect();
        if coherent.iter().all(|&c| c) {
            return Self(None);
        }
        let mut order: Vec<u32> = (0..count as u32).collect();
        let mut begin = 0;
        for run in coherent.chunk_by(|a, b| a == b) {
            let end = begin + run.len();
            if !run[0] {
                let range = starts[begin]..stretch(starts[end - 1]).end;
                sort_along_curve(surface, &mut order[range]);
            }
            begin = end;
        }
        Self(Some(order))
    }
}

/// Whether blocks of successive triangles are not much larger than their triangles; one block in four is looked at.
fn is_coherent<C: Coordinate>(surface: &Surface<'_, C>, stretch: std::ops::Range<usize>) -> bool {
    let (mut singles, mut together, mut count, mut blocks) = (0.0, 0.0, 0.0, 0.0);
    for start in stretch.clone().step_by(4 * WIDTH) {
        let mut block = Bounds::EMPTY;
        for t in start..stretch.end.min(start + WIDTH) {
            let bounds = Bounds::of(surface.corners(t));
            singles += f64::from(bounds.size());
            block = block.with(&bounds);
            count += 1.0;
        }
        together += f64::from(block.size());
        blocks += 1.0;
    }
    // Eight successive triangles of a strip measure at most about five times as much as one of them.
    together / blocks <= 6.0 * singles / count
}

fn sort_along_curve<C: Coordinate>(surface: &Surface<'_, C>, order: &mut [u32]) {
    let centre = |t: u32| {
        let [a, b, c] = surface.corners(t as usize);
        [0, 1, 2].map(|axis| (a[axis] + b[axis] + c[axis]) / 3.0)
    };
    let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for &t in order.iter() {
        let c = centre(t);
        for axis in 0..3 {
            low[axis] = low[axis].min(c[axis]);
            high[axis] = high[axis].max(c[axis]);
        }
    }
    let size = (0..3).map(|axis| high[axis] - low[axis]).fold(f64::MIN_POSITIVE, f64::max);
    order.par_sort_by_cached_key(|&t| {
        let c = centre(t);
        (morton([0, 1, 2].map(|axis| ((c[axis] - low[axis]) / size) as f32)), t)
    });
}
