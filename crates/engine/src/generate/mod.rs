//! Generates a model from its specification, synchronously: simulate, loft, certify, export, with a
//! progress sink and a cancel token.
//!
//! The worker and the command line both call [`generate`], which does not depend on jobs or HTTP.
//! An [`Outcome`] exists only for a model that has passed its certificate.

mod anatomy;
mod batch;
mod checkpoint;
mod contraction;
mod cost;
mod files;
#[cfg(feature = "fuzzing")]
#[doc(hidden)]
pub mod fuzzing;
mod grow;
mod limits;
mod manifest;
mod outputs;
mod pace;
mod skin;
mod surfaces;
mod types;
mod walls;
mod warnings;

pub use batch::{Calls, Member, generate_batch};
pub use checkpoint::{Checkpoint, CheckpointError};
pub use cost::{Cost, Estimate};
pub use files::Report;
pub use files::write_surface;
pub use limits::{CostLimits, OverLimit};
pub use manifest::{Licence, MANIFEST, Manifest, ManifestFile, Origin, is_model_file};
pub use outputs::{Output, Outputs};
pub use types::{
    Backend, Bending, CancelToken, CertificateFigures, ContractionReport, FileOutput, Findings, FrameReport,
    GenerateError, Outcome, ParticleCounts, Progress, Request, Seconds, Sink, Stage, Summary, SurfaceCertificate,
    SurfaceFinding, UsedBackend,
};
pub use warnings::Warning;

use crate::clock::Stopwatch;
use crate::export::centreline::Centreline;
use crate::lock::Mutex;
use crate::measure;
use crate::measure::Certificate;
use crate::measure::morphometry::{Cuts, Morphometry, Regions, morphometry, morphometry_of_cuts};
use crate::mesh::bend::{Leaning, bend_apart};
use crate::mesh::contract::Rest;
use crate::mesh::lean::{self, Lean, Leaned};
use crate::model::{BodyKind, LengthUnit, Mesh, Section};
use crate::sim::{Plan, Statistics};
use crate::spec::ModelSpec;
use files::Inputs;
use grow::GrownSections;
use pace::ProgressMeter;
use surfaces::Surfaces;
use walls::Closed;

/// Grows, certifies and writes one model on the CPU; for a GPU see [`generate_batch`].
///
/// Uses all threads of the rayon pool in which it is called, or one thread with
/// [`Backend::CpuSingle`]. The files are identical in both cases.
///
/// # Errors
/// See [`GenerateError`]. The caller must delete files that were already written.
pub fn generate(request: &Request, sink: &dyn Sink, cancel: &CancelToken) -> Result<Outcome, GenerateError> {
    begin(request, None, sink, cancel)
}

/// Continues a model from its checkpoint, on the CPU. The files are the same as those of
/// [`generate`].
///
/// # Errors
/// See [`GenerateError`].
pub fn resume(
    request: &Request,
    checkpoint: Checkpoint,
    sink: &dyn Sink,
    cancel: &CancelToken,
) -> Result<Outcome, GenerateError> {
    begin(request, Some(checkpoint), sink, cancel)
}

fn begin(
    request: &Request,
    from: Option<Checkpoint>,
    sink: &dyn Sink,
    cancel: &CancelToken,
) -> Result<Outcome, GenerateError> {
    match request.backend {
        Backend::Gpu => Err(GenerateError::Backend { detail: "a GPU needs a device: use generate_batch".into() }),
        // On a thread of the pool, so that the caller is not one thread too many.
        Backend::Auto | Backend::Cpu => rayon::scope(|_| run(request, from, sink, cancel)),
        // The caller has a pool of one thread already.
        Backend::CpuSingle if rayon::current_thread_index().is_some() && rayon::current_num_threads() == 1 => {
            run(request, from, sink, cancel)
        }
        Backend::CpuSingle => rayon::ThreadPoolBuilder::new()
            .num_threads(1)
            .build()
            .map_err(|e| GenerateError::Backend { detail: e.to_string() })?
            .install(|| run(request, from, sink, cancel)),
    }
}

