//! Areas of the layers of simple shapes.

use super::*;
use crate::model::{Border, Line};
use std::f64::consts::{PI, TAU};

const LAYERS: Layers = Layers { epithelium_um: 30.0, lamina_um: 40.0, longitudinal_share: 0.3, serosa_um: 25.0 };

/// A circle as a regular polygon.
fn circle(radius: f64, middle: [f64; 2]) -> Vec<[f32; 2]> {
    (0..720)
        .map(|k| {
            let (sin, cos) = (TAU * f64::from(k) / 720.0).sin_cos();
            [(middle[0] + radius * cos) as f32, (middle[1] + radius * sin) as f32]
        })
        .collect()
}

/// The layers between two closed lines.
fn map(inner: &[[f32; 2]], outer: &[[f32; 2]], layers: &Layers) -> TissueMap {
    let [mucosa, outside] = [inner, outer].map(|line| Border::closed(vec![line.to_vec()]));
    TissueMap::new(&mucosa, &outside, layers)
}

/// Areas of the tissues in µm², by value.
fn areas(inner: &[[f32; 2]], outer: &[[f32; 2]], layers: &Layers, size: u32) -> [f64; 7] {
    let grid = Grid::around(outer, size);
    let mut areas = [0.0; 7];
    for label in map(inner, outer, layers).labels(&grid) {
        areas[usize::from(label)] += grid.um_per_pixel * grid.um_per_pixel;
    }
    areas
}

fn agree(found: &[f64], expected: &[f64]) {
    for (k, (found, expected)) in found.iter().zip(expected).enumerate() {
        assert!((found / expected - 1.0).abs() < 0.01, "{k}: {found} µm², not {expected}");
    }
}

#[test]
fn the_layers_of_an_annulus_have_their_areas() {
    let ring = |from: f64, to: f64| PI * (to * to - from * from);
    // 370 µm of wall: 30 epithelium, 40 lamina propria, 275 muscle (82.5 longitudinal), 25 serosa.
    let radii = [0.0, 500.0, 530.0, 570.0, 762.5, 845.0, 870.0];
    let expected: Vec<f64> = radii.windows(2).map(|r| ring(r[0], r[1])).collect();
    let found = areas(&circle(500.0, [70.0, -30.0]), &circle(870.0, [70.0, -30.0]), &LAYERS, 1200);
    agree(&found[1..], &expected);
}

#[test]
fn a_frond_thinner_than_two_heights_is_epithelium_and_a_thicker_one_has_a_core() {
    // A lumen of 2 × 1 mm with a rectangular frond, 50 µm then 100 µm wide, from below up to the
    // centre.
    for (width, core) in [(50.0_f32, 0.0), (100.0, 40.0)] {
        let half = width / 2.0;
        let inner = [
            [-1000.0, -500.0],
            [-half, -500.0],
            [-half, 0.0],
            [half, 0.0],
            [half, -500.0],
            [1000.0, -500.0],
            [1000.0, 500.0],
            [-1000.0, 500.0],
        ];
        let outer = [[-1400.0, -900.0], [1400.0, -900.0], [1400.0, 900.0], [-1400.0, 900.0]];
        let grid = Grid::around(&outer, 1400);
        let labels = map(&inner, &outer, &LAYERS).labels(&grid);
        let row = (0..grid.height).find(|&row| grid.y(row) < -250.0).unwrap();
        let count = |tissue: Tissue| {
            let frond = (0..grid.width).filter(|&column| grid.x(column).abs() < f64::from(half));
            let at = |column: u32| labels[(row * grid.width + column) as usize];
            frond.filter(|&column| at(column) == tissue as u8).count() as f64 * grid.um_per_pixel
        };
        assert!((count(Tissue::LaminaPropria) - core).abs() < 2.5 * grid.um_per_pixel, "{width}");
        assert!((count(Tissue::Epithelium) - (f64::from(width) - core)).abs() < 2.5 * grid.um_per_pixel, "{width}");
    }
}

#[test]
fn folds_do_not_reach_into_the_muscle() {
    // Eight folds of 200 µm height in a wall that is 400 µm thick at the crypts.
    let inner: Vec<[f32; 2]> = (0..720)
        .map(|k| {
            let angle = TAU * f64::from(k) / 720.0;
            let radius = 500.0 + 100.0 * (8.0 * angle).cos();
            [(radius * angle.cos()) as f32, (radius * angle.sin()) as f32]
        })
        .collect();
    let outer = circle(1000.0, [0.0; 2]);
    let grid = Grid::around(&outer, 800);
    let labels = map(&inner, &outer, &LAYERS).labels(&grid);
    let mut muscle = [0.0, f64::INFINITY];
    for (i, &label) in labels.iter().enumerate() {
        let (x, y) = (grid.x(i as u32 % grid.width), grid.y(i as u32 / grid.width));
        if label == Tissue::CircularMuscle as u8 {
            let radius = (x * x + y * y).sqrt();
            muscle = [f64::max(muscle[0], radius), f64::min(muscle[1], radius)];
        }
    }
    // A smooth ring that is 70 µm outside the crypts.
    assert!((muscle[1] - 670.0).abs() < 8.0, "{muscle:?}");
    let thickness = 1000.0 - 25.0 - muscle[1];
    assert!((1000.0 - muscle[0] - (25.0 + 0.3 * thickness)).abs() < 8.0, "{muscle:?}");
}

