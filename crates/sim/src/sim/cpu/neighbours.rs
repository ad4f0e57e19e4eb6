//! Neighbour search: for each group of consecutive particles, the segments that a particle of the
//! group may interact with, in ascending order.
//!
//! Invariant: the list of a group contains every segment within the range of one of its particles.
//! Other segments in the list add zeros. Therefore all searches and all sizes of groups produce the
//! same bytes.
//!
//! A particle sees farther through tissue than across a gap (D of [`super::pairs`]), so the lists
//! contain the segments within D plus a skin. Lists are kept until motion may have used up the skin
//! (the two-step search suggested in section 4 of the paper). Let q be the vector from a point of a
//! segment to the particle. The slack |q| − D changes by at most [`lists::SLOPE`] times the change
//! of q, plus half of the difference of the two ranges times the change of the normal.
//!
//! In a large loop a few particles may be restless: pressed against another wall, they move and
//! turn in the stages of a step, and the guard holds them back at its end. In this case, only the
//! lists of their groups, and of groups that see their segments, are rebuilt.

mod grid;
mod lists;

use super::chain::{Chain, Stretch};
use crate::sim::layout::StepRow;
use crate::sim::maths::{greatest, max, min};
use crate::spec::Search;
use crate::vectorize::{Simd, Vectors, WithSimd};
use grid::Grid;
pub(super) use lists::OwnSegments;
use lists::{Groups, Lists, Restless, SLOPE, Sight, Tables};
use rayon::prelude::*;
use std::ops::Range;

/// Factor of the skin, µm. With a skin s, the length of lists grows in proportion to s, and lists
/// last for s/v evaluations if motion uses up slack at the rate v. The sum of both costs is minimal
/// at √(`THRIFT`·v). Measured with the presets `paper` and `pig`.
const THRIFT: f32 = 60.0;
/// Bounds of the skin, and the first skin, µm.
const SKINS: [f32; 2] = [5.0, 30.0];
const FIRST_SKIN: f32 = 10.0;
/// Part of the skin reserved for rounding, µm.
const ROUNDING: f32 = 0.01;
/// Limits of a partial rebuild: one particle in `RESTLESS` may be restless, and one cell of
/// segments in `NEAR` may be near a restless particle. Above either limit, all lists are rebuilt.
const RESTLESS: usize = 64;
const NEAR: usize = 3;
/// Parts of the skin that the motion of two particles, and the turn of one, may use up while the
/// particles count as calm.
const CALM: [f32; 2] = [0.55, 0.45];
/// Parts begin at multiples of this number of particles, the maximum size of a group.
const GRAIN: usize = 16;

/// A run of particles processed by one thread, with the list of each group.
#[derive(Clone, Debug, Default)]
pub(super) struct LoopPart {
    pub(super) particles: Range<usize>,
    pub(super) groups: Groups,
    /// Positions and normals at the time when the lists were built.
    built: [Vec<f32>; 4],
    /// Squares of the maximum displacement, and of the maximum change of a normal, since then.
    moved: f32,
    turned: f32,
}

impl LoopPart {
    /// Records the positions and normals with which the lists were built.
    fn note(&mut self, chain: &Chain) {
        let own = self.particles.clone();
        let places = own.start + 1..own.end + 1;
        let now = [&chain.x[places.clone()], &chain.y[places], &chain.nx[own.clone()], &chain.ny[own]];
        for (built, now) in self.built.iter_mut().zip(now) {
            built.clear();
            built.extend_from_slice(now);
        }
        (self.moved, self.turned) = (0.0, 0.0);
    }

    /// Records how far the particles have moved to `next`.
    #[inline(always)]
    pub(super) fn follow(&mut self, next: &Stretch<'_>) {
        let n = self.particles.len();
        let [bx, by, bnx, bny] = self.built.each_ref().map(|v| &v[..]);
        if bx.len() != n {
            return;
        }
        let (x, y, nx, ny) = (&next.x[..n], &next.y[..n], &next.nx[..n], &next.ny[..n]);
        self.moved = greatest(n, |i| square([x[i] - bx[i], y[i] - by[i]]));
        // The normals of the first and the last particle are not known yet.
        self.turned = greatest(n.saturating_sub(2), |i| square([nx[i + 1] - bnx[i + 1], ny[i + 1] - bny[i + 1]]));
    }
}

#[inline(always)]
fn square([x, y]: [f32; 2]) -> f32 {
    x * x + y * y
}

