//! `oviduct check`: certifies the surfaces in files from any source.

use crate::cli::args::CheckArgs;
use crate::cli::exit::{Ended, Failure};
use crate::cli::interrupt::Signals;
use crate::cli::term;
use crate::export::read::{ReadError, Surface, read_surface};
use crate::measure::{BothCertificate, Certificate, CheckOptions, check_regions, check_surface};
use crate::model::{BodyKind, Patch, PatchKind};
use serde_json::{Value, json};
use std::path::Path;

pub(in crate::cli) async fn run(args: CheckArgs) -> Ended {
    let (files, json) = (args.files.clone(), args.json);
    let certify = move || args.files.iter().map(|file| Verdict::of(file, args.euler)).collect::<Vec<_>>();
    let verdicts = Signals::listen().run("the check", certify).await?;
    if json {
        let all: Vec<Value> = files.iter().zip(&verdicts).map(|(file, found)| as_json(file, found)).collect();
        term::print_json(&all)?;
    } else {
        for (file, found) in files.iter().zip(&verdicts) {
            for line in as_text(file, found) {
                term::print(&line)?;
            }
        }
    }
    let all_good = verdicts.iter().all(|found| found.as_ref().is_ok_and(Verdict::passed));
    if all_good { Ok(()) } else { Err(Failure::Negative) }
}

/// Result for a file.
enum Verdict {
    Surface(Box<Certificate>),
    /// Certificate of a file that contains tissue and lumen with one common wall.
    Both(Box<BothCertificate>),
}

impl Verdict {
    fn of(file: &Path, euler: Option<i64>) -> anyhow::Result<Self> {
        let surface = read_surface(file)?;
        let unit_metres = surface.unit.metres();
        if let Some(patches) = both_bodies(&surface) {
            let found = check_regions(&surface.positions, &surface.triangles, &patches, unit_metres);
            return Ok(Self::Both(Box::new(found)));
        }
        let options = CheckOptions { euler, unit_metres };
        Ok(Self::Surface(Box::new(check_surface(&surface.positions, &surface.triangles, &options))))
    }

    fn passed(&self) -> bool {
        match self {
            Self::Surface(certificate) => certificate.passed,
            Self::Both(both) => both.passed(),
        }
    }
}

/// Returns the patches if the surface has exactly those of both bodies.
fn both_bodies(surface: &Surface) -> Option<Vec<Patch>> {
    let patches: Vec<Patch> = (surface.groups.iter())
        .map(|group| Some(Patch { kind: PatchKind::named(&group.name)?, triangles: group.triangles.clone() }))
        .collect::<Option<_>>()?;
    let covered: usize = patches.iter().map(|patch| patch.triangles.len()).sum();
    let of_both = BodyKind::Regions.patches();
    let complete = of_both.iter().all(|kind| patches.iter().any(|patch| patch.kind == *kind))
        && patches.iter().all(|patch| of_both.contains(&patch.kind))
        && covered == surface.triangles.len();
    complete.then_some(patches)
}

fn as_json(file: &Path, found: &anyhow::Result<Verdict>) -> Value {
    match found {
        Ok(Verdict::Surface(certificate)) => json!({ "file": file, "certificate": certificate, "error": null }),
        Ok(Verdict::Both(both)) => json!({ "file": file, "certificate": null, "bodies": both, "error": null }),
        Err(error) => json!({ "file": file, "certificate": null, "error": format!("{error:#}") }),
    }
}

fn as_text(file: &Path, found: &anyhow::Result<Verdict>) -> Vec<String> {
    let shown = file.display();
    match found {
        Ok(Verdict::Surface(certificate)) => of_surface(&shown.to_string(), certificate),
        Ok(Verdict::Both(both)) => {
            let mut lines = of_surface(&format!("{shown}, tissue"), &both.tissue);
            lines.extend(of_surface(&format!("{shown}, lumen"), &both.lumen));
            let regions = &both.regions;
            let (v, t, shared) = (regions.vertices, regions.triangles, regions.shared_triangles);
            let word = verdict(regions.passed);
            lines.push(format!("{shown}, both: {word}: {v} vertices, {t} triangles, {shared} of both bodies"));
            lines.extend(regions.failures.iter().map(|failure| format!("  {failure}")));
            lines
        }
        Err(error) => {
            let why = match error.downcast_ref() {
                Some(ReadError::Io { path, source }) if path == file => source.to_string(),
                _ => format!("{error:#}"),
            };
            vec![format!("{shown}: cannot be read: {why}")]
        }
    }
}

fn of_surface(name: &str, certificate: &Certificate) -> Vec<String> {
    let word = verdict(certificate.passed);
    let (v, t, c) = (certificate.vertices, certificate.triangles, certificate.components);
    let noun = if c == 1 { "component" } else { "components" };
    let euler: Vec<String> = certificate.bodies.iter().map(|body| body.euler.to_string()).collect();
    let mut lines =
        vec![format!("{name}: {word}: {v} vertices, {t} triangles, {c} {noun}, Euler number {}", euler.join(", "))];
    lines.extend(certificate.failures.iter().map(|failure| format!("  {failure}")));
    lines
}

fn verdict(passed: bool) -> &'static str {
    if passed { "passed" } else { "FAILED" }
}
