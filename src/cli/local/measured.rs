//! Measures of images as tables, CSV and JSON.

use crate::measure::comparison::{Compared, Verdict};
use crate::measure::micrograph::Reading;
use crate::measure::morphometry::{Measures, QUANTITIES, Quantity};
use anyhow::Context;
use serde_json::{Map, Value, json};

/// Measures of an image.
pub(super) struct Measured {
    /// Side of a pixel.
    pub(super) pixel_um: f64,
    pub(super) notes: Vec<String>,
    pub(super) measures: Measures,
    pub(super) comparison: Option<Vec<Compared>>,
}

/// Name of an image, and its measures or the reason why it has none.
pub(super) type Row = (String, Result<Measured, String>);

/// JSON of an image; one of several images has its name and the reason why it has no measures.
pub(super) fn document((name, found): &Row, reading: &Reading, several: bool) -> Value {
    let mut whole = Map::new();
    if several {
        whole.insert("image".into(), name.as_str().into());
        whole.insert("error".into(), found.as_ref().err().cloned().into());
    }
    if let Ok(found) = found {
        let settings = json!({
            "pixel_um": found.pixel_um, "tissue": reading.tissue, "threshold": reading.threshold,
        });
        whole.insert("settings".into(), settings);
        let values: Map<String, Value> =
            QUANTITIES.iter().map(|quantity| (quantity.name.to_owned(), quantity.of(&found.measures).into())).collect();
        whole.insert("quantities".into(), values.into());
        whole.insert("notes".into(), found.notes.clone().into());
        if let Some(comparison) = &found.comparison {
            whole.insert("comparison".into(), json!(comparison));
        }
    }
    whole.into()
}

/// All quantities, one row per image. The last column has the reason why an image has no values.
pub(super) fn csv(all: &[Row]) -> anyhow::Result<String> {
    let mut writer = csv::Writer::from_writer(Vec::new());
    let names = QUANTITIES.iter().map(|quantity| quantity.name);
    writer.write_record(["image", "pixel_um"].into_iter().chain(names).chain(["error"]))?;
    for (name, found) in all {
        let mut row = vec![name.clone()];
        match found {
            Ok(found) => {
                row.push(found.pixel_um.to_string());
                let value = |quantity: &Quantity| quantity.of(&found.measures).map(|value| value.to_string());
                row.extend(QUANTITIES.iter().map(|quantity| value(quantity).unwrap_or_default()));
                row.push(String::new());
            }
            Err(why) => {
                row.resize(QUANTITIES.len() + 2, String::new());
                row.push(why.clone());
            }
        }
        writer.write_record(row)?;
    }
    String::from_utf8(writer.into_inner().context("the table")?).context("the table")
}

/// The table of an image and its comparison; `None` for an image without measures.
pub(super) fn text((name, found): &Row, several: bool) -> Option<String> {
    let found = found.as_ref().ok()?;
    let heading = if several { format!("{name}\n") } else { String::new() };
    let comparison = found.comparison.as_deref().map(compared).unwrap_or_default();
    Some(format!("{heading}{}{comparison}", table(&found.measures)))
}

/// Lists one quantity per line: title, value and unit.
fn table(measures: &Measures) -> String {
    let width = QUANTITIES.iter().map(|quantity| quantity.title.chars().count()).max().unwrap_or(0);
    let line = |quantity: &Quantity| {
        let value = quantity.of(measures).map_or_else(|| "–".into(), number);
        format!("{:<width$}  {value:>10}  {}", quantity.title, quantity.unit).trim_end().to_owned() + "\n"
    };
    QUANTITIES.iter().map(line).collect()
}

/// Lists one published value per line: quantity, region, value of the section, published range,
/// verdict and source.
fn compared(all: &[Compared]) -> String {
    let mut text = String::from("\nPublished values\n");
    let mut line = |name: &str, measured: &str, range: &str, verdict: &str, source: &str| {
        text += &format!("{name:<32} {measured:>12} {range:>20}  {verdict:<14} {source}\n");
    };
    if !all.is_empty() {
        line("quantity (region)", "this section", "published", "verdict", "source");
    }
    let shown = |value: Option<f64>| value.map_or_else(|| "–".into(), number);
    for one in all {
        let verdict = match one.verdict {
            Verdict::Inside => "inside",
            Verdict::Outside => "outside",
            Verdict::NoRange => "no range",
            Verdict::MethodUnknown => "method unknown",
            Verdict::NotMeasured => "not measured",
            Verdict::Shortened => "shortened",
        };
        let range = match (one.low, one.high) {
            (None, None) => shown(one.value),
            (low, high) => format!("{} to {}", shown(low), shown(high)),
        };
        let name = format!("{} ({})", one.quantity, one.region);
        line(&name, &shown(one.measured), &range, verdict, &one.source);
    }
    if all.is_empty() {
        text += "none for this region\n";
    }
    text
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
