//! Tests of the parameters of tube and surface: layers, label volumes, pieces, courses,
//! contraction, outlines and folds.

use super::*;

#[test]
fn layers_have_bounds_and_need_not_fit_into_the_wall() {
    assert_eq!(pointers(&json!({ "containment": { "wall_um": 20 }, "wall": { "lobing": 0 } })), [""; 0]);
    assert_eq!(pointers(&json!({ "histology": { "epithelium_um": 0.5 } })), ["/histology/epithelium_um"]);
    let keys = json!({ "keys": [[0, 10], [1, 20]] });
    let spec = resolved(&json!({ "histology": { "lamina_um": 55, "longitudinal_share": 0.25, "serosa_um": keys } }));
    let layers = spec.layers_at(0.5, 7);
    assert_eq!((layers.lamina_um, layers.longitudinal_share, layers.serosa_um), (55.0, 0.25, 15.0));
    assert_eq!((layers.z_um, layers.seed), (500.0 * spec.length_mm, 7));
    assert_eq!(spec.layers_at_um(layers.z_um, 7), layers);
    let wave = json!({ "fluctuation": { "amplitude": 2, "period": 100 } });
    assert_eq!(pointers(&json!({ "histology": { "epithelium_um": wave } })).len(), 1);
}

#[test]
fn a_label_volume_is_a_piece_of_the_tube_within_the_bounds_of_its_formats() {
    let spec = resolved(&json!({}));
    assert_eq!((spec.label_slices(), spec.label_from_um()), (1200, 0.0));
    let piece = resolved(&json!({ "labels": { "from": 0.4, "to": 0.5, "slice_um": 70 } }));
    assert_eq!((piece.label_slices(), piece.label_from_um()), (85, 24_000.0));
    let thin = resolved(&json!({ "labels": { "from": 0.5, "to": 0.5001 } }));
    assert_eq!(thin.label_slices(), 1);
    assert!(fault(&json!({ "labels": { "from": 0.5, "to": 0.5 } })).detail.contains("not above /labels/from 0.5"));
    assert_eq!(fault(&json!({ "labels": { "slice_um": 1 } })).pointer, "/labels/slice_um");
    assert_eq!(pointers(&json!({ "labels": { "slice_um": 1, "to": 0.5 } })), [""; 0]);
    let wide = json!({ "labels": { "voxel_um": 0.5 }, "containment": { "wall_um": 3000 } });
    assert_eq!(fault(&wide).pointer, "/labels/voxel_um");
}

#[test]
fn a_piece_reaches_from_a_section_before_it_to_one_after_it() {
    let steps = |patch: &Value| {
        let spec = resolved(patch);
        let [begin, end] = spec.piece_um().map(|um| um / (spec.length_mm * 1000.0));
        assert!(begin <= spec.piece.from && end >= spec.piece.to, "{begin} {end}");
        assert_eq!(spec.stations().next(), Some(*spec.recorded().start()));
        assert_eq!(spec.stations().last(), Some(*spec.recorded().end()));
        (spec.stations().count(), spec.recorded())
    };
    let (all, whole) = steps(&json!({}));
    assert_eq!((all, whole), (201, 0..=2000));
    let (some, piece) = steps(&json!({ "piece": { "from": 0.5, "to": 0.6 } }));
    assert!((15..30).contains(&some) && piece.start() % 10 == 0 && piece.end() % 10 == 0, "{some} {piece:?}");
    let (short, piece) = steps(&json!({ "piece": { "from": 0.5, "to": 0.5001 } }));
    assert_eq!((short, piece.end() - piece.start()), (2, 10));
    let (last, piece) = steps(&json!({ "piece": { "from": 0.9999 } }));
    assert_eq!((last, piece), (2, 1990..=2000));
    let (first, piece) = steps(&json!({ "piece": { "to": 0.0001 } }));
    assert_eq!((first, piece), (2, 0..=10));
    let beyond = json!({ "solver": { "record_every": 1000 }, "piece": { "from": 0.999 } });
    assert_eq!(steps(&beyond), (2, 1000..=2000));

    // Labels are placed within the piece.
    let spec = resolved(&json!({ "piece": { "from": 0.5, "to": 0.6 }, "labels": { "from": 0.5 } }));
    let [begin, end] = spec.piece_um();
    assert!((spec.label_from_um() - 0.5 * (begin + end)).abs() < 1e-6);
    let covered = f64::from(spec.label_slices()) * spec.labels.slice_um;
    assert!((0.5 * (end - begin) - covered).abs() <= spec.labels.slice_um, "{covered}");
}

#[test]
fn every_preset_can_be_bent() {
    for preset in presets() {
        for turn_deg in [1, 15, 45, 90] {
            let patch = json!({ "course": { "shape": "arc", "turn_deg": turn_deg } });
            let found = ModelSpec::resolve(preset, &patch);
            assert!(found.is_ok(), "{} by {turn_deg}°: {found:?}", preset.name);
        }
    }
}

