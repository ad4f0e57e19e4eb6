//! Areas of the layers of simple shapes.

use super::*;
use crate::model::{Border, Line};
use std::f64::consts::{PI, TAU};

const LAYERS: Layers =
    Layers { epithelium_um: 30.0, lamina_um: 40.0, longitudinal_share: 0.3, serosa_um: 25.0, ..Layers::NONE };

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
fn areas(inner: &[[f32; 2]], outer: &[[f32; 2]], layers: &Layers, size: u32) -> [f64; 10] {
    let grid = Grid::around(outer, size);
    let mut areas = [0.0; 10];
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

/// Eight folds of 200 µm height on a circle of 500 µm.
fn folded() -> Vec<[f32; 2]> {
    (0..720)
        .map(|k| {
            let angle = TAU * f64::from(k) / 720.0;
            let radius = 500.0 + 100.0 * (8.0 * angle).cos();
            [(radius * angle.cos()) as f32, (radius * angle.sin()) as f32]
        })
        .collect()
}

#[test]
fn the_muscle_reaches_into_wide_bases_of_folds_and_not_into_thin_cores() {
    // A comb: folds 300 µm high, 400 and 100 µm wide, between clefts of 50 µm.
    let mut inner = vec![[1000.0, 500.0], [-1000.0, 500.0], [-1000.0, 0.0]];
    let mut x = -1000.0;
    let mut middles = Vec::new();
    while x < 900.0 {
        let width = if middles.len() % 2 == 0 { 400.0 } else { 100.0_f32 };
        inner.extend([[x, -300.0], [x + 50.0, -300.0], [x + 50.0, 0.0]]);
        middles.push(f64::from(x + 50.0 + width / 2.0));
        x += 50.0 + width;
        inner.push([x, 0.0]);
    }
    inner.push([1000.0, 0.0]);
    let outer = [[-1400.0, -700.0], [1400.0, -700.0], [1400.0, 900.0], [-1400.0, 900.0]];
    let layers = Layers { opening_um: 60.0, longitudinal_share: 0.0, ..LAYERS };
    let map = map(&inner, &outer, &layers);
    let grid = Grid::around(&outer, 1400);
    let labels = map.labels(&grid);
    let top = |x: f64| {
        let column = ((x - grid.left_um) / grid.um_per_pixel) as usize;
        let is_muscle = |row: &u32| labels[*row as usize * grid.width as usize + column] == 4 && grid.y(*row) < 400.0;
        grid.y((0..grid.height).find(is_muscle).unwrap())
    };
    // 70 µm under the surface of a wide fold, and less than the disc sags between two clefts.
    let (wide, thin) = (top(middles[2]), top(middles[1]));
    assert!((wide + 70.0).abs() < 8.0, "{wide}");
    assert!(thin < -325.0 && thin > -372.0, "{thin}");
    // A disc wider than the core of the widest fold does not enter it.
    let layers = Layers { opening_um: 200.0, ..layers };
    let labels = self::map(&inner, &outer, &layers).labels(&grid);
    let row = (0..grid.height).find(|&row| grid.y(row) < -270.0).unwrap() as usize * grid.width as usize;
    let column = ((middles[2] - grid.left_um) / grid.um_per_pixel) as usize;
    assert_eq!(labels[row + column], Tissue::LaminaPropria as u8);
}

#[test]
fn pixels_of_any_size_show_the_same_borders() {
    let (inner, outer) = (folded(), circle(1000.0, [0.0; 2]));
    let layers = Layers { opening_um: 40.0, subserosa_um: 40.0, vessels: 9.0, longitudinal_cover: 0.5, ..LAYERS };
    let map = map(&inner, &outer, &layers);
    let coarse = Grid::around(&outer, 400);
    let fine =
        Grid { width: coarse.width * 3, height: coarse.height * 3, um_per_pixel: coarse.um_per_pixel / 3.0, ..coarse };
    let (few, many) = (map.labels(&coarse), map.labels(&fine));
    let centre = |i: usize| {
        let (column, row) = (i % coarse.width as usize, i / coarse.width as usize);
        many[(3 * row + 1) * fine.width as usize + 3 * column + 1]
    };
    let differ = (0..few.len()).filter(|&i| few[i] != centre(i)).count();
    assert!(differ * 1000 < few.len(), "{differ} of {}", few.len());
}

#[test]
fn the_layers_of_the_muscle_have_their_thickness() {
    let ring = |from: f64, to: f64| PI * (to * to - from * from);
    // 275 µm of muscle: 50 inner longitudinal, 82.5 longitudinal.
    let layers = Layers { inner_longitudinal_um: 50.0, opening_um: 80.0, ..LAYERS };
    let found = areas(&circle(500.0, [0.0; 2]), &circle(870.0, [0.0; 2]), &layers, 1200);
    let expected = [ring(530.0, 570.0), ring(620.0, 762.5), ring(762.5, 845.0), ring(845.0, 870.0)];
    agree(&found[3..7], &expected);
    agree(&found[8..9], &[ring(570.0, 620.0)]);
}

/// Labels along a circle, in steps of a tenth of a degree from the direction of x.
fn around(layers: &Layers, radius: f64) -> Vec<u8> {
    let outer = circle(1000.0, [0.0; 2]);
    let map = map(&circle(500.0, [0.0; 2]), &outer, layers);
    let grid = Grid::around(&outer, 1100);
    let labels = map.labels(&grid);
    (0..3600)
        .map(|k| {
            let (sin, cos) = (TAU * f64::from(k) / 3600.0).sin_cos();
            let column = (radius * cos - grid.left_um) / grid.um_per_pixel;
            labels[((grid.top_um - radius * sin) / grid.um_per_pixel) as usize * grid.width as usize + column as usize]
        })
        .collect()
}

#[test]
fn bundles_cover_their_share_of_the_circumference_and_continue_along_the_tube() {
    let share = |cover: f64| {
        let labels = around(&Layers { longitudinal_cover: cover, seed: 5, ..LAYERS }, 970.0);
        labels.iter().filter(|&&label| label == Tissue::LongitudinalMuscle as u8).count() as f64 / 3600.0
    };
    assert!(share(1.0) == 1.0 && share(0.0) == 0.0);
    assert!((share(0.5) - 0.5).abs() < 0.04, "{}", share(0.5));
    let at = |z_um: f64| around(&Layers { longitudinal_cover: 0.5, seed: 5, z_um, ..LAYERS }, 950.0);
    let differ = |a: &[u8], b: &[u8]| a.iter().zip(b).filter(|(a, b)| a != b).count();
    let (near, far) = (differ(&at(1000.0), &at(1050.0)), differ(&at(1000.0), &at(9000.0)));
    assert!(near > 0 && near < 150 && far > 400, "{near} {far}");
}

#[test]
fn vessels_continue_along_the_tube_and_gather_at_the_mesosalpinx() {
    let outer = circle(1000.0, [0.0; 2]);
    let grid = Grid::around(&outer, 600);
    let inner = circle(400.0, [0.0; 2]);
    let at = |z_um: f64| -> Vec<bool> {
        let layers = Layers { vessels: 12.0, subserosa_um: 60.0, seed: 3, z_um, ..LAYERS };
        map(&inner, &outer, &layers).labels(&grid).iter().map(|&label| label == Tissue::Vessel as u8).collect()
    };
    let (one, next) = (at(1000.0), at(1050.0));
    let count = |of: &dyn Fn(usize) -> bool| (0..one.len()).filter(|&i| of(i)).count();
    let (all, shared) = (count(&|i| one[i]), count(&|i| one[i] && next[i]));
    assert!(all > 1000 && shared * 10 > all * 9 && shared < all, "{shared} of {all}");
    let deep = |i: usize| {
        let (x, y) = (grid.x(i as u32 % grid.width), grid.y(i as u32 / grid.width));
        (y, x.hypot(y))
    };
    let subserosal = |i: usize| one[i] && deep(i).1 > 840.0;
    let (below, above) = (count(&|i| subserosal(i) && deep(i).0 < 0.0), count(&|i| subserosal(i) && deep(i).0 > 0.0));
    assert!(below > 2 * above, "{below} below, {above} above");
    assert!(count(&|i| one[i] && deep(i).1 < 840.0) > 100);
}

#[test]
fn the_subserosa_is_three_times_as_thick_at_the_mesosalpinx() {
    let outer = circle(1000.0, [0.0; 2]);
    let layers = Layers { subserosa_um: 30.0, ..LAYERS };
    let grid = Grid::around(&outer, 1100);
    let labels = map(&circle(400.0, [0.0; 2]), &outer, &layers).labels(&grid);
    let thickness = |above: bool| {
        let is_side = |row: u32| (grid.y(row) > 0.0) == above;
        let at = |row: u32| labels[(row * grid.width + grid.width / 2) as usize] == Tissue::Subserosa as u8;
        (0..grid.height).filter(|&row| is_side(row) && at(row)).count() as f64 * grid.um_per_pixel
    };
    assert!((thickness(true) - 30.0).abs() < 3.0 && (thickness(false) - 90.0).abs() < 3.0);
}

#[test]
fn where_the_wall_is_too_thin_the_muscle_goes_first() {
    let thin = areas(&circle(800.0, [0.0; 2]), &circle(860.0, [0.0; 2]), &LAYERS, 1000);
    assert!(thin[4] == 0.0 && thin[5] == 0.0 && thin[2] > 0.0 && thin[6] > 0.0, "{thin:?}");
    let eccentric = areas(&circle(500.0, [300.0, 0.0]), &circle(870.0, [0.0; 2]), &LAYERS, 1000);
    assert!(eccentric[..7].iter().all(|area| *area > 0.0), "{eccentric:?}");
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
    let mut areas = [0.0; 10];
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