/// The neighbour search, with its lists.
#[derive(Clone, Debug)]
pub(super) struct Neighbours {
    search: Search,
    vectors: Vectors,
    threads: usize,
    pub(super) parts: Vec<LoopPart>,
    tables: Tables,
    built: Sight,
    /// Maximum scale of a particle.
    widest: f32,
    /// Distance by which lists extend beyond the ranges, µm; how much of it may be used up; and the
    /// number of evaluations that used it.
    skin: f32,
    used: f32,
    evaluations: u32,
    valid: bool,
    builds: u64,
}

impl Neighbours {
    pub(super) fn new(search: Search, vectors: Vectors, threads: usize) -> Self {
        Self {
            search,
            vectors,
            threads: threads.max(1),
            parts: Vec::new(),
            tables: Tables::default(),
            built: Sight::default(),
            widest: 1.0,
            skin: FIRST_SKIN,
            used: 0.0,
            evaluations: 0,
            valid: false,
            builds: 0,
        }
    }

    /// Continues the count of builds from `builds`.
    pub(super) fn count_from(&mut self, builds: u64) {
        self.builds = builds;
    }

    pub(super) fn builds(&self) -> u64 {
        self.builds
    }

    /// Divides a loop of `n` particles into parts, and discards the lists.
    pub(super) fn divide(&mut self, n: usize) {
        // Several parts per thread, because folds make the work per particle uneven.
        let grains = n.div_ceil(GRAIN);
        let count = if self.threads == 1 { 1 } else { (self.threads * 4).min(grains) };
        self.parts.resize_with(count, LoopPart::default);
        for (k, part) in self.parts.iter_mut().enumerate() {
            let (first, end) = (k * grains / count, (k + 1) * grains / count);
            part.particles = first * GRAIN..(end * GRAIN).min(n);
        }
        self.valid = false;
    }

