//! Text of scale bars and panels, drawn with strokes. Only the characters that they need exist.

use tiny_skia::{LineCap, LineJoin, Paint, PathBuilder, Pixmap, Stroke, Transform};

/// Height of a capital letter or digit, in units of the glyphs.
const HEIGHT: f32 = 7.0;
/// Width of strokes, in units of the glyphs.
const PEN: f32 = 0.9;
/// Space between glyphs, in units of the glyphs.
const SPACING: f32 = 1.5;

/// Characters with their widths and strokes. Strokes are SVG path data of moves (M), lines (L) and
/// quadratic curves (Q). y points down, from the top of a digit at 0 to the baseline at 7.
const GLYPHS: [(char, f32, &str); 27] = [
    (' ', 1.6, ""),
    ('.', 0.2, "M.1 7 L.1 6.9"),
    ('(', 1.6, "M1.6 -1 Q0 .9 0 3.5 Q0 6.3 1.6 8.6"),
    (')', 1.6, "M0 -1 Q1.6 .9 1.6 3.5 Q1.6 6.3 0 8.6"),
    ('×', 3.6, "M0 2.7 L3.6 6.3 M3.6 2.7 L0 6.3"),
    ('0', 4.2, "M2.1 0 Q0 0 0 3.5 Q0 7 2.1 7 Q4.2 7 4.2 3.5 Q4.2 0 2.1 0"),
    ('1', 2.2, "M0 1.6 L2.2 0 L2.2 7"),
    ('2', 4.2, "M.1 1.9 Q.1 0 2.1 0 Q4.1 0 4.1 1.9 Q4.1 3.2 2.6 4.6 L0 7 L4.2 7"),
    ('3', 4.1, "M.1 0 L4 0 L2 2.7 Q4.1 2.8 4.1 4.8 Q4.1 7 2 7 Q.5 7 0 5.8"),
    ('4', 4.4, "M3 0 L0 5 L4.4 5 M3.3 3 L3.3 7"),
    ('5', 4.1, "M3.8 0 L.6 0 L.3 3 Q1 2.5 2 2.5 Q4.1 2.5 4.1 4.7 Q4.1 7 2 7 Q.6 7 0 5.9"),
    ('6', 4.2, "M3.1 0 Q0 2.4 0 4.8 Q0 7 2.1 7 Q4.2 7 4.2 4.8 Q4.2 2.7 2.1 2.7 Q.6 2.7 .1 4"),
    ('7', 4.1, "M0 0 L4.1 0 L1.4 7"),
    (
        '8',
        4.2,
        "M2.1 3.2 Q.2 3.2 .2 1.6 Q.2 0 2.1 0 Q4 0 4 1.6 Q4 3.2 2.1 3.2 Q0 3.2 0 5.1 Q0 7 2.1 7 Q4.2 7 4.2 5.1 Q4.2 3.2 2.1 3.2",
    ),
    ('9', 4.2, "M1.1 7 Q4.2 4.6 4.2 2.2 Q4.2 0 2.1 0 Q0 0 0 2.2 Q0 4.3 2.1 4.3 Q3.6 4.3 4.1 3"),
    ('a', 3.7, "M.4 2.9 Q.9 2 2 2 Q3.7 2 3.7 3.6 L3.7 7 M3.7 4.2 L2 4.3 Q0 4.4 0 5.8 Q0 7 1.5 7 Q3.2 7 3.7 5.7"),
    ('b', 3.8, "M0 0 L0 7 M0 4.5 Q0 2 1.9 2 Q3.8 2 3.8 4.5 Q3.8 7 1.9 7 Q0 7 0 4.5"),
    ('c', 3.5, "M3.5 2.9 Q3 2 1.9 2 Q0 2 0 4.5 Q0 7 1.9 7 Q3 7 3.5 6.1"),
    ('d', 3.8, "M3.8 0 L3.8 7 M3.8 4.5 Q3.8 2 1.9 2 Q0 2 0 4.5 Q0 7 1.9 7 Q3.8 7 3.8 4.5"),
    ('e', 3.9, "M0 4.4 L3.9 4.4 Q3.9 2 2 2 Q0 2 0 4.5 Q0 7 2 7 Q3.3 7 3.7 6.2"),
    (
        'g',
        3.8,
        "M3.8 2 L3.8 7 Q3.8 9.2 1.9 9.2 Q.7 9.2 .2 8.4 M3.8 4.5 Q3.8 2 1.9 2 Q0 2 0 4.5 Q0 7 1.9 7 Q3.8 7 3.8 4.5",
    ),
    ('h', 3.6, "M0 0 L0 7 M0 4.2 Q0 2 1.9 2 Q3.6 2 3.6 4 L3.6 7"),
    ('l', 0.0, "M0 0 L0 7"),
    ('m', 6.2, "M0 2 L0 7 M0 4 Q0 2 1.7 2 Q3.1 2 3.1 4 L3.1 7 M3.1 4 Q3.1 2 4.8 2 Q6.2 2 6.2 4 L6.2 7"),
    ('n', 3.6, "M0 2 L0 7 M0 4.2 Q0 2 1.9 2 Q3.6 2 3.6 4 L3.6 7"),
    ('t', 2.3, "M.9 .5 L.9 5.7 Q.9 7 2.3 7 M0 2 L2.3 2"),
    ('µ', 3.7, "M0 2 L0 9.2 M0 4.7 Q0 7 1.8 7 Q3.7 7 3.7 4.6 M3.7 2 L3.7 7"),
];

