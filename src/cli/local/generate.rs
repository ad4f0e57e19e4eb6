//! `oviduct generate`: grows one model in this process. Its files appear together once it is
//! certified.

use super::folder::Folder;
use super::{folder, report};
use crate::cli::args::{GenerateArgs, GpuArgs};
use crate::cli::exit::{Ended, Failure};
use crate::cli::interrupt::Signals;
use crate::cli::scratch::Scratch;
use crate::cli::{gpu, model, term, units};
use crate::generate::{
    CancelToken, FileOutput, GenerateError, MANIFEST, Manifest, Origin, Outcome, Progress, Request, Sink,
};
use crate::model::Section;
use anyhow::Context;
use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use std::path::{Path, PathBuf};

pub(in crate::cli) async fn run(args: GenerateArgs) -> Ended {
    let (preset, spec) = model::resolve(&args.model.of)?;
    // Before the scratch directory is created, which a signal would leave behind.
    let mut signals = Signals::listen();
    let seed = model::seed(&args.model.of);
    let folder = Folder::open(&args.out, &spec.digest(seed), args.force)?;
    let scratch = Scratch::new(&args.out).with_context(|| format!("--out {}", args.out.display()))?;
    let request = Request {
        preset: preset.name.clone(),
        seed,
        spec,
        backend: args.model.backend,
        outputs: args.model.outputs(),
        dir: scratch.dir().to_owned(),
        memory_limit_bytes: args.memory_limit,
    };
    let (mut outcome, fallback, request) = grow(request, args.gpu.clone(), &mut signals).await?;
    let manifest = manifest(&request, &outcome, scratch.dir()).context(MANIFEST)?;
    outcome.files.push(manifest);
    let publish = |name: &str| scratch.publish(name).with_context(|| name.to_owned());
    let page = if args.report {
        let dir = scratch.dir().to_owned();
        let html = tokio::task::spawn_blocking(move || report::page(&dir)).await.context("drawing panicked")??;
        std::fs::write(scratch.dir().join(folder::PAGE), &html).context(folder::PAGE)?;
        Some(html.len())
    } else {
        None
    };
    let mut new: Vec<&str> = outcome.files.iter().map(|file| file.name.as_str()).collect();
    new.extend(page.map(|_| folder::PAGE));
    folder.clear(&new)?;
    let paths: Vec<PathBuf> = outcome.files.iter().map(|f| publish(&f.name)).collect::<anyhow::Result<_>>()?;
    let page = page.map(|bytes| publish(folder::PAGE).map(|path| (path, bytes as u64))).transpose()?;
    warn(&outcome);
    if args.json {
        let mut told = document(&request, &outcome, fallback.as_deref());
        if page.is_some() {
            told["page"] = folder::PAGE.into();
        }
        term::print_json(&told)?;
        return Ok(());
    }
    for line in summary(&request, &outcome) {
        term::print(&line)?;
    }
    if let Some(reason) = fallback {
        term::print(&format!("grown on the CPU: {reason}"))?;
    }
    for (path, file) in paths.iter().zip(&outcome.files) {
        term::print(&format!("{}  {}", path.display(), units::show_bytes(file.bytes)))?;
    }
    if let Some((path, bytes)) = page {
        term::print(&format!("{}  {}", path.display(), units::show_bytes(bytes)))?;
    }
    Ok(())
}

/// Writes the manifest of the files of a model.
fn manifest(request: &Request, outcome: &Outcome, dir: &Path) -> anyhow::Result<FileOutput> {
    let digest = request.spec.digest(request.seed);
    let origin = Origin {
        engine: crate::ENGINE_VERSION,
        preset: &request.preset,
        seed: request.seed,
        digest: &digest,
        spec: request.spec.to_json(),
    };
    let text = serde_json::to_vec_pretty(&Manifest::new(origin, &request.outputs, &outcome.files))?;
    std::fs::write(dir.join(MANIFEST), &text)?;
    Ok(FileOutput {
        name: MANIFEST.to_owned(),
        media_type: "application/json".to_owned(),
        bytes: text.len() as u64,
        sha256: hex::encode(Sha256::digest(&text)),
    })
}

