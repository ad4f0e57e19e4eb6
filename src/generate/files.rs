//! Writes the files of a model into a folder, each hashed while it is written.

use super::labels;
use super::types::{CancelToken, FileOutput, Findings, GenerateError, Output, Request};
use crate::ENGINE_VERSION;
use crate::export::glb::{GlbOptions, write_glb};
use crate::export::hashing::HashingWriter;
use crate::export::lod::levels;
use crate::export::obj::write_obj;
use crate::export::sections_bin::write_sections;
use crate::export::{Metadata, glb, lod, obj, sections_bin};
use crate::model::{Mesh, Section};
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
    mesh: &Mesh,
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
    let options = GlbOptions { strips: request.spec.mesh.strips };
    let wants = |output| request.outputs.contains(&output);
    let mut tasks: Vec<(&str, &str, Task<'_>)> = Vec::new();
    if wants(Output::Glb) {
        tasks.push(("model.glb", glb::MEDIA_TYPE, Box::new(|out| write_glb(mesh, &meta, &options, out))));
    }
    if wants(Output::Obj) {
        tasks.push(("model.obj", obj::MEDIA_TYPE, Box::new(|out| write_obj(mesh, &meta, out))));
    }
    tasks.push(("sections.bin", sections_bin::MEDIA_TYPE, Box::new(|out| write_sections(sections, &meta, out))));
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
    let mut tasks: Vec<(&str, &str, Task<'_>)> = Vec::new();
    for level in levels.iter().flatten() {
        tasks.push((level.report.file, glb::MEDIA_TYPE, Box::new(|out| level.write(&meta, out))));
    }
    tasks.push((REPORT, "application/json", Box::new(|out| Ok(serde_json::to_writer_pretty(out, &report)?))));
    let mut files = files?;
    files.extend(labels.into_iter().flat_map(|(files, _)| files));
    files.extend(write_all(request, tasks)?);
    Ok(files)
}

/// Writes files in parallel: name, media type and writer of each.
fn write_all(request: &Request, tasks: Vec<(&str, &str, Task<'_>)>) -> Result<Vec<FileOutput>, GenerateError> {
    tasks
        .into_par_iter()
        .map(|(name, media_type, task)| {
            let digest = write_one(&request.dir.join(name), task)
                .map_err(|source| GenerateError::Io { name: name.into(), source })?;
            let (name, media_type) = (name.into(), media_type.into());
            Ok(FileOutput { name, media_type, bytes: digest.bytes, sha256: digest.sha256 })
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