/// Draws a text from `left`, with digits from `top` to `top + height`. Characters without a glyph
/// are omitted. Returns the x coordinate of the end of the text.
pub(super) fn draw(pixmap: &mut Pixmap, text: &str, [left, top]: [f32; 2], height: f32, paint: &Paint<'_>) -> f32 {
    let unit = height / HEIGHT;
    let stroke = Stroke { width: PEN, line_cap: LineCap::Round, line_join: LineJoin::Round, ..Stroke::default() };
    let mut x = left;
    for (width, strokes) in text.chars().filter_map(glyph) {
        if let Some(path) = path(strokes) {
            pixmap.stroke_path(&path, paint, &stroke, Transform::from_row(unit, 0.0, 0.0, unit, x, top), None);
        }
        x += (width + SPACING) * unit;
    }
    x - SPACING * unit
}

/// Width of a text in the unit of `height`.
pub(super) fn width(text: &str, height: f32) -> f32 {
    let advances: f32 = text.chars().filter_map(glyph).map(|(width, _)| width + SPACING).sum();
    (advances - SPACING).max(0.0) * height / HEIGHT
}

fn glyph(character: char) -> Option<(f32, &'static str)> {
    GLYPHS.iter().find(|(known, ..)| *known == character).map(|&(_, width, strokes)| (width, strokes))
}

fn path(strokes: &str) -> Option<tiny_skia::Path> {
    let mut builder = PathBuilder::new();
    let mut rest = strokes;
    while let Some(command) = rest.chars().next() {
        let end = rest[1..].find(|c: char| c.is_ascii_uppercase()).map_or(rest.len(), |at| at + 1);
        let numbers: Vec<f32> = rest[1..end].split_whitespace().filter_map(|number| number.parse().ok()).collect();
        match (command, &numbers[..]) {
            ('M', &[x, y]) => builder.move_to(x, y),
            ('L', &[x, y]) => builder.line_to(x, y),
            ('Q', &[x1, y1, x, y]) => builder.quad_to(x1, y1, x, y),
            _ => return None,
        }
        rest = &rest[end..];
    }
    builder.finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_glyph_is_a_path_within_its_width() {
        for (character, width, strokes) in GLYPHS {
            let Some(path) = path(strokes) else {
                assert_eq!(character, ' ');
                continue;
            };
            let bounds = path.bounds();
            assert!(bounds.left() >= 0.0 && bounds.right() <= width + 0.11, "{character}: {bounds:?}");
            assert!(bounds.top() >= -1.0 && bounds.bottom() <= 9.2, "{character}: {bounds:?}");
        }
    }

    #[test]
    fn a_text_covers_its_width() {
        let mut pixmap = Pixmap::new(200, 40).unwrap();
        let right = draw(&mut pixmap, "☃500 µm", [10.0, 10.0], 14.0, &Paint::default());
        assert!((right - 10.0 - width("☃500 µm", 14.0)).abs() < 1e-3);
        let inked = |x: u32| (0..40).any(|y| pixmap.pixel(x, y).unwrap().alpha() > 100);
        let columns: Vec<u32> = (0..200).filter(|&x| inked(x)).collect();
        assert!(columns[0].abs_diff(10) <= 1 && (*columns.last().unwrap() as f32 - right).abs() <= 1.5, "{columns:?}");
    }
}
