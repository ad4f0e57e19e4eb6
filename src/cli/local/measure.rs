//! `oviduct measure`: measures the sections in images.

use super::measured::{Measured, Row, csv, document, text};
use crate::cli::args::MeasureArgs;
use crate::cli::exit::{Ended, Failure};
use crate::cli::interrupt::Signals;
use crate::cli::{scratch, term};
use crate::measure::comparison::{compare_section, compared_species};
use crate::measure::micrograph::{MAX_BYTES, Micrograph, MicrographError, PIXEL_UM, Picture, Reading, Setting};
use crate::render::{Outline, outlines_png};
use anyhow::{Context, anyhow, bail};
use serde_json::Value;
use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Regions of which values of sections are published.
const REGIONS: [&str; 3] = ["isthmus", "junction", "ampulla"];

pub(in crate::cli) async fn run(args: MeasureArgs) -> Ended {
    let plan = Arc::new(Plan::new(&args)?);
    let one = args.images.len() == 1;
    let mut all = Vec::new();
    for image in &args.images {
        let (task, path) = (Arc::clone(&plan), image.clone());
        let found = Signals::listen().run("measuring", move || task.measured(&path)).await?;
        match found {
            Err(failure) if one && args.csv.is_none() => return Err(failure),
            found => all.push((image.display().to_string(), found.map_err(reason))),
        }
    }
    report(&args, &plan.reading, &all)?;
    for (name, found) in &all {
        match found {
            Ok(found) => found.notes.iter().for_each(|note| term::note(&format!("note: {name}: {note}"))),
            Err(why) => term::note(&format!("error: {why}")),
        }
    }
    if all.iter().all(|(_, found)| found.is_ok()) { Ok(()) } else { Err(Failure::Negative) }
}

/// Writes what was asked for.
fn report(args: &MeasureArgs, reading: &Reading, all: &[Row]) -> Ended {
    if args.json {
        let documents: Vec<Value> = all.iter().map(|row| document(row, reading, all.len() > 1)).collect();
        match documents.as_slice() {
            [one] => term::print_json(one)?,
            many => term::print_json(&many)?,
        }
        return Ok(());
    }
    match &args.csv {
        Some(path) if path.as_os_str() == "-" => return Ok(term::print(&csv(all)?)?),
        Some(path) => drop(scratch::write(path, csv(all)?).context("--csv")?),
        None => {}
    }
    let tables: Vec<String> = all.iter().filter_map(|row| text(row, all.len() > 1)).collect();
    if tables.is_empty() { Ok(()) } else { Ok(term::print(&tables.join("\n"))?) }
}

/// One line for a failure.
fn reason(failure: Failure) -> String {
    match failure {
        Failure::Usage(lines) => lines.join("; "),
        Failure::Failed(error) => format!("{error:#}"),
        Failure::Negative | Failure::Interrupted => "interrupted".into(),
    }
}

/// What to do with each image.
struct Plan {
    reading: Reading,
    /// Organ, species and region to compare with.
    compare: Option<(String, String, Option<String>)>,
    outlines: Option<PathBuf>,
}

impl Plan {
    fn new(args: &MeasureArgs) -> Result<Self, Failure> {
        let pixel_um = args.pixel.or(args.pixel_um);
        if let Some(side) = pixel_um.filter(|side| !PIXEL_UM.contains(side)) {
            let option = if args.pixel.is_some() { "--pixel" } else { "--pixel-um" };
            return Err(Failure::usage(format!("{option}: {}", MicrographError::PixelSize(side))));
        }
        if args.compare.is_some() && args.csv.as_deref() == Some(Path::new("-")) {
            return Err(Failure::usage("--compare: the CSV has no comparison; use --csv FILE or --json"));
        }
        if let Some(dir) = &args.outlines {
            let mut first: BTreeMap<PathBuf, &Path> = BTreeMap::new();
            for image in &args.images {
                let picture = outlines_path(dir, image);
                if let Some(other) = first.insert(picture.clone(), image) {
                    let [image, other, picture] = [image, other, &picture].map(Path::display);
                    return Err(Failure::usage(format!(
                        "--outlines: the pictures of {other} and {image} would both be {picture}"
                    )));
                }
            }
        }
        let compare = args.compare.as_deref().map(published).transpose().map_err(Failure::usage)?;
        let reading = Reading { pixel_um, tissue: args.tissue.clone(), threshold: args.threshold };
        Ok(Self { reading, compare, outlines: args.outlines.clone() })
    }

