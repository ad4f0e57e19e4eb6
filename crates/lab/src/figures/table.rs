//! Tables as SVG in the style of the plots.

use std::fmt::Write as _;

/// Widths of the first column, and of the others.
const WIDTHS: [u32; 2] = [250, 220];
const ROW: u32 = 34;
const LINE: u32 = 20;
const MARGIN: u32 = 20;
const SIZE: u32 = 15;

/// Draws a table: lines of text at the head of each column, rows of cells, and the row below a
/// separating rule.
pub(super) fn svg(head: &[Vec<String>], rows: &[Vec<String>], rule_before: Option<usize>) -> String {
    let columns = head.len() as u32;
    let width = 2 * MARGIN + WIDTHS[0] + WIDTHS[1] * columns.saturating_sub(1);
    let lines = head.iter().map(Vec::len).max().unwrap_or(0) as u32;
    let body = MARGIN + LINE * lines + LINE / 2;
    let height = body + ROW * rows.len() as u32 + MARGIN;
    let mut svg = format!(
        "<svg width=\"{width}\" height=\"{height}\" viewBox=\"0 0 {width} {height}\" xmlns=\"http://www.w3.org/2000/svg\" \
         font-family=\"sans-serif\" font-size=\"{SIZE}\">\n<rect width=\"{width}\" height=\"{height}\" fill=\"#fff\"/>\n"
    );
    // The first column is left-aligned, the others are right-aligned.
    let place = |column: usize| {
        if column == 0 { (MARGIN, "start") } else { (MARGIN + WIDTHS[0] + WIDTHS[1] * column as u32, "end") }
    };
    for (column, cell) in head.iter().enumerate() {
        let (x, anchor) = place(column);
        for (line, text) in cell.iter().enumerate() {
            let y = MARGIN + LINE * line as u32 + SIZE;
            let style = if line == 0 { "font-weight=\"bold\"" } else { "fill=\"#555\"" };
            let _ =
                writeln!(svg, "<text x=\"{x}\" y=\"{y}\" text-anchor=\"{anchor}\" {style}>{}</text>", escaped(text));
        }
    }
    let rules = [Some(0), rule_before, Some(rows.len())];
    for row in rules.into_iter().flatten() {
        let y = body + ROW * row as u32;
        let right = width - MARGIN;
        let _ = writeln!(svg, "<line x1=\"{MARGIN}\" y1=\"{y}\" x2=\"{right}\" y2=\"{y}\" stroke=\"#000\"/>");
    }
    for (row, cells) in rows.iter().enumerate() {
        let y = body + ROW * row as u32 + (ROW + SIZE) / 2 - 2;
        for (column, text) in cells.iter().enumerate() {
            let (x, anchor) = place(column);
            let _ = writeln!(svg, "<text x=\"{x}\" y=\"{y}\" text-anchor=\"{anchor}\">{}</text>", escaped(text));
        }
    }
    svg + "</svg>\n"
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_has_all_its_cells_and_escapes_them() {
        let text = |cells: &[&str]| cells.iter().map(|&cell| cell.to_owned()).collect::<Vec<_>>();
        let svg = svg(&[text(&["name"]), text(&["a", "b < c"])], &[text(&["x", "1"]), text(&["y", "2&3"])], Some(1));
        assert_eq!((svg.matches("<text").count(), svg.matches("<line").count()), (7, 3));
        assert!(svg.contains("b &lt; c") && svg.contains("2&amp;3"));
    }
}
