//! Shapes whose measures are known.

use super::section::{Scope, measure_with};
use super::*;
use crate::model::{Ring, Section};
use crate::tissue::Layers;
use std::f32::consts::TAU;

type Points = Vec<[f32; 2]>;

fn circle(radius: f32, n: usize) -> Points {
    (0..n).map(|i| TAU * i as f32 / n as f32).map(|t| [radius * t.cos(), radius * t.sin()]).collect()
}

/// Joins the corners by points at most `step` apart.
fn dense(corners: &[[f32; 2]], step: f32) -> Points {
    let mut points = Vec::new();
    for (i, a) in corners.iter().enumerate() {
        let b = corners[(i + 1) % corners.len()];
        let pieces = ((b[0] - a[0]).hypot(b[1] - a[1]) / step).ceil().max(1.0);
        points.extend((0..pieces as usize).map(|k| {
            let s = k as f32 / pieces;
            [a[0] + s * (b[0] - a[0]), a[1] + s * (b[1] - a[1])]
        }));
    }
    points
}

/// Radius at the bottoms of the valleys of [`comb`].
const BOTTOM: f32 = 800.0;

/// A lumen of radius 800 µm with `n` equal folds. The corners of a fold are given from one side of
/// its base to the other, with x towards the centre of the tube and y along its wall.
fn comb(n: usize, fold: &[[f32; 2]]) -> Points {
    let mut corners = Vec::new();
    for k in 0..n {
        let (sin, cos) = (TAU * k as f32 / n as f32).sin_cos();
        let place = |[x, y]: [f32; 2]| [(BOTTOM - x) * cos - y * sin, (BOTTOM - x) * sin + y * cos];
        corners.extend(fold.iter().map(|&corner| place(corner)));
        // Bottom of the valley: an arc to the next fold.
        let half = fold[0][1].abs() / BOTTOM;
        let pitch = TAU / n as f32;
        let arc = (1..32).map(|i| k as f32 * pitch + half + (pitch - 2.0 * half) * i as f32 / 32.0);
        corners.extend(arc.map(|t| [BOTTOM * t.cos(), BOTTOM * t.sin()]));
    }
    dense(&corners, 6.0)
}

/// A fold 80 µm wide and 400 µm high with a round tip, between the corners of its base. The corners
/// of `branch` come before the last corner.
fn finger(branch: &[[f32; 2]]) -> Points {
    let tip =
        (0..=16).map(|i| std::f32::consts::PI * i as f32 / 16.0).map(|t| [360.0 + 40.0 * t.sin(), -40.0 * t.cos()]);
    [[0.0, -40.0]].into_iter().chain(tip).chain(branch.iter().copied()).chain([[0.0, 40.0]]).collect()
}

fn plain() -> Points {
    finger(&[])
}

/// A fold with a branch 100 µm long and 40 µm wide on one side.
fn branched() -> Points {
    finger(&[[240.0, 40.0], [240.0, 140.0], [200.0, 140.0], [200.0, 40.0]])
}

/// Area of a plain fold, mm², and length that it adds to the perimeter, mm.
const AREA: f64 = 0.08 * 0.36 + std::f64::consts::PI * 0.04 * 0.04 / 2.0;
const LENGTH: f64 = 2.0 * 0.36 + std::f64::consts::PI * 0.04 - 0.08;

/// All measures.
fn with_layers(layers: &Layers) -> Scope<'_> {
    Scope { rays_um: Some(5.0), tree: true, layers: Some(layers) }
}

fn of(lumen: &[[f32; 2]], outer: &[[f32; 2]]) -> Measures {
    measure(&Shape { outer, lumen: vec![lumen] }, true)
}

#[track_caller]
fn within_one_percent(found: f64, expected: f64) {
    assert!((found / expected - 1.0).abs() < 0.01, "{found} instead of {expected}");
}

