//! `oviduct render`: draws the surfaces in files that `oviduct check` reads and in `sections.bin`.

use super::surface;
use crate::cli::args::RenderArgs;
use crate::cli::exit::{Ended, Failure};
use crate::cli::interrupt::Signals;
use crate::cli::scratch::split;
use crate::cli::{scratch, term, units};
use crate::export::read::Surface;
use crate::export::sections_bin::SectionsReader;
use crate::model::{BodyKind, Mesh, Patch, PatchKind};
use crate::preview;
use crate::render::{Finish, Plane, mesh_png};
use crate::report;
use crate::spec::{DEFAULT_PRESET, ModelSpec, preset, presets};
use anyhow::bail;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufReader;
use std::path::{Path, PathBuf};
use std::sync::Arc;

pub(in crate::cli) async fn run(args: RenderArgs) -> Ended {
    let (dir, names) = targets(&args.files, &args.out)?;
    if args.elevation.is_some_and(|degrees| !(-89.0..=89.0).contains(&degrees)) {
        return Err(Failure::usage("--elevation: must be from -89 to 89"));
    }
    if args.azimuth.is_some_and(|degrees| !degrees.is_finite()) {
        return Err(Failure::usage("--azimuth: must be a number of degrees"));
    }
    if let Some(name) = args.preset.as_ref().filter(|name| preset(name).is_none()) {
        return Err(Failure::usage(format!("--preset: there is no preset {name}")));
    }
    let args = Arc::new(args);
    let mut all_drawn = true;
    for (file, name) in args.files.clone().into_iter().zip(names) {
        let args = Arc::clone(&args);
        let shown = file.display().to_string();
        match Signals::listen().run("drawing", move || draw(&file, &args)).await? {
            Ok(png) => {
                let path = scratch::write(&dir.join(name), png)?;
                term::print(&format!("{shown}: {}", path.display()))?;
            }
            Err(error) => {
                all_drawn = false;
                term::print(&format!("{shown}: cannot be drawn: {error:#}"))?;
            }
        }
    }
    if all_drawn { Ok(()) } else { Err(Failure::Negative) }
}

/// Returns the directory of the pictures and the name of each.
fn targets(files: &[PathBuf], out: &Path) -> Result<(PathBuf, Vec<String>), Failure> {
    if out.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("png")) {
        let ([_], Some((dir, name))) = (files, split(out)) else {
            return Err(Failure::usage(format!("--out {}: one picture for several files", out.display())));
        };
        return Ok((dir.to_owned(), vec![name.to_owned()]));
    }
    let mut first: BTreeMap<String, &Path> = BTreeMap::new();
    let mut names = Vec::new();
    for file in files {
        let name = format!("{}.png", file.file_stem().unwrap_or_default().to_string_lossy());
        if let Some(other) = first.insert(name.clone(), file) {
            let (file, other) = (file.display(), other.display());
            return Err(Failure::usage(format!("{other} and {file}: both pictures would be {name}")));
        }
        names.push(name);
    }
    Ok((out.to_owned(), names))
}

fn draw(file: &Path, args: &RenderArgs) -> anyhow::Result<Vec<u8>> {
    let mesh = if file.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("bin")) {
        if args.unit.from_units.is_some() {
            bail!("--from-units: sections are always in um");
        }
        preview::surface(BufReader::new(File::open(file)?), args.view, args.size)?
    } else {
        mesh(surface::read_aloud(file, args.unit)?)
    };
    let mut view = args.view.of(&mesh, args.size);
    view.azimuth_deg = args.azimuth.unwrap_or(view.azimuth_deg);
    view.elevation_deg = args.elevation.unwrap_or(view.elevation_deg);
    if !args.cut.is_empty() {
        args.cut.iter().try_for_each(|plane| meets(plane, &mesh))?;
        view.cut.clone_from(&args.cut);
    }
    let model = (!args.plain).then(|| model(file, args.preset.as_deref())).flatten();
    let finish = model.as_ref().map(|(spec, seed)| Finish { spec, seed: *seed });
    Ok(mesh_png(&mesh, &view, finish.as_ref())?)
}

