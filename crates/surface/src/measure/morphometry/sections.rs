//! Measures of the sections of a simulation, whose points have ids.

use super::quantity::{QUANTITIES, Quantity};
use super::ring::{Marked, Step};
use super::section::{MODEL_RAYS_UM, Measures, Scope, measure_with};
use super::shape::{Ellipse, Shape};
use super::track::{Following, Frame, Traced, per_mm};
use super::tube::{Basis, Found, Intervals, Morphometry, Regions};
use crate::model::Section;
use crate::tissue::Layers;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Layers of the wall by the place along the tube, µm from the isthmus end.
pub type LayersAt<'a> = dyn Fn(f64) -> Layers + Sync + 'a;

/// Measures the recorded sections of a model. `gaps_um` contains the minimum gap between walls of
/// each section, from its certificate.
///
/// With `layers`, the sections stand for planar cuts of the surface through them: layers, islands
/// and the changes of folds along the tube are measured as well.
#[must_use]
#[inline(never)] // counted by scripts/counts
pub fn morphometry(
    sections: &[Section],
    gaps_um: &[Option<f64>],
    regions: &Regions,
    layers: Option<&LayersAt<'_>>,
) -> Morphometry {
    let recorded: Vec<(usize, &Section)> = sections.iter().enumerate().filter(|(_, section)| !section.added).collect();
    let intervals = Intervals::of_sections(recorded.len());
    let shapes: Vec<(Shape<'_>, Ellipse)> = recorded
        .iter()
        .map(|(_, section)| {
            let shape = Shape::from(*section);
            let base = shape.base_ellipse();
            (shape, base)
        })
        .collect();
    let measured: Vec<(Measures, Marked<'_>)> = (recorded.par_iter().zip(&shapes).enumerate())
        .map(|(k, ((_, section), (shape, base)))| {
            let layers = layers.filter(|_| intervals.has_layers(k)).map(|layers| layers(section.z_um));
            let rays_um = intervals.has_detail(k).then_some(MODEL_RAYS_UM);
            let scope = Scope { rays_um, tree: intervals.has_tree(k), layers: layers.as_ref() };
            (measure_with(shape, base, scope), Marked::new(section, base))
        })
        .collect();
    let steps: Vec<Step> = measured.windows(2).map(|pair| pair[0].1.step(&pair[1].1)).collect();
    let z_mm: Vec<f64> = recorded.iter().map(|(_, section)| section.z_um / 1e3).collect();
    let mut along: BTreeMap<String, Vec<Option<f64>>> = BTreeMap::new();
    let gaps = recorded.iter().map(|&(place, _)| gaps_um.get(place).copied().flatten());
    along.insert("least_gap_um".into(), gaps.collect());
    let forth = |of: fn(&Step, f64) -> Option<f64>| -> Vec<Option<f64>> {
        let lengths = z_mm.windows(2).map(|z| z[1] - z[0]);
        steps.iter().zip(lengths).map(|(step, length)| of(step, length)).chain([None]).collect()
    };
    along.insert("fold_continuity".into(), forth(|step, _| step.continued));
    along.insert("twist_deg_per_mm".into(), forth(|step, length| Some(step.turn.to_degrees() / length)));
    if layers.is_some() {
        let frame = Frame::around(shapes.iter().map(|(shape, _)| shape));
        let mut following = Following::default();
        for some in shapes.chunks(Following::PORTION) {
            following.add(some.par_iter().map(|(shape, base)| Traced::new(shape, base, &frame)).collect());
        }
        along.extend(per_mm(&following.into_changes(), &z_mm));
    }
    let continued: Vec<f64> = steps.iter().filter_map(|step| step.continued).collect();
    let found = Found {
        basis: if layers.is_some() { Basis::Cuts } else { Basis::Sections },
        intervals,
        z_mm,
        measures: measured.into_iter().map(|(measures, _)| measures).collect(),
        steps: along,
        fold_continuity: (!continued.is_empty()).then(|| continued.iter().sum::<f64>() / continued.len() as f64),
        twist_deg: steps.iter().map(|step| step.turn).sum::<f64>().to_degrees(),
    };
    let mut morphometry = match layers {
        Some(_) => found.summarized(QUANTITIES.iter(), regions),
        None => found.summarized(Quantity::of_simulated(), regions),
    };
    let steps = recorded.iter().map(|(_, section)| Some(section.step));
    morphometry.along.insert("step".into(), steps.collect());
    morphometry
}
