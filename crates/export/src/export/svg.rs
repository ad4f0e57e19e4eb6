//! SVG drawings of sections and cuts in micrometres, y up, with a scale bar.

use crate::model::{Cut, Plane, Ring, RingKind, Section};
use std::fmt::Write;

/// Media type of the drawings.
pub const MEDIA_TYPE: &str = "image/svg+xml";

const TISSUE: &str = "#de95a9";
const LUMEN: &str = "#fffaf8";
const OUTLINE: &str = "#7d3a78";
const ISLAND: &str = "#1f6f8b";
const INK: &str = "#3b2a38";
/// Length of the scale bar, micrometres.
const BAR: f64 = 500.0;

/// Draws a section: tissue filled, lumen outlined. Coordinates have two decimals (10 nm).
///
/// Points that are not finite are omitted.
#[must_use]
pub fn section_svg(section: &Section) -> String {
    let frame = DrawingFrame::of(finite(&section.outer).chain(finite(&section.inner)));
    let [outer, inner] = [&section.outer, &section.inner].map(|ring| path(finite(ring)));
    let body = format!(
        r#"<path id="tissue" fill="{TISSUE}" fill-rule="evenodd" d="{outer}{inner}"/>
<path id="lumen" fill="{LUMEN}" stroke="{OUTLINE}" stroke-width="{:.2}" stroke-linejoin="round" d="{inner}"/>
"#,
        frame.extent / 250.0
    );
    let added = if section.added { ", added" } else { "" };
    let place = format!("z = {:.3} mm, step {}{added}", section.z_um / 1000.0, section.step);
    drawing(&frame, &format!("Section at {place}"), &place, &body)
}

/// Draws a cut: tissue filled, lumen and pockets outlined, islands outlined in another colour. u
/// points to the right, v up.
#[must_use]
pub fn cut_svg(cut: &Cut) -> String {
    let points = || cut.rings.iter().flat_map(|ring| ring.points.iter().copied());
    let frame = DrawingFrame::of(points());
    let of = |kinds: &[RingKind]| -> String {
        let rings = cut.rings.iter().filter(|ring| kinds.contains(&ring.kind));
        rings.map(|ring| path(ring.points.iter().copied())).collect()
    };
    use RingKind::{Island, Lumen, Pocket, Tissue};
    let line = frame.extent / 250.0;
    let mut body = format!(
        r#"<path id="tissue" fill="{TISSUE}" fill-rule="evenodd" d="{}"/>"#,
        of(&[Tissue, Lumen, Island, Pocket])
    );
    body.push('\n');
    for (id, kind, color) in [("lumen", Lumen, OUTLINE), ("pockets", Pocket, OUTLINE), ("islands", Island, ISLAND)] {
        let rings = of(&[kind]);
        if !rings.is_empty() {
            body.push_str(&format!(
                r#"<path id="{id}" fill="none" stroke="{color}" stroke-width="{line:.2}" stroke-linejoin="round" d="{rings}"/>"#
            ));
            body.push('\n');
        }
    }
    let Plane { origin_um: [x, y, z], normal, .. } = cut.plane;
    let place = if normal == [0.0, 0.0, 1.0] {
        format!("z = {:.3} mm", z / 1000.0)
    } else {
        let [a, b, c] = normal;
        format!("through ({:.3}, {:.3}, {:.3}) mm, normal ({a:.3}, {b:.3}, {c:.3})", x / 1e3, y / 1e3, z / 1e3)
    };
    drawing(&frame, &format!("Cut at {place}"), &place, &body)
}

/// Composes a drawing from `body`, with a title, a scale bar and a caption.
fn drawing(frame: &DrawingFrame, title: &str, caption: &str, body: &str) -> String {
    let size = frame.text;
    let [left, top, width, height] = frame.view_box();
    let (bar_x, bar_y) = (frame.min[0], top + height - 1.1 * size);
    let (above, right) = (bar_y - 0.3 * size, left + width - size / 2.0);
    format!(
        r#"<svg xmlns="http://www.w3.org/2000/svg" viewBox="{left:.2} {top:.2} {width:.2} {height:.2}" data-units="um">
<title>{title}</title>
{body}<g font-family="sans-serif" font-size="{size:.2}" fill="{INK}"><rect id="scale" x="{bar_x:.2}" y="{bar_y:.2}" width="{BAR}" height="{:.2}"/>
<text x="{bar_x:.2}" y="{above:.2}">{BAR} µm</text>
<text x="{right:.2}" y="{above:.2}" text-anchor="end">{caption}</text></g>
</svg>
"#,
        size / 5.0
    )
}

