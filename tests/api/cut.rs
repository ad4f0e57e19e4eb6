//! Planar cuts of a stored surface.

use super::app::App;
use axum::http::header;
use serde_json::{Value, json};
use std::fmt::Write;

/// OBJ file of a square tube: 4 mm long, outer side 2 mm, lumen 1.2 mm wide. Between z = 1 mm and 2
/// mm the file also contains a cube floating in the lumen and a void in the wall.
pub(super) fn stored() -> Vec<u8> {
    let mut obj = String::new();
    let mut vertices = 0;
    // Corners of the prism: the lower four, then the upper four, each counter-clockwise.
    let mut prism = |obj: &mut String, half: f64, [x, y]: [f64; 2], [low, high]: [f64; 2]| {
        for z in [low, high] {
            for [u, v] in [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]] {
                writeln!(obj, "v {} {} {}", 1e-3 * (x + half * u), 1e-3 * (y + half * v), 1e-3 * z).unwrap();
            }
        }
        vertices += 8;
        vertices - 7
    };
    let outer = prism(&mut obj, 1.0, [0.0; 2], [0.0, 4.0]);
    let inner = prism(&mut obj, 0.6, [0.0; 2], [0.0, 4.0]);
    let island = prism(&mut obj, 0.1, [0.3, 0.0], [1.0, 2.0]);
    let void = prism(&mut obj, 0.05, [0.8, 0.0], [1.0, 2.0]);
    let face = |obj: &mut String, corners: [i32; 4], turned: bool| {
        let [a, b, c, d] = if turned { [corners[3], corners[2], corners[1], corners[0]] } else { corners };
        writeln!(obj, "f {a} {b} {c} {d}").unwrap();
    };
    let sides = |obj: &mut String, of: i32, turned: bool| {
        for k in 0..4 {
            let next = (k + 1) % 4;
            face(obj, [of + k, of + next, of + next + 4, of + k + 4], turned);
        }
    };
    let ends = |obj: &mut String, of: i32, turned: bool| {
        face(obj, [of + 3, of + 2, of + 1, of], turned);
        face(obj, [of + 4, of + 5, of + 6, of + 7], turned);
    };
    obj.push_str("g inner_wall\n");
    sides(&mut obj, inner, true);
    for (of, turned) in [(island, false), (void, true)] {
        sides(&mut obj, of, turned);
        ends(&mut obj, of, turned);
    }
    obj.push_str("g outer_wall\n");
    sides(&mut obj, outer, false);
    for (name, level) in [("cap_isthmus", 0), ("cap_ampulla", 4)] {
        writeln!(obj, "g {name}").unwrap();
        for k in 0..4 {
            let next = (k + 1) % 4;
            let corners = [outer + k, outer + next, inner + next, inner + k].map(|corner| corner + level);
            face(&mut obj, corners, level == 0);
        }
    }
    obj.into_bytes()
}

async fn app() -> (App, String) {
    let app = App::new().await;
    let model = app.finished(7, &[("model.obj", "model/obj", stored())]).await;
    (app, model)
}

fn near(found: &Value, expected: f64) {
    let found = found.as_f64().unwrap();
    assert!((found - expected).abs() <= 1e-6 * expected.abs().max(1.0), "{found}, not {expected}");
}

