//! Report of a model as an HTML page that needs no other file and prints well.
//!
//! | file | subject |
//! |---|---|
//! | `stored` | contents of `report.json` |
//! | `page` | the page |
//! | `checklist` | section with the anatomical checklist |
//! | `number` | numbers and ranges as text |
//! | `plots` | measures along the tube, with the published ranges |
//! | `style.css` | style on screens and on paper |

mod checklist;
mod number;
mod page;
mod plots;
mod stored;

pub use page::STYLE;
pub use stored::ReportError;

use crate::geometry::cut::Body;
use crate::model::{Border, Mesh, Plane, Section};
use crate::render::{Finish, NamedView, mesh_png, sheet_png};
use crate::spec::{Across, ModelSpec};
use serde_json::Value;
use stored::Stored;

/// Media type of the page.
pub const MEDIA_TYPE: &str = "text/html; charset=utf-8";
/// Longest side of the picture of the tube, pixels.
pub const PICTURE: u32 = 1200;
/// View of the picture of the tube.
pub const VIEW: NamedView = NamedView::Opened;
/// Number of sections in the strip.
const STRIP: usize = 8;
/// Distance of the first and the last cut from the ends, µm.
const END_UM: f64 = 1.0;
/// Side of each section in the strip, pixels.
const CELL: u32 = 300;

/// Indices of the sections at the places `z` that the strip of a report shows, evenly spread from
/// end to end.
#[must_use]
pub fn strip(z: &[f64]) -> Vec<usize> {
    let (Some(&first), Some(&last)) = (z.first(), z.last()) else { return Vec::new() };
    let place = |k: usize| first + (last - first) * k as f64 / (STRIP - 1) as f64;
    let nearest = |at: f64| (0..z.len()).min_by(|&a, &b| (z[a] - at).abs().total_cmp(&(z[b] - at).abs()));
    let mut chosen: Vec<usize> = (0..STRIP).filter_map(|k| nearest(place(k))).collect();
    chosen.dedup();
    chosen
}

/// Strip of sections in a report.
#[derive(Clone, Debug)]
pub struct Strip {
    /// Places along the tube, µm.
    z_um: Vec<f64>,
    /// Contours of the mucosa and of the outer wall at each place.
    shown: Vec<[Border; 2]>,
    /// True for cuts of the surface, false for sections of the simulation.
    are_cuts: bool,
}

impl Strip {
    /// Sections of the simulation, which [`strip`] has chosen.
    #[must_use]
    pub fn of_sections(sections: &[Section]) -> Self {
        let z_um = sections.iter().map(|section| section.z_um).collect();
        Self { z_um, shown: sections.iter().map(Section::borders).collect(), are_cuts: false }
    }

    /// Cuts of the tissue at the places `z_um` along its centre line, which follows from the stored
    /// specification; at both ends just inside the tissue. `None` if the tissue has no named
    /// patches.
    #[must_use]
    pub fn of_cuts(tissue: &Body<'_>, z_um: &[f64], spec: &Value) -> Option<Self> {
        let [low, high] = [z_um.first()?, z_um.last()?];
        let across = ModelSpec::from_stored(spec).map(|spec| Across::of(&spec));
        let cut = |z: &f64| {
            let z = z.clamp(low + END_UM, high - END_UM);
            tissue.borders(&across.as_ref().map_or(Some(Plane::across(z)), |across| across.at(z))?)
        };
        let shown = z_um.iter().map(cut).collect::<Option<Vec<_>>>()?;
        Some(Self { z_um: z_um.to_vec(), shown, are_cuts: true })
    }
}

/// True if the surface of a model leans, according to its `report.json`. Cuts of a leaning surface
/// differ from the sections of the simulation.
#[must_use]
pub fn leans(report: &[u8]) -> bool {
    #[derive(serde::Deserialize)]
    struct Lean {
        lean: Option<serde::de::IgnoredAny>,
    }
    serde_json::from_slice(report).is_ok_and(|Lean { lean }| lean.is_some())
}

/// Specification in a `report.json`; null if it has none.
#[must_use]
pub fn spec(report: &[u8]) -> Value {
    serde_json::from_slice::<Value>(report).map_or(Value::Null, |mut report| report["spec"].take())
}

