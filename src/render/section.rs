//! Sections as in a histological slide: tissue filled, lumen outlined, y up, a scale bar of 500 µm.

use super::picture::{INK, LUMEN, OUTLINE, RenderError, Rgb, TISSUE, color, encode, pixmap};
use crate::model::{Ring, Section};
use tiny_skia::{FillRule, LineJoin, Paint, Path, PathBuilder, Pixmap, Rect, Stroke, Transform};

/// Length of the scale bar, micrometres.
const BAR_UM: f32 = 500.0;
/// Margin of a picture, as a fraction of its side.
const MARGIN: f32 = 0.05;

/// Draws sections side by side in rows of `columns`, each in a square of `cell` pixels, all to one scale.
///
/// # Errors
/// [`RenderError::Size`] unless each side of the whole picture is from 1 to [`MAX_SIZE`](super::MAX_SIZE).
pub fn sheet_png(sections: &[&Section], columns: usize, cell: u32) -> Result<Vec<u8>, RenderError> {
    let columns = columns.clamp(1, sections.len().max(1));
    let rows = sections.len().div_ceil(columns);
    let side = |cells: usize| u32::try_from(cells).unwrap_or(u32::MAX).saturating_mul(cell);
    let mut pixmap = pixmap(side(columns), side(rows))?;
    let extents = sections.iter().filter_map(|section| bounds(section)).map(|b| b.width().max(b.height()));
    let largest = extents.fold(1.0, f32::max);
    let cell = cell as f32;
    let scale = cell * (1.0 - 2.0 * MARGIN) / largest;
    for (i, section) in sections.iter().enumerate() {
        let corner = [(i % columns) as f32 * cell, (i / columns) as f32 * cell];
        draw(&mut pixmap, section, corner, cell, scale);
    }
    encode(&pixmap)
}

/// Draws into the cell at `corner`; `scale` is in pixels per micrometre.
fn draw(pixmap: &mut Pixmap, section: &Section, corner: [f32; 2], cell: f32, scale: f32) {
    let middle = bounds(section).map_or([0.0; 2], |b| [(b.left() + b.right()) / 2.0, (b.top() + b.bottom()) / 2.0]);
    let place = Transform::from_row(
        scale,
        0.0,
        0.0,
        -scale,
        corner[0] + cell / 2.0 - scale * middle[0],
        corner[1] + cell / 2.0 + scale * middle[1],
    );
    if let Some(tissue) = path(&[&section.outer, &section.inner]) {
        pixmap.fill_path(&tissue, &paint(TISSUE), FillRule::EvenOdd, place, None);
    }
    if let Some(lumen) = path(&[&section.inner]) {
        pixmap.fill_path(&lumen, &paint(LUMEN), FillRule::EvenOdd, place, None);
        // At least a pixel wide, and thin enough for the narrowest gaps of a large picture.
        let width = (cell / 250.0).max(1.0) / scale;
        let stroke = Stroke { width, line_join: LineJoin::Round, ..Stroke::default() };
        pixmap.stroke_path(&lumen, &paint(OUTLINE), &stroke, place, None);
    }
    let bar = BAR_UM * scale;
    let left = corner[0] + cell * MARGIN / 2.0;
    let top = corner[1] + cell * (1.0 - MARGIN / 2.0);
    if let Some(rect) = Rect::from_xywh(left, top, bar, (cell / 160.0).max(1.0)) {
        pixmap.fill_rect(rect, &paint(INK), Transform::identity(), None);
    }
}

fn paint(rgb: Rgb) -> Paint<'static> {
    let mut paint = Paint { anti_alias: true, ..Paint::default() };
    paint.set_color(color(rgb));
    paint
}

/// Bounds in micrometres with y up (`top` is the least y); none if no point is finite.
fn bounds(section: &Section) -> Option<Rect> {
    let points = || finite(&section.outer).chain(finite(&section.inner));
    let range = |axis: usize| {
        points().map(|p| p[axis]).fold((f32::INFINITY, f32::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)))
    };
    let ((left, right), (top, bottom)) = (range(0), range(1));
    Rect::from_ltrb(left, top, right, bottom)
}

/// One path of several closed rings; none if fewer than three points are finite.
fn path(rings: &[&Ring]) -> Option<Path> {
    let mut builder = PathBuilder::new();
    for ring in rings.iter().filter(|ring| finite(ring).count() >= 3) {
        for (i, [x, y]) in finite(ring).enumerate() {
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

fn finite(ring: &Ring) -> impl Iterator<Item = [f32; 2]> + '_ {
    ring.points.iter().copied().filter(|[x, y]| x.is_finite() && y.is_finite())
}

#[cfg(test)]
mod tests {
    use super::super::picture::BACKGROUND;
    use super::*;
    use crate::model::sample;

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
        // The lumen lies in the upper right quarter: y points up.
        let section =
            Section { inner: square(200.0, [500.0, 500.0]), outer: square(1000.0, [0.0; 2]), ..Section::default() };
        let picture = Pixmap::decode_png(&sheet_png(&[&section], 1, 1000).unwrap()).unwrap();
        assert_eq!(pixel(&picture, 725, 275), LUMEN);
        assert_eq!(pixel(&picture, 275, 725), TISSUE);
        assert_eq!(pixel(&picture, 725, 725), TISSUE);
        assert_eq!(pixel(&picture, 635, 275), OUTLINE);
        assert_eq!(pixel(&picture, 15, 15), BACKGROUND);
        // 500 µm at 900 pixels for 2 mm: 225 pixels from 25.
        let row: Vec<u32> = (0..1000).filter(|&x| pixel(&picture, x, 978) == INK).collect();
        assert_eq!(row, (25..250).collect::<Vec<_>>());
    }

    #[test]
    fn a_sheet_has_one_scale() {
        let (small, large) = (square(250.0, [0.0; 2]), square(1000.0, [0.0; 2]));
        let sections = [small, large].map(|outer| Section { outer, ..Section::default() });
        let picture = Pixmap::decode_png(&sheet_png(&[&sections[0], &sections[1]], 2, 100).unwrap()).unwrap();
        assert_eq!((picture.width(), picture.height()), (200, 100));
        let tissue = |cell: u32| (cell * 100..cell * 100 + 100).filter(|&x| pixel(&picture, x, 50) == TISSUE).count();
        assert_eq!(tissue(1), 90);
        assert!((22..=24).contains(&tissue(0)), "{}", tissue(0));
    }

    #[test]
    fn sizes_out_of_bounds_and_empty_sections() {
        let section = sample::section(20, 0.0, 0.0);
        assert!(matches!(sheet_png(&[&section], 1, 0), Err(RenderError::Size { .. })));
        assert!(matches!(sheet_png(&[&section; 9], 9, 1000), Err(RenderError::Size { .. })));
        assert!(matches!(sheet_png(&[], 3, 100), Err(RenderError::Size { .. })));
        assert!(sheet_png(&[&Section::default()], 1, 10).is_ok());
    }
}
