//! Triangles that intersect outside the vertices and edges they share.
//!
//! Candidates come from a hierarchy over the triangles in their given order. That order is coherent
//! for the strips of a lofted surface. Stretches that are not coherent, such as the ends, are first
//! sorted along a space-filling curve.
//!
//! Triangles that share vertices by index are tested at their smallest common vertex, unless
//! [`super::topology`] has excluded other common points. Two vertices at the same position with
//! different indices therefore count as an intersection.
//!
//! Degenerate triangles are left out, because they are failures themselves. Triangles with the same
//! vertices are counted separately and searched once. The search stops after [`MAX_INTERSECTIONS`]
//! intersections, which bounds its time for surfaces with very many faults.

use super::surface::{Coordinate, Corners, Surface, Tally, few};
use super::topology::{Copies, Topology};
use super::types::{FailureKind, Failures, PLACES};
use crate::geometry::bvh::{Bounds, Bvh, WIDTH};
use crate::geometry::coarse::{Coarse, Window};
use crate::geometry::curve::sort_along_curve;
use crate::geometry::tri_tri::{Triangle, meet, meet_in_mesh};
use rayon::prelude::*;
use std::ops::Range;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Number of triangles in a stretch, which is either coherent or sorted as a whole.
const STRETCH: usize = 64 * WIDTH;
/// Number of vertices per task.
const TASK: usize = 256;
/// Number of triangles above which a surface is searched by windows.
const WINDOWED_FROM_TRIANGLES: usize = if cfg!(test) { 1 << 10 } else { 1 << 18 };
/// Number of intersections after which the search stops.
const MAX_INTERSECTIONS: u64 = 100_000;

/// Pairs of triangles that intersect, and pairs that have the same vertices.
#[derive(Default)]
pub(super) struct Intersections {
    /// Intersections found one by one; each pair of groups of copies counts once.
    met: u64,
    pub(super) crossing: Tally,
    pub(super) duplicates: Tally,
    /// Last hierarchy and the vertices of its blocks; the next window reuses their memory.
    memory: (Bvh, Vec<Vertices>),
}

pub(super) fn examine<C: Coordinate>(
    surface: &Surface<'_, C>,
    degenerate: &[u32],
    topology: &Topology,
    failures: &mut Failures,
) -> Intersections {
    let mut intersections = Intersections::default();
    intersections.search(surface, degenerate, topology);
    intersections.add_duplicates(surface, degenerate, &topology.copies);
    intersections.report(failures);
    intersections
}

impl Intersections {
    /// Adds the pairs of copies.
    fn add_duplicates<C: Coordinate>(&mut self, surface: &Surface<'_, C>, degenerate: &[u32], copies: &Copies) {
        let (mut count, mut first) = (0, Vec::new());
        for group in copies.groups().filter(|group| degenerate.binary_search(&group[0][0]).is_err()) {
            let size = group.len() as u64;
            count += size * (size - 1) / 2;
            // The smallest pairs of a group contain its smallest triangle.
            let pairs = (0..group.len()).flat_map(|i| group[i + 1..].iter().map(move |other| [group[i][1], other[1]]));
            first.extend(pairs.take(PLACES));
        }
        first.sort_unstable();
        self.duplicates.add(count, few(&first, |pair| surface.place_of_triangles(pair)));
    }

    /// Adds the intersecting pairs. Of triangles with the same vertices, only the smallest is
    /// searched.
    fn search<C: Coordinate>(&mut self, surface: &Surface<'_, C>, degenerate: &[u32], topology: &Topology) {
        let search = Search { surface, topology, left_out: left_out(surface, degenerate, &topology.copies) };
        let stars: Vec<&[Star]> = topology.crowded.chunks(TASK).collect();
        self.add(surface, stars.len(), |task, most| search.stars(stars[task], most));
        let order = Order::of(surface);
        if surface.triangles.len() <= WINDOWED_FROM_TRIANGLES {
            self.search_window(&search, order, surface.triangles.len());
            return;
        }
        let coarse = Coarse::of_hulls(
            surface.triangles.len(),
            #[inline(always)]
            |items, of| search.points(&order, items, of),
        );
        for Window { mut items, own } in coarse.windows() {
            items.iter_mut().for_each(|item| *item = order.triangle(*item as usize) as u32);
            self.search_window(&search, Order(Some(items)), own);
        }
    }

