//! Generates a model from its specification, synchronously: simulate, loft, certify, export; with a progress sink and a cancel
//! token.
//!
//! Does not depend on jobs or HTTP; the worker and the command line both call [`generate`]. An [`Outcome`] exists only for a
//! model that has passed its certificate.

mod batch;
mod checkpoint;
mod contraction;
mod cost;
mod device;
mod files;
#[cfg(feature = "fuzzing")]
#[doc(hidden)]
pub mod fuzzing;
mod grow;
mod labels;
mod lean;
mod limits;
mod manifest;
mod outputs;
mod pace;
mod surfaces;
mod types;
mod walls;
mod warnings;

pub use batch::{Calls, Member, generate_batch};
pub use checkpoint::{Checkpoint, CheckpointError};
pub use cost::{Cost, Estimate};
pub use files::write_surface;
pub use limits::{CostLimits, OverLimit};
pub use manifest::{Licence, MANIFEST, Manifest, ManifestFile, Origin};
pub use outputs::{Output, Outputs};
pub use types::{
    Backend, Bending, CancelToken, ContractionReport, FileOutput, Findings, FrameReport, GenerateError, Outcome,
    Progress, Request, Seconds, Sink, Stage, UsedBackend,
};

use crate::clock::Stopwatch;
use crate::export::centreline::Centreline;
use crate::geometry::cut::Body;
use crate::lock::Mutex;
use crate::measure;
use crate::measure::Certificate;
use crate::measure::comparison::compare;
use crate::measure::morphometry::{Cuts, Morphometry, Regions, cuts, morphometry};
use crate::mesh::bend::{Leaning, bend_apart};
use crate::mesh::contract::Rest;
use crate::mesh::lean::{Leaned, lean};
use crate::model::{BodyKind, LengthUnit, Section};
use crate::sim::Statistics;
use crate::spec::preset;
use files::Inputs;
use grow::Grown;
use pace::Pace;
use serde_json::json;
use surfaces::Surfaces;
use walls::Closed;

/// Grows, certifies and writes one model on the CPU; for a GPU see [`generate_batch`].
///
/// Uses all threads of the rayon pool in which it is called, or one thread with
/// [`Backend::CpuSingle`]. The files are the same, byte for byte, in both cases.
///
/// # Errors
/// See [`GenerateError`]. Files that were already written are left for the caller to remove.
pub fn generate(request: &Request, sink: &dyn Sink, cancel: &CancelToken) -> Result<Outcome, GenerateError> {
    begin(request, None, sink, cancel)
}

/// Continues a model from its checkpoint, on the CPU. The files are the same as those of [`generate`].
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
        Backend::Auto | Backend::Cpu => run(request, from, sink, cancel),
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
    let mut pace = Pace::new(request, sink);
    let grown = grow::grow(request, from, &mut pace, cancel)?;
    let threads = rayon::current_num_threads();
    let ran = Ran {
        used: if request.backend == Backend::CpuSingle { UsedBackend::CpuSingle } else { UsedBackend::Cpu },
        device: format!("cpu, {threads} thread{}", if threads == 1 { "" } else { "s" }),
        total,
    };
    finish(request, grown, ran, &Mutex::new(pace), cancel)
}

/// Backend, device and time of a simulation.
struct Ran {
    used: UsedBackend,
    device: String,
    total: Stopwatch,
}

/// Closes, certifies and writes a grown model.
fn finish(
    request: &Request,
    grown: Grown,
    ran: Ran,
    pace: &Mutex<Pace<'_>>,
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

/// What is known of a model while it is finished.
struct Finishing<'a> {
    request: &'a Request,
    statistics: Statistics,
    /// Diagonals flipped to mend slabs.
    flipped: usize,
    ran: Ran,
    /// Reports a part of a stage; fails if the generation is cancelled.
    stage: &'a dyn Fn(Stage, f64) -> Result<(), GenerateError>,
    cancel: &'a CancelToken,
}

/// What was found of a model, and what its files are made from.
struct Examined<'a> {
    certificate: Certificate,
    others: Vec<serde_json::Value>,
    /// The frames of a tube that contracts: files that are written, and what they measure.
    contraction: Option<(Vec<FileOutput>, ContractionReport)>,
    morphometry: Morphometry,
    /// Of a surface that leans.
    cuts: Option<Cuts>,
    lean: Option<Leaned>,
    course: Option<Bending>,
    /// Sections that were added to mend slabs.
    added: usize,
    /// Points of the first and of the last section.
    ends: [usize; 2],
    inputs: Inputs<'a>,
}