#[test]
fn courses_without_room_are_refused_with_the_place_or_relaxed() {
    let faults = |course: &Value| resolve(&json!({ "course": course })).unwrap_err();
    for (course, pointer, words) in [
        (json!({ "shape": "arc", "turn_deg": 720 }), "/course/turn_deg", "too near to each other"),
        (json!({ "shape": "sigmoid", "turn_deg": 700 }), "/course/turn_deg", "is too tight at"),
        (json!({ "shape": "coil", "windings": 12, "pitch_mm": 5 }), "/course/windings", "is not less than /length_mm"),
        (json!({ "shape": "coil", "windings": 6, "pitch_mm": 2 }), "/course/windings", "mm from the isthmus end"),
        (
            json!({ "shape": "random", "tortuosity": 4, "wavelength_mm": 8 }),
            "/course/tortuosity",
            "mm from the isthmus end",
        ),
        (json!({ "shape": "random", "wavelength_mm": 10_000 }), "/course/tortuosity", "use shorter ones"),
        (json!({ "shape": "points" }), "/course/points_mm", "has 0 points"),
        (
            json!({ "shape": "points", "points_mm": [[0, 0, 0], [0, 0, 1], [0, 0, 1]] }),
            "/course/points_mm/2",
            "is the point before it",
        ),
        (
            json!({ "shape": "points", "points_mm": [[9000, 0, 0], [9000, 0, 1]] }),
            "/course/points_mm",
            "single precision",
        ),
        (json!({ "points_mm": [[0, 0]] }), "/course/points_mm/0", "not an array of 2"),
        (json!({ "points_mm": [[0, 0, "a"]] }), "/course/points_mm/0/2", "must be a number"),
        (json!({ "points_mm": 3 }), "/course/points_mm", "must be an array of points"),
        (json!({ "shape": "knot" }), "/course/shape", "must be one of"),
        (json!({ "shape": "turns" }), "/course/turns", "has 0 turns"),
        (json!({ "shape": "turns", "turns": [[0.5, 0, 0, 0.2]] }), "/course/turns/0/1", "at least 1°"),
        (json!({ "shape": "turns", "turns": [[0.5, 90, 0, 0]] }), "/course/turns/0/3", "is 0; a turn takes"),
        (json!({ "shape": "turns", "turns": [[0.05, 90, 0, 0.2]] }), "/course/turns/0/0", "leave the tube"),
        (
            json!({ "shape": "turns", "turns": [[0.3, 90, 0, 0.2], [0.4, 90, 0, 0.2]] }),
            "/course/turns/1/0",
            "begin at 0.3000, before the turn before it ends at 0.4000",
        ),
        (json!({ "shape": "turns", "turns": [[0.5, 180, 0, 0.05]] }), "/course/turns", "is too tight at"),
        (json!({ "turns": [[0.5, 180, 0]] }), "/course/turns/0", "[at, turn_deg, toward_deg, share]"),
        (json!({ "turns": [[0.5, 400, 0, 0.1]] }), "/course/turns/0/1", "above the greatest"),
    ] {
        let found = faults(&course);
        assert!(
            found.len() == 1 && found[0].pointer == pointer && found[0].detail.contains(words),
            "{course}: {found:?}"
        );
    }
    for course in [
        json!({ "shape": "arc", "turn_deg": 720, "relax": true }),
        json!({ "shape": "random", "tortuosity": 4, "wavelength_mm": 8, "relax": true }),
        json!({ "shape": "coil", "windings": 6, "pitch_mm": 2, "relax": true }),
    ] {
        let bent = resolve(&json!({ "course": course })).unwrap().bent_course().unwrap();
        assert!(bent.relaxed && bent.room.bend.radius_ratio() <= 0.8, "{course}");
        assert!(bent.room.near.is_none_or(|near| near.distance >= 200.0));
    }
}

#[test]
fn the_coil_of_the_mouse_has_its_turning_points() {
    let spec = ModelSpec::resolve(preset("mouse").unwrap(), &json!({})).unwrap();
    let turns = spec.turning_points();
    assert_eq!(turns.iter().map(|turn| turn.number).collect::<Vec<_>>(), (1..=11).rev().collect::<Vec<_>>());
    // Published: the ampulla ends at the third of eleven turns from the ovary.
    let regions: Vec<&str> = turns.iter().rev().map(|turn| turn.region.as_str()).collect();
    assert_eq!(regions[..3], ["ampulla", "ampulla", "junction"]);
    assert!(regions[3..].iter().all(|region| *region == "isthmus"), "{regions:?}");
    let course = spec.centre_line().unwrap();
    for turn in &turns {
        assert!((course.at(1000.0 * turn.z_mm).origin / 1000.0).distance(turn.position_mm.into()) < 1e-9);
        assert!(course.curvature(1000.0 * turn.z_mm) > 1.0 / 1000.0, "{turn:?}");
    }
    // The turns of an animal are unequal, unlike those of a helix.
    let parts: Vec<f64> = turns.windows(2).map(|pair| pair[1].z_mm - pair[0].z_mm).collect();
    let [least, most] = [f64::min, f64::max].map(|pick| parts.iter().copied().reduce(pick).unwrap());
    assert!(most > 1.3 * least, "{parts:?}");
    let shorter = ModelSpec::resolve(preset("mouse").unwrap(), &json!({ "course": { "shape": "straight" } })).unwrap();
    assert_eq!(shorter.turning_points(), []);
}

