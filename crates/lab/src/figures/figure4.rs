//! Figure 4: sections of the isthmus and of the ampulla, each as two closed lines.

use super::figure::Figure;
use super::grown::Grown;
use anyhow::Context;
use oviduct::model::Section;
use oviduct::render::{OVERSAMPLING, Panel, SectionStyle, extent_um, line_height, page_png, section_drawing};
use serde_json::{Value, json};

/// Width of the lines: fraction of the width of the page, and minimum in pixels.
const PEN: (f32, f32) = (0.0014, 1.2);

pub(super) fn draw(grown: &Grown, size: u32) -> anyhow::Result<Figure> {
    let [from, to] = grown.junction();
    let chosen = [grown.nearest(from / 2.0), grown.nearest((1.0 + to) / 2.0)];
    let strip = line_height(size);
    let side = size / 2;
    let drawings = chosen.map(|k| {
        let section = &grown.sections[k];
        let [wide, high] = extent_um(section).context("the section has no points")?;
        // The margin of a drawing is a tenth of its longer side.
        let um_per_pixel = 1.1 * wide.max(high) / f64::from(OVERSAMPLING * side);
        Ok::<_, anyhow::Error>(section_drawing(section, um_per_pixel, SectionStyle::Loops { pen: pen(size) })?)
    });
    let [isthmus, ampulla] = drawings;
    let drawings = [isthmus?, ampulla?];
    let highest = drawings.iter().map(|drawing| drawing.size()[1]).max().unwrap_or(0);
    let height = highest.div_ceil(OVERSAMPLING) + strip;
    let panels: Vec<Panel<'_>> = drawings
        .iter()
        .zip(['a', 'b'])
        .enumerate()
        .map(|(i, (drawing, letter))| {
            let place = [i as u32 * side, 0, side, height];
            Panel { place, drawing, letter: Some(letter), note: "", bar: true }
        })
        .collect();
    let png = page_png([2 * side, height], &panels)?;
    let of = |k: usize| -> &Section { &grown.sections[k] };
    let mm = |k: usize| format!("{:.1} mm", of(k).z_um / 1e3);
    let caption = vec![
        format!(
            "Sections of (a) the isthmus, {} from the isthmus end, with {} particles in the inner and {} in the outer loop, and (b) the ampulla, {}, with {} and {} ({}).",
            mm(chosen[0]),
            of(chosen[0]).inner.len(),
            of(chosen[0]).outer.len(),
            mm(chosen[1]),
            of(chosen[1]).inner.len(),
            of(chosen[1]).outer.len(),
            grown.name()
        ),
        "Each is in the middle of its region; (a) and (b) have scales of their own.".to_owned(),
    ];
    let numbers = json!({ "a": describe(grown, chosen[0]), "b": describe(grown, chosen[1]) });
    let files = vec![("figure-4.png".to_owned(), png)];
    Ok(Figure { number: "4", title: "Sections of isthmus and ampulla", files, caption, numbers })
}

/// Returns the width of a line in a drawing, pixels.
fn pen(size: u32) -> f32 {
    (PEN.0 * size as f32).max(PEN.1) * OVERSAMPLING as f32
}

/// Describes a section for `figures.json`.
pub(super) fn describe(grown: &Grown, index: usize) -> Value {
    let section = &grown.sections[index];
    json!({
        "section": index, "z_mm": section.z_um / 1e3, "step": section.step, "extent_um": extent_um(section),
        "particles": { "inner": section.inner.len(), "outer": section.outer.len() },
    })
}