#[tokio::test]
async fn a_cut_across_the_tube_classifies_its_rings() {
    let (app, model) = app().await;
    let reply = app.get(&format!("{model}/cut?z_um=1500")).await;
    assert_eq!((reply.status.as_u16(), reply.header(header::CONTENT_TYPE)), (200, Some("application/json")));
    let cut = reply.json();
    assert_eq!(cut["model"], model.strip_prefix("/models/").unwrap());
    assert_eq!((&cut["units"], &cut["file"]), (&json!("um"), &json!("model.obj")));
    let plane = json!({ "origin_um": [0.0, 0.0, 1500.0], "normal": [0.0, 0.0, 1.0], "u": [1.0, 0.0, 0.0], "v": [0.0, 1.0, 0.0] });
    assert_eq!(cut["plane"], plane);
    assert_eq!((&cut["islands"], &cut["pockets"]), (&json!(1), &json!(1)));
    near(&cut["tissue_area_um2"], 4e6 - 1.44e6 + 0.04e6 - 0.01e6);
    near(&cut["lumen_area_um2"], 1.44e6 - 0.04e6 + 0.01e6);
    let rings = cut["rings"].as_array().unwrap();
    let kinds: Vec<(&str, &Value)> =
        rings.iter().map(|ring| (ring["kind"].as_str().unwrap(), &ring["parent"])).collect();
    assert_eq!(kinds, [("tissue", &Value::Null), ("lumen", &json!(0)), ("island", &json!(1)), ("pocket", &json!(0))]);
    near(&rings[2]["area_um2"], 0.04e6);
    near(&rings[2]["perimeter_um"], 800.0);
    // Beyond the island the cut has two rings.
    assert_eq!(app.get(&format!("{model}/cut?z_um=3000")).await.json()["rings"].as_array().unwrap().len(), 2);
}

#[tokio::test]
async fn a_cut_along_the_tube_has_tissue_on_both_sides() {
    let (app, model) = app().await;
    let across = app.get(&format!("{model}/cut?z_um=1500")).await.json();
    assert_eq!(app.get(&format!("{model}/cut?z_mm=1.5")).await.json(), across);
    let through = |origin: &str| format!("{model}/cut?{origin}&normal=0,0,1");
    let [um, mm] = ["origin_um=0,0,1500", "origin_mm=0,0,1.5"].map(through);
    assert_eq!(app.get(&um).await.json(), app.get(&mm).await.json());

    let cut = app.get(&format!("{model}/cut?origin_um=0,0,0&normal=0,-2,0")).await.json();
    assert_eq!(cut["plane"]["normal"], json!([0.0, -1.0, 0.0]));
    // The tissue consists of two strips of the wall, one of them with a void, and the cube between
    // them. No ring surrounds the cube.
    near(&cut["tissue_area_um2"], 2.0 * 400.0 * 4000.0 + 200.0 * 1000.0 - 100.0 * 1000.0);
    let kinds: Vec<&str> = cut["rings"].as_array().unwrap().iter().map(|ring| ring["kind"].as_str().unwrap()).collect();
    assert_eq!(kinds.iter().filter(|kind| **kind == "tissue").count(), 3, "{kinds:?}");
    // The label image marks the lumen up to the ends of the tube.
    let png = app.get(&format!("{model}/cut?origin_um=0,0,0&normal=0,-2,0&labels=true&size=400")).await;
    let (width, height, pixels) = decoded(&png.body);
    let middle = pixels[(height / 2 * width + width / 8) as usize];
    assert_eq!(middle, 1, "lumen in the middle near an end");
    assert!(pixels.iter().filter(|&&label| label == 0).count() < pixels.len() / 3);
}

fn decoded(png: &[u8]) -> (u32, u32, Vec<u8>) {
    let mut reader = png::Decoder::new(std::io::Cursor::new(png)).read_info().unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut pixels).unwrap();
    (info.width, info.height, pixels)
}

#[tokio::test]
async fn a_cut_is_drawn_and_stained_on_request() {
    let (app, model) = app().await;
    let path = format!("{model}/cut?z_um=1500");
    let svg = app.get_with(&path, &[("accept", "image/svg+xml")]).await;
    assert_eq!((svg.header(header::CONTENT_TYPE), svg.header(header::VARY)), (Some("image/svg+xml"), Some("accept")));
    assert!(std::str::from_utf8(&svg.body).unwrap().contains("id=\"islands\""));
    let labels = app.get(&format!("{path}&labels=true&size=500")).await;
    assert_eq!(labels.header(header::CONTENT_TYPE), Some("image/png"));
    let um: f64 = labels.header("um-per-pixel").unwrap().parse().unwrap();
    let (.., pixels) = decoded(&labels.body);
    let area = |label: u8| pixels.iter().filter(|&&pixel| pixel == label).count() as f64 * um * um;
    assert!((area(1) / 1.41e6 - 1.0).abs() < 0.02, "{} µm² of lumen", area(1));
    assert!(area(2) > 0.0 && area(6) > 0.0);
    let stained = app.get(&format!("{path}&format=png&size=100")).await;
    assert_eq!(stained.status, 200);
    assert_ne!(stained.body, app.get(&format!("{model}/cut?z_um=1501&format=png&size=100")).await.body);
}

