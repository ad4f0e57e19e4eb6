//! Known shapes, and rules of connectivity.

use super::*;
use crate::geometry::polygon::{Containment, locate, signed_area};
use proptest::prelude::*;
use std::f32::consts::TAU;

fn ellipse(a: f32, b: f32, turn: f32, centre: [f32; 2]) -> Points {
    let (sin, cos) = turn.sin_cos();
    let point = |t: f32| {
        let (x, y) = (a * t.cos(), b * t.sin());
        [centre[0] + x * cos - y * sin, centre[1] + x * sin + y * cos]
    };
    (0..720).map(|i| point(TAU * i as f32 / 720.0)).collect()
}

/// A lumen of 12 folds with straight sides and sharp corners.
fn comb() -> Points {
    let at = |k: f32, radius: f32| [radius * (TAU * k / 48.0).cos(), radius * (TAU * k / 48.0).sin()];
    (0..48).map(|k| at(k as f32, if k % 4 < 2 { 780.0 } else { 420.0 })).collect()
}

#[track_caller]
fn close(found: f64, expected: f64, tolerance: f64) {
    assert!((found / expected - 1.0).abs() < tolerance, "{found} instead of {expected}");
}

/// Measures of the shape itself and of its image.
fn both(pixel_um: f64, outer: &[[f32; 2]], lumen: &[&[[f32; 2]]]) -> (Measures, Measures) {
    let side = (2200.0 / pixel_um) as usize;
    let contours: Vec<&[[f32; 2]]> = [&[outer], lumen].concat();
    let traced = read(&grey(side, &paint([side; 2], pixel_um, &contours)), pixel_um).unwrap();
    assert_sound(&traced);
    (measure(&Shape { outer, lumen: lumen.to_vec() }, true), traced.measure())
}

#[test]
fn known_shapes_have_their_areas_and_lengths() {
    let outer = ellipse(1000.0, 950.0, 0.3, [3.0, 1.0]);
    let square = |turn: f32| -> Points {
        (0..4).map(|k| turn + TAU * k as f32 / 4.0).map(|t| [1.2 + 500.0 * t.cos(), 500.0 * t.sin() - 0.5]).collect()
    };
    let mut lumens = vec![ellipse(400.0, 400.0, 0.0, [0.3, 0.7]), ellipse(700.0, 200.0, 1.1, [-20.0, 30.0]), comb()];
    lumens.extend([0.0, 0.02, 0.1, 0.3, 0.5, TAU / 8.0].map(square));
    for (i, lumen) in lumens.iter().enumerate() {
        for pixel_um in [1.0, 2.0, 5.0] {
            let (own, found) = both(pixel_um, &outer, &[lumen]);
            close(found.outer_diameter_mm, own.outer_diameter_mm, 0.001);
            close(found.lumen_area_mm2, own.lumen_area_mm2, 0.003);
            close(found.lumen_perimeter_mm, own.lumen_perimeter_mm, 0.01);
            close(found.hydraulic_diameter_um, own.hydraulic_diameter_um, 0.01);
            assert_eq!(found.folds_on_ring, if i == 2 { 12 } else { found.folds_on_ring });
            assert_eq!(found.folds.unwrap().branches[0], if i == 2 { 12 } else { 0 }, "{i}, {pixel_um} µm");
        }
    }
}

#[test]
fn islands_and_pockets_count_and_specks_do_not() {
    let outer = ellipse(1000.0, 1000.0, 0.0, [0.0; 2]);
    let lumen = ellipse(500.0, 400.0, 0.0, [-100.0, 0.0]);
    // The base ellipse is a circle with a radius of 600 µm.
    let pocket = ellipse(60.0, 60.0, 0.0, [500.0, 100.0]);
    let vessels = [ellipse(60.0, 60.0, 0.0, [800.0, 100.0]), ellipse(60.0, 60.0, 0.0, [560.0, -100.0])];
    let debris = ellipse(30.0, 30.0, 0.0, [800.0, 100.0]);
    let mut island = ellipse(90.0, 50.0, 0.5, [-100.0, 100.0]);
    island.reverse();
    // 314 µm² each: one in the tissue, one in the lumen.
    let specks = [ellipse(10.0, 10.0, 0.0, [-700.0, 300.0]), ellipse(10.0, 10.0, 0.0, [-100.0, -200.0])];
    let contours: Vec<&[[f32; 2]]> = [&outer, &lumen, &pocket, &island, &debris]
        .into_iter()
        .chain(&vessels)
        .chain(&specks)
        .map(Vec::as_slice)
        .collect();
    let traced = read(&grey(1100, &paint([1100; 2], 2.0, &contours)), 2.0).unwrap();
    assert_sound(&traced);
    let areas: Vec<f64> = traced.lumen.iter().map(|contour| signed_area(contour)).collect();
    let expected = [&lumen, &pocket, &island].map(|contour| signed_area(contour));
    assert_eq!(areas.len(), 3, "{areas:?}");
    for (found, expected) in areas.iter().zip(expected) {
        close(*found, expected, 0.003);
    }
    let (own, found) = both(2.0, &outer, &[&lumen, &pocket, &island]);
    assert_eq!((found.islands, found.folds), (1, own.folds));
    close(found.lumen_area_mm2, own.lumen_area_mm2, 0.001);
    close(found.lumen_perimeter_mm, own.lumen_perimeter_mm, 0.005);
}