/// Page of a model. `report` is its `report.json`; `tube` is its surface, as dense as [`VIEW`]
/// needs it at [`PICTURE`] pixels.
///
/// # Errors
/// [`ReportError`].
pub fn html(report: &[u8], strip: &Strip, tube: &Mesh) -> Result<String, ReportError> {
    let stored: Stored = serde_json::from_slice(report)?;
    let spec = ModelSpec::from_stored(&stored.spec);
    let finish = spec.as_ref().map(|spec| Finish { spec, seed: stored.seed });
    let pictures = page::Pictures {
        tube: mesh_png(tube, &VIEW.of(tube, PICTURE), finish.as_ref())?,
        strip: sheet_png(&strip.shown, STRIP / 2, CELL)?,
        places_mm: strip.z_um.iter().map(|z| z / 1e3).collect(),
        are_cuts: strip.are_cuts,
    };
    let plots = stored.morphometry.as_ref().map(|m| plots::plots(m, stored.comparison.as_ref())).transpose()?;
    Ok(page::page(&stored, &pictures, &plots.unwrap_or_default()).into_string())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measure::checklist::{Judged, judge};
    use crate::measure::comparison::compare;
    use crate::measure::morphometry::{Regions, morphometry};
    use crate::mesh::draft;
    use crate::model::sample::section;
    use serde_json::json;

    fn sections() -> Vec<Section> {
        (0..13).map(|k| section(120, f64::from(k), 500.0 * f64::from(k))).collect()
    }

    fn stored() -> Value {
        let preset = crate::spec::preset("pig").unwrap();
        let spec = crate::spec::ModelSpec::resolve(preset, &json!({ "friction": 0.25 })).unwrap();
        let sections = sections();
        let found = morphometry(
            &sections,
            &[Some(4.0); 13],
            &Regions { length_mm: 6.0, junction: [0.3, 0.4], piece: [0.0, 1.0] },
            Some(&|z_um: f64| spec.layers_at_um(z_um, 7)),
        );
        let simulated =
            morphometry(&sections, &[], &Regions { length_mm: 6.0, junction: [0.3, 0.4], piece: [0.0, 1.0] }, None);
        let checklist = judge(&Judged {
            morphometry: &found,
            organ: "oviduct",
            species: "pig",
            preset: "pig",
            length_mm: 6.0,
            shortened: preset.shortened.as_deref(),
            tube: &[].into(),
            parameter: &|_, _| Some(0.35),
        });
        json!({
            "digest": "d1gest", "preset": "pig", "seed": 7, "engine": "9.9.9",
            "spec": spec.to_json(),
            "summary": { "sections": 13, "warnings": [{ "code": "small-gap", "detail": "A <gap> is small." }] },
            "certificate": { "passed": true, "closed": true, "triangle_intersections": 0, "euler": 0, "min_gap_um": 4.0 },
            "comparison": compare(&found, "oviduct", "pig", preset.shortened.as_deref()),
            "checklist": checklist,
            "morphometry": found,
            "simulated": simulated,
        })
    }

    fn page(stored: &Value) -> String {
        let sections = sections();
        let z: Vec<f64> = sections.iter().map(|s| s.z_um).collect();
        let shown: Vec<Section> = strip(&z).into_iter().map(|k| sections[k].clone()).collect();
        html(&serde_json::to_vec(stored).unwrap(), &Strip::of_sections(&shown), &draft(&sections).unwrap()).unwrap()
    }

    #[test]
    fn the_page_shows_what_the_report_says_and_needs_nothing_else() {
        let html = page(&stored());
        for text in [
            "Pig oviduct, seed 7",
            "d1gest",
            "A &lt;gap&gt; is small.",
            "Fractal dimension of the lumen area",
            "Belda-Perez et al. 2024",
            "outside",
            "/collision/gap_um",
            "<strong>the request</strong>",
            "Burkitt, Romano, Walker, Fazeli",
            "Checklist of anatomy",
            "The muscularis is thickest in the isthmus",
            "The tube is shortened by choice. The preset has 60 mm",
            "Shortened by choice: The preset has 60 mm",
            "published order",
        ] {
            assert!(html.contains(text), "{text}");
        }
        assert_eq!(html.matches("<strong>the request</strong>").count(), 1, "one value differs from the preset");
        assert_eq!(html.matches("data:image/png;base64,").count(), 2);
        assert_eq!(html.matches("<svg").count(), 12);
        let first = |text: &str| html.find(text).unwrap_or_else(|| panic!("{text}"));
        assert!(first("Planar cuts of the surface, by region") < first("Simulated sections, by region"));
        assert!(html.contains("method unknown") && html.contains("Muscle thickness, µm"));
        for outside in ["<script", "http:", "https:", "url(", "@import"] {
            let found = html.replace("http://www.w3.org/2000/svg", "").contains(outside);
            assert!(!found, "{outside}");
        }
        assert_eq!(page(&stored()), html);
    }

    #[test]
    fn the_page_of_an_older_model_has_no_morphometry() {
        let mut stored = stored();
        for name in ["morphometry", "comparison", "checklist"] {
            stored.as_object_mut().unwrap().remove(name);
        }
        let html = page(&stored);
        assert!(!html.contains("Checklist"));
        assert!(html.contains("did not measure its sections") && html.contains("Certificate"));
        assert!(matches!(html_of_garbage(), Err(ReportError::Json(_))));
    }

    fn html_of_garbage() -> Result<String, ReportError> {
        html(b"{}", &Strip::of_sections(&sections()), &draft(&sections()).unwrap())
    }

    #[test]
    fn the_strip_is_evenly_spread() {
        let z: Vec<f64> = (0..201).map(f64::from).collect();
        assert_eq!(strip(&z), [0, 29, 57, 86, 114, 143, 171, 200]);
        assert_eq!(strip(&[0.0, 1.0, 100.0]), [0, 1, 2]);
        assert_eq!(strip(&[]), [0; 0]);
    }
}
