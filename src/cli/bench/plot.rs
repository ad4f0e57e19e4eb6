//! Curves as SVG, linear or logarithmic.

use super::curve::Point;
use anyhow::anyhow;
use plotters::chart::{ChartContext, SeriesLabelPosition};
use plotters::coord::cartesian::Cartesian2d;
use plotters::coord::ranged1d::ValueFormatter;
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;

const SIZE: (u32, u32) = (960, 600);
/// Colours that are told apart in print and by the colour-blind (Okabe and Ito).
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

/// A curve and its name. Few points are marked one by one.
pub(super) struct Line {
    pub(super) label: String,
    pub(super) points: Vec<Point>,
}

/// Scale of the time axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Scale {
    Linear,
    Logarithmic,
}

/// Draws time per step (ms) against particles.
///
/// # Errors
/// Where the picture cannot be laid out.
pub(super) fn draw(title: &str, lines: &[Line], scale: Scale) -> anyhow::Result<String> {
    layout(title, lines, scale).map_err(|error| anyhow!("the plot could not be drawn: {error}"))
}

type Drawn<T> = Result<T, Box<dyn std::error::Error>>;

fn layout(title: &str, lines: &[Line], scale: Scale) -> Drawn<String> {
    let all = || lines.iter().flat_map(|line| &line.points);
    let most = all().fold(1.0f64, |m, p| m.max(p.particles));
    let slowest = all().fold(0.0f64, |m, p| m.max(1e3 * p.seconds_per_step));
    let fastest = all().fold(f64::INFINITY, |m, p| m.min(1e3 * p.seconds_per_step));
    let mut svg = String::new();
    {
        let root = SVGBackend::with_string(&mut svg, SIZE).into_drawing_area();
        root.fill(&WHITE)?;
        let mut builder = ChartBuilder::on(&root);
        builder.caption(title, ("sans-serif", 17)).margin(14).x_label_area_size(46).y_label_area_size(72);
        let x = 0.0..1.02 * most;
        match scale {
            Scale::Linear => curves(&mut builder.build_cartesian_2d(x, 0.0..1.05 * slowest)?, lines)?,
            Scale::Logarithmic => {
                let y = (0.5 * fastest..2.0 * slowest).log_scale();
                curves(&mut builder.build_cartesian_2d(x, y)?, lines)?;
            }
        }
        root.present()?;
    }
    Ok(svg)
}

fn curves<'a, B, Y>(chart: &mut ChartContext<'a, B, Cartesian2d<RangedCoordf64, Y>>, lines: &[Line]) -> Drawn<()>
where
    B: DrawingBackend + 'a,
    B::ErrorType: 'static,
    Y: Ranged<ValueType = f64> + ValueFormatter<f64>,
{
    chart
        .configure_mesh()
        .x_desc("particles (both loops)")
        .y_desc("time per step, ms")
        .x_label_formatter(&|n| format!("{n:.0}"))
        .y_label_formatter(&|ms| if *ms < 10.0 { format!("{ms}") } else { format!("{ms:.0}") })
        .light_line_style(WHITE)
        .draw()?;
    for (line, colour) in lines.iter().zip(COLOURS.iter().cycle()) {
        let points = || line.points.iter().map(|p| (p.particles, 1e3 * p.seconds_per_step));
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
        .position(SeriesLabelPosition::UpperLeft)
        .background_style(WHITE.mix(0.85))
        .border_style(BLACK.mix(0.3))
        .draw()?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_curve_is_named_in_both_scales() {
        let point = |particles, seconds_per_step| Point { particles, seconds_per_step };
        let lines = [
            Line { label: "slow way".into(), points: vec![point(710.0, 0.01), point(8300.0, 1.0)] },
            Line { label: "fast way".into(), points: vec![point(710.0, 1e-4), point(8300.0, 1e-3)] },
        ];
        for scale in [Scale::Linear, Scale::Logarithmic] {
            let svg = draw("A title", &lines, scale).unwrap();
            assert!(svg.starts_with("<svg") && svg.trim_end().ends_with("</svg>"));
            for text in ["A title", "slow way", "fast way", "particles"] {
                assert!(svg.contains(text), "{text} in {scale:?}");
            }
            assert!(!svg.contains("NaN"));
        }
    }
}