#[test]
fn tissue_is_connected_by_sides_and_lumen_by_corners_too() {
    // The two holes share a corner, so they are one lumen. Debris touches the section only at a
    // corner, and touches the border of the image.
    let traced = read(
        &drawn(&[
            "#.........",
            ".########.",
            ".########.",
            ".##..####.",
            ".##..####.",
            ".####..##.",
            ".####..##.",
            ".########.",
            "..........",
        ]),
        20.0,
    )
    .unwrap();
    assert_sound(&traced);
    assert_eq!(traced.lumen.len(), 1);
    let top = traced.outer.iter().map(|p| p[1]).fold(f32::MIN, f32::max);
    let left = traced.outer.iter().map(|p| p[0]).fold(f32::MAX, f32::min);
    // 3.5 pixels above the middle of nine rows, 4 pixels left of the middle of ten columns.
    assert!((top - 70.0).abs() < 10.0 && (left + 80.0).abs() < 10.0, "{top} {left}");
    // Towards the upper left and the lower right.
    let lean: f32 = traced.lumen[0].iter().map(|p| p[0] * (p[1] + 10.0)).sum();
    assert!(lean < 0.0, "{lean}");
}

#[test]
fn holes_in_islands_are_filled() {
    let traced = read(
        &drawn(&[
            "...............",
            ".#############.",
            ".#...........#.",
            ".#.#######.#.#.",
            ".#.#######...#.",
            ".#.##...##...#.",
            ".#.##.#.##...#.",
            ".#.##...##...#.",
            ".#.#######...#.",
            ".#.#######...#.",
            ".#...........#.",
            ".#############.",
            "...............",
        ]),
        10.0,
    )
    .unwrap();
    assert_sound(&traced);
    // The single pixel, 100 µm², is not an island.
    assert_eq!((traced.lumen.len(), traced.measure().islands), (2, 1));
    close(-signed_area(&traced.lumen[1]), 4900.0, 0.06);
}

#[test]
fn the_first_of_the_largest_pieces_is_measured() {
    let rows = ["...........", ".###...###.", ".#.#...#.#.", ".###...###.", "..........."];
    let left = read(&drawn(&rows), 30.0).unwrap();
    assert!(left.outer.iter().all(|p| p[0] < 0.0));
}

/// Winding number of the smooth contours, in pixels: 1 inside of the lumen.
fn turns(contours: &[Points], at: [f32; 2]) -> i32 {
    let turn = |contour: &Points| match locate(contour, at) {
        Containment::Inside if signed_area(contour) > 0.0 => 1,
        Containment::Inside => -1,
        Containment::Boundary => panic!("a contour passes the middle of a pixel"),
        Containment::Outside => 0,
    };
    contours.iter().map(turn).sum()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]
    /// For any mask within a frame, contours are sound. Before points are resampled, they separate
    /// the centres of the pixels like the mask does.
    #[test]
    fn contours_of_any_mask_are_sound(rows in prop::collection::vec(0_u32..1 << 14, 14), dense: bool) {
        let side = 18;
        let mut pixels = vec![0; side * side];
        for y in 1..side - 1 {
            for x in 1..side - 1 {
                let frame = x == 1 || y == 1 || x == side - 2 || y == side - 2;
                let bit = |rows: &[u32], k: usize| rows[y - 2] >> ((x - 2 + k) % 14) & 1 == 1;
                pixels[y * side + x] = u8::from(frame || bit(&rows, 0) || dense && bit(&rows, 5));
            }
        }
        let traced = match read(&grey(side, &pixels), 30.0) {
            Ok(traced) => traced,
            Err(error) => {
                prop_assert_eq!(error, MicrographError::NoLumen);
                return Ok(());
            }
        };
        assert_sound(&traced);
        let measures = traced.measure();
        prop_assert!(crate::measure::morphometry::QUANTITIES.iter().all(|q| q.of(&measures).is_none_or(f64::is_finite)));

        let image = read::read(&grey(side, &pixels), MAX_SIDE).unwrap();
        let mut field = PixelRegions::new(&image, &std::array::from_fn::<bool, 65536, _>(|value| value != 0));
        field.keep_the_largest_piece().unwrap();
        field.find_the_lumen(0.0).unwrap();
        let mut room = MAX_POINTS;
        for region in [Region::Outside, Region::Lumen] {
            let borders = trace(&mut field, region, 0.0, &mut room).unwrap();
            // y points up, so that contours turn as they are seen.
            let smooth = |border: &contour::Loop| border.smooth().map(|[x, y]| [x as f32, -y as f32]).collect();
            let contours: Vec<Points> = borders.iter().map(smooth).collect();
            for at in 0..(side + 2) * (side + 2) {
                let middle = [(at % (side + 2)) as f32 + 0.5, -((at / (side + 2)) as f32 + 0.5)];
                let expected = i32::from(field.is(region, at)) - i32::from(region == Region::Outside);
                prop_assert_eq!(turns(&contours, middle), expected, "{:?} at {:?}", region, middle);
            }
        }
    }
}
