//! Writes the files of a model into a directory. Each file is hashed while it is written.

use super::cost::StageSeconds;
use super::outputs::{Output, stem};
use super::types::{
    Bending, CancelToken, ContractionReport, FileOutput, Findings, GenerateError, Request, Summary, SurfaceFinding,
};
use crate::export::centreline::{self, Centreline};
use crate::export::glb::{GlbOptions, Skin, write_glb, write_gltf, write_gltf_data};
use crate::export::hashing::{FileDigest, HashingWriter};
use crate::export::labels::LabelReport;
use crate::export::lod::{LevelReport, levels};
use crate::export::obj::write_obj;
use crate::export::ply::write_ply;
use crate::export::stl::{write_ascii_stl, write_stl};
use crate::export::threemf::write_3mf;
use crate::export::vtp::write_vtp;
use crate::export::{Metadata, Shape, glb, labels, lod, sections_bin};
use crate::measure::Certificate;
use crate::measure::checklist::Checklist;
use crate::measure::comparison::Comparison;
use crate::measure::morphometry::{Cuts, Morphometry};
use crate::mesh::lean::Leaned;
use crate::model::{BodyKind, LengthUnit, Mesh, Rows, Section};
use rayon::prelude::*;
use serde::Serialize;
use serde_json::Value;
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::Path;
use std::sync::atomic::{AtomicU32, Ordering};

/// Name of the report.
pub(super) const REPORT: &str = "report.json";
/// Name of the file of the sections.
pub(super) const SECTIONS: &str = "sections.bin";

/// Contents of the files of a model.
pub(super) struct Inputs<'a> {
    pub(super) meta: &'a Metadata,
    /// Surface of each body in each unit that is written.
    pub(super) surfaces: Vec<(BodyKind, LengthUnit, Shape<'a>)>,
    pub(super) tissue: &'a Mesh,
    /// Tissue before bending.
    pub(super) straight: &'a Mesh,
    /// Rows of both; `None` if the surface is even.
    pub(super) rows: Option<Rows>,
    pub(super) centreline: Centreline,
    /// Textures of the tissue, if they are requested.
    pub(super) skin: Option<Skin<'a>>,
    /// Description of `sections.bin`, which is already written.
    pub(super) sections: FileOutput,
}

pub(super) type HashedFile = HashingWriter<BufWriter<File>>;

/// Writes `sections.bin`.
pub(super) fn write_sections(
    request: &Request,
    sections: &[Section],
    cancel: &CancelToken,
) -> Result<FileOutput, GenerateError> {
    let meta = request.metadata(sections.len());
    let task: Task<'_> = Box::new(|out| sections_bin::write_sections(sections, &meta, out));
    let mut files = write_all(request, vec![(SECTIONS.to_owned(), sections_bin::MEDIA_TYPE, task)], cancel)?;
    Ok(files.remove(0))
}