#[test]
fn where_the_wall_is_too_thin_the_muscle_goes_first() {
    let thin = areas(&circle(800.0, [0.0; 2]), &circle(860.0, [0.0; 2]), &LAYERS, 1000);
    assert!(thin[4] == 0.0 && thin[5] == 0.0 && thin[2] > 0.0 && thin[6] > 0.0, "{thin:?}");
    let eccentric = areas(&circle(500.0, [300.0, 0.0]), &circle(870.0, [0.0; 2]), &LAYERS, 1000);
    assert!(eccentric.iter().all(|area| *area > 0.0), "{eccentric:?}");
}

#[test]
fn any_bands_give_the_same_pixels_and_row_0_is_on_top() {
    let (inner, outer) = (circle(300.0, [0.0, 200.0]), circle(800.0, [0.0; 2]));
    let map = map(&inner, &outer, &LAYERS);
    let grid = Grid::around(&outer, 150);
    let whole = map.labels(&grid);
    let rows: Vec<u8> =
        (0..grid.height).flat_map(|y| map.band(&grid, y..y + 1)).map(|place| place.tissue as u8).collect();
    assert_eq!(whole, rows);
    let lumen: Vec<_> = (0..whole.len()).filter(|&i| whole[i] == Tissue::Lumen as u8).collect();
    assert!(!lumen.is_empty());
    assert!(lumen.iter().all(|i| grid.y((i / grid.width as usize) as u32) > -101.0));
}

#[test]
fn sections_without_extent_have_no_tissue() {
    for points in [vec![], vec![[1.0, 2.0]; 3], vec![[f32::NAN, 0.0]; 4]] {
        let grid = Grid::around(&points, 64);
        assert!(map(&points, &points, &LAYERS).labels(&grid).iter().all(|&label| label == 0));
    }
}

#[test]
fn a_tube_cut_along_has_lumen_up_to_its_ends_and_no_epithelium_there() {
    // Both walls of a tube 2 mm long: a lumen 400 µm wide in a tube 1000 µm wide.
    let walls = |half: f32| Border {
        lines: [half, -half].map(|y| Line { points: vec![[-1000.0, y], [1000.0, y]], is_closed: false }).to_vec(),
        closing: [-1000.0, 1000.0].map(|x| [[x, -half], [x, half]]).to_vec(),
    };
    let outside = walls(500.0);
    let grid = Grid::around(&outside.points().collect::<Vec<_>>(), 2200);
    let labels = TissueMap::new(&walls(200.0), &outside, &LAYERS).labels(&grid);
    let mut areas = [0.0; 7];
    for label in labels {
        areas[usize::from(label)] += grid.um_per_pixel * grid.um_per_pixel;
    }
    let muscle = 2.0 * 2000.0 * (300.0 - 30.0 - 40.0 - 25.0);
    agree(&areas[1..4], &[800_000.0, 2.0 * 2000.0 * 30.0, 2.0 * 2000.0 * 40.0]);
    agree(&[areas[4] + areas[5], areas[6]], &[muscle, 2.0 * 2000.0 * 25.0]);
}

#[test]
fn an_island_has_epithelium_all_around() {
    let island: Vec<[f32; 2]> = circle(100.0, [50.0, 0.0]).into_iter().rev().collect();
    let mucosa = Border::closed(vec![circle(300.0, [0.0; 2]), island]);
    let outer = circle(600.0, [0.0; 2]);
    let grid = Grid::around(&outer, 900);
    let labels = TissueMap::new(&mucosa, &Border::closed(vec![outer]), &LAYERS).labels(&grid);
    let of = |tissue: Tissue| {
        labels.iter().filter(|&&label| label == tissue as u8).count() as f64 * grid.um_per_pixel * grid.um_per_pixel
    };
    let epithelium = PI * (330.0_f64.powi(2) - 300.0_f64.powi(2) + 100.0_f64.powi(2) - 70.0_f64.powi(2));
    agree(&[of(Tissue::Lumen), of(Tissue::Epithelium)], &[PI * (90_000.0 - 10_000.0), epithelium]);
}
