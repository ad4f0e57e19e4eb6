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
//! Each particle has a reference position and a reference normal, and a list contains the segments
//! within D plus the skin at the references. Particles that have moved far get new references. Only
//! the lists of their groups, and those that lack one of their segments, are then rebuilt.

mod grid;
mod lists;

use super::chain::{Chain, Stretch};
use crate::sim::layout::StepRow;
use crate::sim::maths::{greatest, max, min};
use crate::spec::Search;
use crate::vectorize::{Simd, Vectors, WithSimd};
use grid::Grid;
pub(super) use lists::OwnSegments;
use lists::{Groups, Lists, OwnParticles, References, Restless, SLOPE, Sight, Tables, square};
use std::ops::Range;

/// Factor of the skin, µm. With a skin s, the length of lists grows in proportion to s, and a
/// particle gets a new reference after s/v evaluations if it uses up slack at the rate v. The sum
/// of both costs is minimal at √(`THRIFT`·v). Measured with the presets `paper` and `pig`.
const THRIFT: f32 = 120.0;
/// Bounds of the skin, and the first skin, µm.
const SKINS: [f32; 2] = [5.0, 30.0];
const FIRST_SKIN: f32 = 10.0;
/// Part of the skin reserved for rounding, µm.
const ROUNDING: f32 = 0.01;
/// If more than one particle in `RESTLESS` is restless, all lists are rebuilt.
const RESTLESS: usize = 48;
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
    references: References,
    /// Squares of the maximum displacement, and of the maximum change of a normal, from the
    /// references.
    moved: f32,
    turned: f32,
}