    /// Adds the intersecting pairs without a common vertex that contain at least one of the first
    /// `own` triangles in order.
    fn search_window<C: Coordinate>(&mut self, search: &Search<'_, C>, order: Order, own: usize) {
        if self.met > MAX_INTERSECTIONS {
            return;
        }
        let count = order.0.as_ref().map_or(search.surface.triangles.len(), Vec::len);
        let (bvh, vertices) = std::mem::take(&mut self.memory);
        let bvh = Bvh::of_hulls(
            bvh,
            count,
            #[inline(always)]
            |items, of| search.points(&order, items, of),
        );
        let vertices = order.vertices(vertices, search.surface.triangles, count);
        let window = WindowSearch { search, own, order, vertices, bvh };
        let parts = own.div_ceil(window.bvh.part_len());
        self.add(search.surface, parts, |part, most| window.part(part, most));
        self.memory = (window.bvh, window.vertices);
    }

    /// Adds the results of tasks. A task may stop when it has found more than `most` (its second
    /// argument) intersections. Results of later tasks are then not used.
    fn add<C: Coordinate>(
        &mut self,
        surface: &Surface<'_, C>,
        tasks: usize,
        find: impl Fn(usize, u64) -> FoundPairs + Sync,
    ) {
        if self.met > MAX_INTERSECTIONS {
            return;
        }
        let most = MAX_INTERSECTIONS - self.met;
        let full = AtomicUsize::new(usize::MAX);
        let found: Vec<FoundPairs> = (0..tasks)
            .into_par_iter()
            .map(|task| {
                if task > full.load(Ordering::Relaxed) {
                    return FoundPairs::default();
                }
                let found = find(task, most);
                if found.is_full(most) {
                    full.fetch_min(task, Ordering::Relaxed);
                }
                found
            })
            .collect();
        let (mut count, mut first) = (0, Vec::new());
        for part in found {
            self.met += part.met;
            count += part.count;
            first.extend(part.first);
            if self.met > MAX_INTERSECTIONS {
                break;
            }
        }
        first.sort_unstable();
        self.crossing.add(count, few(&first, |pair| surface.place_of_triangles(pair)));
    }

    fn report(&self, failures: &mut Failures) {
        let what = "pairs of triangles meet where they share neither vertex nor edge";
        let detail = match self.met > MAX_INTERSECTIONS {
            false => format!("{} {what}", self.crossing.count),
            true => format!("at least {} {what} (the search stopped after {MAX_INTERSECTIONS})", self.crossing.count),
        };
        let places = self.crossing.places.clone();
        failures.add(FailureKind::TriangleIntersections, self.crossing.count, detail, places);
        let what = "pairs of triangles have the same three vertices";
        self.duplicates.report(FailureKind::DuplicateTriangles, what, failures);
    }
}

/// Marks the triangles that are not searched: degenerate ones, and all triangles of a group of
/// copies except the smallest.
fn left_out<C>(surface: &Surface<'_, C>, degenerate: &[u32], copies: &Copies) -> Option<Vec<bool>> {
    if degenerate.is_empty() && copies.is_empty() {
        return None;
    }
    let others = copies.groups().flat_map(|group| group[1..].iter().map(|pair| pair[1]));
    let mut out = vec![false; surface.triangles.len()];
    degenerate.iter().copied().chain(others).for_each(|triangle| out[triangle as usize] = true);
    Some(out)
}

#[derive(Default)]
struct FoundPairs {
    /// Intersections found; each pair of groups of copies counts once.
    met: u64,
    /// Intersections including all copies.
    count: u64,
    /// Smallest pairs, unsorted.
    first: Vec<[u32; 2]>,
}

impl FoundPairs {
    fn is_full(&self, most: u64) -> bool {
        self.met > most
    }

    fn add(&mut self, copies: &Copies, pair: [u32; 2]) {
        self.met += 1;
        self.count += if copies.is_empty() { 1 } else { copies.of(pair[0]) * copies.of(pair[1]) };
        self.first.push(pair);
        if self.first.len() >= 4 * PLACES {
            self.first.sort_unstable();
            self.first.truncate(PLACES);
        }
    }
}

/// A vertex and its triangles.
type Star = (u32, Box<[u32]>);

struct Search<'a, C> {
    surface: &'a Surface<'a, C>,
    topology: &'a Topology,
    left_out: Option<Vec<bool>>,
}

