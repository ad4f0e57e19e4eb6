//! `oviduct cut`: cuts a surface with a plane.

use super::section::spec;
use super::target::Target;
use super::{folder, solid, surface};
use crate::cli::args::CutArgs;
use crate::cli::exit::{Ended, Failure};
use crate::cli::interrupt::Signals;
use crate::cli::{scratch, term};
use crate::export::convert::Converted;
use crate::export::cut::CutDocument;
use crate::export::svg::cut_svg;
use crate::geometry::cut::Body;
use crate::model::{Cut, Plane, RingKind};
use crate::render::Slide;
use crate::report;
use crate::spec::{Across, ModelSpec, presets};
use anyhow::{Context, anyhow};
use std::path::Path;

pub(in crate::cli) async fn run(args: CutArgs) -> Ended {
    let plane = plane(&args)?;
    let kind = args.out.as_deref().map(kind).transpose()?;
    if args.labels && kind != Some(Kind::Png) {
        return Err(Failure::usage("--labels: is for pictures only (--out PATH.png)"));
    }
    if !presets().iter().any(|preset| preset.name == args.preset) {
        return Err(Failure::usage(format!("--preset: there is no preset {}", args.preset)));
    }
    if let Some(path) = &args.solid {
        let target = Target::of(path, None, false)?;
        target.spare(&args.file)?;
        let of = args.clone();
        let lines = Signals::listen().run("cutting", move || solid::make(&of, &plane, &target)).await??;
        lines.iter().try_for_each(|line| term::print(line))?;
        if args.out.is_none() {
            return Ok(());
        }
    }
    let out = args.out.clone();
    let (summary, file) = Signals::listen().run("cutting", move || make(&args, &plane, kind)).await??;
    term::print(&summary)?;
    if let (Some(path), Some(bytes)) = (out, file) {
        let path = scratch::write(&path, bytes)?;
        term::print(&path.display().to_string())?;
    }
    Ok(())
}

/// Result of a cut.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    Json,
    Svg,
    Png,
}

fn kind(path: &Path) -> Result<Kind, Failure> {
    let ending = path.extension().and_then(|ending| ending.to_str()).unwrap_or_default().to_ascii_lowercase();
    match ending.as_str() {
        "json" => Ok(Kind::Json),
        "svg" => Ok(Kind::Svg),
        "png" => Ok(Kind::Png),
        _ => Err(Failure::usage(format!("--out {}: must end in .json, .svg or .png", path.display()))),
    }
}

fn plane(args: &CutArgs) -> Result<Plane, Failure> {
    match (args.across_um(), args.point_um(), args.normal) {
        (Some(z), ..) if z.is_finite() => across(args, z),
        (Some(_), ..) => Err(Failure::usage("--z-um: must be a number of micrometres")),
        (None, Some(origin), Some(normal)) => Plane::through(origin, normal)
            .ok_or_else(|| Failure::usage("--normal: must not be zero, and all numbers must be finite")),
        _ => Err(Failure::usage("give --z, or --origin and --normal")),
    }
}

/// Returns the plane across the tube at a position along it; the tube may be bent.
fn across(args: &CutArgs, z_um: f64) -> Result<Plane, Failure> {
    let beside = args.file.with_file_name("report.json");
    let path = match &args.report {
        Some(path) => path,
        None if beside.is_file() => &beside,
        None => return Ok(Plane::across(z_um)),
    };
    let shown = path.display();
    folder::verify(path)?;
    let stored = std::fs::read(path).with_context(|| format!("--report {shown}"))?;
    let spec = ModelSpec::from_stored(&report::spec(&stored));
    let Some(across) = spec.map(|spec| Across::of(&spec)) else {
        return Err(Failure::usage(format!("--report {shown}: is not the report of a model")));
    };
    across.at(z_um).ok_or_else(|| {
        let [first, last] = across.ends_um();
        Failure::usage(format!(
            "--z: the plane is at {z_um:.1} µm; along its centre line the model reaches from {first:.1} to {last:.1} µm"
        ))
    })
}

/// Prints a line of figures and the name of the file.
fn make(args: &CutArgs, plane: &Plane, kind: Option<Kind>) -> Result<(String, Option<Vec<u8>>), Failure> {
    let shown = args.file.display();
    folder::verify(&args.file)?;
    let surface = surface::read_aloud(&args.file, args.unit).with_context(|| shown.to_string())?;
    let body = Converted::in_its_unit(&surface).into_body();
    drop(surface);
    let cut = body.cut(plane);
    if cut.rings.is_empty() {
        let [low, high] = body.extent_um(plane);
        let at = plane.height_um();
        let text = format!(
            "{shown}: the plane at {at:.1} µm does not meet the surface, which reaches from {low:.1} to {high:.1} µm along its normal"
        );
        return Err(anyhow!(text).into());
    }
    let summary = summary(&cut);
    let file = match kind {
        None => None,
        Some(Kind::Svg) => Some(cut_svg(&cut).into_bytes()),
        Some(Kind::Json) => Some(serde_json::to_vec(&CutDocument::from(cut)).context("the cut cannot be written")?),
        Some(Kind::Png) => Some(picture(args, &body, plane, &cut)?),
    };
    Ok((summary, file))
}

fn summary(cut: &Cut) -> String {
    let areas = |kind| -> String {
        let areas: Vec<String> = cut.of(kind).map(|ring| format!("{:.0}", ring.area_um2)).collect();
        if areas.is_empty() { String::new() } else { format!(" ({} µm²)", areas.join(", ")) }
    };
    format!(
        "tissue {:.4} mm²  lumen {:.4} mm²  islands {}{}  pockets {}{}",
        cut.tissue_um2() / 1e6,
        cut.lumen_um2() / 1e6,
        cut.of(RingKind::Island).count(),
        areas(RingKind::Island),
        cut.of(RingKind::Pocket).count(),
        areas(RingKind::Pocket)
    )
}

fn picture(args: &CutArgs, body: &Body<'_>, plane: &Plane, cut: &Cut) -> Result<Vec<u8>, Failure> {
    let borders = match body.borders(plane) {
        Some(borders) => borders,
        None => cut.borders().with_context(|| {
            format!(
                "{}: has no patches inner_wall and outer_wall, so that the layers of this cut are unknown",
                args.file.display()
            )
        })?,
    };
    let spec = spec(&args.preset, &args.layers)?;
    let z_um = args.across_um().unwrap_or_else(|| spec.middle_um());
    let slide = Slide { borders, layers: spec.layers_at_um(z_um, 0), seed: 0, index: plane.digest() as u32 };
    let drawn = if args.labels { slide.labels(args.size) } else { slide.stained(args.size) };
    Ok(drawn.context("the cut cannot be drawn")?)
}