/// Content of `report.json`.
#[derive(Serialize)]
#[cfg_attr(feature = "schema", derive(utoipa::ToSchema), schema(as = StoredReport))]
pub struct Report<'a> {
    /// SHA-256 of the canonical spec (without `solver.search`), the seed and the engine version, as
    /// in the model.
    digest: &'a str,
    /// Preset that the spec was resolved on.
    preset: &'a str,
    /// Seed.
    #[cfg_attr(feature = "schema", schema(minimum = 0, maximum = 9007199254740991i64))]
    seed: u64,
    /// Version of the program that grew the model.
    engine: &'a str,
    /// The complete, resolved spec.
    #[cfg_attr(feature = "schema", schema(value_type = crate::spec::ModelSpec))]
    spec: Value,
    /// Counts, main measures and warnings.
    summary: &'a Summary,
    /// Certificate of the tissue in metres.
    certificate: &'a Certificate,
    /// Measures of planar cuts across the surface before bending; in models of version 0.3.0 and
    /// earlier, of the simulated sections. Absent in models of version 0.2 and earlier.
    #[cfg_attr(feature = "schema", schema(required = false))]
    morphometry: &'a Morphometry,
    /// Measures of the simulated sections; null if they are the cuts, because the surface neither
    /// leans nor is even.
    #[cfg_attr(feature = "schema", schema(required = false, nullable = true))]
    simulated: Option<&'a Morphometry>,
    /// Islands, thickness and gaps in the cuts across the ampulla; null like `simulated`.
    #[cfg_attr(feature = "schema", schema(required = false, nullable = true))]
    cuts: Option<&'a Cuts>,
    /// Displacement of the surface; null if it does not lean.
    #[cfg_attr(feature = "schema", schema(required = false, nullable = true))]
    lean: Option<&'a Leaned>,
    /// Bending of the surface; null if the tube is straight.
    #[cfg_attr(feature = "schema", schema(required = false, nullable = true))]
    course: Option<&'a Bending>,
    /// Measures of the frames of the contraction. Absent if the tube does not contract.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "schema", schema(value_type = ContractionReport, required = false))]
    contraction: Option<&'a ContractionReport>,
    /// Measures compared with published values for the organ and species of the preset.
    #[cfg_attr(feature = "schema", schema(value_type = Comparison, required = false))]
    comparison: Option<&'a Comparison>,
    /// Judgement by the anatomical checklist; null if it has no statement about the organ and
    /// species of the preset. Absent in models of version 0.3 and earlier.
    #[cfg_attr(feature = "schema", schema(required = false, nullable = true))]
    checklist: Option<&'a Checklist>,
    /// Levels of detail, the finest first. Absent if the model was grown without `lod`. A model
    /// that reuses this model has the same report, but only the files that its request names.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    #[cfg_attr(feature = "schema", schema(required = false))]
    levels: Vec<&'a LevelReport>,
    /// Label volume. Absent if the model was grown without `labels`.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "schema", schema(value_type = LabelReport, required = false))]
    labels: Option<&'a LabelReport>,
    /// Certificates of the other written surfaces: the lumen, both bodies together, and surfaces in
    /// units other than metres.
    #[serde(skip_serializing_if = "<[_]>::is_empty")]
    #[cfg_attr(feature = "schema", schema(required = false))]
    surfaces: &'a [SurfaceFinding],
}

