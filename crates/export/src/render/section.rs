//! Pictures of sections: tissue filled, lumen outlined, y up, with a scale bar of 500 µm.

use super::drawing::Drawing;
use super::picture::{INK, LUMEN, OUTLINE, RenderError, TISSUE, encode, paint, pixmap};
use crate::model::{Border, Section};
use tiny_skia::{FillRule, LineJoin, Path, PathBuilder, Pixmap, Rect, Stroke, Transform};

/// Length of the scale bar, micrometres.
const BAR_UM: f32 = 500.0;
/// Margin of a picture, as a fraction of its side.
const MARGIN: f32 = 0.05;

/// Draws sections or cuts in rows of `columns`, each in a square of `cell` pixels, all at the same
/// scale.
///
/// # Errors
/// [`RenderError::Size`] unless each side of the whole picture is from 1 to
/// [`MAX_SIZE`](super::MAX_SIZE).
pub fn sheet_png(sections: &[[Border; 2]], columns: usize, cell: u32) -> Result<Vec<u8>, RenderError> {
    let columns = columns.clamp(1, sections.len().max(1));
    let rows = sections.len().div_ceil(columns);
    let side = |cells: usize| u32::try_from(cells).unwrap_or(u32::MAX).saturating_mul(cell);
    let mut pixmap = pixmap(side(columns), side(rows))?;
    let extents = sections.iter().filter_map(bounds).map(|b| b.width().max(b.height()));
    let largest = extents.fold(1.0, f32::max);
    let cell = cell as f32;
    let scale = cell * (1.0 - 2.0 * MARGIN) / largest;
    for (i, section) in sections.iter().enumerate() {
        let corner = [(i % columns) as f32 * cell, (i / columns) as f32 * cell];
        draw(&mut pixmap, section, corner, cell, scale);
    }
    encode(&pixmap)
}

/// Style of the drawing of a section.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SectionStyle {
    /// Tissue filled, lumen outlined, as in [`sheet_png`].
    Tissue,
    /// Both contours as lines, as in the paper's Figure 4.
    Loops {
        /// Width of the lines, pixels.
        pen: f32,
    },
}

/// Draws a section to scale on a transparent background, with a margin and without a bar.
///
/// # Errors
/// [`RenderError::Size`] if a side is above [`MAX_SIZE`](super::MAX_SIZE) or the section has no
/// finite point.
pub fn section_drawing(section: &Section, um_per_pixel: f64, style: SectionStyle) -> Result<Drawing, RenderError> {
    let scale = (1.0 / um_per_pixel) as f32;
    let borders = section.borders();
    let bounds = bounds(&borders).ok_or(RenderError::Size { width: 0, height: 0 })?;
    let margin = 2.0 * MARGIN * bounds.width().max(bounds.height());
    let [width, height] = [bounds.width(), bounds.height()].map(|extent| (scale * (extent + margin)).ceil() as u32);
    let mut pixmap = pixmap(width, height)?;
    pixmap.fill(tiny_skia::Color::TRANSPARENT);
    let middle = [width, height].map(|side| side as f32 / 2.0);
    let place = centred(&bounds, middle, scale);
    match style {
        SectionStyle::Tissue => {
            tissue(&mut pixmap, &borders, place, (width.max(height) as f32 / 250.0).max(1.0) / scale);
        }
        SectionStyle::Loops { pen } => {
            if let Some(loops) = path(&borders.each_ref()) {
                let stroke = Stroke { width: pen / scale, line_join: LineJoin::Round, ..Stroke::default() };
                pixmap.stroke_path(&loops, &paint(INK), &stroke, place, None);
            }
        }
    }
    Ok(Drawing { pixmap, scale: 1e6 * f64::from(scale), axial_scale: 1.0 })
}

/// Width and height of a section, micrometres; `None` if it has no finite point.
#[must_use]
pub fn extent_um(section: &Section) -> Option<[f64; 2]> {
    bounds(&section.borders()).map(|bounds| [f64::from(bounds.width()), f64::from(bounds.height())])
}