/// Returns specification and seed of the tissue in a picture: of the given preset, of the report
/// beside the file, of the preset that the file names, or of the default preset.
fn model(file: &Path, given: Option<&str>) -> Option<(ModelSpec, u64)> {
    let of = |name: &str, seed| {
        let preset = preset(name).unwrap_or(&presets()[0]);
        Some((ModelSpec::resolve(preset, &json!({})).ok()?, seed))
    };
    if let Some(name) = given {
        return of(name, 0);
    }
    let beside = std::fs::read(file.with_file_name("report.json")).ok();
    let stored = beside.and_then(|stored| {
        let seed = serde_json::from_slice::<Value>(&stored).ok()?["seed"].as_u64()?;
        Some((ModelSpec::from_stored(&report::spec(&stored))?, seed))
    });
    stored.or_else(|| {
        let header = File::open(file).ok().and_then(|file| SectionsReader::open(BufReader::new(file)).ok());
        match header.as_ref().map(SectionsReader::header) {
            Some(header) => of(&header.preset, header.seed),
            None => of(DEFAULT_PRESET, 0),
        }
    })
}

/// Checks that a plane has parts of a mesh on both sides. A picture of all or nothing would not
/// tell that the plane is in the wrong place or unit.
fn meets(plane: &Plane, mesh: &Mesh) -> anyhow::Result<()> {
    let along = |corner: &u32| -> Option<f64> {
        let point = mesh.positions.get(*corner as usize)?;
        Some(point.iter().zip(plane.normal).map(|(x, n)| f64::from(*x) * n).sum())
    };
    let places = mesh.triangles.as_flattened().iter().filter_map(along);
    let [low, high] = places.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], x| [low.min(x), high.max(x)]);
    if low < plane.offset && plane.offset < high {
        return Ok(());
    }
    let what = if plane.offset >= high { "nothing" } else { "everything" };
    // The direction of `-z=12mm` is that of z for a reader.
    let [x, y, z] = plane.normal;
    let is_reversed = [x, y, z].iter().all(|n| *n <= 0.0);
    let [at, low, high] = if is_reversed { [-plane.offset, -high, -low] } else { [plane.offset, low, high] };
    let direction = match [x, y, z].map(f64::abs) {
        [1.0, 0.0, 0.0] => "x".to_owned(),
        [0.0, 1.0, 0.0] => "y".to_owned(),
        [0.0, 0.0, 1.0] => "z".to_owned(),
        _ => {
            let sign = if is_reversed { -1.0 } else { 1.0 };
            format!("{:.3},{:.3},{:.3}", sign * x, sign * y, sign * z)
        }
    };
    let [at, low, high] = [at, low, high].map(|metres| units::show_length(metres, 6));
    bail!(
        "--cut: the plane {direction}={at} cuts away {what}; the model reaches from {low} to {high} along {direction}"
    )
}

/// Converts a surface to a mesh in metres. Groups that are named like patches become these patches.
pub fn mesh(surface: Surface) -> Mesh {
    let metres = surface.unit.metres();
    Mesh {
        body: BodyKind::Tissue,
        positions: surface.positions.iter().map(|p| p.map(|x| (x * metres) as f32)).collect(),
        triangles: surface.triangles,
        patches: surface
            .groups
            .into_iter()
            .filter_map(|group| Some(Patch { kind: PatchKind::named(&group.name)?, triangles: group.triangles }))
            .collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_are_named_like_the_files_or_as_asked() {
        let paths = |names: &[&str]| names.iter().map(PathBuf::from).collect::<Vec<_>>();
        let found = |files: &[&str], out: &str| targets(&paths(files), Path::new(out));
        assert_eq!(
            found(&["a/x.glb", "y.tar.stl"], "dir").unwrap(),
            ("dir".into(), vec!["x.png".into(), "y.tar.png".into()])
        );
        assert_eq!(found(&["a/x.glb"], "p.png").unwrap(), (".".into(), vec!["p.png".into()]));
        assert_eq!(found(&["a/x.glb"], "d/p.PNG").unwrap(), ("d".into(), vec!["p.PNG".into()]));
        assert!(matches!(found(&["x.glb", "y.glb"], "p.png"), Err(Failure::Usage(_))));
        assert!(matches!(found(&["a/x.glb", "b/x.obj"], "."), Err(Failure::Usage(_))));
    }
}
