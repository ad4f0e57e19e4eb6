//! `oviduct check`: certifies the surfaces in files from any source.

use super::surface;
use crate::cli::args::{CheckArgs, UnitArgs};
use crate::cli::exit::{Ended, Failure};
use crate::cli::interrupt::Signals;
use crate::cli::{term, units};
use crate::export::read::{ReadError, Surface, Unit};
use crate::measure::{BothCertificate, Certificate, CheckOptions, check_regions, check_surface};
use crate::model::{BodyKind, Patch, PatchKind};
use serde_json::{Value, json};
use std::path::Path;

pub(in crate::cli) async fn run(args: CheckArgs) -> Ended {
    let (files, json) = (args.files.clone(), args.json);
    let certify = move || args.files.iter().map(|file| Checked::of(file, args.unit, args.euler)).collect::<Vec<_>>();
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
    let all_good = verdicts.iter().all(|found| found.as_ref().is_ok_and(|found| found.verdict.passed()));
    if all_good { Ok(()) } else { Err(Failure::Negative) }
}

/// Result for a file.
struct Checked {
    verdict: Verdict,
    /// Unit in which the file was judged.
    unit: Unit,
    notes: Vec<String>,
}

impl Checked {
    fn of(file: &Path, unit: UnitArgs, euler: Option<i64>) -> anyhow::Result<Self> {
        let surface = surface::read(file, unit)?;
        let verdict = Verdict::of(&surface, euler);
        Ok(Self { verdict, unit: surface.unit, notes: surface.notes })
    }
}

/// Certificates of a surface.
enum Verdict {
    Surface(Box<Certificate>),
    /// Certificate of a file that contains tissue and lumen with one common wall.
    Both(Box<BothCertificate>),
}

impl Verdict {
    fn of(surface: &Surface, euler: Option<i64>) -> Self {
        let unit_metres = surface.unit.metres();
        if let Some(patches) = both_bodies(surface) {
            let found = check_regions(&surface.positions, &surface.triangles, &patches, unit_metres);
            return Self::Both(Box::new(found));
        }
        let options = CheckOptions { euler, unit_metres };
        Self::Surface(Box::new(check_surface(&surface.positions, &surface.triangles, &options)))
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

fn as_json(file: &Path, found: &anyhow::Result<Checked>) -> Value {
    let Checked { verdict, unit, notes } = match found {
        Ok(checked) => checked,
        Err(error) => return json!({ "file": file, "certificate": null, "error": format!("{error:#}") }),
    };
    let mut told = json!({
        "file": file, "certificate": null, "error": null,
        "unit_m": unit.metres(), "unit_assumed": *unit == Unit::Assumed, "notes": notes,
    });
    match verdict {
        Verdict::Surface(certificate) => told["certificate"] = json!(certificate),
        Verdict::Both(both) => told["bodies"] = json!(both),
    }
    told
}

fn as_text(file: &Path, found: &anyhow::Result<Checked>) -> Vec<String> {
    let shown = file.display();
    match found {
        Ok(Checked { verdict, notes, .. }) => {
            let mut lines = of_verdict(&shown.to_string(), verdict);
            lines.extend(notes.iter().map(|note| format!("  note: {note}")));
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

fn of_verdict(shown: &str, found: &Verdict) -> Vec<String> {
    let both = match found {
        Verdict::Surface(certificate) => return of_surface(shown, certificate),
        Verdict::Both(both) => both,
    };
    let mut lines = of_surface(&format!("{shown}, tissue"), &both.tissue);
    lines.extend(of_surface(&format!("{shown}, lumen"), &both.lumen));
    let regions = &both.regions;
    let (v, t, shared) = (regions.vertices, regions.triangles, regions.shared_triangles);
    let word = verdict(regions.passed);
    lines.push(format!("{shown}, both: {word}: {v} vertices, {t} triangles, {shared} of both bodies"));
    lines.extend(regions.failures.iter().map(|failure| format!("  {failure}")));
    lines
}

fn of_surface(name: &str, certificate: &Certificate) -> Vec<String> {
    let word = verdict(certificate.passed);
    let (v, t, c) = (certificate.vertices, certificate.triangles, certificate.components);
    let noun = if c == 1 { "component" } else { "components" };
    let euler: Vec<String> = certificate.bodies.iter().map(|body| body.euler.to_string()).collect();
    // An open surface encloses nothing.
    let volume = if certificate.closed {
        format!(", volume {}", units::show_volume(certificate.volume_mm3))
    } else {
        String::new()
    };
    let euler = euler.join(", ");
    let mut lines =
        vec![format!("{name}: {word}: {v} vertices, {t} triangles, {c} {noun}, Euler number {euler}{volume}")];
    lines.extend(certificate.failures.iter().map(|failure| format!("  {failure}")));
    lines
}

fn verdict(passed: bool) -> &'static str {
    if passed { "passed" } else { "FAILED" }
}