#[tokio::test]
async fn a_cut_never_changes() {
    let (app, model) = app().await;
    let path = format!("{model}/cut?z_um=1500");
    for more in ["", "&format=svg", "&format=png"] {
        let path = format!("{path}{more}");
        let reply = app.get(&path).await;
        let tag = reply.header(header::ETAG).unwrap();
        assert_eq!(app.get_with(&path, &[("if-none-match", tag)]).await.status, 304, "{more}");
        let other = format!("{model}/cut?z_um=1500.5{more}");
        assert_eq!(app.get_with(&other, &[("if-none-match", tag)]).await.status, 200, "{more}");
    }
}

#[tokio::test]
async fn impossible_cuts_are_problems() {
    let (app, model) = app().await;
    for (query, name) in [
        ("", "z_um"),
        ("z_um=high", "z_um"),
        ("z_um=NaN", "z_um"),
        ("z_mm=high", "z_mm"),
        ("z_mm=1e10", "z_mm"),
        ("z_um=1500&z_mm=1.5", "z_mm"),
        ("z_mm=1&normal=0,0,1", "z_mm"),
        ("origin_mm=0,0,1", "normal"),
        ("origin_mm=0,0&normal=0,0,1", "origin_mm"),
        ("origin_um=0,0,0&origin_mm=0,0,0&normal=0,0,1", "origin_mm"),
        ("z_um=1&normal=0,0,1", "z_um"),
        ("normal=0,0,1", "origin_um"),
        ("origin_um=0,0,1", "normal"),
        ("origin_um=0,0&normal=0,0,1", "origin_um"),
        ("origin_um=0,0,0&normal=0,0,inf", "normal"),
        ("origin_um=0,0,0&normal=0,0,0", "normal"),
        ("z_um=1&format=gif", "format"),
        ("z_um=1&format=svg&size=100", "size"),
        ("z_um=1&size=10000", "size"),
        ("z_um=1&depth=4", "depth"),
    ] {
        assert_eq!(app.get(&format!("{model}/cut?{query}")).await.places(), [name], "{query}");
    }
    for more in ["", "&format=svg", "&format=png"] {
        let missed = app.get(&format!("{model}/cut?z_um=4500{more}")).await;
        assert_eq!((missed.status.as_u16(), missed.slug().as_str()), (404, "cut-not-found"));
        assert!(missed.json()["detail"].as_str().unwrap().contains("0.0 to 4000.0 µm"));
    }
    let bare = app.finished(8, &[("sections.bin", "application/octet-stream", vec![1])]).await;
    let reply = app.get(&format!("{bare}/cut?z_um=1500")).await;
    assert_eq!((reply.status.as_u16(), reply.slug().as_str()), (404, "file-not-found"));
    assert!(reply.json()["detail"].as_str().unwrap().contains("model.glb"));
}

#[tokio::test]
async fn a_damaged_surface_is_an_internal_problem_and_the_service_keeps_running() {
    let app = App::new().await;
    app.expect_faults();
    let model = app.finished(1, &[("model.glb", "model/gltf-binary", b"glTF and no more".to_vec())]).await;
    for query in ["z_um=1", "z_um=1&format=png"] {
        assert_eq!(app.get(&format!("{model}/cut?{query}")).await.slug(), "internal");
    }
    assert_eq!(app.get("/healthz").await.status, 200);
}