/// Transform that moves the middle of `bounds` to a position in the picture, y up.
fn centred(bounds: &Rect, [x, y]: [f32; 2], scale: f32) -> Transform {
    let middle = [(bounds.left() + bounds.right()) / 2.0, (bounds.top() + bounds.bottom()) / 2.0];
    Transform::from_row(scale, 0.0, 0.0, -scale, x - scale * middle[0], y + scale * middle[1])
}

/// Fills the tissue and outlines the lumen. `line` is the width of the outline, micrometres.
fn tissue(pixmap: &mut Pixmap, section: &[Border; 2], place: Transform, line: f32) {
    let [mucosa, outside] = section;
    if let Some(tissue) = path(&[outside, mucosa]) {
        pixmap.fill_path(&tissue, &paint(TISSUE), FillRule::EvenOdd, place, None);
    }
    if let Some(lumen) = path(&[mucosa]) {
        pixmap.fill_path(&lumen, &paint(LUMEN), FillRule::EvenOdd, place, None);
        let stroke = Stroke { width: line, line_join: LineJoin::Round, ..Stroke::default() };
        pixmap.stroke_path(&lumen, &paint(OUTLINE), &stroke, place, None);
    }
}

/// Draws a section with its bar into the cell at `corner`. `scale` is in pixels per micrometre.
fn draw(pixmap: &mut Pixmap, section: &[Border; 2], corner: [f32; 2], cell: f32, scale: f32) {
    if let Some(bounds) = bounds(section) {
        let place = centred(&bounds, [corner[0] + cell / 2.0, corner[1] + cell / 2.0], scale);
        // At least a pixel wide, and thin enough for the narrowest gaps of a large picture.
        tissue(pixmap, section, place, (cell / 250.0).max(1.0) / scale);
    }
    let bar = BAR_UM * scale;
    let left = corner[0] + cell * MARGIN / 2.0;
    let top = corner[1] + cell * (1.0 - MARGIN / 2.0);
    if let Some(rect) = Rect::from_xywh(left, top, bar, (cell / 160.0).max(1.0)) {
        pixmap.fill_rect(rect, &paint(INK), Transform::identity(), None);
    }
}

/// Bounds in micrometres with y up, so `top` is the minimum y; `None` if no point is finite.
fn bounds(section: &[Border; 2]) -> Option<Rect> {
    let points = || section.iter().flat_map(Border::points).filter(is_finite);
    let range = |axis: usize| {
        points().map(|p| p[axis]).fold((f32::INFINITY, f32::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)))
    };
    let ((left, right), (top, bottom)) = (range(0), range(1));
    Rect::from_ltrb(left, top, right, bottom)
}

/// Path of the closed lines of borders. Lines with fewer than three finite points are omitted;
/// `None` if no line remains.
fn path(borders: &[&Border]) -> Option<Path> {
    let mut builder = PathBuilder::new();
    for line in borders.iter().flat_map(|border| &border.lines) {
        let points = || line.points.iter().copied().filter(is_finite);
        if points().count() < 3 {
            continue;
        }
        for (i, [x, y]) in points().enumerate() {
            if i == 0 {
                builder.move_to(x, y);
            } else {
                builder.line_to(x, y);
            }
        }
        builder.close();
    }
    builder.finish()
}

fn is_finite(point: &[f32; 2]) -> bool {
    point.iter().all(|x| x.is_finite())
}

#[cfg(test)]
mod tests {
    use super::super::picture::{BACKGROUND, Rgb};
    use super::*;
    use crate::model::{Ring, sample};

    fn square(r: f32, shift: [f32; 2]) -> Ring {
        let points = [[r, -r], [r, r], [-r, r], [-r, -r]].map(|[x, y]| [x + shift[0], y + shift[1]]);
        Ring { ids: vec![0, 1, 2, 3], points: points.to_vec() }
    }