impl LoopPart {
    /// Records how far the particles have moved to `next`.
    #[inline(always)]
    pub(super) fn follow(&mut self, next: &Stretch<'_>) {
        let n = self.particles.len();
        let References { x: rx, y: ry, nx: rnx, ny: rny } = &self.references;
        if rx.len() != n {
            return;
        }
        let (rx, ry, rnx, rny) = (&rx[..n], &ry[..n], &rnx[..n], &rny[..n]);
        let (x, y, nx, ny) = (&next.x[..n], &next.y[..n], &next.nx[..n], &next.ny[..n]);
        self.moved = greatest(n, |i| square([x[i] - rx[i], y[i] - ry[i]]));
        // The normals of the first and the last particle are not known yet.
        self.turned = greatest(n.saturating_sub(2), |i| square([nx[i + 1] - rnx[i + 1], ny[i + 1] - rny[i + 1]]));
    }
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
    /// Distance by which lists extend beyond the ranges, µm.
    skin: f32,
    /// Number of evaluations with this skin, and of new references in them.
    evaluations: u32,
    renewed: u64,
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
            evaluations: 0,
            renewed: 0,
            valid: false,
            builds: 0,
        }
    }

    pub(super) fn threads(&self) -> usize {
        self.threads
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
        let vectors = self.vectors;
        let restless = match self.outdated(chain, row) {
            Outdated::None => return (&mut self.parts, Update { vectors, chain, lists: None }),
            Outdated::Some(particles) => {
                self.renewed += particles.len() as u64;
                Some(self.renew(chain, particles))
            }
            Outdated::All => {
                if !self.begin(chain, scale, row) {
                    return (&mut self.parts, Update { vectors, chain, lists: None });
                }
                None
            }
        };
        let Self { parts, tables, search, built, .. } = self;
        let grid = (*search == Search::Grid).then(|| Grid::new(&tables.cells));
        let lists = Lists { sight: *built, tables, grid };
        (parts, Update { vectors, chain, lists: Some((lists, restless)) })
    }

    fn outdated(&mut self, chain: &Chain, row: &StepRow) -> Outdated {
        match self.search {
            _ if !self.valid => Outdated::All,
            Search::AllPairs => Outdated::None,
            Search::Grid => Outdated::All,
            Search::Lists => {
                self.evaluations += 1;
                if self.used_up(chain, row) <= self.skin - ROUNDING {
                    return Outdated::None;
                }
                match self.restless(chain, row) {
                    Some(particles) => Outdated::Some(particles),
                    None => {
                        self.renewed += chain.len() as u64;
                        Outdated::All
                    }
                }
            }
        }
    }

    /// Begins new lists for all groups. Returns false if the search uses no lists.
    fn begin(&mut self, chain: &Chain, scale: &[f32], row: &StepRow) -> bool {
        self.builds += 1;
        self.valid = true;
        self.built = Sight::at(row);
        self.widest = scale.iter().fold(1.0f32, |a, &b| max(a, b));
        if self.search == Search::AllPairs {
            return false;
        }
        if self.evaluations > 0 {
            let renewed = self.renewed as f32 / (chain.len() as f32 * self.evaluations as f32);
            self.skin = min(max((THRIFT * self.skin * renewed).sqrt(), SKINS[0]), SKINS[1]);
        }
        (self.evaluations, self.renewed) = (0, 0);
        let (tables, skin) = (&mut self.tables, self.skin);
        self.vectors.run(
            #[inline(always)]
            || tables.fill(chain, skin),
        );
        true
    }

    /// Gives these particles new references.
    fn renew(&mut self, chain: &Chain, particles: Vec<usize>) -> Restless {
        for &i in &particles {
            let part = self.parts.partition_point(|part| part.particles.end <= i);
            let LoopPart { particles, references, .. } = &mut self.parts[part];
            let k = i - particles.start;
            (references.x[k], references.y[k]) = (chain.x[i + 1], chain.y[i + 1]);
            (references.nx[k], references.ny[k]) = (chain.nx[i], chain.ny[i]);
        }
        let n = chain.len();
        let reference = |i: usize| {
            let part = &self.parts[self.parts.partition_point(|part| part.particles.end <= i)];
            let k = i - part.particles.start;
            [part.references.x[k], part.references.y[k]]
        };
        let ends = particles.iter().flat_map(|&i| [(i + n - 1) % n, i]);
        let mut segments: Vec<usize> = ends.collect();
        segments.sort_unstable();
        segments.dedup();
        for &j in &segments {
            self.tables.place(j, [reference(j), reference((j + 1) % n)], self.skin);
        }
        let [tissue, gap] = self.built.of(self.widest);
        self.tables.restless(particles, &segments, max(tissue, gap))
    }

    /// Upper bound of the decrease of the slack between a particle and a segment from that at their
    /// references.
    fn used_up(&self, chain: &Chain, row: &StepRow) -> f32 {
        let (mut moved, mut turned) = (0.0, 0.0);
        for part in &self.parts {
            moved = max(moved, part.moved);
            turned = max(turned, part.turned);
            let count = part.particles.len();
            for k in [0, count - 1] {
                turned = max(turned, part.references.changes(k, chain, part.particles.start + k)[1]);
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
        if allowed <= 0.0 {
            return None;
        }
        let limits = [CALM[0] * allowed / (2.0 * SLOPE), CALM[1] * allowed / by_turning].map(|limit| limit * limit);
        let mut restless = Vec::new();
        for part in &self.parts {
            for (k, i) in part.particles.clone().enumerate() {
                let changes = part.references.changes(k, chain, i);
                if changes[0] > limits[0] || changes[1] > limits[1] {
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
    /// Some lists of groups near these particles.
    Some(Vec<usize>),
    All,
}

/// Update of the lists of all parts.
pub(super) struct Update<'a> {
    vectors: Vectors,
    chain: &'a Chain,
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
        let LoopPart { particles, groups, references, moved, turned } = part;
        if restless.is_none() {
            references.take(self.chain, particles);
            (*moved, *turned) = (0.0, 0.0);
        }
        let own = OwnParticles { range: particles, references, scale, n: self.chain.len() };
        self.vectors.run_in_lanes(ListUpdate { lists, restless: restless.as_ref(), own, groups });
    }
}

/// Rebuild of lists of a part: of all lists, or of those near the restless particles.
struct ListUpdate<'a> {
    lists: &'a Lists<'a>,
    restless: Option<&'a Restless>,
    own: OwnParticles<'a>,
    groups: &'a mut Groups,
}

impl WithSimd for ListUpdate<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { lists, restless, own, groups } = self;
        match restless {
            None => lists.build(simd, own, groups),
            Some(restless) => lists.mend(simd, own, restless, groups),
        }
    }
}
