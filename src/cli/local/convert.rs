//! `oviduct convert`: converts a surface to another format or unit.

use super::surface;
use super::target::Target;
use crate::cli::args::ConvertArgs;
use crate::cli::exit::Ended;
use crate::cli::interrupt::Signals;
use crate::cli::{term, units};
use crate::export::convert::Converted;
use crate::export::read::Unit;
use crate::export::{Shape, threemf};
use crate::generate::Output;
use crate::measure::printable::{Least, printable};
use crate::measure::{CheckOptions, check_surface};
use anyhow::Context;

pub(in crate::cli) async fn run(args: ConvertArgs) -> Ended {
    let target = Target::of(&args.out, args.units, args.ascii)?;
    target.spare(&args.file)?;
    // If it is interrupted, the name of its scratch directory shows that the files are incomplete.
    let lines = Signals::listen().run("the conversion", move || convert(&args, &target)).await??;
    lines.iter().try_for_each(|line| term::print(line))?;
    Ok(())
}

fn convert(args: &ConvertArgs, target: &Target) -> anyhow::Result<Vec<String>> {
    let from = args.file.display();
    let mut surface = surface::read_aloud(&args.file, args.unit).with_context(|| from.to_string())?;
    if let Some(factor) = args.scale {
        // With the unit, so that each coordinate is rounded once.
        surface.unit = Unit::Stated(surface.unit.metres() * factor);
    }
    let converted = Converted::new(&surface, target.unit, &target.stem);
    drop(surface);
    let shape = converted.shape();
    let mut used = shape.triangles.as_flattened().iter().flat_map(|&v| shape.positions[v as usize]);
    if let Some(coordinate) = used.find(|x| !x.is_finite()) {
        let unit = target.unit.name();
        anyhow::bail!("{from}: a coordinate would be {coordinate} {unit} in single precision; use a smaller --scale");
    }
    let [x, y, z] = extent(&shape);
    if args.scale.is_some() && x.max(y).max(z) == 0.0 {
        anyhow::bail!("{from}: the surface would have no size in single precision; use a larger --scale");
    }
    let mut lines = target.write(&shape)?;
    if args.scale.is_some() || target.output == Output::ThreeMf {
        lines.push(printed_sizes(&shape));
    }
    if target.output == Output::ThreeMf {
        closed_objects(&shape).iter().for_each(|note| term::note(note));
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

/// Line about the sizes that a printer must resolve.
fn printed_sizes(shape: &Shape<'_>) -> String {
    let found = printable(shape.positions, shape.triangles);
    let length = |units: f64| units::show_length(units * shape.unit.metres(), 3);
    let [x, y, z] = extent(shape).map(|units| length(units.into()));
    let shown = |what: &str, narrow: &str, found: Option<Least>| match found {
        Some(Least { least, fifth_percentile }) => {
            format!("{what}: least {}, 5 % {narrow} than {}", length(least), length(fifth_percentile))
        }
        None => format!("no {what}"),
    };
    format!(
        "size {x} x {y} x {z}; {}; {}; sampled at {} places, so a thinner place may lie between them",
        shown("walls", "thinner", found.wall),
        shown("gaps", "narrower", found.gap),
        found.places
    )
}

/// Extent of the triangles along each axis.
fn extent(shape: &Shape<'_>) -> [f32; 3] {
    let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for p in shape.triangles.as_flattened().iter().map(|&v| shape.positions[v as usize]) {
        (0..3).for_each(|axis| (low[axis], high[axis]) = (low[axis].min(p[axis]), high[axis].max(p[axis])));
    }
    [0, 1, 2].map(|axis| high[axis] - low[axis])
}

/// Notes about objects of a 3MF file that are not closed surfaces as the format requires.
fn closed_objects(shape: &Shape<'_>) -> Vec<String> {
    let positions: Vec<[f64; 3]> = shape.positions.iter().map(|p| p.map(f64::from)).collect();
    let options = CheckOptions { euler: None, unit_metres: shape.unit.metres() };
    let note = |solid: threemf::Solid<'_>| {
        let triangles: Vec<[u32; 3]> = solid.triangles(shape).map(|(triangle, _)| triangle).collect();
        let failure = check_surface(&positions, &triangles, &options).first_failure()?;
        let name = solid.name;
        Some(format!(
            "{name} is not a sound closed surface, which 3MF requires, so a slicer may refuse or mend it: {failure}"
        ))
    };
    threemf::solids(shape).into_iter().filter_map(note).collect()
}
