//! Page of a report.

use super::checklist::checklist;
use super::number::{number, optional, range};
use super::plots::Plot;
use super::stored::{Course, Stored};
use crate::measure::comparison::{Compared, Comparison, Verdict};
use crate::measure::morphometry::{Basis, CHANGES, Cuts, Morphometry, QUANTITIES, Quantity};
use crate::spec::{DEFAULT_PRESET, ModelSpec, preset};
use base64::Engine as _;
use maud::{DOCTYPE, Markup, PreEscaped, html};
use serde_json::{Value, json};

/// Style sheet of pages.
pub const STYLE: &str = include_str!("style.css");
/// Title of the paper whose method grows the models.
const PAPER: &str = "Burkitt, Romano, Walker, Fazeli: 3D Modelling of Complex Biological Structures: The Oviduct";

pub(super) struct Pictures {
    /// PNG of the tube.
    pub(super) tube: Vec<u8>,
    /// PNG of the sections.
    pub(super) strip: Vec<u8>,
    /// Places of the sections, mm.
    pub(super) places_mm: Vec<f64>,
    /// True if the strip shows cuts of the surface, false for sections of the simulation.
    pub(super) are_cuts: bool,
}

pub(super) fn page(stored: &Stored, pictures: &Pictures, plots: &[Plot]) -> Markup {
    let of = preset(&stored.preset);
    let name = of.map_or(stored.preset.as_str(), |preset| preset.title.as_str());
    html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                title { (name) ", seed " (stored.seed) " · oviduct" }
                style { (PreEscaped(STYLE)) }
            }
            body {
                h1 { (name) ", seed " (stored.seed) }
                p.soft { "Grown by oviduct " (stored.engine) " from the preset " (stored.preset) ". Digest " code { (stored.digest) } }
                h2 { "The model" }
                figure {
                    @let cut_away = if stored.course.is_some() { "half of it" } else { "a quarter" };
                    img.tube alt=(format!("The tube with {cut_away} cut away along it")) src=(data(&pictures.tube));
                    figcaption { "The tube with " (cut_away) " cut away along it." }
                }
                @if let Some(course) = &stored.course { p { (bending(course)) } }
                figure {
                    img alt="Sections along the tube" src=(data(&pictures.strip));
                    figcaption { (if pictures.are_cuts { "Planar cuts of the surface at " } else { "Sections at " }) (places(&pictures.places_mm)) " mm from the isthmus end, to one scale; the bar is 500 µm." }
                }
                @if let Some(cuts) = &stored.cuts { p { (islands(cuts)) } }
                @match (&stored.morphometry, &stored.comparison) {
                    (Some(morphometry), comparison) => {
                        @if let Some(comparison) = comparison { (anatomy(comparison)) }
                        @if let Some(found) = &stored.checklist { (checklist(found)) }
                        (along(plots))
                        (regions(morphometry))
                        (whole_tube(morphometry))
                        @if let Some(simulated) = &stored.simulated { (regions(simulated)) }
                    }
                    (None, _) => {
                        h2 { "Morphometry" }
                        p { "This model was grown by a version that did not measure its sections." }
                    }
                }
                (certificate(&stored.certificate, &stored.summary))
                (parameters(stored))
                (citation(stored))
            }
        }
    }
}

fn data(png: &[u8]) -> String {
    format!("data:image/png;base64,{}", base64::engine::general_purpose::STANDARD.encode(png))
}

fn islands(cuts: &Cuts) -> String {
    let median =
        cuts.island_area_um2.map_or_else(String::new, |area| format!(", median area {} µm²", area.p50.round()));
    format!(
        "Islands (tissue not connected to the wall in a plane, from {} µm²) are in {} % of {} planar cuts through the ampulla, {} in a cut{median}.",
        number(cuts.least_island_um2),
        number(100.0 * cuts.with_islands),
        cuts.count,
        number(cuts.islands_per_cut)
    )
}

fn places(places_mm: &[f64]) -> String {
    places_mm.iter().map(|z| number(*z)).collect::<Vec<_>>().join(", ")
}

fn unit(quantity: &str) -> (&str, &str) {
    let known = Quantity::named(quantity);
    known.map_or_else(
        || match quantity {
            "length_mm" => ("Length", "mm"),
            "isthmus_length_mm" => ("Length of the isthmus", "mm"),
            "ampulla_length_mm" => ("Length of the ampulla", "mm"),
            "fold_ratio" => ("Folds, ampulla over isthmus", ""),
            other => {
                CHANGES.iter().find(|change| change.0 == other).map_or((other, ""), |&(_, title, unit)| (title, unit))
            }
        },
        |q| (q.title, q.unit),
    )
}

