//! Figures: drawings on a white page, each with a letter, a scale bar and a note.

use super::bar::Bar;
use super::drawing::Drawing;
use super::glyphs;
use super::picture::{INK, RenderError, encode, paint, pixmap};
use tiny_skia::{FilterQuality, PixmapPaint, Transform};

/// Pixels of a drawing per pixel of the page in each direction; the page smooths its drawings.
pub const OVERSAMPLING: u32 = 2;
/// Height of digits as a fraction of the width of the page, and its minimum in pixels.
const DIGIT: (f32, f32) = (0.0105, 7.0);
/// Maximum length of a bar, as a fraction of the width of its panel.
const LONGEST: f64 = 0.3;

/// A drawing and its place on a page.
#[derive(Clone, Copy, Debug)]
pub struct Panel<'a> {
    /// Left, top, width and height, pixels of the page.
    pub place: [u32; 4],
    /// Drawing in the middle of the place, [`OVERSAMPLING`] times as large as on the page.
    pub drawing: &'a Drawing,
    /// Letter in the upper left corner.
    pub letter: Option<char>,
    /// Text below the drawing, above the bar. It may have the characters of scale bars.
    pub note: &'a str,
    /// True if the panel has a scale bar in its lower left corner.
    pub bar: bool,
}

/// Height of the line of a note or bar, for a page of the given width, pixels.
#[must_use]
pub fn line_height(width: u32) -> u32 {
    (3.0 * digit(width)).ceil() as u32
}

fn digit(width: u32) -> f32 {
    (DIGIT.0 * width as f32).max(DIGIT.1).round()
}

/// Draws a page. A bar and a note each take [`line_height`] pixels at the bottom of their panel.
///
/// # Errors
/// [`RenderError::Size`] unless each side is from 1 to [`MAX_SIZE`](super::MAX_SIZE).
pub fn page_png([width, height]: [u32; 2], panels: &[Panel<'_>]) -> Result<Vec<u8>, RenderError> {
    let mut page = pixmap(width, height)?;
    let digit = digit(width);
    let paint = paint(INK);
    for panel in panels {
        let [left, top, wide, high] = panel.place.map(|side| side as f32);
        let line = line_height(width) as f32;
        let lines = u8::from(panel.bar) + u8::from(!panel.note.is_empty());
        let strip = f32::from(lines) * line;
        let factor = 1.0 / OVERSAMPLING as f32;
        let shown = panel.drawing.size().map(|side| side as f32 * factor);
        // At whole pixels, so that each pixel of the page is the mean of the pixels that it covers.
        let corner = [left + (wide - shown[0]) / 2.0, top + (high - strip - shown[1]) / 2.0].map(f32::round);
        let how = PixmapPaint { quality: FilterQuality::Bilinear, ..PixmapPaint::default() };
        let at = Transform::from_row(factor, 0.0, 0.0, factor, corner[0], corner[1]);
        page.draw_pixmap(0, 0, panel.drawing.pixmap.as_ref(), &how, at, None);
        if panel.bar {
            let middle = top + high - line / 2.0;
            let scale = panel.drawing.scale * f64::from(factor);
            let bar = Bar { digit, ink: INK };
            let most = LONGEST * f64::from(wide);
            bar.draw_at(&mut page, [left + digit, middle], most, scale, panel.drawing.axial_scale);
        }
        if !panel.note.is_empty() {
            let middle = top + high - strip + line / 2.0;
            let start = left + (wide - glyphs::width(panel.note, digit)) / 2.0;
            glyphs::draw(&mut page, panel.note, [start, middle - digit / 2.0], digit, &paint);
        }
        if let Some(letter) = panel.letter {
            glyphs::draw(&mut page, &format!("({letter})"), [left + digit, top + digit], 1.3 * digit, &paint);
        }
    }
    encode(&page)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::section::{SectionStyle, section_drawing};
    use tiny_skia::Pixmap;

    #[test]
    fn a_panel_has_its_drawing_in_the_middle_its_letter_and_a_bar_of_its_scale() {
        let section = crate::model::sample::section(90, 0.0, 0.0);
        // 2 mm is 400 pixels of the drawing and 200 pixels of the page.
        let drawing = section_drawing(&section, 5.0, SectionStyle::Loops { pen: 2.0 }).unwrap();
        let panel = Panel { place: [100, 50, 400, 340], drawing: &drawing, letter: Some('b'), note: "", bar: true };
        let page = Pixmap::decode_png(&page_png([600, 400], &[panel]).unwrap()).unwrap();
        let dark = |x: u32, y: u32| page.pixel(x, y).unwrap().red() < 140;
        let strip = line_height(600);
        let rows: Vec<u32> = (80..390 - strip).filter(|&y| (250..350).any(|x| dark(x, y))).collect();
        let middle = 50 + (340 - strip) / 2;
        assert!(rows[0].abs_diff(middle - 100) <= 2 && rows[rows.len() - 1].abs_diff(middle + 100) <= 2, "{rows:?}");
        let run = |y: u32| {
            let row: String = (100..500).map(|x| if dark(x, y) { '#' } else { ' ' }).collect();
            row.split(' ').map(str::len).max().unwrap_or(0)
        };
        // 0.3 of 400 pixels is 1.2 mm.
        assert_eq!((390 - strip..390).map(run).max(), Some(100), "1 mm");
        let letter = (50..80).flat_map(|y| (100..130).map(move |x| (x, y))).filter(|&(x, y)| dark(x, y)).count();
        assert!(letter > 20, "{letter}");
        assert!((0..400).all(|y| (0..95).chain(505..600).all(|x| !dark(x, y))), "nothing beyond its place");
    }

    #[test]
    fn notes_are_centred() {
        let section = crate::model::sample::section(90, 0.0, 0.0);
        let drawing = section_drawing(&section, 20.0, SectionStyle::Tissue).unwrap();
        let panel = Panel { place: [0, 0, 300, 200], drawing: &drawing, letter: None, note: "12.5 mm", bar: false };
        let page = Pixmap::decode_png(&page_png([300, 200], &[panel]).unwrap()).unwrap();
        let strip = 200 - line_height(300)..200;
        let inked: Vec<u32> =
            (0..300).filter(|&x| strip.clone().any(|y| page.pixel(x, y).unwrap().red() < 140)).collect();
        assert!((i64::from(inked[0]) - (299 - i64::from(inked[inked.len() - 1]))).abs() <= 2, "{inked:?}");
    }
}
