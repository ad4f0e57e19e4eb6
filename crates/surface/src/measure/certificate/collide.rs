//! Triangles that meet other than at the vertices and edges they share.
//!
//! Candidates come from a hierarchy over the triangles in their given order, which is coherent for the strips of a lofted
//! surface; stretches that are not coherent, such as the ends, are first sorted along a space-filling curve. Triangles that
//! share vertices by index are tested for other common points, at the least vertex that they share, unless [`super::topology`]
//! has seen that there are none. Two vertices at the same position with different indices therefore count as a meeting.
//! Degenerate triangles are left out (they are failures by themselves). Triangles with the
//! same vertices are counted separately and searched as one, and the search stops after [`MOST`] meetings, so that its time
//! is bounded for surfaces with very many faults.

use super::surface::{Coordinate, Corners, Surface, Tally, few};
use super::topology::{Copies, Topology};
use super::types::{FailureKind, Failures, PLACES};
use crate::geometry::bvh::{Bounds, Bvh, WIDTH, morton};
use crate::geometry::coarse::{Coarse, Window};
use crate::geometry::tri_tri::{Triangle, meet, meet_in_mesh};
use rayon::prelude::*;
use std::ops::Range;
use std::sync::atomic::{AtomicUsize, Ordering};

/// Triangles of a stretch, which is either coherent or sorted as a whole.
const STRETCH: usize = 64 * WIDTH;
/// Vertices per task.
const TASK: usize = 256;
/// Triangles of a surface that is searched by windows.
const LARGE: usize = if cfg!(test) { 1 << 10 } else { 1 << 18 };
/// Meetings after which the search stops.
const MOST: u64 = 100_000;

/// Pairs of triangles that meet, and pairs that have the same vertices.
#[derive(Default)]
pub(super) struct Meetings {
    /// Meetings found one by one: each pair of groups of copies once.
    met: u64,
    meetings: Tally,
    duplicates: Tally,
    /// The last hierarchy and the vertices of its blocks, whose memory the next ones use.
    memory: (Bvh, Vec<Vertices>),
}

pub(super) fn examine<C: Coordinate>(
    surface: &Surface<'_, C>,
    degenerate: &[u32],
    topology: &Topology,
    failures: &mut Failures,
) -> Meetings {
    let mut meetings = Meetings::default();
    meetings.search(surface, degenerate, topology);
    meetings.add_duplicates(surface, degenerate, &topology.copies);
    meetings.report(failures);
    meetings
}

impl Meetings {
    pub(super) fn count(&self) -> u64 {
        self.meetings.count
    }

    pub(super) fn duplicates(&self) -> u64 {
        self.duplicates.count
    }

    /// Adds the pairs of copies.
    fn add_duplicates<C: Coordinate>(&mut self, surface: &Surface<'_, C>, degenerate: &[u32], copies: &Copies) {
        let (mut count, mut first) = (0, Vec::new());
        for group in copies.groups().filter(|group| degenerate.binary_search(&group[0][0]).is_err()) {
            let size = group.len() as u64;
            count += size * (size - 1) / 2;
            // The least pairs of a group are those of its least triangle.
            let pairs = (0..group.len()).flat_map(|i| group[i + 1..].iter().map(move |other| [group[i][1], other[1]]));
            first.extend(pairs.take(PLACES));
        }
        first.sort_unstable();
        self.duplicates.add(count, few(&first, |pair| surface.place_of_triangles(pair)));
    }