#[track_caller]
fn is_dimension(found: Option<Dimension>, expected: f64) {
    let found = found.unwrap();
    assert!((found.value - expected).abs() < 0.03, "{found:?} instead of {expected}");
}

#[test]
fn an_annulus() {
    let measures = of(&circle(400.0, 320), &circle(1000.0, 200));
    let pi = std::f64::consts::PI;
    within_one_percent(measures.lumen_area_mm2, pi * 0.16);
    within_one_percent(measures.tissue_area_mm2, pi * 0.84);
    within_one_percent(measures.outer_diameter_mm, 2.0);
    within_one_percent(measures.lumen_perimeter_mm, pi * 0.8);
    within_one_percent(measures.hydraulic_diameter_um, 800.0);
    within_one_percent(measures.perimeter_ratio, 1.0);
    within_one_percent(measures.wall_share, 0.84);
    assert!(measures.fill.abs() < 0.01);
    let (thickness, gap) = (measures.thickness_um.unwrap(), measures.gap_um.unwrap());
    for (spread, expected) in [(thickness, 600.0), (gap, 800.0)] {
        [spread.p5, spread.p50, spread.p95].into_iter().for_each(|found| within_one_percent(found, expected));
        assert!(spread.cv < 0.01);
    }
    let folds = measures.folds.unwrap();
    assert_eq!((measures.folds_on_ring, folds.branches, folds.height_um), (0, [0; 4], None));
}

#[test]
fn an_ellipse_has_its_ratio_whatever_its_direction() {
    let turned = |a: f32, b: f32| -> Points {
        circle(1.0, 400).iter().map(|[x, y]| [a * x * 0.8 - b * y * 0.6, a * x * 0.6 + b * y * 0.8]).collect()
    };
    let measures = of(&turned(500.0, 300.0), &turned(1000.0, 600.0));
    within_one_percent(measures.perimeter_ratio, 1.0);
    within_one_percent(measures.wall_share, 0.75);
    assert!(measures.fill < 0.001);
}

#[test]
fn a_comb_of_plain_folds() {
    let lumen = comb(12, &plain());
    let measures = of(&lumen, &circle(1200.0, 240));
    // The base of a fold is the chord of its corners, which are 1 µm off the circle.
    let area = std::f64::consts::PI * 0.64 - 12.0 * AREA;
    within_one_percent(measures.lumen_area_mm2, area);
    within_one_percent(measures.lumen_perimeter_mm, std::f64::consts::TAU * 0.8 + 12.0 * LENGTH);
    let folds = measures.folds.clone().unwrap();
    assert_eq!((measures.folds_on_ring, folds.branches, folds.orders), (12, [12, 0, 0, 0], [12, 0, 0, 0]));
    within_one_percent(folds.height_um.unwrap().p50, 400.0);
    // Most rays go from the sides of the folds, which have more than half of the points, to the
    // opposite side.
    within_one_percent(measures.thickness_um.unwrap().p50, 80.0);
    within_one_percent(measures.fill, 1.0 - area / (std::f64::consts::PI * 0.64));
    within_one_percent(measures.fold_height_share.unwrap(), 0.5);
    // The tips of the folds leave half of the radius free.
    let outer = circle(1200.0, 240);
    let shape = Shape { outer: &outer, lumen: vec![&lumen] };
    let layered = measure_with(&shape, &shape.base_ellipse(), with_layers(&Layers::NONE));
    within_one_percent(layered.lumen_disc_share.unwrap(), 0.5);
    assert!(folds.angle_deg.unwrap() < 3.0, "{folds:?}");
    assert_eq!((measures.touching_share, measures.layers), (Some(0.0), None));
}