    fn measured(&self, image: &Path) -> Result<Measured, Failure> {
        let shown = || image.display().to_string();
        let file = read(image).with_context(shown)?;
        let traced = Micrograph::read(&file, &self.reading).map_err(|error| refused(&shown(), &error))?;
        if let Some(dir) = &self.outlines {
            let png = drawn(&file, &traced).with_context(shown)?;
            scratch::write(&outlines_path(dir, image), png)?;
        }
        let measures = traced.measure();
        let comparison = self
            .compare
            .as_ref()
            .map(|(organ, species, region)| compare_section(&measures, organ, species, region.as_deref()));
        Ok(Measured { pixel_um: traced.pixel_um(), notes: traced.notes().to_vec(), measures, comparison })
    }
}

/// An image that cannot be measured; names the option that helps.
fn refused(name: &str, error: &MicrographError) -> Failure {
    match error {
        MicrographError::NoPixelSize(_) | MicrographError::NotSquare(..) | MicrographError::PixelSize(_) => {
            Failure::usage(format!("{name}: {error}; state it with --pixel-um, such as --pixel-um 2"))
        }
        _ if error.setting() == Some(Setting::Tissue) => {
            let help = "see --tissue (such as 2, 1,2, nonzero or zero) and --threshold";
            Failure::Failed(anyhow!("{name}: {error}; {help}"))
        }
        _ => Failure::Failed(anyhow::Error::from(error.clone()).context(name.to_owned())),
    }
}

/// Reads the organ, species and region of `--compare`.
fn published(text: &str) -> Result<(String, String, Option<String>), String> {
    let (name, region) = text.split_once(':').map_or((text, None), |(name, region)| (name, Some(region)));
    let (organ, species) = name.split_once('/').unwrap_or(("oviduct", name));
    if !compared_species().any(|known| known == (organ, species)) {
        let known = compared_species().map(|(organ, species)| match organ {
            "oviduct" => species.to_owned(),
            _ => format!("{organ}/{species}"),
        });
        let known: Vec<String> = known.collect();
        return Err(format!("--compare {text}: values of sections are published for {}", known.join(", ")));
    }
    if let Some(region) = region.filter(|region| !REGIONS.contains(region)) {
        return Err(format!("--compare {text}: `{region}` is no region; the regions are {}", REGIONS.join(", ")));
    }
    Ok((organ.to_owned(), species.to_owned(), region.map(str::to_owned)))
}

fn outlines_path(dir: &Path, image: &Path) -> PathBuf {
    dir.join(format!("{}.outlines.png", image.file_name().unwrap_or_default().to_string_lossy()))
}

/// The image with the traced outlines.
fn drawn(file: &[u8], traced: &Micrograph) -> anyhow::Result<Vec<u8>> {
    let picture = Picture::read(file)?;
    let shape = traced.shape();
    let place = |contour: &[[f32; 2]]| picture.place(contour, traced.pixel_um());
    let of_lumen = shape.lumen.iter().map(|contour| {
        let is_island = crate::geometry::polygon::signed_area(contour) < 0.0;
        (if is_island { Outline::Island } else { Outline::Lumen }, place(contour))
    });
    let outlines: Vec<_> = std::iter::once((Outline::Outer, place(shape.outer))).chain(of_lumen).collect();
    Ok(outlines_png(picture.size, &picture.grey, &outlines)?)
}

/// Reads a file of limited size.
pub(in crate::cli) fn read(path: &Path) -> anyhow::Result<Vec<u8>> {
    let file = File::open(path)?;
    let mut bytes = Vec::new();
    // A file may grow while it is read, and a pipe has no length.
    if file.metadata()?.len() <= MAX_BYTES {
        file.take(MAX_BYTES + 1).read_to_end(&mut bytes)?;
        if bytes.len() as u64 <= MAX_BYTES {
            return Ok(bytes);
        }
    }
    bail!("larger than {} MiB, the most that is read", MAX_BYTES >> 20)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn published_values_are_named_by_species_and_region() {
        let of = |text| published(text).map(|(organ, species, region)| [organ, species, region.unwrap_or_default()]);
        assert_eq!(of("human").unwrap(), ["oviduct", "human", ""]);
        assert_eq!(of("human:ampulla").unwrap(), ["oviduct", "human", "ampulla"]);
        assert_eq!(of("ureter/human").unwrap(), ["ureter", "human", ""]);
        assert!(of("unicorn").unwrap_err().contains("cow, human, pig"), "{:?}", of("unicorn"));
        assert!(of("human:fundus").unwrap_err().contains("isthmus, junction, ampulla"));
    }
}