    /// Adds the pairs that meet. Of triangles with the same vertices only the least is searched.
    fn search<C: Coordinate>(&mut self, surface: &Surface<'_, C>, degenerate: &[u32], topology: &Topology) {
        let search = Search { surface, topology, left_out: left_out(surface, degenerate, &topology.copies) };
        let stars: Vec<&[Star]> = topology.crowded.chunks(TASK).collect();
        self.add(surface, stars.len(), |task, most| search.stars(stars[task], most));
        let order = Order::of(surface);
        if surface.triangles.len() <= LARGE {
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

    /// Adds the pairs of triangles without a common vertex, of which at least one is among the first `own` in order.
    fn search_window<C: Coordinate>(&mut self, search: &Search<'_, C>, order: Order, own: usize) {
        if self.met > MOST {
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

    /// Adds what tasks find. Each may stop when it has found more than `most`, its second argument; when one does, results of later
    /// tasks are not used.
    fn add<C: Coordinate>(
        &mut self,
        surface: &Surface<'_, C>,
        tasks: usize,
        find: impl Fn(usize, u64) -> Found + Sync,
    ) {
        if self.met > MOST {
            return;
        }
        let most = MOST - self.met;
        let full = AtomicUsize::new(usize::MAX);
        let found: Vec<Found> = (0..tasks)
            .into_par_iter()
            .map(|task| {
                if task > full.load(Ordering::Relaxed) {
                    return Found::default();
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
            if self.met > MOST {
                break;
            }
        }
        first.sort_unstable();
        self.meetings.add(count, few(&first, |pair| surface.place_of_triangles(pair)));
    }

    fn report(&self, failures: &mut Failures) {
        let what = "pairs of triangles meet where they share neither vertex nor edge";
        let detail = match self.met > MOST {
            false => format!("{} {what}", self.count()),
            true => format!("at least {} {what} (the search stopped after {MOST})", self.count()),
        };
        let places = self.meetings.places.clone();
        failures.add(FailureKind::TriangleIntersections, self.count(), detail, places);
        let what = "pairs of triangles have the same three vertices";
        self.duplicates.report(FailureKind::DuplicateTriangles, what, failures);
    }
}

/// Marks the triangles that are not searched: degenerate ones, and all of a group of copies but the least.
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
struct Found {
    /// Meetings found, each pair of groups of copies once.
    met: u64,
    /// Meetings including all copies.
    count: u64,
    /// The least pairs, unsorted.
    first: Vec<[u32; 2]>,
}

impl Found {
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

/// A vertex and the triangles there.
type Star = (u32, Box<[u32]>);

struct Search<'a, C> {
    surface: &'a Surface<'a, C>,
    topology: &'a Topology,
    left_out: Option<Vec<bool>>,
}

impl<C: Coordinate> Search<'_, C> {
    /// Fills in the corners of up to eight items; none of those that are left out.
    #[inline(always)]
    fn points(&self, order: &Order, items: Range<usize>, corners: &mut Corners) {
        self.surface.lanes(items.clone().map(|i| order.triangle(i)), corners);
        if let Some(out) = &self.left_out {
            for (lane, _) in items.enumerate().filter(|(_, i)| out[order.triangle(*i)]) {
                corners.as_flattened_mut().iter_mut().for_each(|axis| axis[lane] = f64::NAN);
            }
        }
    }

    /// Triangles of which the least common vertex is that of one of these.
    fn stars(&self, stars: &[Star], most: u64) -> Found {
        let (mut found, mut star) = (Found::default(), Vec::new());
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

    fn add(&self, found: &mut Found, first: usize, second: usize) {
        found.add(&self.topology.copies, [first.min(second), first.max(second)].map(|triangle| triangle as u32));
    }
}

/// The search among triangles in an order, with a hierarchy over them.
struct WindowSearch<'a, C> {
    search: &'a Search<'a, C>,
    /// Pairs are sought of which one is among so many first ones.
    own: usize,
    order: Order,
    /// Of each block of the hierarchy.
    vertices: Vec<Vertices>,
    bvh: Bvh,
}

impl<C: Coordinate> WindowSearch<'_, C> {
    /// Triangles without a common vertex, of which the first in order is in this part of the hierarchy.
    fn part(&self, part: usize, most: u64) -> Found {
        let Self { search, .. } = self;
        let mut found = Found::default();
        let triangle = |t: usize| Triangle::new(search.surface.corners(t));
        self.bvh.pairs_by_block(
            part,
            #[inline(always)]
            |i, block, others| {
                // The last part may hold later items.
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

/// The vertices of eight triangles: `[corner][triangle]`.
type Vertices = [[u32; WIDTH]; 3];

/// Bit `l` is set if triangle `l` of the block has a vertex in common with another one.
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

/// The order of the triangles in the hierarchy.
struct Order(Option<Vec<u32>>);

impl Order {
    fn triangle(&self, item: usize) -> usize {
        self.0.as_ref().map_or(item, |order| order[item] as usize)
    }

    /// The vertices of each eight of the first `count` triangles, in the memory of others.
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

    /// Keeps the given order except in runs of stretches that are not coherent.
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

/// Whether blocks of successive triangles are not much larger than their triangles; examines one block in four.
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