impl Finishing<'_> {
    /// Certifies and measures a surface, and writes its files; `watch` runs since its loft was ended.
    fn examine(self, closed: Closed, watch: Stopwatch, mut seconds: Seconds) -> Result<Outcome, GenerateError> {
        let Closed { tissue: mut straight, lids, sections } = closed;
        let stop = || self.cancel.is_cancelled();
        let along = self.request.spec.bent_course();
        let course = along.as_ref().map(|bent| &bent.course);
        let by = lean::lean(self.request);
        let z: Vec<f32> = straight.positions.iter().map(|p| p[2]).collect();
        let leaned = by.as_ref().map(|by| lean(&mut straight, by, &stop));
        let leaning = course.and(by.as_ref()).map(|lean| Leaning { lean, z: z.clone() });
        let (mut bent, mut refined, mut split) = (None, None, Vec::new());
        if let Some(course) = course {
            let (mesh, done, edges) = bend_apart(&mut straight, leaning, course, &stop);
            (bent, refined, split) = (Some(mesh), Some(done), edges);
        }
        let straight = &straight;
        let tissue = bent.as_ref().unwrap_or(straight);
        let surfaces = Surfaces::new(tissue, straight, course, lids.as_ref(), &self.request.outputs);
        let surfaces = surfaces.map_err(walls::unsound)?;
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
        let (morphometry, file) = rayon::join(
            || morphometry(&sections, &certificate.section_gaps_um, &regions),
            || files::write_sections(request, &sections, cancel),
        );
        // Planes across the straight tube are planes across the centre line.
        let cuts = leaned.and_then(|_| cuts(&Body::from(straight), &regions));
        let centreline = Centreline::of(&sections, course);
        let meta = self.request.metadata(sections.len());
        let added = sections.iter().filter(|s| s.added).count();
        let ends = [&sections[0], &sections[sections.len() - 1]].map(Section::particles);
        // Levels of detail need the memory.
        drop(sections);
        seconds.measure = watch.seconds();

        let placed = surfaces.placed();
        let inputs = Inputs {
            meta: &meta,
            surfaces: placed.iter().map(|of| of.shape(&meta)).collect(),
            tissue,
            straight,
            centreline,
            sections: file?,
        };
        let course = along.as_ref().zip(refined).map(|(bent, refined)| Bending::of(bent, refined));
        let found =
            Examined { certificate, others, contraction, morphometry, cuts, lean: leaned, course, added, ends, inputs };
        self.write(found, seconds)
    }

    /// Whether version 0.3.0 certified the surface in batches.
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

    /// Writes the files.
    fn write(self, found: Examined<'_>, mut seconds: Seconds) -> Result<Outcome, GenerateError> {
        let Examined { certificate, others, contraction, morphometry, cuts, lean, course, added, ends, inputs } = found;
        let (frames, contraction) = contraction.unzip();
        let (request, spec) = (self.request, &self.request.spec);
        let comparison = preset(&request.preset).map(|of| compare(&morphometry, &of.organ, &of.species));

        (self.stage)(Stage::Export, 0.0)?;
        let watch = Stopwatch::start();
        // A smooth contour has two points for each particle.
        let points = if spec.mesh.smooth_um > 0.0 { 2 } else { 1 };
        let ends = ends.map(|of| of / points);
        let last = *spec.recorded().end();
        let statistics = &self.statistics;
        let warnings = warnings::warnings(&warnings::Growth {
            // Before the end of the tube they may still be made.
            splits_missing: if last == spec.steps { statistics.splits_missing } else { 0 },
            min_gap_um: certificate.min_gap_um,
            particles: ends[1] as u64,
            target: spec.particles.total.at(f64::from(last) / f64::from(spec.steps)).round() as u64,
            lean_scale: lean.map(|lean| lean.scale),
            lean_left_out: spec.asks_to_lean() && !spec.leans(),
            wave: contraction.as_ref().map(|of| [of.contracted.least_factor, of.contracted.least_factor_at_mm]),
        });
        let summary = json!({
            "sections": inputs.meta.sections - added,
            "sections_added": added,
            "diagonals_flipped": self.flipped,
            "particles": { "start": ends[0], "end": ends[1] },
            "splits_deferred": statistics.splits_deferred,
            "splits_missing": statistics.splits_missing,
            "vertices": certificate.vertices,
            "triangles": certificate.triangles,
            "min_gap_um": certificate.min_gap_um,
            "volume_mm3": certificate.volume_mm3,
            "area_mm2": certificate.area_mm2,
            "warnings": warnings,
        });
        let certificate = serde_json::to_value(&certificate)
            .map_err(|e| GenerateError::Io { name: files::REPORT.into(), source: e.into() })?;
        let findings = Findings {
            summary,
            certificate,
            surfaces: others,
            morphometry,
            cuts,
            lean,
            course,
            contraction,
            comparison,
        };
        let mut files = files::write(request, inputs, &findings, self.cancel)?;
        files.extend(frames.into_iter().flatten());
        seconds.export += watch.seconds();
        (self.stage)(Stage::Export, 1.0)?;
        seconds.total = self.ran.total.seconds();
        Ok(Outcome { used: self.ran.used, device: self.ran.device, files, findings, seconds })
    }
}

/// Refuses what is predicted to need too much memory, or more than a format holds, before anything is computed.
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