fn run(
    request: &Request,
    from: Option<Checkpoint>,
    sink: &dyn Sink,
    cancel: &CancelToken,
) -> Result<Outcome, GenerateError> {
    check(request)?;
    let total = Stopwatch::start();
    let mut pace = ProgressMeter::new(request, sink);
    let grown = grow::grow(request, from, &mut pace, cancel)?;
    let threads = rayon::current_num_threads();
    let ran = RunInfo {
        used: if request.backend == Backend::CpuSingle { UsedBackend::CpuSingle } else { UsedBackend::Cpu },
        device: format!("cpu, {threads} thread{}", if threads == 1 { "" } else { "s" }),
        total,
    };
    finish(request, grown, ran, &Mutex::new(pace), cancel)
}

/// Backend, device and time of a simulation.
struct RunInfo {
    used: UsedBackend,
    device: String,
    total: Stopwatch,
}

/// Closes, certifies and writes a grown model.
fn finish(
    request: &Request,
    grown: GrownSections,
    ran: RunInfo,
    pace: &Mutex<ProgressMeter<'_>>,
    cancel: &CancelToken,
) -> Result<Outcome, GenerateError> {
    let stage = |stage, part| {
        pace.lock().stage(stage, part);
        if cancel.is_cancelled() { Err(GenerateError::Cancelled) } else { Ok(()) }
    };
    let seconds = Seconds { simulate: grown.seconds, mesh: grown.walls.seconds(), ..Seconds::default() };
    let (statistics, flipped) = (grown.statistics, grown.walls.flipped());
    let watch = Stopwatch::start();
    stage(Stage::Mesh, 0.0)?;
    let closed =
        grown.walls.close(surfaces::need_lumen(&request.outputs), &|part| stage(Stage::Mesh, part).is_err())?;
    Finishing { request, statistics, flipped, ran, stage: &stage, cancel }.examine(closed, watch, seconds)
}

/// A model between its growth and its files.
struct Finishing<'a> {
    request: &'a Request,
    statistics: Statistics,
    /// Number of diagonals flipped to mend slabs.
    flipped: usize,
    ran: RunInfo,
    /// Reports a completed fraction of a stage. Fails if the generation is cancelled.
    stage: &'a (dyn Fn(Stage, f64) -> Result<(), GenerateError> + Sync),
    cancel: &'a CancelToken,
}

