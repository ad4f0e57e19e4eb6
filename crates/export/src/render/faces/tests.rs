//! Tests of pictures with a [`Finish`]: stained faces and textured walls.

use super::super::histology::Slide;
use super::super::picture::linear;
use super::super::view::{Plane as Cut, View, plain};
use super::super::{mesh_drawing, mesh_png};
use super::*;
use crate::model::sample;
use crate::spec::preset;
use serde_json::json;
use tiny_skia::Pixmap;

fn spec(patch: &serde_json::Value) -> ModelSpec {
    ModelSpec::resolve(preset("pig").unwrap(), patch).unwrap()
}

/// Linear light of an opaque pixel.
fn light(picture: &Pixmap, x: u32, y: u32) -> Vec3 {
    let pixel = picture.pixel(x, y).unwrap();
    assert_eq!(pixel.alpha(), 255, "{x}, {y}");
    linear([pixel.red(), pixel.green(), pixel.blue()])
}

/// Mean linear light of a square around a pixel.
fn around(picture: &Pixmap, [x, y]: [i32; 2], reach: i32) -> Vec3 {
    let places = (-reach..=reach).flat_map(|i| (-reach..=reach).map(move |j| (x + i, y + j)));
    let sum: Vec3 = places.map(|(x, y)| light(picture, x as u32, y as u32)).sum();
    sum / ((2 * reach + 1) * (2 * reach + 1)) as f32
}

/// A cut across the sample tube, seen from the front: 2 mm in 0.93 of 800 pixels.
fn end_on(z_m: f64) -> View {
    let cut = vec![Cut { normal: [0.0, 0.0, 1.0], offset: z_m }];
    View { azimuth_deg: 0.0, elevation_deg: 0.0, cut, ..plain(800, 800) }
}

#[test]
fn a_cut_face_has_the_stain_of_the_section() {
    let (mesh, spec) = (sample::tube(96, 12, 0.4), spec(&json!({})));
    let finish = Finish { spec: &spec, seed: 7 };
    let picture = mesh_drawing(&mesh, &end_on(2e-3), Some(&finish)).unwrap();
    let plane = Plane::across(2000.0);
    let slide = Slide {
        borders: Body::from(&mesh).borders(&plane).unwrap(),
        layers: spec.layers_at_um(2000.0, 7),
        seed: 7,
        index: plane.digest() as u32,
    };
    let stained = slide.drawing(800).unwrap();
    let factor = stained.um_per_pixel() / picture.um_per_pixel();
    // Places in the tissue, by angle and distance from the middle, µm. The mucosa is at 300 to
    // 700 µm.
    let mut ratios = Vec::new();
    let mut lights = Vec::new();
    for (turn, radius_um) in (0..40).flat_map(|k| [680.0, 760.0, 850.0, 930.0].map(|r| (f64::from(k) / 40.0, r))) {
        let (sin, cos) = (turn * std::f64::consts::TAU).sin_cos();
        if radius_um < 500.0 * (1.0 + 0.4 * (6.0 * turn * std::f64::consts::TAU).cos()) + 40.0 {
            continue;
        }
        let at = |um_per_pixel: f64| [400.0 + radius_um * cos / um_per_pixel, 400.0 - radius_um * sin / um_per_pixel];
        let [shown, own] = [at(picture.um_per_pixel()), at(stained.um_per_pixel())];
        let reach = 5.0;
        let shown = around(&picture.pixmap, shown.map(|x| x.floor() as i32), reach as i32);
        let own = around(&stained.pixmap, own.map(|x| x.floor() as i32), (reach / factor).round() as i32);
        ratios.push(shown / own);
        lights.push(own);
    }
    assert!(ratios.len() > 100, "{}", ratios.len());
    // The face is flat, so its lamps multiply every colour by the same factor.
    let mean = ratios.iter().sum::<Vec3>() / ratios.len() as f32;
    let off = ratios.iter().map(|ratio| (*ratio / mean - 1.0).abs().max_element()).fold(0.0, f32::max);
    assert!((0.8..1.2).contains(&mean.min_element()) && mean.max_element() < 1.2, "{mean}");
    assert!(off < 0.15, "{off}");
    let greens = || lights.iter().map(|light| light.y);
    assert!(greens().fold(0.0, f32::max) > 1.3 * greens().fold(1.0, f32::min), "the layers differ");
}