    /// Determines which lists are outdated for `chain`. Returns the parts, and the update that each
    /// part needs before it is used.
    pub(super) fn prepare<'a>(
        &'a mut self,
        chain: &'a Chain,
        scale: &[f32],
        row: &StepRow,
    ) -> (&'a mut [LoopPart], Update<'a>) {
        let sight = Sight::at(row);
        let vectors = self.vectors;
        let mut restless = None;
        match self.outdated(chain, row) {
            Outdated::None => return (&mut self.parts, Update { vectors, lists: None }),
            Outdated::Some(particles) => {
                self.fill(chain, ROUNDING);
                let [tissue, gap] = sight.of(self.widest);
                restless = Some(self.tables.restless(particles, max(tissue, gap))).filter(|r| r.are_few(NEAR));
            }
            Outdated::All => {}
        }
        if restless.is_none() {
            let Some(skin) = self.renew(scale, sight) else {
                return (&mut self.parts, Update { vectors, lists: None });
            };
            self.fill(chain, skin);
        }
        let Self { parts, tables, search, .. } = self;
        let grid = (*search == Search::Grid).then(|| Grid::new(&tables.cells));
        let lists = Lists { chain, sight, tables, grid };
        (parts, Update { vectors, lists: Some((lists, restless)) })
    }

    /// Fills the tables of segments for lists with this skin.
    fn fill(&mut self, chain: &Chain, skin: f32) {
        let tables = &mut self.tables;
        self.vectors.run(
            #[inline(always)]
            || tables.fill(chain, skin),
        );
    }

    fn outdated(&mut self, chain: &Chain, row: &StepRow) -> Outdated {
        match self.search {
            _ if !self.valid => Outdated::All,
            Search::AllPairs => Outdated::None,
            Search::Grid => Outdated::All,
            Search::Lists => {
                self.parts.iter_mut().for_each(|part| part.groups.settle());
                self.used = self.used_up(chain, row);
                self.evaluations += 1;
                if self.used <= self.skin - ROUNDING {
                    Outdated::None
                } else {
                    self.restless(chain, row).map_or(Outdated::All, Outdated::Some)
                }
            }
        }
    }

    /// Begins new lists for all groups. Returns their skin; `None` if the search uses no lists.
    fn renew(&mut self, scale: &[f32], sight: Sight) -> Option<f32> {
        self.builds += 1;
        self.valid = true;
        self.built = sight;
        self.widest = scale.iter().fold(1.0f32, |a, &b| max(a, b));
        if self.evaluations > 0 {
            let rate = min(self.used, self.skin) / self.evaluations as f32;
            self.skin = min(max((THRIFT * rate).sqrt(), SKINS[0]), SKINS[1]);
        }
        (self.used, self.evaluations) = (0.0, 0);
        (self.search != Search::AllPairs).then_some(self.skin)
    }

    /// Upper bound of the decrease of the slack between a particle and a segment since the lists
    /// were built.
    fn used_up(&self, chain: &Chain, row: &StepRow) -> f32 {
        let (mut moved, mut turned) = (0.0, 0.0);
        for part in &self.parts {
            moved = max(moved, part.moved);
            turned = max(turned, part.turned);
            let count = part.particles.len();
            for k in [0, count - 1] {
                let i = part.particles.start + k;
                turned = max(turned, square([chain.nx[i] - part.built[2][k], chain.ny[i] - part.built[3][k]]));
            }
        }
        let (widened, by_turning) = self.changes(row);
        SLOPE * 2.0 * moved.sqrt() + by_turning * turned.sqrt() + widened
    }

    /// Upper bound of the growth of ranges since the lists were built, and change of slack per
    /// change of a normal.
    fn changes(&self, row: &StepRow) -> (f32, f32) {
        let (built, now) = (self.built, Sight::at(row));
        let wider = max(max(now.tissue - built.tissue, now.gap - built.gap), 0.0);
        let [tissue, gap] = built.of(self.widest);
        (max(wider * self.widest, now.least - built.least), 0.5 * (tissue - gap).abs())
    }

    /// Particles that have moved or turned so much that their lists may be outdated; `None` if they
    /// are too many.
    fn restless(&self, chain: &Chain, row: &StepRow) -> Option<Vec<usize>> {
        let most = chain.len() / RESTLESS;
        let (widened, by_turning) = self.changes(row);
        let allowed = self.skin - ROUNDING - widened;
        if most == 0 || allowed <= 0.0 {
            return None;
        }
        let (far, turned) = (CALM[0] * allowed / (2.0 * SLOPE), CALM[1] * allowed / by_turning);
        let mut restless = Vec::new();
        for part in &self.parts {
            let [x, y, nx, ny] = &part.built;
            for (k, i) in part.particles.clone().enumerate() {
                if square([chain.x[i + 1] - x[k], chain.y[i + 1] - y[k]]) > far * far
                    || square([chain.nx[i] - nx[k], chain.ny[i] - ny[k]]) > turned * turned
                {
                    if restless.len() == most {
                        return None;
                    }
                    restless.push(i);
                }
            }
        }
        Some(restless)
    }
}

/// Outdated lists.
enum Outdated {
    None,
    /// Lists of groups near these particles.
    Some(Vec<usize>),
    All,
}

/// Update of the lists of all parts.
pub(super) struct Update<'a> {
    vectors: Vectors,
    /// Lists to rebuild: all, or only those near the restless particles; `None` if all lists are
    /// valid.
    lists: Option<(Lists<'a>, Option<Restless>)>,
}

impl Update<'_> {
    /// Rebuilds lists of a part, whose particles have these scales.
    pub(super) fn apply(&self, part: &mut LoopPart, scale: &[f32]) {
        let Some((lists, restless)) = &self.lists else {
            return;
        };
        let LoopPart { particles, groups, .. } = part;
        self.vectors.run_in_lanes(ListUpdate { lists, restless: restless.as_ref(), particles, scale, groups });
        if restless.is_none() {
            part.note(lists.chain);
        }
    }
}

/// Rebuild of lists of a part: of all lists, or of those near the restless particles.
struct ListUpdate<'a> {
    lists: &'a Lists<'a>,
    restless: Option<&'a Restless>,
    particles: &'a Range<usize>,
    scale: &'a [f32],
    groups: &'a mut Groups,
}

impl WithSimd for ListUpdate<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { lists, restless, particles, scale, groups } = self;
        match restless {
            None => lists.build(simd, particles, scale, groups),
            Some(restless) => lists.mend(simd, particles, scale, restless, groups),
        }
    }
}

/// Runs `work` on every item, in parallel.
pub(super) fn each<T: Send>(items: impl Iterator<Item = T>, work: impl Fn(T) + Sync + Send) {
    let items: Vec<T> = items.collect();
    if items.len() == 1 {
        items.into_iter().for_each(work);
    } else {
        items.into_par_iter().for_each(work);
    }
}
