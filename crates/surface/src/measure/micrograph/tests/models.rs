//! Images of the sections of a model give the same measures as the model.

use super::*;
use crate::measure::morphometry::QUANTITIES;
use crate::model::{Border, Section};
use oviduct_base::tissue::{Contour, Grid};
use oviduct_export::render::Slide;
use oviduct_sim::sim::Plan;
use oviduct_sim::sim::cpu::CpuSimulation;
use oviduct_spec::spec::{ModelSpec, preset};
use serde_json::json;

/// Sections of a pig with 3000 particles: in the isthmus, the junction and the ampulla, at 21, 36
/// and 96 % of its length.
fn sections() -> (ModelSpec, Vec<Section>) {
    // Without sway and variety: with them, a fold of this seed is within a pixel of the minimum
    // height that counts.
    let patch = json!({
        "steps": 400, "sway": { "strength": 0 },
        "variety": { "asymmetry": 0, "height": 0, "thickness": 0, "shift": 0 },
        "particles": { "total": { "keys": [[0, 800], [1, 3000]] }, "tip_weight": 0.5 },
        "collision": { "gap_um": { "keys": [[0, 60], [0.125, 60], [0.45, 36], [1, 36]], "ease": "smooth" } },
    });
    let spec = ModelSpec::resolve(preset("pig").unwrap(), &patch).unwrap();
    let mut simulation = CpuSimulation::new(Plan::new(&spec, 7), 1);
    let mut sections = Vec::new();
    while simulation.time() < 380 {
        simulation.step().unwrap();
        if [50, 90, 380].contains(&simulation.time()) {
            sections.push(simulation.section());
        }
    }
    (spec, sections)
}

/// Tolerance of a quantity, and whether the tolerance is absolute (in the unit of the quantity)
/// instead of percent.
fn tolerance(name: &str) -> Option<(f64, bool)> {
    match name {
        "fractal_dimension" | "outline_dimension" => Some((0.03, true)),
        // An error of the fit, not of the section.
        "fractal_dimension_error" | "outline_dimension_error" => None,
        "islands" | "folds_on_ring" | "primary_folds" | "secondary_folds" | "tertiary_folds" => Some((0.0, true)),
        "branching_order" | "branching_order_mean" => Some((0.0, true)),
        // Near zero in most sections.
        "asymmetry" | "angular_cv" => Some((0.002, true)),
        "touching_share" => Some((0.02, true)),
        // A pixel moves the middle of a base of 100 µm, and the axis begins there.
        "fold_angle_deg" => Some((2.0, true)),
        // Few rays have a gap near the 5th percentile: most gaps are between fronds, the others at
        // the ends of clefts.
        "lumen_gap_p5_um" => Some((8.0, false)),
        // A few long rays determine these.
        "lumen_gap_p95_um" | "lumen_gap_cv" => Some((4.0, false)),
        _ => Some((2.0, false)),
    }
}

#[test]
fn images_of_the_sections_of_a_model_measure_what_the_model_does() {
    let (spec, sections) = sections();
    let mut faults = Vec::new();
    for (section, region) in sections.iter().zip(["isthmus", "junction", "ampulla"]) {
        let grid = Grid::around(&section.outer.points, 1000);
        let side_um = 1000.0 * grid.um_per_pixel;
        let own = measure(&Shape::from(section), true);
        for pixel_um in [1.0, 2.0] {
            let size = (side_um / pixel_um).round() as u32;
            let grid = Grid::around(&section.outer.points, size);
            let pixel_um = grid.um_per_pixel;
            let middle = [
                grid.left_um + f64::from(grid.width) * pixel_um / 2.0,
                grid.top_um - f64::from(grid.height) * pixel_um / 2.0,
            ];
            let centred = |points: &[[f32; 2]]| -> Points {
                points.iter().map(|p| [0, 1].map(|k| (f64::from(p[k]) - middle[k]) as f32)).collect()
            };
            let (inner, outer) = (centred(&section.inner.points), centred(&section.outer.points));

            let slide =
                Slide { borders: section.borders(), layers: spec.layers_at_um(section.z_um, 7), seed: 7, index: 0 };
            let labels = slide.labels(size).unwrap();
            let tissue = Some(Tissue::Values((2..10).collect()));
            let reading = Reading { pixel_um: Some(pixel_um), tissue, threshold: None };
            let labels = Micrograph::read(&labels, &reading).unwrap();
            let pixels = [grid.width, grid.height].map(|side| side as usize);
            let mask = paint(pixels, pixel_um, &[&inner, &outer]);
            let mask = read(&png(pixels[0], &mask, ColorType::Grayscale, BitDepth::One), pixel_um).unwrap();

            for (image, kind) in [(labels, "labels"), (mask, "mask")] {
                assert_sound(&image);
                // It lies over the section.
                for (own, traced) in [(&inner, &image.lumen[0]), (&outer, &image.outer)] {
                    let own = Contour::new(&Border::closed(vec![own.clone()]));
                    let far = traced.iter().map(|p| own.distance(p.map(f64::from))).fold(0.0, f64::max);
                    assert!(far < 1.5 * pixel_um, "{region}, {kind}: {far} µm off");
                }
                let found = image.measure();
                for quantity in QUANTITIES {
                    let (Some((most, absolute)), Some(expected)) = (tolerance(quantity.name), quantity.of(&own)) else {
                        continue;
                    };
                    let found = quantity.of(&found).unwrap_or(f64::NAN);
                    let off = if absolute { found - expected } else { 100.0 * (found / expected - 1.0) };
                    // `0 / 0` where nothing is expected and nothing is found.
                    if !(off.abs() <= most || found == expected) {
                        faults.push(format!(
                            "{region}, {kind}, {pixel_um:.2} µm: {} is {found}, not {expected}",
                            quantity.name
                        ));
                    }
                }
            }
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}
