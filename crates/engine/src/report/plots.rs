//! Plots of measures along the tube as SVG: curves, regions and published ranges.

use super::stored::ReportError;
use crate::measure::comparison::Comparison;
use crate::measure::morphometry::{Morphometry, Quantity};
use plotters::prelude::*;

const SIZE: (u32, u32) = (460, 240);
/// Colours of the curves, from light to dark if there are three, so that they differ in print.
const CURVES: [RGBColor; 3] = [RGBColor(0, 114, 178), RGBColor(0, 60, 100), RGBColor(86, 180, 233)];
const BAND: RGBColor = RGBColor(0, 158, 115);
const RULE: RGBColor = RGBColor(150, 150, 150);

/// A plot.
pub(super) struct Plot {
    pub(super) title: &'static str,
    pub(super) svg: String,
    /// True if the plot shows a published range.
    pub(super) published: bool,
}

/// Titles and quantities of the plots.
const PLOTS: [(&str, &[&str]); 12] = [
    ("Folds on the ring", &["folds_on_ring"]),
    ("Branching order, mean", &["branching_order_mean"]),
    ("Lumen area, mm²", &["lumen_area_mm2"]),
    ("Tissue area, mm²", &["tissue_area_mm2"]),
    ("Outer diameter, mm", &["outer_diameter_mm"]),
    ("Muscle thickness, µm", &["muscle_thickness_um"]),
    ("Free lumen", &["free_lumen"]),
    ("Perimeter ratio", &["perimeter_ratio"]),
    (
        "Tissue thickness, µm: 5th, 50th, 95th percentile",
        &["tissue_thickness_p50_um", "tissue_thickness_p5_um", "tissue_thickness_p95_um"],
    ),
    ("Lumen gap, µm: 5th, 50th, 95th percentile", &["lumen_gap_p50_um", "lumen_gap_p5_um", "lumen_gap_p95_um"]),
    ("Fold height, median, µm", &["fold_height_p50_um"]),
    ("Fractal dimension of the lumen area", &["fractal_dimension"]),
];

/// Draws all plots for which the model has values.
pub(super) fn plots(morphometry: &Morphometry, comparison: Option<&Comparison>) -> Result<Vec<Plot>, ReportError> {
    let mut plots = Vec::new();
    for (title, names) in PLOTS {
        let curves: Vec<Vec<(f64, f64)>> = names.iter().map(|name| curve(morphometry, name)).collect();
        if curves.iter().all(Vec::is_empty) {
            continue;
        }
        let bands = bands(morphometry, comparison, names);
        let svg = draw(morphometry, &curves, &bands).map_err(|error| ReportError::Plot(error.to_string()))?;
        plots.push(Plot { title, svg, published: !bands.is_empty() });
    }
    Ok(plots)
}

fn curve(morphometry: &Morphometry, name: &str) -> Vec<(f64, f64)> {
    debug_assert!(Quantity::named(name).is_some(), "{name}");
    let (Some(z), Some(values)) = (morphometry.along.get("z_mm"), morphometry.along.get(name)) else {
        return Vec::new();
    };
    z.iter().zip(values).filter_map(|(z, value)| Some(((*z)?, (*value)?))).collect()
}

/// A published range: along the tube, and of the values.
type Band = ([f64; 2], [f64; 2]);

fn bands(morphometry: &Morphometry, comparison: Option<&Comparison>, names: &[&str]) -> Vec<Band> {
    let compared = comparison.into_iter().flat_map(|c| &c.compared).filter(|c| names.contains(&c.quantity.as_str()));
    compared
        .filter_map(|c| {
            let region = morphometry.regions.get(&c.region)?;
            Some(([region.from_mm, region.to_mm], [c.low?, c.high?]))
        })
        .collect()
}

fn draw(
    morphometry: &Morphometry,
    curves: &[Vec<(f64, f64)>],
    bands: &[Band],
) -> Result<String, Box<dyn std::error::Error>> {
    let values = || curves.iter().flatten().map(|p| p.1).chain(bands.iter().flat_map(|band| band.1));
    let top = values().fold(0.0_f64, f64::max).max(1e-9) * 1.06;
    let low = values().fold(f64::INFINITY, f64::min);
    // The axis need not begin at 0 for dimensions and ratios, which vary little around a value far
    // from 0.
    let bottom = if low > 0.6 * top { low - 0.3 * (top - low) } else { 0.0 };
    let length = morphometry.tube.length_mm;
    let mut svg = String::new();
    {
        let root = SVGBackend::with_string(&mut svg, SIZE).into_drawing_area();
        let mut chart = ChartBuilder::on(&root)
            .margin(6)
            .margin_right(16)
            .x_label_area_size(34)
            .y_label_area_size(46)
            .build_cartesian_2d(0.0..length, bottom..top)?;
        for (z, range) in bands {
            chart.draw_series([Rectangle::new([(z[0], range[0]), (z[1], range[1])], BAND.mix(0.22).filled())])?;
        }
        for z in [morphometry.regions.get("junction").map(|r| [r.from_mm, r.to_mm])].into_iter().flatten().flatten() {
            chart.draw_series([PathElement::new([(z, bottom), (z, top)], RULE.stroke_width(1))])?;
        }
        chart
            .configure_mesh()
            .disable_mesh()
            .x_desc("mm from the isthmus end")
            .x_labels(6)
            .y_labels(5)
            .y_label_formatter(&|y| number(*y))
            .x_label_formatter(&|x| number(*x))
            .draw()?;
        for (points, colour) in curves.iter().zip(CURVES) {
            chart.draw_series(LineSeries::new(points.iter().copied(), colour.stroke_width(2)))?;
        }
        root.present()?;
    }
    Ok(svg)
}

/// Formats a number at an axis, without digits from rounding errors.
fn number(value: f64) -> String {
    if value.abs() < 10.0 { format!("{}", (1e3 * value).round() / 1e3) } else { format!("{value:.0}") }
}