impl<C: Coordinate> Search<'_, C> {
    /// Stores the corners of up to eight triangles. Triangles that are left out have none.
    #[inline(always)]
    fn points(&self, order: &Order, items: Range<usize>, corners: &mut Corners) {
        self.surface.lanes(items.clone().map(|i| order.triangle(i)), corners);
        if let Some(out) = &self.left_out {
            for (lane, _) in items.enumerate().filter(|(_, i)| out[order.triangle(*i)]) {
                corners.as_flattened_mut().iter_mut().for_each(|axis| axis[lane] = f64::NAN);
            }
        }
    }

    /// Finds intersecting triangles whose smallest common vertex is the vertex of one of these
    /// stars.
    fn stars(&self, stars: &[Star], most: u64) -> FoundPairs {
        let (mut found, mut star) = (FoundPairs::default(), Vec::new());
        for (vertex, triangles) in stars {
            let is_searched = |&t: &usize| !self.left_out.as_ref().is_some_and(|out| out[t]);
            let triangles = triangles.iter().map(|&t| t as usize).filter(is_searched);
            star.clear();
            star.extend(triangles.map(|t| (t, Triangle::new(self.surface.corners(t)))));
            for (i, (first, a)) in star.iter().enumerate() {
                let ta = self.surface.triangles[*first];
                for (second, b) in &star[i + 1..] {
                    let tb = self.surface.triangles[*second];
                    let is_least = !ta.iter().any(|v| v < vertex && tb.contains(v));
                    if is_least && !found.is_full(most) && meet_in_mesh((a, ta), (b, tb)) {
                        self.add(&mut found, *first, *second);
                    }
                }
            }
        }
        found
    }

    fn add(&self, found: &mut FoundPairs, first: usize, second: usize) {
        found.add(&self.topology.copies, [first.min(second), first.max(second)].map(|triangle| triangle as u32));
    }
}

/// Search among ordered triangles, with a hierarchy over them.
struct WindowSearch<'a, C> {
    search: &'a Search<'a, C>,
    /// Only pairs that contain at least one of the first `own` triangles are searched.
    own: usize,
    order: Order,
    /// Vertices of each block of the hierarchy.
    vertices: Vec<Vertices>,
    bvh: Bvh,
}

impl<C: Coordinate> WindowSearch<'_, C> {
    /// Finds intersecting triangles without a common vertex, of which the first in order is in this
    /// part of the hierarchy.
    fn part(&self, part: usize, most: u64) -> FoundPairs {
        let Self { search, .. } = self;
        let mut found = FoundPairs::default();
        let triangle = |t: usize| Triangle::new(search.surface.corners(t));
        self.bvh.pairs_by_block(
            part,
            #[inline(always)]
            |i, block, others| {
                // The last part may contain later items.
                if i >= self.own || found.is_full(most) {
                    return;
                }
                let first = self.order.triangle(i);
                let mut others = others & !sharing(&self.vertices[block], search.surface.triangles[first]);
                if others == 0 {
                    return;
                }
                let a = triangle(first);
                while others != 0 {
                    let second = self.order.triangle(block * WIDTH + others.trailing_zeros() as usize);
                    others &= others - 1;
                    if meet(&a, &triangle(second)) {
                        search.add(&mut found, first, second);
                    }
                }
            },
        );
        found
    }
}

/// Vertices of eight triangles: `[corner][triangle]`.
type Vertices = [[u32; WIDTH]; 3];

/// Bit `l` is set if triangle `l` of the block shares a vertex with another triangle.
#[inline(always)]
fn sharing(block: &Vertices, triangle: [u32; 3]) -> u32 {
    let mut shared = [0u32; WIDTH];
    for corners in block {
        for vertex in triangle {
            for lane in 0..WIDTH {
                shared[lane] |= if corners[lane] == vertex { !0 } else { 0 };
            }
        }
    }
    (0..WIDTH).fold(0, |bits, lane| bits | (shared[lane] & (1 << lane)))
}

/// Order of the triangles in the hierarchy; `None` for the given order.
struct Order(Option<Vec<u32>>);

impl Order {
    fn triangle(&self, item: usize) -> usize {
        self.0.as_ref().map_or(item, |order| order[item] as usize)
    }

    /// Collects the vertices of the first `count` triangles, in blocks of eight. Reuses `memory`.
    fn vertices(&self, mut memory: Vec<Vertices>, triangles: &[[u32; 3]], count: usize) -> Vec<Vertices> {
        memory.resize(count.div_ceil(WIDTH), [[0; WIDTH]; 3]);
        memory.par_iter_mut().enumerate().with_min_len(STRETCH).for_each(|(number, block)| {
            let first = number * WIDTH;
            for (lane, i) in (first..count.min(first + WIDTH)).enumerate() {
                for (corner, vertex) in block.iter_mut().zip(triangles[self.triangle(i)]) {
                    corner[lane] = vertex;
                }
            }
        });
        memory
    }

    /// Keeps the given order, except in runs of stretches that are not coherent.
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
                sort_along_curve(&mut order[range], |t| {
                    let [a, b, c] = surface.corners(t as usize);
                    [0, 1, 2].map(|axis| (a[axis] + b[axis] + c[axis]) / 3.0)
                });
            }
            begin = end;
        }
        Self(Some(order))
    }
}

/// True if blocks of consecutive triangles are not much larger than their triangles. Examines one
/// block in four.
fn is_coherent<C: Coordinate>(surface: &Surface<'_, C>, stretch: Range<usize>) -> bool {
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
    // Eight consecutive triangles of a strip are at most about five times as large as one.
    together / blocks <= 6.0 * singles / count
}
