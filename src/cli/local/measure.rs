//! `oviduct measure`: measures the section in an image.

use crate::cli::args::MeasureArgs;
use crate::cli::exit::{Ended, Failure};
use crate::cli::interrupt::Signals;
use crate::cli::term;
use crate::measure::micrograph::{MAX_BYTES, Micrograph, MicrographError, Reading};
use crate::measure::morphometry::{Measures, QUANTITIES};
use anyhow::{Context, bail};
use serde_json::{Map, Value, json};
use std::fs::File;
use std::io::Read;
use std::path::Path;

pub(in crate::cli) async fn run(args: MeasureArgs) -> Ended {
    let tissue = (!args.tissue.is_empty()).then_some(args.tissue);
    let reading = Reading { pixel_um: args.pixel_um, tissue };
    let settings = json!({ "pixel_um": reading.pixel_um, "tissue": reading.tissue });
    let measures = Signals::listen().run("measuring", move || measured(&args.image, &reading)).await??;
    if args.json {
        let values: Map<String, Value> =
            QUANTITIES.iter().map(|quantity| (quantity.name.to_owned(), quantity.of(&measures).into())).collect();
        term::print_json(&json!({ "settings": settings, "quantities": values }))?;
    } else {
        term::print(&table(&measures))?;
    }
    Ok(())
}

fn measured(image: &Path, reading: &Reading) -> Result<Measures, Failure> {
    let shown = || image.display().to_string();
    let png = read(image).with_context(shown)?;
    match Micrograph::read(&png, reading) {
        Ok(micrograph) => Ok(micrograph.measure()),
        Err(error @ MicrographError::PixelSize(_)) => Err(Failure::usage(format!("--pixel-um: {error}"))),
        Err(error) => Err(anyhow::Error::from(error).context(shown()).into()),
    }
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

/// Prints one quantity per line: title, value and unit.
fn table(measures: &Measures) -> String {
    let width = QUANTITIES.iter().map(|quantity| quantity.title.chars().count()).max().unwrap_or(0);
    let line = |quantity: &crate::measure::morphometry::Quantity| {
        let value = quantity.of(measures).map_or_else(|| "–".into(), number);
        format!("{:<width$}  {value:>10}  {}", quantity.title, quantity.unit).trim_end().to_owned() + "\n"
    };
    QUANTITIES.iter().map(line).collect()
}

/// Formats a value with four digits, or all digits before the point; counts have no point.
fn number(value: f64) -> String {
    if value == value.trunc() && value.abs() < 1e6 {
        return format!("{value}");
    }
    let digits = (3 - value.abs().log10().floor() as i32).clamp(0, 6);
    format!("{value:.*}", digits as usize)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_four_digits() {
        let shown = [0.0, 12.0, 0.012_345_6, 1.618_034, 271.828, 31_415.9].map(number);
        assert_eq!(shown, ["0", "12", "0.01235", "1.618", "271.8", "31416"]);
    }
}