impl Finishing<'_> {
    /// Certifies and measures a surface, and writes the files. `watch` has run since the end of the
    /// loft.
    fn examine(self, closed: Closed, watch: Stopwatch, mut seconds: Seconds) -> Result<Outcome, GenerateError> {
        let Closed { tissue: mut straight, rows, lids, sections } = closed;
        let stop = || self.cancel.is_cancelled();
        let along = self.request.spec.bent_course();
        let course = along.as_ref().map(|bent| &bent.course);
        let by = lean_of(&self.request.spec, self.request.seed);
        let coordinates = skin::coordinates(self.request, &straight)?;
        let z: Vec<f32> = straight.positions.iter().map(|p| p[2]).collect();
        let leaned = by.as_ref().map(|by| lean::lean(&mut straight, by, &stop));
        let leaning = course.and(by.as_ref()).map(|lean| Leaning { lean, z: z.clone() });
        let (mut bent, mut refined, mut split) = (None, None, Vec::new());
        if let Some(course) = course {
            let (mesh, done, edges) = bend_apart(&mut straight, leaning, course, &stop);
            (bent, refined, split) = (Some(mesh), Some(done), edges);
        }
        let straight = &straight;
        let tissue = bent.as_ref().unwrap_or(straight);
        let surfaces = Surfaces::new(tissue, straight, course, lids.as_ref(), &self.request.outputs);
        let surfaces = surfaces?;
        seconds.mesh += watch.seconds();

        (self.stage)(Stage::Certify, 0.0)?;
        let watch = Stopwatch::start();
        let mut certificate = measure::certify(tissue, &sections);
        let batches = self.sums_in_batches().then_some(&sections[..]);
        if let Some(sections) = batches {
            certificate.sum_in_batches(tissue, LengthUnit::Metre, sections);
        }
        if let Some(detail) = certificate.first_failure() {
            return Err(GenerateError::Certificate { detail });
        }
        let others = surfaces.certify(certificate.volume_mm3, batches)?;
        let contraction = self.request.spec.contracts().then(|| {
            let rest = Rest { straight, z: &z, split: &split, lean: by.as_ref(), course };
            let progress = |part| (self.stage)(Stage::Certify, part);
            contraction::write(self.request, rest, (tissue, certificate.volume_mm3), &progress, &stop)
        });
        let contraction = contraction.transpose()?;
        seconds.certify = watch.seconds();

        (self.stage)(Stage::Measure, 0.0)?;
        let watch = Stopwatch::start();
        let (request, cancel, regions) = (self.request, self.cancel, self.regions());
        let gaps_um = &certificate.section_gaps_um;
        let (shapes, file) = rayon::join(
            || ShapesFound::measure(request, &sections, gaps_um, straight, leaned.is_some(), &regions),
            || files::write_sections(request, &sections, cancel),
        );
        let ShapesFound { morphometry, simulated, cuts } = shapes;
        let centreline = Centreline::new(&sections, course);
        let meta = self.request.metadata(sections.len());
        let added = sections.iter().filter(|s| s.added).count();
        let ends = [&sections[0], &sections[sections.len() - 1]];
        let skin = coordinates.map(|of| skin::skin(request, of, &split, straight, ends)).transpose()?;
        let ends = ends.map(Section::particles);
        // Levels of detail need this memory.
        drop(sections);
        seconds.measure = watch.seconds();

        let placed = surfaces.placed();
        let inputs = Inputs {
            meta: &meta,
            surfaces: placed.iter().map(|of| of.shape(&meta)).collect(),
            tissue,
            straight,
            rows,
            centreline,
            skin,
            sections: file?,
        };
        let (frames, contraction) = contraction.unzip();
        let (comparison, checklist) = anatomy::compared(request, &morphometry).unzip();
        let findings = Findings {
            summary: self.summary(&certificate, inputs.meta.sections, added, ends, leaned, contraction.as_ref()),
            certificate,
            surfaces: others,
            comparison,
            checklist: checklist.flatten(),
            morphometry,
            simulated,
            cuts,
            lean: leaned,
            course: along
                .as_ref()
                .zip(refined)
                .map(|(bent, refined)| Bending::of(bent, request.spec.turning_points(), refined)),
            contraction,
        };

        (self.stage)(Stage::Export, 0.0)?;
        let watch = Stopwatch::start();
        let progress = |part| drop((self.stage)(Stage::Export, part));
        let mut files = files::write(request, inputs, &findings, &progress, cancel)?;
        files.extend(frames.into_iter().flatten());
        seconds.export = watch.seconds();
        (self.stage)(Stage::Export, 1.0)?;
        seconds.total = self.ran.total.seconds();
        Ok(Outcome { used: self.ran.used, device: self.ran.device, files, findings, seconds })
    }

    /// True if version 0.3.0 certified the surface in batches. The sums of such surfaces keep the
    /// order of that version.
    fn sums_in_batches(&self) -> bool {
        let Request { spec, outputs, .. } = self.request;
        let is_lofted = spec.mesh.resolution_um == 0.0 && !spec.mesh.strips;
        let is_straight = !(spec.leans() || spec.bends() || spec.contracts());
        let is_tissue = outputs.bodies.iter().all(|body| *body == BodyKind::Tissue) && !outputs.has(Output::Labels);
        is_lofted && is_straight && is_tissue
    }

    fn regions(&self) -> Regions {
        let spec = &self.request.spec;
        Regions {
            length_mm: spec.length_mm,
            junction: [spec.regions.junction_from, spec.regions.junction_to],
            piece: spec.piece_um().map(|um| um / (spec.length_mm * 1000.0)),
        }
    }

    /// Counts and warnings. `sections` includes `added` sections of mended slabs. `ends` contains
    /// the numbers of points of the first and of the last section.
    fn summary(
        &self,
        certificate: &Certificate,
        sections: usize,
        added: usize,
        ends: [usize; 2],
        lean: Option<Leaned>,
        contraction: Option<&ContractionReport>,
    ) -> Summary {
        let (spec, statistics) = (&self.request.spec, &self.statistics);
        // A smooth contour has two points per particle.
        let points = if spec.mesh.smooth_um > 0.0 { 2 } else { 1 };
        let ends = ends.map(|of| of / points);
        let last = *spec.recorded().end();
        let warnings = warnings::warnings(&warnings::Growth {
            // A piece that ends before the tube may lack splits.
            splits_missing: if last == spec.steps { statistics.splits_missing } else { 0 },
            min_gap_um: certificate.min_gap_um,
            particles: ends[1] as u64,
            target: spec.particles.total.at(f64::from(last) / f64::from(spec.steps)).round() as u64,
            lean_scale: lean.map(|lean| lean.scale),
            lean_left_out: spec.asks_to_lean() && !spec.leans(),
            units_unused: self.request.outputs.units_unused(),
            wave: contraction.map(|of| [of.contracted.least_factor, of.contracted.least_factor_at_mm]),
        });
        Summary {
            sections: (sections - added) as u64,
            sections_added: added as u64,
            diagonals_flipped: self.flipped as u64,
            particles: ParticleCounts { start: ends[0] as u64, end: ends[1] as u64 },
            splits_deferred: statistics.splits_deferred,
            splits_missing: statistics.splits_missing,
            vertices: certificate.vertices,
            triangles: certificate.triangles,
            min_gap_um: certificate.min_gap_um,
            volume_mm3: certificate.volume_mm3,
            area_mm2: certificate.area_mm2,
            warnings,
            certificate: None,
        }
    }
}

