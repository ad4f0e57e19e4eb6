//! Generates a model from its specification, synchronously: simulate, loft, certify, export; with a progress sink and a cancel
//! token.
//!
//! Does not depend on jobs or HTTP; the worker and the command line both call [`generate`]. An [`Outcome`] exists only for a
//! model that has passed its certificate.

mod batch;
mod checkpoint;
mod device;
mod files;
#[cfg(feature = "fuzzing")]
#[doc(hidden)]
pub mod fuzzing;
mod grow;
mod labels;
mod manifest;
mod outputs;
mod pace;
mod surfaces;
mod types;
mod walls;
mod warnings;

pub use batch::{Member, generate_batch};
pub use checkpoint::{Checkpoint, CheckpointError};
pub use files::write_surface;
pub use manifest::{Licence, MANIFEST, Manifest, ManifestFile, Origin};
pub use outputs::{Output, Outputs};
pub use types::{
    Backend, CancelToken, FileOutput, Findings, GenerateError, Outcome, Progress, Request, Seconds, Sink, Stage,
};

use crate::clock::Stopwatch;
use crate::measure;
use crate::measure::comparison::compare;
use crate::measure::morphometry::{Regions, morphometry};
use crate::spec::preset;
use grow::Grown;
use pace::Pace;
use serde_json::json;
use std::sync::{Mutex, PoisonError};
use surfaces::Surfaces;

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
    check_memory(request)?;
    let total = Stopwatch::start();
    let mut pace = Pace::new(&request.spec, sink);
    let grown = grow::grow(request, from, &mut pace, cancel)?;
    let threads = rayon::current_num_threads();
    let ran = Ran {
        used: if request.backend == Backend::CpuSingle { Backend::CpuSingle } else { Backend::Cpu },
        device: format!("cpu, {threads} thread{}", if threads == 1 { "" } else { "s" }),
        total,
    };
    finish(request, grown, ran, &Mutex::new(pace), cancel)
}

/// Backend, device and time of a simulation.
struct Ran {
    used: Backend,
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
    let mut seconds = Seconds { simulate: grown.seconds, ..Seconds::default() };
    let done = |stage, part| pace.lock().unwrap_or_else(PoisonError::into_inner).stage(stage, part);
    let stage = |stage| done(stage, 0.0);
    stage(Stage::Mesh);
    let closed = grown.walls.close(surfaces::need_lumen(&request.outputs), &|part| {
        done(Stage::Mesh, part);
        cancel.is_cancelled()
    })?;
    let watch = Stopwatch::start();
    let (mesh, sections) = (&closed.tissue, &closed.sections);
    let surfaces = Surfaces::new(mesh, closed.lids.as_ref(), &request.outputs).map_err(walls::unsound)?;
    seconds.mesh = closed.seconds + watch.seconds();
    stop_if_cancelled(cancel)?;

    stage(Stage::Certify);
    let watch = Stopwatch::start();
    let certificate = measure::certify(mesh, sections);
    if let Some(detail) = certificate.first_failure() {
        return Err(GenerateError::Certificate { detail });
    }
    let others = surfaces.certify(certificate.volume_mm3)?;
    seconds.certify = watch.seconds();
    stop_if_cancelled(cancel)?;

    stage(Stage::Measure);
    let watch = Stopwatch::start();
    let spec = &request.spec;
    let regions = Regions {
        length_mm: spec.length_mm,
        junction: [spec.regions.junction_from, spec.regions.junction_to],
        piece: spec.piece_um().map(|um| um / (spec.length_mm * 1000.0)),
    };
    let morphometry = morphometry(sections, &certificate.section_gaps_um, &regions);
    let comparison = preset(&request.preset).map(|of| compare(&morphometry, &of.organ, &of.species));
    seconds.measure = watch.seconds();
    stop_if_cancelled(cancel)?;

    stage(Stage::Export);
    let watch = Stopwatch::start();
    let added = sections.iter().filter(|s| s.added).count();
    let ends = closed.particles;
    let last = *spec.recorded().end();
    let warnings = warnings::warnings(&warnings::Growth {
        // Before the end of the tube they may still be made.
        splits_missing: if last == spec.steps { grown.statistics.splits_missing } else { 0 },
        min_gap_um: certificate.min_gap_um,
        particles: ends[1] as u64,
        target: spec.particles.total.at(f64::from(last) / f64::from(spec.steps)).round() as u64,
    });
    let summary = json!({
        "sections": sections.len() - added,
        "sections_added": added,
        "diagonals_flipped": closed.flipped,
        "particles": { "start": ends[0], "end": ends[1] },
        "splits_deferred": grown.statistics.splits_deferred,
        "splits_missing": grown.statistics.splits_missing,
        "vertices": certificate.vertices,
        "triangles": certificate.triangles,
        "min_gap_um": certificate.min_gap_um,
        "volume_mm3": certificate.volume_mm3,
        "area_mm2": certificate.area_mm2,
        "warnings": warnings,
    });
    let certificate = serde_json::to_value(&certificate)
        .map_err(|e| GenerateError::Io { name: files::REPORT.into(), source: e.into() })?;
    let findings = Findings { summary, certificate, surfaces: others, morphometry, comparison };
    let files = files::write(request, &surfaces, sections, &findings, cancel)?;
    seconds.export = watch.seconds();
    stop_if_cancelled(cancel)?;
    seconds.total = ran.total.seconds();
    Ok(Outcome { used: ran.used, device: ran.device, files, findings, seconds })
}

fn check_memory(request: &Request) -> Result<(), GenerateError> {
    let needed = request.spec.cost(&request.outputs.names()).memory_bytes;
    match request.memory_limit_bytes {
        Some(limit) if needed > limit => Err(GenerateError::Memory { needed, limit }),
        _ => Ok(()),
    }
}

fn stop_if_cancelled(cancel: &CancelToken) -> Result<(), GenerateError> {
    if cancel.is_cancelled() { Err(GenerateError::Cancelled) } else { Ok(()) }
}

#[cfg(test)]
mod tests;
