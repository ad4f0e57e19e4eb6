//! Writes the files of a model into a folder, each hashed while it is written.

use super::labels;
use super::outputs::{Output, stem};
use super::surfaces::Surfaces;
use super::types::{CancelToken, FileOutput, Findings, GenerateError, Request};
use crate::ENGINE_VERSION;
use crate::export::centreline::{self, Centreline};
use crate::export::glb::{GlbOptions, write_glb, write_gltf, write_gltf_data};
use crate::export::hashing::HashingWriter;
use crate::export::lod::levels;
use crate::export::obj::write_obj;
use crate::export::ply::write_ply;
use crate::export::sections_bin::write_sections;
use crate::export::stl::{write_ascii_stl, write_stl};
use crate::export::vtp::write_vtp;
use crate::export::{Metadata, Shape, glb, lod, sections_bin};
use crate::model::{LengthUnit, Section};
use rayon::prelude::*;
use serde_json::json;
use std::fs::File;
use std::io::{self, BufWriter, Write};

/// Name of the report.
pub(super) const REPORT: &str = "report.json";

type Buffered = HashingWriter<BufWriter<File>>;

/// Writes `report.json`, `sections.bin` and the requested outputs. The report contains neither times nor
/// the backend, so its bytes do not depend on where the model is grown.
pub(super) fn write(
    request: &Request,
    surfaces: &Surfaces<'_>,
    sections: &[Section],
    findings: &Findings,
    cancel: &CancelToken,
) -> Result<Vec<FileOutput>, GenerateError> {
    let meta = Metadata {
        preset: request.preset.clone(),
        seed: request.seed,
        digest: request.spec.digest(request.seed),
        engine: ENGINE_VERSION.into(),
        length_mm: request.spec.length_mm,
        sections: sections.len(),
    };
    let mesh = surfaces.tissue;
    let options = GlbOptions { strips: request.spec.mesh.strips };
    let wants = |output| request.outputs.has(output);
    let placed = surfaces.placed();
    let mut tasks: Vec<(String, &str, Task<'_>)> = Vec::new();
    for &output in &request.outputs.formats {
        for of in placed.iter().filter(|of| output.unit(request.outputs.units) == Some(of.unit)) {
            tasks.extend(surface_tasks(output, &of.shape(&meta), options, stem(of.mesh.body)));
        }
    }
    if let Some(unit) = Output::Centreline.unit(request.outputs.units).filter(|_| wants(Output::Centreline)) {
        tasks.extend(centreline_tasks(sections, unit, &meta));
    }
    let name = "sections.bin".to_owned();
    tasks.push((name, sections_bin::MEDIA_TYPE, Box::new(|out| write_sections(sections, &meta, out))));
    let (files, levels) = rayon::join(
        || write_all(request, tasks),
        || if wants(Output::Lod) { levels(mesh, &|| cancel.is_cancelled()).map(Some) } else { Ok(None) },
    );
    if cancel.is_cancelled() {
        return Err(GenerateError::Cancelled);
    }
    let labels = wants(Output::Labels).then(|| labels::write(request, mesh, &meta, cancel)).transpose()?;
    let levels = levels.map_err(|source| GenerateError::Io { name: lod::FILES[0].into(), source })?;
    let mut report = json!({
        "digest": meta.digest,
        "preset": meta.preset,
        "seed": meta.seed,
        "engine": meta.engine,
        "spec": request.spec.to_json(),
        "summary": findings.summary,
        "certificate": findings.certificate,
        "morphometry": findings.morphometry,
        "comparison": findings.comparison,
    });
    if let Some(levels) = &levels {
        report["levels"] = levels.iter().map(|level| json!(level.report)).collect();
    }
    if let Some((_, volume)) = &labels {
        report["labels"] = json!(volume);
    }
    if !findings.surfaces.is_empty() {
        report["surfaces"] = json!(findings.surfaces);
    }
    let mut tasks: Vec<(String, &str, Task<'_>)> = Vec::new();
    for level in levels.iter().flatten() {
        tasks.push((level.report.file.to_owned(), glb::MEDIA_TYPE, Box::new(|out| level.write(&meta, out))));
    }
    tasks.push((
        REPORT.to_owned(),
        "application/json",
        Box::new(|out| Ok(serde_json::to_writer_pretty(out, &report)?)),
    ));
    let mut files = files?;
    files.extend(labels.into_iter().flat_map(|(files, _)| files));
    files.extend(write_all(request, tasks)?);
    Ok(files)
}

/// The files of a format of a body.
fn surface_tasks<'a>(
    output: Output,
    shape: &Shape<'a>,
    options: GlbOptions,
    stem: &'static str,
) -> impl Iterator<Item = (String, &'static str, Task<'a>)> {
    output.endings().iter().map(move |&(ending, media_type)| {
        let shape = shape.clone();
        let task: Task<'a> = Box::new(move |out| write_surface(output, ending, &shape, options, stem, out));
        (format!("{stem}.{ending}"), media_type, task)
    })
}

/// Writes the file of a format with this ending, and of this stem, which glTF needs to name its data.
///
/// # Errors
/// Those of `out`, and what the format cannot hold.
pub fn write_surface(
    output: Output,
    ending: &str,
    shape: &Shape<'_>,
    options: GlbOptions,
    stem: &str,
    out: &mut impl Write,
) -> io::Result<()> {
    match (output, ending) {
        (Output::Glb, _) => write_glb(shape, &options, out),
        (Output::Gltf, "bin") => write_gltf_data(shape, &options, out),
        (Output::Gltf, _) => write_gltf(shape, &options, &format!("{stem}.bin"), out),
        (Output::Obj, _) => write_obj(shape, out),
        (Output::Stl, _) => write_stl(shape, out),
        (Output::StlAscii, _) => write_ascii_stl(shape, out),
        (Output::Ply, _) => write_ply(shape, out),
        (Output::Vtp, _) => write_vtp(shape, out),
        (Output::Centreline | Output::Lod | Output::Labels, _) => Ok(()),
    }
}

/// The files of the centre line.
fn centreline_tasks<'a>(
    sections: &'a [Section],
    unit: LengthUnit,
    meta: &'a Metadata,
) -> Vec<(String, &'static str, Task<'a>)> {
    let [vtp, csv] = centreline::FILES.map(str::to_owned);
    let [vtp_type, csv_type] = centreline::MEDIA_TYPES;
    vec![
        (vtp, vtp_type, Box::new(move |out| Centreline::of(sections).write_vtp(unit, meta, out))),
        (csv, csv_type, Box::new(move |out| Centreline::of(sections).write_csv(unit, out))),
    ]
}

/// Writes files in parallel: name, media type and writer of each.
fn write_all(request: &Request, tasks: Vec<(String, &str, Task<'_>)>) -> Result<Vec<FileOutput>, GenerateError> {
    tasks
        .into_par_iter()
        .map(|(name, media_type, task)| {
            let digest = write_one(&request.dir.join(&name), task)
                .map_err(|source| GenerateError::Io { name: name.clone(), source })?;
            Ok(FileOutput { name, media_type: media_type.into(), bytes: digest.bytes, sha256: digest.sha256 })
        })
        .collect()
}

type Task<'a> = Box<dyn FnOnce(&mut Buffered) -> io::Result<()> + Send + 'a>;

fn write_one(path: &std::path::Path, task: Task<'_>) -> io::Result<crate::export::hashing::FileDigest> {
    let file = BufWriter::with_capacity(1 << 18, File::create(path)?);
    let mut out = HashingWriter::new(file);
    task(&mut out)?;
    let (mut file, digest) = out.finish();
    file.flush()?;
    Ok(digest)
}