/// Extent of a drawing, in micrometres with y down.
struct DrawingFrame {
    min: [f64; 2],
    max: [f64; 2],
    extent: f64,
    text: f64,
}

impl DrawingFrame {
    fn of(points: impl Iterator<Item = [f64; 2]>) -> Self {
        let (mut min, mut max) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for [x, y] in points {
            for (axis, value) in [x, -y].into_iter().enumerate() {
                min[axis] = min[axis].min(value);
                max[axis] = max[axis].max(value);
            }
        }
        if min[0] > max[0] {
            (min, max) = ([-BAR / 2.0; 2], [BAR / 2.0; 2]);
        }
        let extent = (max[0] - min[0]).max(max[1] - min[1]).max(BAR);
        Self { min, max, extent, text: extent / 28.0 }
    }

    /// Left, top, width and height of the points with a margin and a line for scale bar and
    /// caption.
    fn view_box(&self) -> [f64; 4] {
        let margin = self.text;
        let width = (self.max[0] - self.min[0]).max(self.extent) + 2.0 * margin;
        let height = self.max[1] - self.min[1] + 2.0 * margin + 2.5 * self.text;
        [self.min[0] - margin, self.min[1] - margin, width, height]
    }
}

fn finite(ring: &Ring) -> impl Iterator<Item = [f64; 2]> + '_ {
    ring.points.iter().map(|p| p.map(f64::from)).filter(|[x, y]| x.is_finite() && y.is_finite())
}

/// Path data of a closed ring, with y down.
fn path(points: impl Iterator<Item = [f64; 2]>) -> String {
    let mut data = String::with_capacity(points.size_hint().0 * 18);
    for (i, [x, y]) in points.enumerate() {
        data.push(if i == 0 { 'M' } else { 'L' });
        // Adding zero turns −0 into 0.
        write!(data, "{:.2} {:.2}", x + 0.0, 0.0 - y).expect("writing to a string cannot fail");
    }
    if !data.is_empty() {
        data.push('Z');
    }
    data
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::cut::nested_rings;
    use crate::model::sample;

    #[test]
    fn a_small_section_is_drawn_as_agreed() {
        let square = |r: f32| Ring { ids: vec![0, 1, 2, 3], points: vec![[r, 0.0], [0.0, r], [-r, 0.0], [0.0, -r]] };
        let section = Section { step: 12.5, z_um: 375.0, added: true, inner: square(400.25), outer: square(1000.0) };
        insta::assert_snapshot!(section_svg(&section));
    }

    #[test]
    fn every_point_is_drawn() {
        let section = sample::section(100, 1.0, 2.0);
        let svg = section_svg(&section);
        // The inner ring is drawn twice: as a hole of the tissue, and as an outline.
        assert_eq!(svg.matches('L').count(), 3 * 99);
        assert!(svg.contains(&format!("M{:.2} 0.00L", section.outer.points[0][0])));
    }

    #[test]
    fn a_cut_is_drawn_with_its_islands_told_apart() {
        let square = |r: f64| vec![[r, 0.0], [0.0, r], [-r, 0.0], [0.0, -r]];
        let cut = nested_rings(Plane::across(12_345.0), vec![square(900.0), square(600.0), square(100.0)], false);
        insta::assert_snapshot!(cut_svg(&cut));
        let plane = Plane::through([0.0, 0.0, 1e4], [0.0, 1.0, 0.0]).unwrap();
        let svg = cut_svg(&nested_rings(plane, vec![square(900.0)], false));
        assert!(
            svg.contains("through (0.000, 0.000, 10.000) mm, normal (0.000, 1.000, 0.000)") && !svg.contains("islands")
        );
    }

    #[test]
    fn an_empty_section_and_strange_points_are_drawn_finite() {
        let mut section = sample::section(8, 0.0, 0.0);
        section.inner.points[0][0] = f32::NAN;
        section.outer.points[3][1] = f32::INFINITY;
        for svg in [section_svg(&section), section_svg(&Section::default())] {
            assert!(!svg.contains("inf") && !svg.contains("NaN"), "{svg}");
        }
    }
}