    fn pixel(picture: &Pixmap, x: u32, y: u32) -> Rgb {
        let p = picture.pixel(x, y).unwrap();
        [p.red(), p.green(), p.blue()]
    }

    #[test]
    fn tissue_lumen_and_bar_are_where_they_belong() {
        // y points up, so the lumen lies in the upper right quarter.
        let section =
            Section { inner: square(200.0, [500.0, 500.0]), outer: square(1000.0, [0.0; 2]), ..Section::default() };
        let picture = Pixmap::decode_png(&sheet_png(&[section.borders()], 1, 1000).unwrap()).unwrap();
        assert_eq!(pixel(&picture, 725, 275), LUMEN);
        assert_eq!(pixel(&picture, 275, 725), TISSUE);
        assert_eq!(pixel(&picture, 725, 725), TISSUE);
        assert_eq!(pixel(&picture, 635, 275), OUTLINE);
        assert_eq!(pixel(&picture, 15, 15), BACKGROUND);
        // 2 mm is 900 pixels, so 500 µm is 225 pixels, from column 25.
        let row: Vec<u32> = (0..1000).filter(|&x| pixel(&picture, x, 978) == INK).collect();
        assert_eq!(row, (25..250).collect::<Vec<_>>());
    }

    #[test]
    fn a_sheet_has_one_scale() {
        let (small, large) = (square(250.0, [0.0; 2]), square(1000.0, [0.0; 2]));
        let sections = [small, large].map(|outer| Section { outer, ..Section::default() });
        let picture =
            Pixmap::decode_png(&sheet_png(&sections.map(|section| section.borders()), 2, 100).unwrap()).unwrap();
        assert_eq!((picture.width(), picture.height()), (200, 100));
        let tissue = |cell: u32| (cell * 100..cell * 100 + 100).filter(|&x| pixel(&picture, x, 50) == TISSUE).count();
        assert_eq!(tissue(1), 90);
        assert!((22..=24).contains(&tissue(0)), "{}", tissue(0));
    }

    #[test]
    fn loops_are_two_closed_lines_to_scale() {
        let section =
            Section { inner: square(200.0, [500.0, 500.0]), outer: square(1000.0, [0.0; 2]), ..Section::default() };
        let drawing = section_drawing(&section, 4.0, SectionStyle::Loops { pen: 4.0 }).unwrap();
        assert_eq!((drawing.size(), drawing.um_per_pixel()), ([550, 550], 4.0));
        let inked = |x: u32, y: u32| drawing.pixmap.pixel(x, y).unwrap().alpha() > 127;
        // A row through both contours crosses each twice.
        let row: Vec<bool> = (0..550).map(|x| inked(x, 150)).collect();
        assert_eq!(row.chunk_by(|a, b| a == b).filter(|run| run[0]).map(<[bool]>::len).collect::<Vec<_>>(), [4; 4]);
        assert_eq!(row.iter().position(|&on| on), Some(23));
        // Points outside, between and inside the contours are transparent.
        assert!(!inked(5, 5) && !inked(275, 400) && !inked(400, 150));
        assert!(section_drawing(&Section::default(), 4.0, SectionStyle::Tissue).is_err());
        assert_eq!(extent_um(&section), Some([2000.0, 2000.0]));
    }

    #[test]
    fn sizes_out_of_bounds_and_empty_sections() {
        let section = sample::section(20, 0.0, 0.0).borders();
        assert!(matches!(sheet_png(std::slice::from_ref(&section), 1, 0), Err(RenderError::Size { .. })));
        assert!(matches!(sheet_png(&vec![section; 9], 9, 1000), Err(RenderError::Size { .. })));
        assert!(matches!(sheet_png(&[], 3, 100), Err(RenderError::Size { .. })));
        assert!(sheet_png(&[Section::default().borders()], 1, 10).is_ok());
    }
}