/// Writes `report.json` and the requested outputs. The report contains neither times nor the
/// backend, so its bytes do not depend on where the model is grown. `progress` receives the
/// completed fraction.
pub(super) fn write(
    request: &Request,
    inputs: Inputs<'_>,
    findings: &Findings,
    progress: &(dyn Fn(f64) + Sync),
    cancel: &CancelToken,
) -> Result<Vec<FileOutput>, GenerateError> {
    let Inputs { meta, surfaces, tissue, straight, rows, centreline, skin, sections } = inputs;
    let strips = request.spec.mesh.strips;
    let wants = |output| request.outputs.has(output);
    let mut tasks: Vec<(String, &str, Task<'_>)> = Vec::new();
    for &output in &request.outputs.formats {
        let unit = output.unit(request.outputs.units);
        for (body, _, surface) in surfaces.iter().filter(|(_, of, _)| unit == Some(*of)) {
            let skin = skin.as_ref().filter(|_| *body == BodyKind::Tissue);
            tasks.extend(surface_tasks(output, surface, GlbOptions { strips, skin }, stem(*body)));
        }
    }
    if let Some(unit) = Output::Centreline.unit(request.outputs.units).filter(|_| wants(Output::Centreline)) {
        tasks.extend(centreline_tasks(&centreline, unit, meta));
    }
    let (files, levels) = rayon::join(
        || write_all(request, tasks, cancel),
        || wants(Output::Lod).then(|| levels(tissue, rows.as_ref(), &|| cancel.is_cancelled())).transpose(),
    );
    if cancel.is_cancelled() {
        return Err(GenerateError::Cancelled);
    }
    let seconds = StageSeconds::new(&request.spec, &request.outputs);
    let before = seconds.export / (seconds.export + seconds.labels);
    progress(before);
    let of_labels = |part: f64| progress(before + (1.0 - before) * part);
    let labels =
        wants(Output::Labels).then(|| write_labels(request, straight, meta, &of_labels, cancel)).transpose()?;
    let levels = levels.map_err(|source| GenerateError::Io { name: lod::FILES[0].into(), source })?;
    let report = Report {
        digest: &meta.digest,
        preset: &meta.preset,
        seed: meta.seed,
        engine: &meta.engine,
        spec: request.spec.to_json(),
        summary: &findings.summary,
        certificate: &findings.certificate,
        morphometry: &findings.morphometry,
        simulated: findings.simulated.as_ref(),
        cuts: findings.cuts.as_ref(),
        lean: findings.lean.as_ref(),
        course: findings.course.as_ref(),
        contraction: findings.contraction.as_ref(),
        comparison: findings.comparison.as_ref(),
        checklist: findings.checklist.as_ref(),
        levels: levels.iter().flatten().map(|level| &level.report).collect(),
        labels: labels.as_ref().map(|(_, volume)| volume),
        surfaces: &findings.surfaces,
    };
    // A `Value` sorts the members.
    let report = serde_json::to_value(report)
        .map_err(|error| GenerateError::Io { name: REPORT.into(), source: error.into() })?;
    let mut tasks: Vec<(String, &str, Task<'_>)> = Vec::new();
    for level in levels.iter().flatten() {
        tasks.push((level.report.file.to_owned(), glb::MEDIA_TYPE, Box::new(|out| level.write(meta, out))));
    }
    tasks.push((
        REPORT.to_owned(),
        "application/json",
        Box::new(|out| Ok(serde_json::to_writer_pretty(out, &report)?)),
    ));
    let mut files = files?;
    files.push(sections);
    files.extend(labels.into_iter().flat_map(|(files, _)| files));
    files.extend(write_all(request, tasks, cancel)?);
    Ok(files)
}

/// Files of a format of a body.
fn surface_tasks<'a>(
    output: Output,
    surface: &'a Shape<'a>,
    options: GlbOptions<'a>,
    stem: &'static str,
) -> impl Iterator<Item = (String, &'static str, Task<'a>)> {
    output.endings().iter().map(move |&(ending, media_type)| {
        let task: Task<'a> = Box::new(move |out| write_surface(output, ending, surface, options, stem, out));
        (format!("{stem}.{ending}"), media_type, task)
    })
}

/// Writes the file of a format with this ending. glTF needs `stem` to name its data file.
///
/// # Errors
/// Any error of writing to `out`, and surfaces that the format cannot contain.
pub fn write_surface(
    output: Output,
    ending: &str,
    surface: &Shape<'_>,
    options: GlbOptions<'_>,
    stem: &str,
    out: &mut impl Write,
) -> io::Result<()> {
    match (output, ending) {
        (Output::Glb, _) => write_glb(surface, &options, out),
        (Output::Gltf, "bin") => write_gltf_data(surface, &options, out),
        (Output::Gltf, _) => write_gltf(surface, &options, &format!("{stem}.bin"), out),
        (Output::Obj, _) => write_obj(surface, out),
        (Output::Stl, _) => write_stl(surface, out),
        (Output::StlAscii, _) => write_ascii_stl(surface, out),
        (Output::Ply, _) => write_ply(surface, out),
        (Output::Vtp, _) => write_vtp(surface, out),
        (Output::ThreeMf, _) => write_3mf(surface, out),
        (Output::Centreline | Output::Lod | Output::Labels, _) => Ok(()),
    }
}

/// Files of the centre line.
fn centreline_tasks<'a>(
    line: &'a Centreline,
    unit: LengthUnit,
    meta: &'a Metadata,
) -> Vec<(String, &'static str, Task<'a>)> {
    let [vtp, csv] = centreline::FILES.map(str::to_owned);
    let [vtp_type, csv_type] = centreline::MEDIA_TYPES;
    vec![
        (vtp, vtp_type, Box::new(move |out| line.write_vtp(unit, meta, out))),
        (csv, csv_type, Box::new(move |out| line.write_csv(unit, out))),
    ]
}

