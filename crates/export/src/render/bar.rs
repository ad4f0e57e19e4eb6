//! Scale bars, with their length and the factor on lengths along the tube.

use super::glyphs;
use super::picture::{Rgb, paint};
use tiny_skia::{Pixmap, Rect, Transform};

/// Minimum of the longest side of a picture with a bar, pixels. The text would be illegible in
/// smaller ones.
const MIN_SIDE: u32 = 256;
/// Maximum length of a bar, as a fraction of the width of the picture.
const LONGEST: f64 = 0.2;
/// Height of digits as a fraction of the longest side, and its minimum in pixels.
const DIGIT: (f32, f32) = (0.0135, 7.0);
/// Colour that is legible on light and on dark pages.
const INK: Rgb = [0x8a, 0x80, 0x88];

/// Style of the scale bar of a picture.
pub(super) struct Bar {
    /// Height of digits, pixels.
    pub(super) digit: f32,
    pub(super) ink: Rgb,
}

impl Bar {
    /// Style for a picture; `None` if the picture is too small.
    pub(super) fn new([width, height]: [u32; 2]) -> Option<Self> {
        let side = width.max(height);
        (side >= MIN_SIDE).then(|| Self { digit: (DIGIT.0 * side as f32).max(DIGIT.1), ink: INK })
    }

    /// Height of the strip that the bar needs at the bottom of the picture, pixels.
    pub(super) fn strip(&self) -> f32 {
        2.0 * self.digit
    }

    /// Draws the bar into the lower left corner. `scale` is in pixels per metre.
    pub(super) fn draw(&self, pixmap: &mut Pixmap, scale: f64, axial_scale: f64) {
        let place = [2.0 * self.digit, pixmap.height() as f32 - 2.2 * self.digit];
        let most = LONGEST * f64::from(pixmap.width());
        self.draw_at(pixmap, place, most, scale, axial_scale);
    }

    /// Draws the bar from `left`, centred vertically at `middle`. Without its text, it is at most
    /// `most` pixels long.
    pub(super) fn draw_at(
        &self,
        pixmap: &mut Pixmap,
        [left, middle]: [f32; 2],
        most: f64,
        scale: f64,
        axial_scale: f64,
    ) {
        let (length, label) = round(most / scale);
        let paint = paint(self.ink);
        let (left, thickness) = (left.round(), (self.digit / 5.0).round().max(1.0));
        let middle = middle.round();
        let bar = Rect::from_xywh(left, middle - thickness, (length * scale) as f32, 2.0 * thickness);
        let Some(bar) = bar else { return };
        pixmap.fill_rect(bar, &paint, Transform::identity(), None);
        let top = middle - self.digit / 2.0;
        let end = glyphs::draw(pixmap, &label, [bar.right() + self.digit, top], self.digit, &paint);
        if (axial_scale - 1.0).abs() > f64::EPSILON {
            let note = format!("length × {axial_scale}");
            glyphs::draw(pixmap, &note, [end + 3.0 * self.digit, top], self.digit, &paint);
        }
    }
}

/// Largest length up to `most` that is 1, 2 or 5 times a power of ten, metres, with its text.
fn round(most: f64) -> (f64, String) {
    // A loop instead of a logarithm, whose last bit may differ between machines.
    let mut power = -12;
    while 10f64.powi(power + 1) <= most && power < 12 {
        power += 1;
    }
    let digit = [5, 2].into_iter().find(|digit| f64::from(*digit) * 10f64.powi(power) <= most).unwrap_or(1);
    let (unit, name) = match power {
        ..-3 => (-6, "µm"),
        -3..0 => (-3, "mm"),
        _ => (0, "m"),
    };
    let decimals = usize::try_from(unit - power).unwrap_or(0);
    let shown = f64::from(digit) * 10f64.powi(power - unit);
    (f64::from(digit) * 10f64.powi(power), format!("{shown:.decimals$} {name}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_are_round_and_written_with_their_unit() {
        for (most, length, text) in [
            (0.99e-3, 5e-4, "500 µm"),
            (1.01e-3, 1e-3, "1 mm"),
            (2.5e-3, 2e-3, "2 mm"),
            (0.06, 0.05, "50 mm"),
            (7.0, 5.0, "5 m"),
            (2.1e-7, 2e-7, "0.2 µm"),
        ] {
            let (found, label) = round(most);
            assert!((found / length - 1.0).abs() < 1e-12, "{most}: {found}");
            assert_eq!(label, text);
        }
    }

    #[test]
    fn the_bar_is_as_long_as_it_says() {
        let mut pixmap = Pixmap::new(600, 400).unwrap();
        // 20 % of the width is 1.2 mm.
        Bar::new([600, 400]).unwrap().draw(&mut pixmap, 1e5, 1.0);
        let runs = (0..400).map(|y| {
            let row: String =
                (0..600).map(|x| if pixmap.pixel(x, y).unwrap().alpha() == 255 { '#' } else { ' ' }).collect();
            row.split(' ').map(str::len).max().unwrap_or(0)
        });
        assert_eq!(runs.max(), Some(100), "1 mm at 100 pixels");
    }

    #[test]
    fn small_pictures_have_no_bar() {
        assert!(Bar::new([MIN_SIDE - 1, 100]).is_none() && Bar::new([MIN_SIDE, 100]).is_some());
    }
}
