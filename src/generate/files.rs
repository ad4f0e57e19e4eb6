//! Writes the files of a model into a folder, each hashed while it is written.

use super::types::{FileOutput, GenerateError, Output, Request};
use crate::ENGINE_VERSION;
use crate::export::glb::{GlbOptions, write_glb};
use crate::export::hashing::HashingWriter;
use crate::export::obj::write_obj;
use crate::export::sections_bin::write_sections;
use crate::export::{Metadata, glb, obj, sections_bin};
use crate::model::{Mesh, Section};
use rayon::prelude::*;
use serde_json::{Value, json};
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
    summary: &Value,
    certificate: &Value,
) -> Result<Vec<FileOutput>, GenerateError> {
    let meta = Metadata {
        preset: request.preset.clone(),
        seed: request.seed,
        digest: request.spec.digest(request.seed),
        engine: ENGINE_VERSION.into(),
        length_mm: request.spec.length_mm,
        sections: sections.len(),
    };
    let report = json!({
        "digest": meta.digest,
        "preset": meta.preset,
        "seed": meta.seed,
        "engine": meta.engine,
        "spec": request.spec.to_json(),
        "summary": summary,
        "certificate": certificate,
    });
    let options = GlbOptions { strips: request.spec.mesh.strips };
    let model = |output: Output| -> (String, &'static str, Task<'_>) {
        let name = format!("model.{}", output.extension());
        match output {
            Output::Glb => (name, glb::MEDIA_TYPE, Box::new(|out| write_glb(mesh, &meta, &options, out))),
            Output::Obj => (name, obj::MEDIA_TYPE, Box::new(|out| write_obj(mesh, &meta, out))),
        }
    };
    let mut outputs = request.outputs.clone();
    outputs.sort_unstable();
    outputs.dedup();
    let mut tasks: Vec<(String, &str, Task<'_>)> = outputs.into_iter().map(model).collect();
    tasks.push(("sections.bin".into(), sections_bin::MEDIA_TYPE, Box::new(|out| write_sections(sections, &meta, out))));
    tasks.push((REPORT.into(), "application/json", Box::new(|out| Ok(serde_json::to_writer_pretty(out, &report)?))));
    tasks
        .into_par_iter()
        .map(|(name, media_type, task)| {
            let path = request.dir.join(&name);
            let digest = write_one(&path, task).map_err(|source| GenerateError::Io { name: name.clone(), source })?;
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