#[test]
fn the_ends_of_a_tube_are_stained_and_a_lumen_is_not() {
    let (mesh, spec) = (sample::tube(96, 12, 0.4), spec(&json!({})));
    let finish = Finish { spec: &spec, seed: 7 };
    let view = View { cut: Vec::new(), ..end_on(0.0) };
    let colors = |mesh: &Mesh| {
        let picture = mesh_drawing(mesh, &view, Some(&finish)).unwrap().pixmap;
        let shades = (20..110).filter_map(|y| picture.pixel(400, y)).map(tiny_skia::PremultipliedColorU8::green);
        shades.collect::<std::collections::BTreeSet<u8>>().len()
    };
    assert!(colors(&mesh) > 25, "{}", colors(&mesh));
    let unnamed = Mesh { patches: Vec::new(), ..mesh };
    assert!(colors(&unnamed) < 10, "{}", colors(&unnamed));
}

#[test]
fn walls_have_relief_near_and_none_far_away() {
    let (mesh, spec) = (sample::tube(96, 40, 0.0), spec(&json!({})));
    let finish = Finish { spec: &spec, seed: 7 };
    let side = |size: u32| View { azimuth_deg: 90.0, elevation_deg: 0.0, ..plain(size, size) };
    // Root mean square difference between a picture and the plain one, of 255.
    let difference = |size: u32| {
        let [with, without] = [Some(&finish), None].map(|finish| mesh_drawing(&mesh, &side(size), finish).unwrap());
        let pixels = with.pixmap.data().iter().zip(without.pixmap.data());
        let sum: f64 = pixels.map(|(a, b)| f64::from(a.abs_diff(*b)).powi(2)).sum();
        (sum / f64::from(4 * size * size)).sqrt()
    };
    assert!(difference(12) < 0.6, "{}", difference(12));
    assert!(difference(600) > 4.0, "{}", difference(600));
}

#[test]
fn a_mucosa_cut_open_is_textured() {
    let (mesh, spec) = (sample::tube(96, 40, 0.0), spec(&json!({})));
    let finish = Finish { spec: &spec, seed: 7 };
    let cut = vec![Cut { normal: [1.0, 0.0, 0.0], offset: 0.0 }];
    let view = View { azimuth_deg: 90.0, elevation_deg: 0.0, cut, ..plain(1200, 1200) };
    let [with, without] = [Some(&finish), None].map(|finish| mesh_drawing(&mesh, &view, finish).unwrap().pixmap);
    // A row along the middle of the lumen, which is smooth without a texture.
    let roughness = |picture: &Pixmap| -> f32 {
        (300..900).map(|x| (light(picture, x, 600).y - light(picture, x + 1, 600).y).abs()).sum::<f32>() / 600.0
    };
    assert!(roughness(&with) > 4.0 * roughness(&without) + 0.002, "{} {}", roughness(&with), roughness(&without));
}

#[test]
fn a_finished_picture_has_the_same_bytes_on_any_number_of_threads() {
    let (mesh, spec) = (sample::tube(48, 6, 0.3), spec(&json!({})));
    let finish = Finish { spec: &spec, seed: 3 };
    let view = View { axial_scale: 0.5, ..super::super::NamedView::Opened.of(&mesh, 300) };
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| mesh_png(&mesh, &view, Some(&finish)).unwrap())
    };
    assert_eq!(on(1), on(3));
    assert_ne!(on(2), mesh_png(&mesh, &view, None).unwrap());
}

#[test]
fn a_shortened_face_shows_the_mean_of_its_pixels() {
    let (mesh, spec) = (sample::tube(96, 12, 0.0), spec(&json!({})));
    let finish = Finish { spec: &spec, seed: 7 };
    let cut = vec![Cut { normal: [1.0, 0.0, 0.0], offset: 0.0 }];
    let view =
        |axial_scale| View { azimuth_deg: 90.0, elevation_deg: 0.0, axial_scale, cut: cut.clone(), ..plain(400, 400) };
    // Mean colour of the upper wall between mucosa and serosa.
    let mean = |axial_scale: f64| {
        let drawing = mesh_drawing(&mesh, &view(axial_scale), Some(&finish)).unwrap();
        let rows = [600.0, 900.0].map(|um| (200.0 - um / drawing.um_per_pixel()) as u32);
        let places = (rows[1]..rows[0]).flat_map(|y| (190..210).map(move |x| (x, y)));
        let sum: Vec3 = places.clone().map(|(x, y)| light(&drawing.pixmap, x, y)).sum();
        sum / places.count() as f32
    };
    let off = (mean(0.5) / mean(0.05) - 1.0).abs().max_element();
    assert!(off < 0.08, "{off}");
}