#[test]
fn the_angle_of_folds_is_that_of_their_axes() {
    for degrees in [15.0_f32, 40.0] {
        // Pointed folds whose tips are displaced along the wall, all in the same direction.
        let tip = [400.0, 400.0 * degrees.to_radians().tan()];
        let folds = of(&comb(8, &[[0.0, -40.0], tip, [0.0, 40.0]]), &circle(1200.0, 240)).folds.unwrap();
        assert_eq!(folds.branches[0], 8);
        let found = folds.angle_deg.unwrap();
        assert!((found - f64::from(degrees)).abs() < 1.5, "{found}°, not {degrees}°");
    }
}

#[test]
fn walls_touch_below_ten_micrometres() {
    for (width, share) in [(8.0, 1.0), (12.0, 0.0)] {
        let slit = dense(&[[0.0, 0.0], [1000.0, 0.0], [1000.0, width], [0.0, width]], 4.0);
        let found = of(&slit, &circle(2000.0, 200)).touching_share.unwrap();
        assert!((found - share).abs() < 0.06, "{width} µm: {found}");
    }
}

#[test]
fn lamina_below_clefts_is_measured_at_their_deepest_points() {
    let (lumen, outer) = (comb(12, &plain()), circle(1200.0, 720));
    let shape = Shape { outer: &outer, lumen: vec![&lumen] };
    let layers = Layers { epithelium_um: 30.0, lamina_um: 50.0, opening_um: 40.0, serosa_um: 20.0, ..Layers::NONE };
    let measures = measure_with(&shape, &shape.base_ellipse(), with_layers(&layers));
    let clefts = &measures.folds.as_ref().unwrap().clefts;
    assert_eq!(clefts.len(), 12);
    assert!(clefts.iter().all(|[x, y]| (x.hypot(*y) - 800.0).abs() < 2.0), "{clefts:?}");
    let found = measures.layers.unwrap();
    assert!((found.cleft_lamina_um.unwrap() - 50.0).abs() < 3.0, "{found:?}");
    // Folds of 80 µm are 60 µm of epithelium and 20 µm of lamina; no muscle enters them.
    assert!(found.lamina_over_epithelium.unwrap() > 0.6, "{found:?}");
    assert_eq!((found.vessels, found.subserosa_um), (0, 0.0));
}

#[test]
fn a_comb_of_branched_folds() {
    let measures = of(&comb(9, &branched()), &circle(1200.0, 240));
    let folds = measures.folds.clone().unwrap();
    assert_eq!((folds.branches, folds.orders), ([9, 9, 0, 0], [0, 9, 0, 0]));
    within_one_percent(folds.height_um.unwrap().p50, 400.0);
    let value = |name: &str| Quantity::named(name).unwrap().of(&measures).unwrap();
    assert_eq!((value("primary_folds"), value("secondary_folds"), value("tertiary_folds")), (9.0, 9.0, 0.0));
    assert_eq!((value("branching_order"), value("branching_order_mean")), (2.0, 2.0));
}

#[test]
fn low_bumps_are_not_folds() {
    // 35 µm high on a base of 200 µm; and 60 µm high, less than the width of its base.
    for height in [35.0, 60.0] {
        let bump = [[0.0, -100.0], [height, 0.0], [0.0, 100.0]];
        let folds = of(&comb(8, &bump), &circle(1200.0, 240)).folds.unwrap();
        assert_eq!(folds.branches, [0; 4], "{height}");
    }
}

/// A strip 40 µm wide along an Archimedean spiral with a pitch of 120 µm.
fn spiral() -> Points {
    let side = |offset: f32| {
        (0..1600).map(move |i| {
            let t = TAU * (1.0 + 5.0 * i as f32 / 1600.0);
            let radius = 120.0 * t / TAU + offset;
            [radius * t.cos(), radius * t.sin()]
        })
    };
    let mut points: Points = side(20.0).collect();
    points.extend(side(-20.0).collect::<Vec<_>>().into_iter().rev());
    dense(&points, 8.0)
}