fn anatomy(comparison: &Comparison) -> Markup {
    let titles: Vec<&str> = comparison.no_reference.iter().map(|name| unit(name).0).collect();
    html! {
        h2 { "Beside published anatomy" }
        p {
            (comparison.inside) " of " (comparison.inside + comparison.outside) " measures with a published range (" (comparison.organ) ", "
            (comparison.species) ") are inside it."
            @if let Some(why) = &comparison.shortened { " The tube is shortened by choice. " (why) }
        }
        div.scroll { table {
            thead { tr {
                th { "Measure" } th { "Region" } th.n { "Model" } th.n { "Published" } th.n { "Range" } th { "" } th { "Source" }
            } }
            tbody { @for one in &comparison.compared { (compared(one)) } }
        } }
        p.small.soft { "Model: mean over the region. Nothing was found to compare these with: " (titles.join(", ")) "." }
    }
}

fn compared(one: &Compared) -> Markup {
    let (title, unit) = unit(&one.quantity);
    let n = one.n.map(|n| format!(" (n = {n})")).unwrap_or_default();
    html! {
        tr {
            td { (title) @if !unit.is_empty() { ", " (unit) } }
            td { (one.region) }
            td.n { (optional(one.measured)) }
            td.n { (optional(one.value)) @if let Some(sd) = one.sd { ", SD " (number(sd)) } (n) }
            td.n { (range(one.low, one.high, false)) }
            td {
                @match one.verdict {
                    Verdict::Inside => span.inside { "inside" },
                    Verdict::Outside => span.outside { "outside" },
                    Verdict::NoRange => span.soft { "no range" },
                    Verdict::MethodUnknown => span.soft { "method unknown" },
                    Verdict::NotMeasured => span.soft { "not measured" },
                    Verdict::Shortened => span.soft { "shortened by choice" },
                }
                @if let Some(sd) = one.deviation_sd { " (" (format!("{sd:+.1}")) " SD)" }
            }
            td.source { (one.published) ". " (one.source) " [" (one.confidence) "]" }
        }
    }
}

fn along(plots: &[Plot]) -> Markup {
    html! {
        h2 { "Along the tube" }
        p.soft { "Vertical lines: the ampullary–isthmic junction. Green: the published range." }
        div.plots {
            @for plot in plots {
                figure {
                    h3 { (plot.title) @if plot.published { span.inside { " · published range" } } }
                    (PreEscaped(&plot.svg))
                }
            }
        }
    }
}

fn bending(course: &Course) -> String {
    let radius = course.curve_radius_mm.map_or_else(String::new, |radius| {
        format!(
            "; its radius of curvature is {radius:.1} mm where it is bent most for its width, at {:.1} mm",
            course.tightest_at_mm
        )
    });
    let relaxed =
        if course.relaxed { ". It was relaxed: the course that was asked for has no room for the tube" } else { "" };
    format!(
        "The tube follows a centre line of tortuosity {:.2}, whose ends are {:.1} mm apart{radius}{relaxed}. Places are those along the centre line, and sections lie across it.",
        course.tortuosity, course.end_distance_mm
    )
}

/// Table of all quantities that the model has in some region.
fn regions(morphometry: &Morphometry) -> Markup {
    let names = ["isthmus", "junction", "ampulla", "whole"].map(|name| (name, morphometry.regions.get(name)));
    let quantities = QUANTITIES.iter().map(|quantity| (quantity.name, quantity.title, quantity.unit)).chain(CHANGES);
    let is_known = |name: &str| names.iter().any(|(_, of)| of.is_some_and(|of| of.quantities.contains_key(name)));
    html! {
        h2 { (if morphometry.settings.basis == Basis::Cuts { "Planar cuts of the surface" } else { "Simulated sections" }) ", by region" }
        p.soft { "Mean ± standard deviation along the region." }
        div.scroll { table {
            thead { tr { th { "Measure" } @for (name, _) in names { th.n { (name) } } } }
            tbody { @for (name, title, unit) in quantities.filter(|(name, ..)| is_known(name)) {
                tr {
                    td { (title) @if !unit.is_empty() { ", " (unit) } }
                    @for (_, region) in names {
                        td.n {
                            @match region.and_then(|region| region.quantities.get(name)) {
                                Some(along) => { (number(along.mean)) " ± " (number(along.sd)) }
                                None => "–",
                            }
                        }
                    }
                }
            } }
        } }
    }
}