/// Writes `labels.ome.tif` and `labels.nii.gz`. Returns the files and their part of the report.
/// `progress` receives the completed fraction.
fn write_labels(
    request: &Request,
    mesh: &Mesh,
    meta: &Metadata,
    progress: &(dyn Fn(f64) + Sync),
    cancel: &CancelToken,
) -> Result<(Vec<FileOutput>, labels::LabelReport), GenerateError> {
    let spec = &request.spec;
    let volume = labels::LabelVolume {
        voxel_um: spec.labels.voxel_um,
        slice_um: spec.labels.slice_um,
        from_um: spec.label_from_um(),
        slices: spec.label_slices(),
    };
    let [ome_path, nifti_path] = labels::FILES.map(|name| request.dir.join(name));
    let write = || {
        let mut ome = buffered(&ome_path)?;
        let mut nifti = hashed(&nifti_path)?;
        let begun = AtomicU32::new(0);
        // Called before each slice.
        let cancelled = || {
            progress(f64::from(begun.fetch_add(1, Ordering::Relaxed)) / f64::from(volume.slices.max(1)));
            cancel.is_cancelled()
        };
        let layers = |z_um: f64| spec.layers_at_um(z_um, request.seed);
        let report = labels::write_labels(mesh, &layers, &volume, meta, (&mut ome, &mut nifti), &cancelled)?;
        ome.flush()?;
        drop(ome);
        let (mut file, nifti) = nifti.finish();
        file.flush()?;
        Ok(([hash(&ome_path)?, nifti], report))
    };
    let (digests, report) = write().map_err(|source: io::Error| {
        if cancel.is_cancelled() {
            GenerateError::Cancelled
        } else {
            GenerateError::Io { name: labels::FILES[0].into(), source }
        }
    })?;
    let files = labels::FILES.into_iter().zip(labels::MEDIA_TYPES).zip(digests);
    Ok((files.map(|((name, media_type), digest)| output(name, media_type, digest)).collect(), report))
}

/// Hashes a complete file, because a TIFF is not written from its beginning to its end.
fn hash(path: &Path) -> io::Result<FileDigest> {
    let mut hashing = HashingWriter::new(io::sink());
    let mut file = io::BufReader::with_capacity(1 << 18, File::open(path)?);
    io::copy(&mut file, &mut hashing)?;
    Ok(hashing.finish().1)
}

/// Writes files in parallel: name, media type and writer of each.
#[inline(never)] // counted by scripts/counts
fn write_all(
    request: &Request,
    tasks: Vec<(String, &str, Task<'_>)>,
    cancel: &CancelToken,
) -> Result<Vec<FileOutput>, GenerateError> {
    tasks
        .into_par_iter()
        .map(|(name, media_type, task)| {
            let digest = write_one(&request.dir.join(&name), task, cancel).map_err(failed(&name))?;
            Ok(output(&name, media_type, digest))
        })
        .collect()
}

/// Error of writing the file `name`. Writers report a surface that their format cannot contain as
/// [`io::ErrorKind::InvalidInput`].
pub(super) fn failed(name: &str) -> impl Fn(io::Error) -> GenerateError {
    move |source| match source.kind() {
        io::ErrorKind::InvalidInput => GenerateError::Format { name: name.into(), detail: source.to_string() },
        _ => GenerateError::Io { name: name.into(), source },
    }
}

type Task<'a> = Box<dyn FnOnce(&mut Cancellable<'_>) -> io::Result<()> + Send + 'a>;

fn write_one(path: &Path, task: Task<'_>, cancel: &CancelToken) -> io::Result<FileDigest> {
    let mut out = Cancellable { out: hashed(path)?, cancel };
    task(&mut out)?;
    let (mut file, digest) = out.out.finish();
    file.flush()?;
    Ok(digest)
}

/// A new file with a buffer.
pub(super) fn buffered(path: &Path) -> io::Result<BufWriter<File>> {
    Ok(BufWriter::with_capacity(1 << 18, File::create(path)?))
}

/// A new file that is hashed while it is written.
pub(super) fn hashed(path: &Path) -> io::Result<HashedFile> {
    Ok(HashingWriter::new(buffered(path)?))
}

pub(super) fn output(name: &str, media_type: &str, digest: FileDigest) -> FileOutput {
    FileOutput { name: name.into(), media_type: media_type.into(), bytes: digest.bytes, sha256: digest.sha256 }
}

/// A file whose writer fails after a cancellation.
struct Cancellable<'a> {
    out: HashedFile,
    cancel: &'a CancelToken,
}

impl Write for Cancellable<'_> {
    fn write(&mut self, data: &[u8]) -> io::Result<usize> {
        if self.cancel.is_cancelled() {
            return Err(io::Error::other("the generation was cancelled"));
        }
        self.out.write(data)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }
}
