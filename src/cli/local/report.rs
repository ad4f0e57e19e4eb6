//! `oviduct report`: writes the report of a model as one HTML page. It reads `report.json`,
//! `sections.bin` and, if the model leans, the surface.

use super::{folder, surface};
use crate::cli::args::{ReportArgs, UnitArgs};
use crate::cli::exit::Ended;
use crate::cli::interrupt::Signals;
use crate::cli::scratch::split;
use crate::cli::{scratch, term};
use crate::export::convert::Converted;
use crate::export::sections_bin::SectionsReader;
use crate::geometry::cut::Body;
use crate::model::Section;
use crate::preview;
use crate::report::{self, Strip};
use anyhow::Context;
use std::fs::File;
use std::io::BufReader;
use std::path::Path;

pub(in crate::cli) async fn run(args: ReportArgs) -> Ended {
    let dir = args.dir.clone();
    let html = Signals::listen().run("drawing", move || page(&dir)).await??;
    let to = args.out.unwrap_or_else(|| args.dir.join(folder::PAGE));
    split(&to).context("--out: not the name of a file")?;
    term::print(&scratch::write(&to, html)?.display().to_string())?;
    Ok(())
}

/// Returns the page for the model in a directory.
pub(in crate::cli) fn page(dir: &Path) -> anyhow::Result<String> {
    let (json, bin) = (dir.join("report.json"), dir.join("sections.bin"));
    [&json, &bin].into_iter().try_for_each(|file| folder::verify(file))?;
    let stored = std::fs::read(&json).with_context(|| json.display().to_string())?;
    let open = || File::open(&bin).map(BufReader::new).with_context(|| bin.display().to_string());
    let mut reader = SectionsReader::open(open()?).with_context(|| bin.display().to_string())?;
    let z: Vec<f64> = reader.entries().iter().map(|entry| entry.z_um).collect();
    let chosen = report::strip(&z);
    let places: Vec<f64> = chosen.iter().map(|&k| z[k]).collect();
    let spec = report::spec(&stored);
    let strip = match body(dir, &stored)?.and_then(|body| Strip::of_cuts(&body, &places, &spec)) {
        Some(strip) => strip,
        None => {
            let read = chosen.into_iter().map(|k| reader.section(k)).collect::<Result<Vec<Section>, _>>();
            Strip::of_sections(&read?)
        }
    };
    let tube = preview::bent(preview::surface(open()?, report::VIEW, report::PICTURE)?, &spec);
    Ok(report::html(&stored, &strip, &tube)?)
}

/// Returns the surface of the tissue if the model leans and the directory has a file of the
/// surface.
fn body(dir: &Path, report: &[u8]) -> anyhow::Result<Option<Body<'static>>> {
    if !report::leans(report) {
        return Ok(None);
    }
    let files = ["glb", "gltf", "ply", "vtp", "obj", "stl"].map(|ending| dir.join(format!("model.{ending}")));
    let Some(file) = files.iter().find(|file| file.is_file()) else { return Ok(None) };
    folder::verify(file)?;
    let surface = surface::read_aloud(file, UnitArgs::default()).with_context(|| file.display().to_string())?;
    Ok(Some(Converted::in_its_unit(&surface).into_body()))
}