#[test]
fn a_spiral_has_its_gap_and_its_thickness() {
    let measures = of(&spiral(), &circle(1000.0, 200));
    within_one_percent(measures.gap_um.unwrap().p50, 40.0);
    within_one_percent(measures.thickness_um.unwrap().p50, 80.0);
}

#[test]
fn distances_do_not_depend_on_how_a_contour_is_divided() {
    let outer = circle(1200.0, 240);
    // Folds and clefts of varying width, with points 9 µm apart.
    let radius = |t: f32| 600.0 + 250.0 * (9.0 * t).sin().powi(3) + 40.0 * (31.0 * t).cos();
    let star: Points = (0..700)
        .map(|i| TAU * i as f32 / 700.0)
        .map(|t| [radius(t) * (t + 0.2 * (5.0 * t).sin()).cos(), radius(t) * (t + 0.2 * (5.0 * t).sin()).sin()])
        .collect();
    for lumen in [star, comb(12, &branched())] {
        let numbers = |lumen: &[[f32; 2]]| {
            let measures = of(lumen, &outer);
            let [thickness, gap] = [measures.thickness_um.unwrap(), measures.gap_um.unwrap()];
            [thickness, gap].map(|spread| [spread.p5, spread.p50, spread.p95, spread.cv])
        };
        for (whole, divided) in numbers(&lumen).iter().flatten().zip(numbers(&dense(&lumen, 0.8)).iter().flatten()) {
            assert!((divided / whole - 1.0).abs() < 0.003, "{divided} instead of {whole}");
        }
    }
}

/// Koch's snowflake: each edge is replaced by four, `level` times.
fn koch(side: f32, level: u32) -> Points {
    let high = side * 3.0_f32.sqrt() / 2.0;
    let mut points: Vec<[f32; 2]> = vec![[0.0, 0.0], [side, 0.0], [side / 2.0, high]];
    for _ in 0..level {
        let n = points.len();
        points = (0..n)
            .flat_map(|i| {
                let (a, b) = (points[i], points[(i + 1) % n]);
                let [u, v] = [(b[0] - a[0]) / 3.0, (b[1] - a[1]) / 3.0];
                let tip = [a[0] + 1.5 * u + v * 0.75_f32.sqrt(), a[1] + 1.5 * v - u * 0.75_f32.sqrt()];
                [a, [a[0] + u, a[1] + v], tip, [a[0] + 2.0 * u, a[1] + 2.0 * v]]
            })
            .collect();
    }
    points
}

#[test]
fn fractal_dimensions() {
    let outer: Points = circle(6000.0, 100);
    is_dimension(of(&koch(4000.0, 6), &outer).outline_dimension, 4.0_f64.ln() / 3.0_f64.ln());
    let square = of(&dense(&[[0.0, 0.0], [2048.0, 0.0], [2048.0, 2048.0], [0.0, 2048.0]], 64.0), &outer);
    is_dimension(square.area_dimension, 2.0);
    is_dimension(of(&circle(1000.0, 800), &outer).outline_dimension, 1.0);
    assert!((square.lacunarity.unwrap() - 1.0).abs() < 1e-9);
    // A strip one pixel wide is a line.
    let line = of(&dense(&[[0.0, 0.0], [3000.0, 0.0], [3000.0, 4.1], [0.0, 4.1]], 64.0), &outer);
    is_dimension(line.area_dimension, 1.0);
}