/// Grows a model on another thread and shows its progress. A signal stops it. Also returns the
/// reason if an `auto` request ran on the CPU.
pub async fn grow(
    request: Request,
    gpu: GpuArgs,
    signals: &mut Signals,
) -> Result<(Outcome, Option<String>, Request), Failure> {
    let cancel = CancelToken::default();
    let bar = term::Bar::on_stderr();
    let task = tokio::task::spawn_blocking({
        let (cancel, sink) = (cancel.clone(), Shown(bar.clone()));
        move || (gpu::grow(&request, &gpu, &sink, &cancel), request)
    });
    match signals.stoppable(task, &cancel, &bar).await?.context("the generation panicked")? {
        (Ok((outcome, fallback)), request) => Ok((outcome, fallback, request)),
        (Err(GenerateError::Cancelled), _) => Err(Failure::Interrupted),
        (Err(error), _) => Err(error.into()),
    }
}

/// Shows progress on stderr.
struct Shown(term::Bar);

impl Sink for Shown {
    fn progress(&self, progress: &Progress) {
        let stage = serde_json::to_value(progress.stage).ok().and_then(|v| v.as_str().map(str::to_owned));
        let message = format!("step {} of {}, {} particles", progress.step, progress.steps, progress.particles);
        self.0.show(&stage.unwrap_or_default(), progress.fraction, message);
    }

    fn section(&self, _: &Section) {}
}

/// Prints the warnings about poor growth to stderr.
pub fn warn(outcome: &Outcome) {
    for warning in &outcome.findings.summary.warnings {
        term::note(&format!("warning: {}", warning.detail));
    }
}

/// Returns the output with `--json`.
fn document(request: &Request, outcome: &Outcome, fallback: Option<&str>) -> Value {
    let summary = &outcome.findings.summary;
    let file =
        |file: &crate::generate::FileOutput| json!({ "name": file.name, "bytes": file.bytes, "sha256": file.sha256 });
    json!({
        "digest": request.spec.digest(request.seed),
        "preset": request.preset,
        "seed": request.seed,
        "engine": crate::ENGINE_VERSION,
        "backend": {
            "requested": request.backend, "used": outcome.used, "device": outcome.device, "fallback": fallback,
        },
        "sections": summary.sections,
        "sections_added": summary.sections_added,
        "particles": summary.particles,
        "vertices": summary.vertices,
        "triangles": summary.triangles,
        "seconds": outcome.seconds,
        "peak_rss_bytes": term::peak_rss_bytes(),
        "files": outcome.files.iter().map(file).collect::<Vec<_>>(),
        "warnings": summary.warnings,
        "certificate": outcome.findings.certificate,
        "summary": summary,
    })
}

/// Returns the output without `--json`.
fn summary(request: &Request, outcome: &Outcome) -> [String; 3] {
    let (of, proof, seconds) = (&outcome.findings.summary, &outcome.findings.certificate, &outcome.seconds);
    let gap = proof.min_gap_um.map(|gap| format!("; minimum gap {gap:.2} µm")).unwrap_or_default();
    [
        format!(
            "{}, seed {}: {} sections ({} added), {} to {} particles, {} vertices, {} triangles",
            request.preset,
            request.seed,
            of.sections,
            of.sections_added,
            of.particles.start,
            of.particles.end,
            of.vertices,
            of.triangles,
        ),
        format!("certified: closed, manifold, oriented, Euler number {}, no triangles intersect{gap}", proof.euler),
        format!(
            "{:.1} s: simulate {:.1}, mesh {:.1}, certify {:.1}, export {:.1}",
            seconds.total, seconds.simulate, seconds.mesh, seconds.certify, seconds.export,
        ),
    ]
}