fn whole_tube(morphometry: &Morphometry) -> Markup {
    let tube = &morphometry.tube;
    let whole = [
        ("Length, mm", Some(tube.length_mm)),
        ("Volume of the lumen, mm³", Some(tube.lumen_volume_mm3)),
        ("Volume of the tissue, mm³", Some(tube.tissue_volume_mm3)),
        ("Surface of the mucosa, mm²", Some(tube.lumen_surface_mm2)),
        ("Surface over volume of the lumen, 1/mm", Some(tube.surface_over_volume_per_mm)),
        ("Hydraulic diameter, µm", Some(tube.hydraulic_diameter_um)),
        ("Fold continuity", tube.fold_continuity),
        ("Twist from end to end, degrees", Some(tube.twist_deg)),
        ("Folds, ampulla over isthmus", tube.fold_ratio),
    ];
    html! {
        h2 { "The whole tube" }
        table { tbody { @for (title, value) in whole { tr { td { (title) } td.n { (optional(value)) } } } } }
    }
}

fn certificate(certificate: &Value, summary: &Value) -> Markup {
    let is = |name: &str| certificate[name].as_bool().unwrap_or(false);
    let count = |name: &str| certificate[name].to_string();
    let measure = |name: &str| optional(certificate[name].as_f64());
    let share = |name: &str| certificate["quality"][name].as_f64().map(|share| 100.0 * share);
    let (wide, compact) = (share("least_angles_from_20"), share("edge_ratios_to_4"));
    html! {
        h2 { "Certificate" }
        p {
            @if is("passed") { span.inside { "Passed" } } @else { span.outside { "Failed" } }
            " by exact tests of the surface as exported."
        }
        table { tbody {
            @for (title, holds) in [
                ("Closed: no open edge", is("closed")),
                ("Manifold: every edge has two triangles, every vertex one fan", is("manifold")),
                ("Oriented: all triangles face outwards", is("oriented")),
                ("No two triangles intersect", certificate["triangle_intersections"] == 0),
                ("No contour of a section crosses itself or another", certificate["section_crossings"] == 0),
            ] {
                tr { td { (title) } td.n { @if holds { span.inside { "yes" } } @else { span.outside { "no" } } } }
            }
            @for (title, value) in [
                ("Euler number", count("euler")),
                ("Vertices", count("vertices")),
                ("Triangles", count("triangles")),
                ("Sections", summary["sections"].to_string()),
                ("Least gap between walls, µm", measure("min_gap_um")),
                ("Triangles with no angle below 20°, %", optional(wide)),
                ("Triangles with edges of a ratio up to 4, %", optional(compact)),
                ("Volume, mm³", measure("volume_mm3")),
                ("Surface, mm²", measure("area_mm2")),
            ] {
                tr { td { (title) } td.n { (value) } }
            }
        } }
        @for warning in summary["warnings"].as_array().into_iter().flatten() {
            p.outside { (warning["detail"].as_str().unwrap_or_default()) }
        }
    }
}

fn parameters(stored: &Stored) -> Markup {
    let of = preset(&stored.preset);
    let own = of.and_then(|of| ModelSpec::resolve(of, &json!({})).ok()).map(|spec| spec.to_json());
    let parameters = of.or_else(|| preset(DEFAULT_PRESET)).map_or_else(Vec::new, |of| of.details().parameters);
    html! {
        h2 { "Parameters" }
        p.soft { "A value of the request is marked; all others are those of the preset, with its sources." }
        div.scroll { table {
            thead { tr { th { "Parameter" } th { "Value" } th { "Source" } } }
            tbody { @for parameter in parameters {
                @let value = stored.spec.pointer(&parameter.pointer);
                tr {
                    td { (parameter.title) br; code { (parameter.pointer) } }
                    td { code { (value.map_or_else(|| "–".to_owned(), Value::to_string)) } " " (parameter.unit) }
                    td.source {
                        @if value.is_some() && value == own.as_ref().and_then(|own| own.pointer(&parameter.pointer)) {
                            (parameter.source.unwrap_or_default())
                        } @else { strong { "the request" } }
                    }
                }
            } }
        } }
    }
}

fn citation(stored: &Stored) -> Markup {
    html! {
        h2 { "How to cite" }
        p {
            "The model: oviduct " (stored.engine) ", preset " (stored.preset) ", seed " (stored.seed) ", digest " code { (stored.digest) }
            ". The same specification, seed and version give the same model."
        }
        p { "The method: " (PAPER) "." }
        p { "Published values: each with its source in the table above." }
    }
}