/// A square without one quarter, recursively; the removed parts are islands.
#[test]
fn the_dimension_of_a_gasket() {
    let side = 2048.0;
    let square = |x: f32, y: f32, w: f32| vec![[x, y], [x + w, y], [x + w, y + w], [x, y + w]];
    let whole = square(0.0, 0.0, side);
    let mut holes = Vec::new();
    let mut corners = vec![[0.0_f32, 0.0_f32]];
    let mut width = side;
    for _ in 0..8 {
        width /= 2.0;
        for [x, y] in std::mem::take(&mut corners) {
            let mut hole = square(x + width, y + width, width);
            hole.reverse();
            holes.push(hole);
            corners.extend([[x, y], [x + width, y], [x, y + width]]);
        }
    }
    let outer = circle(4000.0, 100);
    let lumen: Vec<&[[f32; 2]]> = std::iter::once(&whole).chain(&holes).map(Vec::as_slice).collect();
    let measures = measure(&Shape { outer: &outer, lumen }, false);
    assert_eq!(measures.islands as usize, holes.len());
    is_dimension(measures.area_dimension, 3.0_f64.log2());
    within_one_percent(measures.lumen_area_mm2, f64::from(side / 1e3).powi(2) * 0.75_f64.powi(8));
}

fn section(inner: Points, z_um: f64) -> Section {
    let ring = |points: Points| Ring { ids: (0..points.len() as u32).collect(), points };
    Section { step: z_um, z_um, added: false, inner: ring(inner), outer: ring(circle(1200.0, 240)) }
}

#[test]
fn a_turning_tube() {
    let turned = |k: usize| -> Points {
        let (sin, cos) = (2.0 * k as f32).to_radians().sin_cos();
        comb(12, &plain()).iter().map(|[x, y]| [x * cos - y * sin, x * sin + y * cos]).collect()
    };
    let mut sections: Vec<Section> = (0..11).map(|k| section(turned(k), 1000.0 * k as f64)).collect();
    // Sections added to mend a slab are not measured.
    sections.insert(4, Section { added: true, ..section(circle(100.0, 50), 3500.0) });
    let gaps: Vec<Option<f64>> = (0..sections.len()).map(|k| Some(k as f64)).collect();
    let found =
        morphometry(&sections, &gaps, &Regions { length_mm: 10.0, junction: [0.25, 0.45], piece: [0.0, 1.0] }, None);
    assert!((found.tube.twist_deg - 20.0).abs() < 0.01, "{}", found.tube.twist_deg);
    assert_eq!(found.tube.fold_continuity, Some(1.0));
    let area = std::f64::consts::PI * 0.64 - 12.0 * AREA;
    within_one_percent(found.tube.lumen_volume_mm3, 10.0 * area);
    let perimeter = std::f64::consts::TAU * 0.8 + 12.0 * LENGTH;
    within_one_percent(found.tube.lumen_surface_mm2, 10.0 * perimeter);
    within_one_percent(found.tube.surface_over_volume_per_mm, perimeter / area);
    within_one_percent(found.tube.hydraulic_diameter_um, 4e3 * area / perimeter);
    assert_eq!(found.tube.fold_ratio, Some(1.0));
    let sections_of = |name: &str| found.regions[name].sections;
    assert_eq!(["isthmus", "junction", "ampulla", "whole"].map(sections_of), [3, 2, 6, 11]);
    assert_eq!(found.mean("folds_on_ring", "ampulla"), Some(12.0));
    assert_eq!(found.mean("length_mm", "tube"), Some(10.0));
    assert!((found.mean("twist_deg_per_mm", "isthmus").unwrap() - 2.0).abs() < 0.01);
    let piece = Regions { length_mm: 10.0, junction: [0.25, 0.45], piece: [0.1, 0.4] };
    let found_there = morphometry(&sections[1..6], &gaps[1..6], &piece, None).tube;
    assert_eq!((found_there.length_mm, found_there.isthmus_length_mm), ((0.4 - 0.1) * 10.0, 1.5));
    assert_eq!(found_there.ampulla_length_mm, 0.0);
    assert!(found.along.values().all(|values| values.len() == 11));
    assert_eq!(found.along["least_gap_um"][4], Some(5.0));
    // Sections of a simulation cannot have islands, so a report does not claim that the tube has
    // none.
    assert!(!found.along.contains_key("islands") && !found.regions["whole"].quantities.contains_key("islands"));
    assert_eq!(found.along["twist_deg_per_mm"][10], None);
}