/// Measures of the surface, and of the sections from which it was made.
struct ShapesFound {
    /// Measures of planar cuts.
    morphometry: Morphometry,
    /// Measures of the sections; `None` if the cuts are the sections.
    simulated: Option<Morphometry>,
    cuts: Option<Cuts>,
}

impl ShapesFound {
    /// Planes across the straight tube are planes across the centre line, so a bent tube is measured
    /// before bending.
    fn measure(
        request: &Request,
        sections: &[Section],
        gaps_um: &[Option<f64>],
        straight: &Mesh,
        leans: bool,
        regions: &Regions,
    ) -> Self {
        let layers = |z_um: f64| request.spec.layers_at_um(z_um, request.seed);
        // A lofted surface contains the sections. An even surface is only near them.
        if !leans && request.spec.mesh.resolution_um == 0.0 {
            let morphometry = morphometry(sections, gaps_um, regions, Some(&layers));
            return Self { morphometry, simulated: None, cuts: None };
        }
        let simulated = morphometry(sections, gaps_um, regions, None);
        let (morphometry, cuts) = morphometry_of_cuts(straight, regions, &layers, &simulated);
        Self { morphometry, simulated: Some(simulated), cuts }
    }
}

/// Lean of the surface; `None` if the specification has none.
pub(crate) fn lean_of(spec: &ModelSpec, seed: u64) -> Option<Lean> {
    if !spec.leans() {
        return None;
    }
    let plan = Plan::new(spec, seed);
    let station = |step: u32| {
        let row = plan.at(i64::from(step));
        lean::Station {
            z_um: plan.z_um[step as usize],
            // The minimum radius of every outline, so that the wall keeps its place.
            r_in_um: f64::from(row.r_in * plan.scale * plan.region(i64::from(step)).narrowest()),
            squash: f64::from(row.squash),
            strength_um: spec.lean.strength_um.at(f64::from(step) / f64::from(spec.steps)),
        }
    };
    Some(Lean {
        seed,
        wavelength_um: spec.lean.wavelength_um,
        along_um: spec.lean.along_mm * 1000.0,
        ends_um: spec.lean.ends_mm * 1000.0,
        stations: spec.stations().map(station).collect(),
    })
}

/// Refuses a model that is predicted to need too much memory, or to exceed the size of a format,
/// before anything is computed.
fn check(request: &Request) -> Result<(), GenerateError> {
    let cost = Cost::new(&request.spec, &request.outputs);
    let needed = cost.memory_bytes;
    if let Some(limit) = request.memory_limit_bytes.filter(|limit| needed > *limit) {
        return Err(GenerateError::Memory { needed, limit });
    }
    cost.check_formats().map_err(|over| GenerateError::Format { name: "model.glb".into(), detail: over.to_string() })
}

#[cfg(test)]
mod tests;