#[test]
fn a_course_is_the_same_each_time_and_in_a_stored_specification() {
    let spec = resolve(&json!({ "course": { "shape": "random", "seed": 5 } })).unwrap();
    let again = ModelSpec::from_stored(&spec.to_json()).unwrap();
    assert_eq!(again.bent_course(), spec.bent_course());
    assert!((spec.bent_course().unwrap().course.tortuosity() - 1.5).abs() < 0.01);
    let mut older = resolve(&json!({})).unwrap().to_json();
    older.as_object_mut().unwrap().remove("course");
    assert!(!ModelSpec::from_stored(&older).unwrap().bends());
    assert!(ModelSpec::from_stored(&Value::Null).is_none(), "no specification is not an empty one");
    assert!(resolve(&json!({ "course": { "twist_deg": 30 } })).unwrap().bends());
}

#[test]
fn a_contraction_needs_frames_that_its_surface_can_make() {
    let faults = |patch: Value| resolve(&patch).unwrap_err();
    for (patch, words) in [
        (json!({ "contraction": { "frames": 1 } }), "at least 2 frames"),
        (
            json!({ "contraction": { "frames": 20 }, "mesh": { "resolution_um": 40 } }),
            "an even surface does not contract",
        ),
        (json!({ "contraction": { "frames": 201 } }), "200"),
        (json!({ "contraction": { "frames": 20, "closure": 0, "shortening": 0 } }), "nothing would move"),
    ] {
        let found = faults(patch);
        assert!(found.len() == 1 && found[0].pointer == "/contraction/frames", "{found:?}");
        assert!(found[0].detail.contains(words), "{found:?}");
    }
    assert_eq!(faults(json!({ "contraction": { "toward": "up" } }))[0].pointer, "/contraction/toward");
    let short =
        |ends_mm: f64| json!({ "contraction": { "frames": 2, "ends_mm": ends_mm }, "piece": { "from": 0.9, "to": 1 } });
    let found = faults(short(3.4));
    assert!(found.len() == 1 && found[0].pointer == "/contraction/ends_mm", "{found:?}");
    assert!(resolve(&short(3.1)).is_ok());
}

#[test]
fn outlines_and_folds_that_cannot_be_name_the_place() {
    let polygon = |points: Value| json!({ "outline": { "kind": "polygon", "points": points } });
    let grid = |rows: Value| json!({ "outline": { "kind": "grid", "grid": rows } });
    for (patch, pointer, detail) in [
        (polygon(json!([])), "/outline/points", "at least 3"),
        (polygon(json!([[1, 0], [0, 1], [0.2, -0.2], [-1, 0], [0, -1]])), "/outline/points/1", "runs back"),
        (polygon(json!([[2, 2], [2, 3], [1, 3]])), "/outline/points/2", "runs back"),
        (polygon(json!([[1, 0], [0, 1], [-0.1, -0.1]])), "/outline/points", "0.3"),
        (
            polygon(json!([[1, 0, 0], [0, 1], [-1, 0]])),
            "/outline/points/0",
            "must be a point [x, y], not an array of 3",
        ),
        (polygon(json!([[1, 0], [0, 4], [-1, 0]])), "/outline/points/1/1", "above the greatest"),
        (grid(json!([])), "/outline/grid", "at least 2 rows"),
        (grid(json!([[1, 1], [1]])), "/outline/grid/1", "an array of 2 numbers"),
        (grid(json!([[1, 1], [1, "a"]])), "/outline/grid/1/1", "must be a number"),
        (grid(json!([[1, 1], [1, 1]])), "/outline/grid", "not negative at the axis"),
        (grid(json!([[-1, -1], [-1, -1]])), "/outline/grid", "0 times along the ray at 0°"),
        (json!({ "outline": { "kind": "circle" } }), "/outline/kind", "must be one of"),
        (json!({ "folds": { "depth": 0.5, "period_mm": 1 } }), "/folds/period_mm", "the folds move the boundary by"),
        (json!({ "scale": 0 }), "/scale", "below the least"),
    ] {
        let fault = fault(&patch);
        assert!(fault.pointer == pointer && fault.detail.contains(detail), "{patch}: {fault:?}");
    }
    let bad = json!({ "outline": { "strength": 0, "kind": "polygon" } });
    assert_eq!(pointers(&bad), [""; 0], "an outline that is never taken on may be anything");
}