#[test]
fn few_of_many_sections_are_measured_in_detail() {
    let lumen = comb(12, &plain());
    let sections: Vec<Section> = (0..=91).map(|k| section(lumen.clone(), 10.0 * f64::from(k))).collect();
    let regions = Regions { length_mm: 0.91, junction: [0.3, 0.4], piece: [0.0, 1.0] };
    let found = morphometry(&sections, &[], &regions, Some(&|_| Layers::NONE));
    let Settings { detail_every, tree_every, layers_every, .. } = found.settings;
    assert_eq!((detail_every, tree_every, layers_every), (6, 4, 16));
    let measured = |name: &str| found.along[name].iter().flatten().count();
    assert_eq!(["lumen_area_mm2", "folds_on_ring", "islands"].map(measured), [92; 3]);
    assert_eq!(measured("primary_folds"), 24);
    // At the multiples of 6 and where layers are measured.
    assert_eq!(["lumen_gap_p50_um", "lacunarity", "asymmetry"].map(measured), [21; 3]);
    assert_eq!(["free_lumen", "lumen_disc_share"].map(measured), [7; 2]);
    // The last section belongs to the measured ones even if it is not at a multiple.
    assert!(found.along["lumen_gap_p50_um"][91].is_some());
    let short = morphometry(&sections[..13], &[], &regions, None);
    assert_eq!((short.settings.detail_every, short.settings.tree_every), (1, 1));
}

#[test]
fn a_fold_that_divides_does_not_continue() {
    // Every second fold is missing in the next section, so half of the folds continue.
    let (many, few) = (comb(12, &plain()), comb(6, &plain()));
    let n = few.len();
    let nearest = |p: &[f32; 2]| {
        let distance = |q: &[f32; 2]| (q[0] - p[0]).hypot(q[1] - p[1]);
        (0..n).min_by(|&a, &b| distance(&few[a]).total_cmp(&distance(&few[b]))).unwrap()
    };
    let mut next = section(few.clone(), 1000.0);
    // The points of the remaining folds have the ids of the nearest earlier points; all other
    // points are new.
    let mut ids: Vec<u32> = (10_000..10_000 + n as u32).collect();
    for (id, p) in many.iter().enumerate() {
        let k = nearest(p);
        if (few[k][0] - p[0]).hypot(few[k][1] - p[1]) < 3.0 {
            ids[k] = id as u32;
        }
    }
    next.inner.ids = ids;
    let sections = [section(many, 0.0), next];
    let found = morphometry(
        &sections,
        &[None, None],
        &Regions { length_mm: 1.0, junction: [0.3, 0.4], piece: [0.0, 1.0] },
        None,
    );
    assert_eq!(found.along["fold_continuity"], [Some(0.5), None]);
    assert!(!found.regions.contains_key("junction"));
}

#[test]
fn results_do_not_depend_on_the_threads() {
    let sections: Vec<Section> =
        (0..8).map(|k| crate::model::sample::section(200, f64::from(k), 500.0 * f64::from(k))).collect();
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let regions = Regions { length_mm: 3.5, junction: [0.3, 0.4], piece: [0.0, 1.0] };
            let layers = |_| crate::tissue::Layers { epithelium_um: 30.0, ..crate::tissue::Layers::NONE };
            morphometry(&sections, &[None; 8], &regions, Some(&layers))
        })
    };
    assert_eq!(on(1), on(3));
}

#[test]
fn unusable_sections_are_measured_without_a_panic() {
    let outer = circle(500.0, 30);
    let line = [[0.0, 0.0], [100.0, 0.0], [50.0, 0.0]];
    for lumen in [&line[..], &[[1.0, 1.0]; 3], &[]] {
        let measures = measure(&Shape { outer: &outer, lumen: vec![lumen] }, true);
        assert!(QUANTITIES.iter().all(|quantity| quantity.of(&measures).is_none_or(f64::is_finite)));
    }
}
