//! `oviduct convert`: converts a surface to another format or unit.

use super::surface;
use crate::cli::args::ConvertArgs;
use crate::cli::exit::{Ended, Failure};
use crate::cli::interrupt::Signals;
use crate::cli::scratch::{Scratch, split};
use crate::cli::term;
use crate::export::convert::Converted;
use crate::export::glb::GlbOptions;
use crate::generate::{Output, write_surface};
use crate::model::LengthUnit;
use anyhow::Context;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

pub(in crate::cli) async fn run(args: ConvertArgs) -> Ended {
    let target = Target::of(&args)?;
    // If it is interrupted, the name of its scratch directory shows that the files are incomplete.
    let lines = Signals::listen().run("the conversion", move || convert(&args, &target)).await??;
    lines.iter().try_for_each(|line| term::print(line))?;
    Ok(())
}

/// Target of a conversion.
struct Target {
    output: Output,
    dir: PathBuf,
    /// Name of the file without its ending.
    stem: String,
    /// Endings of the files: as in the table of formats, and as given.
    endings: Vec<(&'static str, String)>,
    unit: LengthUnit,
}

impl Target {
    fn of(args: &ConvertArgs) -> Result<Self, Failure> {
        let shown = args.out.display();
        let name = args.out.file_name().and_then(|name| name.to_str()).unwrap_or_default();
        let lower = name.to_ascii_lowercase();
        // The longest ending: `.ascii.stl` also ends in `.stl`.
        let known = Output::ALL.into_iter().filter_map(|output| Some((output, output.endings().first()?.0)));
        let found = known.filter(|(_, ending)| lower.ends_with(&format!(".{ending}"))).max_by_key(|(_, e)| e.len());
        let Some((output, ending)) = found else {
            let endings: Vec<&str> =
                Output::ALL.iter().filter_map(|output| Some(output.endings().first()?.0)).collect();
            return Err(Failure::usage(format!(
                "{shown}: the format is not known; known are .{}",
                endings.join(", .")
            )));
        };
        let output = if args.ascii { ascii(output, name)? } else { output };
        let unit = output.unit(args.units).unwrap_or(LengthUnit::Metre);
        if args.units.is_some_and(|asked| asked != unit) {
            return Err(Failure::usage(format!("--units: {} is always in {}", output.name(), unit.name())));
        }
        let (stem, given) = name.split_at(name.len() - ending.len() - 1);
        if stem.is_empty() {
            return Err(Failure::usage(format!("{shown}: has no name before its ending")));
        }
        let mut endings = vec![(output.endings()[0].0, given[1..].to_owned())];
        endings.extend(output.endings().iter().skip(1).map(|(ending, _)| (*ending, (*ending).to_owned())));
        let dir = split(&args.out).map_or(Path::new("."), |(dir, _)| dir);
        Ok(Self { output, dir: dir.to_owned(), stem: stem.to_owned(), endings, unit })
    }
}

/// Returns the text variant of a format.
fn ascii(output: Output, name: &str) -> Result<Output, Failure> {
    match output {
        Output::Stl | Output::StlAscii => Ok(Output::StlAscii),
        _ => Err(Failure::usage(format!("--ascii: {name}: only STL can be binary or text"))),
    }
}

fn convert(args: &ConvertArgs, target: &Target) -> anyhow::Result<Vec<String>> {
    let from = args.file.display();
    let surface = surface::read_aloud(&args.file, args.unit).with_context(|| from.to_string())?;
    let mut lines = Vec::new();
    let converted = Converted::new(&surface, target.unit, &target.stem);
    drop(surface);
    let shape = converted.shape();
    let scratch = Scratch::new(&target.dir).with_context(|| target.dir.display().to_string())?;
    let mut names = Vec::new();
    for (ending, given) in &target.endings {
        let name = format!("{}.{given}", target.stem);
        let write = || -> std::io::Result<()> {
            let mut file = BufWriter::with_capacity(1 << 18, File::create(scratch.dir().join(&name))?);
            write_surface(target.output, ending, &shape, GlbOptions::default(), &target.stem, &mut file)?;
            file.flush()
        };
        write().with_context(|| name.clone())?;
        names.push(name);
    }
    let patches: Vec<&str> = shape.patches.iter().map(|patch| patch.name).collect();
    for name in &names {
        let path = scratch.publish(name).with_context(|| name.clone())?;
        lines.push(format!(
            "{}: {} vertices, {} triangles, in {}; patches {}",
            path.display(),
            shape.positions.len(),
            shape.triangles.len(),
            target.unit.name(),
            patches.join(", ")
        ));
    }
    if converted.rounded > 0.0 {
        let (by, unit) = (converted.rounded, target.unit.name());
        term::note(&format!("coordinates were rounded to single precision, by at most {by:.1e} {unit}"));
    }
    if converted.collapsed > 0 {
        term::note(&format!("{} triangles with a corner twice were left out", converted.collapsed));
    }
    Ok(lines)
}
