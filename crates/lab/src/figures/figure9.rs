//! Figure 9: the ends, the whole length, a lengthwise cut, and a large picture.

use super::figure::Figure;
use super::grown::Grown;
use oviduct::mesh::draft;
use oviduct::model::{Mesh, Section};
use oviduct::render::{
    Drawing, NamedView, OVERSAMPLING, Panel, Plane, View, extent_um, line_height, mesh_drawing, page_png,
};
use serde_json::json;

/// Length of the pieces of the ampulla, in widths of the tube: of the lengthwise cut and of the
/// large picture.
const PIECES: [f64; 2] = [3.0, 1.1];
/// Camera of the view of the whole length: degrees from the side towards the ampulla end, and
/// degrees above.
const ASIDE: [f64; 2] = [20.0, 5.0];

pub(super) fn draw(grown: &Grown, size: u32) -> anyhow::Result<Figure> {
    let strip = line_height(size);
    let half = size / 2;
    let finish = grown.finish();
    let shown = Some(&finish);
    let named = |view: NamedView| -> anyhow::Result<Drawing> {
        let mesh = grown.surface(view, OVERSAMPLING * half)?;
        let of = view.of(&mesh, OVERSAMPLING * (half - strip));
        Ok(mesh_drawing(&mesh, &of, shown)?)
    };
    let isthmus = named(NamedView::Isthmus)?;
    let ampulla = named(NamedView::Ampulla)?;

    let width = extent_um(&grown.sections[grown.sections.len() - 1]).map_or(1.0, |[wide, high]| wide.max(high));
    let length = grown.length_um();
    let band = band(size, width, length).min(half);
    let whole = mesh_drawing(
        &grown.mesh,
        &View {
            azimuth_deg: ASIDE[0] - 90.0,
            elevation_deg: ASIDE[1],
            ..true_proportions(OVERSAMPLING * size, OVERSAMPLING * band)
        },
        shown,
    )?;

    let mid = (1.0 + grown.junction()[1]) / 2.0 * length;
    let [cut_um, fine_um] = PIECES.map(|widths| (widths * width).min(length));
    let cut_from = (mid - cut_um / 2.0).clamp(0.0, length - cut_um);
    let cut_piece = draft(within(&grown.sections, [cut_from, cut_from + cut_um]))?;
    let tall = size * 7 / 20;
    let lengthwise = View {
        azimuth_deg: 14.0 - 90.0,
        elevation_deg: 12.0,
        cut: vec![through_middle(&cut_piece, [-1.0, 0.0, 0.0])],
        ..true_proportions(OVERSAMPLING * size, OVERSAMPLING * (tall - strip))
    };
    let lengthwise = mesh_drawing(&cut_piece, &lengthwise, shown)?;

    let fine_piece = draft(within(&grown.sections, [length - fine_um, length]))?;
    let high = size * 4 / 5;
    let wedge = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]].map(|normal| through_middle(&fine_piece, normal)).to_vec();
    let fine = View {
        azimuth_deg: 42.0,
        elevation_deg: 26.0,
        cut: wedge,
        ..true_proportions(OVERSAMPLING * size, OVERSAMPLING * (high - strip))
    };
    let fine = mesh_drawing(&fine_piece, &fine, shown)?;

    let panel = |place, drawing, letter| Panel { place, drawing, letter: Some(letter), note: "", bar: true };
    let rows = [0, half, half + band + strip, half + band + strip + tall];
    let panels = [
        panel([0, 0, half, half], &isthmus, 'a'),
        panel([half, 0, half, half], &ampulla, 'b'),
        panel([0, rows[1], size, band + strip], &whole, 'c'),
        panel([0, rows[2], size, tall], &lengthwise, 'd'),
        panel([0, rows[3], size, high], &fine, 'e'),
    ];
    let png = page_png([size, rows[3] + high], &panels)?;
    let mm = |um: f64| format!("{:.1} mm", um / 1e3);
    let caption = vec![
        format!(
            "The model ({}), all in true proportions: (a) from the isthmus end, (b) from the ampulla end, each with a piece of tube.",
            grown.name()
        ),
        format!("(c) The whole length of {}, isthmus to the left.", mm(length)),
        format!(
            "(d) A piece of the ampulla, {} to {} from the isthmus end, cut lengthwise.",
            mm(cut_from),
            mm(cut_from + cut_um)
        ),
        format!(
            "(e) The last {} of the ampulla without a quarter, with procedural texturing and bump mapping as in the paper; faces of the cut show the stained layers of the wall.",
            mm(fine_um)
        ),
    ];
    let numbers = json!({
        "length_mm": length / 1e3, "width_um": width,
        "d": { "from_mm": cut_from / 1e3, "to_mm": (cut_from + cut_um) / 1e3, "triangles": cut_piece.triangles.len() },
        "e": { "from_mm": (length - fine_um) / 1e3, "to_mm": length / 1e3, "triangles": fine_piece.triangles.len() },
    });
    let files = vec![("figure-9.png".to_owned(), png)];
    Ok(Figure { number: "9", title: "The model", files, caption, numbers })
}

/// Returns the height of the picture of the whole length, in which the tube is a slightly inclined
/// band as wide as the page.
fn band(size: u32, width: f64, length: f64) -> u32 {
    let [aside, above] = ASIDE.map(f64::to_radians);
    let rise = width * above.cos() + length * aside.sin() * above.sin();
    let run = length * aside.cos() + width * aside.sin();
    (f64::from(size) * (0.07 + 0.93 * rise / run)).ceil() as u32
}

fn true_proportions(width: u32, height: u32) -> View {
    View { width, height, azimuth_deg: 0.0, elevation_deg: 0.0, axial_scale: 1.0, cut: Vec::new() }
}

/// Returns the sections in a piece of the tube, at least two.
fn within(sections: &[Section], [from, to]: [f64; 2]) -> &[Section] {
    let start = sections.partition_point(|section| section.z_um < from).min(sections.len() - 2);
    let end = sections.partition_point(|section| section.z_um <= to).max(start + 2);
    &sections[start..end]
}

/// Returns the plane with this normal through the middle of a mesh.
fn through_middle(mesh: &Mesh, normal: [f64; 3]) -> Plane {
    let along = |p: &[f32; 3]| (0..3).map(|axis| normal[axis] * f64::from(p[axis])).sum::<f64>();
    let [low, high] = mesh
        .positions
        .iter()
        .map(along)
        .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], at| [low.min(at), high.max(at)]);
    Plane { normal, offset: (low + high) / 2.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use oviduct::model::sample::{section, tube};

    #[test]
    fn a_piece_has_at_least_two_sections() {
        let sections: Vec<Section> = (0..6).map(|k| section(12, f64::from(k), 100.0 * f64::from(k))).collect();
        let found = |range: [f64; 2]| -> Vec<f64> { within(&sections, range).iter().map(|s| s.z_um).collect() };
        assert_eq!(found([150.0, 420.0]), [200.0, 300.0, 400.0]);
        assert_eq!(found([210.0, 220.0]), [300.0, 400.0]);
        assert_eq!(found([499.0, 500.0]), [400.0, 500.0]);
        assert_eq!(found([-5.0, 1e9]).len(), 6);
    }

    #[test]
    fn planes_halve_the_piece() {
        let plane = through_middle(&tube(24, 4, 0.2), [0.0, 0.0, -1.0]);
        assert!((plane.offset + 2e-3).abs() < 1e-9, "{plane:?}");
    }
}
