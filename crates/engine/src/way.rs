//! The way through the lumen of a stored model, from its sections and its surface.

use crate::generate::lean_of;
use crate::geometry::cut::Body;
use crate::measure::way::{Bend, NoWay, Source, Way};
use crate::mesh::lean::lean;
use crate::mesh::{LoftError, Lofter};
use crate::model::{Mesh, Rows, Section};
use crate::spec::{Across, ModelSpec};

/// Reason why a model has no way.
#[derive(Debug, thiserror::Error)]
pub enum WayError {
    /// The sections do not form a tube.
    #[error("the sections cannot be lofted")]
    Loft(#[from] LoftError),
    /// The search failed.
    #[error(transparent)]
    NoWay(#[from] NoWay),
}

/// Finds a way through `body`, which was grown from `sections` with this specification and seed.
///
/// # Errors
/// See [`WayError`].
pub fn way(sections: Vec<Section>, body: &Body<'_>, spec: &ModelSpec, seed: u64) -> Result<Way, WayError> {
    let (loft, rows) = lofted(sections)?;
    let across = Across::of(spec);
    let course = spec.centre_line().map(|course| move |point: [f64; 3]| course.place(point).into());
    Ok(Source {
        body,
        rows: &rows.walls[0].expanded(),
        straight: &loft.positions,
        positions_um: &positions_um(&loft, body, spec, seed),
        bend: course.as_ref().map(|course| course as Bend<'_>),
        ends_um: across.ends_um(),
        plane_at: &|place_um| across.at(place_um),
    }
    .way()?)
}

fn lofted(sections: Vec<Section>) -> Result<(Mesh, Rows), LoftError> {
    let mut sections = sections.into_iter();
    let mut lofter = Lofter::new(sections.next().ok_or(LoftError::NoSection)?)?;
    for section in sections {
        lofter.advance(&[section])?;
    }
    lofter.finish_with_rows()
}

/// Positions of the vertices of a loft after it leans, µm.
///
/// A straight surface has the triangles of its loft unless the requested resolution changed them.
/// Otherwise the loft leans anew, and its vertices may be somewhat off the surface.
fn positions_um(loft: &Mesh, body: &Body<'_>, spec: &ModelSpec, seed: u64) -> Vec<[f64; 3]> {
    if !spec.bends() && loft.triangles.len() == body.triangle_count() {
        let mut positions = vec![[0.0; 3]; loft.positions.len()];
        for (k, triangle) in loft.triangles.iter().enumerate() {
            for (&vertex, corner) in triangle.iter().zip(body.corners_um(k)) {
                positions[vertex as usize] = corner;
            }
        }
        return positions;
    }
    let mut leaning = loft.clone();
    if let Some(by) = lean_of(spec, seed) {
        lean(&mut leaning, &by, &|| false);
    }
    leaning.positions.iter().map(|p| p.map(|x| 1e6 * f64::from(x))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::convert::Converted;
    use crate::export::read::{Format, parse};
    use crate::export::sections_bin::SectionsReader;
    use crate::generate::{Backend, CancelToken, Output, Request, generate};
    use crate::geometry::distance::squared_distance;
    use crate::spec::preset;
    use serde_json::{Value, json};

    /// Grows a small model, and checks its way by brute force.
    fn check(patch: &Value) {
        let dir = tempfile::tempdir().unwrap();
        let mut small = json!({
            "steps": 80, "burn_in": 30, "length_mm": 8,
            "particles": { "total": { "keys": [[0, 160], [1, 320]] }, "outer": { "keys": [[0, 60], [1, 80]] } },
        });
        json_patch::merge(&mut small, patch);
        let request = Request {
            preset: "pig".into(),
            spec: ModelSpec::resolve(preset("pig").unwrap(), &small).unwrap(),
            seed: 3,
            backend: Backend::Cpu,
            outputs: vec![Output::Glb].into(),
            dir: dir.path().into(),
            memory_limit_bytes: None,
        };
        generate(&request, &(), &CancelToken::default()).unwrap();
        let surface = std::fs::read(dir.path().join("model.glb")).unwrap();
        let body = Converted::in_its_unit(&parse(&surface, Format::Gltf, None).unwrap()).into_body();
        let mut reader = SectionsReader::open(std::fs::File::open(dir.path().join("sections.bin")).unwrap()).unwrap();
        let sections: Vec<Section> = (0..reader.len()).map(|k| reader.section(k).unwrap()).collect();
        let found = way(sections, &body, &request.spec, request.seed).unwrap();

        let across = Across::of(&request.spec);
        let [first, last] = across.ends_um();
        let places = || found.points.iter().map(|point| point.place_um);
        assert!(places().next().unwrap() < first + 3.0 && places().next_back().unwrap() > last - 3.0);
        let nearest = |p: [f64; 3]| {
            let squares = (0..body.triangle_count()).map(|k| squared_distance(p, body.corners_um(k)));
            squares.fold(f64::INFINITY, f64::min).sqrt()
        };
        assert!(found.clearance_um >= 0.5);
        for pair in found.points.windows(2).step_by(found.points.len() / 12) {
            let [a, b] = [pair[0].position_um, pair[1].position_um];
            for t in [0.0, 0.4] {
                let distance = nearest([0, 1, 2].map(|k| a[k] + t * (b[k] - a[k])));
                assert!(distance >= found.clearance_um, "{distance} {}", found.clearance_um);
                assert!(t > 0.0 || (distance - pair[0].clearance_um).abs() < 1e-6);
            }
            let plane = across.at(pair[0].place_um).unwrap();
            assert!((plane.height_of(a) - plane.height_um()).abs() < 0.01);
        }
    }

    #[test]
    fn ways_of_straight_tubes_that_lean_touch_nothing() {
        check(&json!({}));
    }

    #[test]
    fn ways_of_bent_tubes_touch_nothing() {
        // Few rows, between which the tube turns and folds change.
        check(&json!({
            "length_mm": 20, "course": { "shape": "arc", "turn_deg": 120 }, "lean": { "strength_um": 0 },
            "particles": { "total": { "keys": [[0, 300], [1, 600]] }, "outer": null }, "steps": 120, "burn_in": null,
        }));
        check(&json!({
            "course": { "shape": "sigmoid", "turn_deg": 80 }, "containment": { "wall_um": 500 },
            "lean": { "strength_um": 0 },
        }));
    }

    #[test]
    fn ways_of_bent_tubes_that_lean_and_of_even_surfaces_touch_nothing() {
        check(&json!({ "course": { "shape": "arc", "turn_deg": 60 }, "containment": { "wall_um": 500 } }));
        check(&json!({ "mesh": { "resolution_um": 60 } }));
    }
}
