//! Figure 7: sections along the tube as tissue and as stained pictures.

use super::figure::Figure;
use super::figure4::describe;
use super::grown::Grown;
use anyhow::Context;
use oviduct::render::{
    Drawing, OVERSAMPLING, Panel, RenderError, SectionStyle, extent_um, line_height, page_png, section_drawing,
};
use oviduct::report;
use serde_json::{Value, json};

/// Sections per row.
const COLUMNS: usize = 4;

pub(super) fn draw(grown: &Grown, size: u32) -> anyhow::Result<Figure> {
    let places: Vec<f64> = grown.sections.iter().map(|section| section.z_um).collect();
    let chosen = report::strip(&places);
    let widest = chosen.iter().filter_map(|&k| extent_um(&grown.sections[k])).map(|[wide, high]| wide.max(high));
    let widest = widest.reduce(f64::max).context("no section has points")?;
    let cell = size / COLUMNS as u32;
    // The margin of a drawing is a tenth of its longer side.
    let um_per_pixel = 1.1 * widest / f64::from(OVERSAMPLING * cell);
    let drawn = |k: usize| -> Result<[Drawing; 2], RenderError> {
        let section = &grown.sections[k];
        let longer = extent_um(section).map_or(1.0, |[wide, high]| wide.max(high));
        let pixels = (1.1 * longer / um_per_pixel).round() as u32;
        Ok([section_drawing(section, um_per_pixel, SectionStyle::Tissue)?, grown.slide(k).drawing(pixels)?])
    };
    let pairs = chosen.iter().map(|&k| drawn(k)).collect::<Result<Vec<_>, _>>()?;
    let notes: Vec<String> = chosen.iter().map(|&k| format!("{:.1} mm", grown.sections[k].z_um / 1e3)).collect();
    let (line, mut top, mut panels) = (line_height(size), 0, Vec::new());
    let rows = pairs.len().div_ceil(COLUMNS);
    for (i, (pairs, notes)) in pairs.chunks(COLUMNS).zip(notes.chunks(COLUMNS)).enumerate() {
        let highest = pairs.iter().flatten().map(|drawing| drawing.size()[1]).max().unwrap_or(0);
        let row = highest.div_ceil(OVERSAMPLING);
        // All sections have the same scale, so one bar below the first section of the last row
        // suffices.
        let bar = |column: usize| i + 1 == rows && column == 0;
        for (column, (pair, note)) in pairs.iter().zip(notes).enumerate() {
            let left = column as u32 * cell;
            let letter = |letter| (i == 0 && column == 0).then_some(letter);
            let above = [left, top, cell, row];
            panels.push(Panel { place: above, drawing: &pair[0], letter: letter('a'), note: "", bar: false });
            let high = row + line * (1 + u32::from(bar(column)));
            let below = [left, top + row, cell, high];
            panels.push(Panel { place: below, drawing: &pair[1], letter: letter('b'), note, bar: bar(column) });
        }
        top += 2 * row + line + if i + 1 == rows { line } else { line / 2 };
    }
    let png = page_png([cell * COLUMNS as u32, top], &panels)?;
    let caption = vec![
        format!(
            "{} sections along the tube at one scale, from the isthmus end to the ampulla end; below each, its distance from the isthmus end ({}).",
            chosen.len(),
            grown.name()
        ),
        "(a) As grown: tissue and the outline of the lumen. (b) The same sections with synthetic staining, haematoxylin and eosin; these are no micrographs.".to_owned(),
        "The paper has micrographs of a pig's oviduct in (b); no such pictures with a licence that lets us ship them were found.".to_owned(),
    ];
    let sections: Vec<Value> = chosen.iter().map(|&k| describe(grown, k)).collect();
    let numbers = json!({ "sections": sections, "um_per_pixel": um_per_pixel * f64::from(OVERSAMPLING) });
    let files = vec![("figure-7.png".to_owned(), png)];
    Ok(Figure { number: "7", title: "Progressive sections, and the same ones stained", files, caption, numbers })
}
