//! Plots of curves as SVG, linear or logarithmic.

use anyhow::anyhow;
use plotters::chart::ChartContext;
pub(crate) use plotters::chart::SeriesLabelPosition;
use plotters::coord::cartesian::Cartesian2d;
use plotters::coord::ranged1d::ValueFormatter;
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;

const SIZE: (u32, u32) = (960, 600);
/// Colours that can be distinguished in print and by colour-blind people (Okabe and Ito).
const COLOURS: [RGBColor; 8] = [
    RGBColor(0, 0, 0),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
    RGBColor(0, 158, 115),
    RGBColor(213, 94, 0),
    RGBColor(0, 114, 178),
    RGBColor(204, 121, 167),
    RGBColor(240, 228, 66),
];

/// A curve and its name. The points of a curve with few points are marked.
pub(crate) struct Line {
    pub(crate) label: String,
    /// Each (x, y), ascending in x.
    pub(crate) points: Vec<(f64, f64)>,
}

/// Title and labels of the axes.
pub(crate) struct Axes {
    pub(crate) title: String,
    pub(crate) x: &'static str,
    pub(crate) y: &'static str,
    /// Formats a number on the x axis.
    pub(crate) x_tick: fn(f64) -> String,
    /// Position of the legend, where it does not cover the curves.
    pub(crate) names: SeriesLabelPosition,
}

/// Scale of the y axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Scale {
    Linear,
    Logarithmic,
}

/// Formats a number on an axis as an integer.
pub(crate) fn whole(n: f64) -> String {
    format!("{n:.0}")
}

/// Curves in one system of axes, with x starting at 0.
pub(crate) struct Panel {
    pub(crate) axes: Axes,
    pub(crate) lines: Vec<Line>,
    pub(crate) scale: Scale,
}

/// Draws curves.
///
/// # Errors
/// If the plot cannot be drawn.
pub(crate) fn draw(axes: &Axes, lines: &[Line], scale: Scale) -> anyhow::Result<String> {
    let drawn = |area: &Area<'_>| panel(area, axes, lines, scale);
    picture(1, |areas| areas.iter().try_for_each(drawn))
}

/// Draws panels below each other.
///
/// # Errors
/// If the plot cannot be drawn.
pub(crate) fn draw_all(panels: &[Panel]) -> anyhow::Result<String> {
    let drawn = |(area, of): (&Area<'_>, &Panel)| panel(area, &of.axes, &of.lines, of.scale);
    picture(panels.len(), |areas| areas.iter().zip(panels).try_for_each(drawn))
}

type PlotResult<T> = Result<T, Box<dyn std::error::Error>>;
type Area<'a> = DrawingArea<SVGBackend<'a>, plotters::coord::Shift>;

fn picture(panels: usize, draw: impl FnOnce(&[Area<'_>]) -> PlotResult<()>) -> anyhow::Result<String> {
    let mut svg = String::new();
    let drawn = || -> PlotResult<()> {
        let root = SVGBackend::with_string(&mut svg, (SIZE.0, SIZE.1 * panels as u32)).into_drawing_area();
        root.fill(&WHITE)?;
        draw(&root.split_evenly((panels, 1)))?;
        Ok(root.present()?)
    };
    drawn().map_err(|error| anyhow!("the plot could not be drawn: {error}"))?;
    Ok(svg)
}

fn panel(area: &Area<'_>, axes: &Axes, lines: &[Line], scale: Scale) -> PlotResult<()> {
    let all = || lines.iter().flat_map(|line| &line.points);
    let most = all().fold(1.0f64, |m, p| m.max(p.0));
    let highest = all().fold(f64::MIN_POSITIVE, |m, p| m.max(p.1));
    // Without points, any range is valid.
    let lowest = all().fold(highest, |m, p| m.min(p.1));
    let mut builder = ChartBuilder::on(area);
    builder.caption(&axes.title, ("sans-serif", 17)).margin(14).x_label_area_size(46).y_label_area_size(72);
    let x = 0.0..1.02 * most;
    match scale {
        Scale::Linear => curves(&mut builder.build_cartesian_2d(x, 0.0..1.05 * highest)?, axes, lines),
        Scale::Logarithmic => {
            let y = (0.5 * lowest..2.0 * highest).log_scale();
            curves(&mut builder.build_cartesian_2d(x, y)?, axes, lines)
        }
    }
}

fn curves<'a, B, Y>(
    chart: &mut ChartContext<'a, B, Cartesian2d<RangedCoordf64, Y>>,
    axes: &Axes,
    lines: &[Line],
) -> PlotResult<()>
where
    B: DrawingBackend + 'a,
    B::ErrorType: 'static,
    Y: Ranged<ValueType = f64> + ValueFormatter<f64>,
{
    chart
        .configure_mesh()
        .x_desc(axes.x)
        .y_desc(axes.y)
        .x_label_formatter(&|x| (axes.x_tick)(*x))
        .y_label_formatter(&|y| tick(*y))
        .axis_desc_style(("sans-serif", 17))
        .label_style(("sans-serif", 15))
        .light_line_style(WHITE)
        .draw()?;
    for (line, colour) in lines.iter().zip(COLOURS.iter().cycle()) {
        let points = || line.points.iter().copied();
        chart
            .draw_series(LineSeries::new(points(), colour.stroke_width(2)))?
            .label(&line.label)
            .legend(|(x, y)| PathElement::new([(x, y), (x + 22, y)], colour.stroke_width(3)));
        if line.points.len() < 16 {
            chart.draw_series(points().map(|at| Circle::new(at, 3, colour.filled())))?;
        }
    }
    chart
        .configure_series_labels()
        .position(axes.names.clone())
        .background_style(WHITE.mix(0.85))
        .border_style(BLACK.mix(0.3))
        .label_font(("sans-serif", 16))
        .draw()?;
    Ok(())
}

/// Formats a number on an axis without digits from rounding errors.
fn tick(y: f64) -> String {
    if y < 10.0 { format!("{}", (1e6 * y).round() / 1e6) } else { format!("{y:.0}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_curve_is_named_in_both_scales() {
        let names = SeriesLabelPosition::UpperLeft;
        let axes = Axes { title: "A title".into(), x: "particles", y: "time", x_tick: whole, names };
        let lines = [
            Line { label: "slow".into(), points: vec![(710.0, 0.01), (8300.0, 1.0)] },
            Line { label: "fast".into(), points: vec![(710.0, 1e-4), (8300.0, 1e-3)] },
        ];
        for scale in [Scale::Linear, Scale::Logarithmic] {
            let svg = draw(&axes, &lines, scale).unwrap();
            assert!(svg.starts_with("<svg") && svg.trim_end().ends_with("</svg>"));
            for text in ["A title", "slow", "fast", "particles", "time"] {
                assert!(svg.contains(text), "{text} in {scale:?}");
            }
            assert!(!svg.contains("NaN"));
        }
    }

    #[test]
    fn ticks_are_short() {
        assert_eq!([0.2 + 0.4, 0.0, 1e-4, 12.000_000_1, 1500.0].map(tick), ["0.6", "0", "0.0001", "12", "1500"]);
    }
}
