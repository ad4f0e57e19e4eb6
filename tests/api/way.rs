//! The way through the lumen of a stored model.

use super::app::App;
use super::{cut, sections};
use oviduct::export::sections_bin::MEDIA_TYPE;
use oviduct::generate::{Backend, CancelToken, Output, Request, generate};
use oviduct::spec::{ModelSpec, preset};
use serde_json::{Value, json};

/// Surface and sections of a small model that leans, of the length of the preset `pig`.
fn grown() -> [Vec<u8>; 2] {
    let dir = tempfile::tempdir().unwrap();
    let particles = json!({ "total": { "keys": [[0, 160], [1, 420]] }, "outer": { "keys": [[0, 60], [1, 90]] } });
    let small = json!({ "steps": 120, "burn_in": 40, "particles": particles });
    let request = Request {
        preset: "pig".into(),
        spec: ModelSpec::resolve(preset("pig").unwrap(), &small).unwrap(),
        seed: 7,
        backend: Backend::Cpu,
        outputs: vec![Output::Glb].into(),
        dir: dir.path().into(),
        memory_limit_bytes: None,
    };
    generate(&request, &(), &CancelToken::default()).unwrap();
    ["model.glb", "sections.bin"].map(|name| std::fs::read(dir.path().join(name)).unwrap())
}

fn number(value: &Value) -> f64 {
    value.as_f64().unwrap()
}

/// True if a point is in the lumen or a pocket of a cut, and in no island.
fn is_in_lumen(cut: &Value, [x, y]: [f64; 2]) -> bool {
    let surrounds = |ring: &Value| {
        let points = ring["points"].as_array().unwrap();
        let ends = points.iter().zip(points.iter().cycle().skip(1));
        let is_right = |(a, b): (&Value, &Value)| {
            let ([ax, ay], [bx, by]) = ([0, 1].map(|k| number(&a[k])), [0, 1].map(|k| number(&b[k])));
            (ay > y) != (by > y) && x < ax + (y - ay) * (bx - ax) / (by - ay)
        };
        ends.filter(|ends| is_right(*ends)).count() % 2 == 1
    };
    let rings = cut["rings"].as_array().unwrap();
    rings.iter().filter(|ring| !ring["parent"].is_null() && surrounds(ring)).count() % 2 == 1
}

#[tokio::test(flavor = "multi_thread")]
async fn a_way_lies_in_the_lumen_of_every_cut() {
    let app = App::new().await;
    let [surface, sections] = grown();
    let files = [("model.glb", "model/gltf-binary", surface), ("sections.bin", MEDIA_TYPE, sections)];
    let model = app.finished(7, &files).await;
    let reply = app.get(&format!("{model}/way")).await;
    assert_eq!(reply.status, 200, "{}", reply.json());
    let way = reply.json();
    assert_eq!((&way["model"], &way["file"]), (&json!(model.strip_prefix("/models/").unwrap()), &json!("model.glb")));
    let points = way["points"].as_array().unwrap();
    let (first, last) = (&points[0], &points[points.len() - 1]);
    assert!(number(&first["s_mm"]) < 0.01 && number(&last["s_mm"]) > 59.99, "{first} {last}");
    assert!(points.is_sorted_by(|a, b| number(&a["s_mm"]) < number(&b["s_mm"])));
    let clearance = number(&way["clearance_um"]);
    assert!(clearance > 0.5 && number(&way["length_mm"]) > 59.9, "{clearance} {}", way["length_mm"]);
    for (k, point) in points.iter().enumerate() {
        let position = [0, 1, 2].map(|axis| number(&point["position_mm"][axis]));
        let length: f64 = (0..3).map(|axis| number(&point["tangent"][axis]).powi(2)).sum();
        assert!((length - 1.0).abs() < 1e-9 && (position[2] - number(&point["s_mm"])).abs() < 1e-5, "{point}");
        assert!(number(&point["clearance_um"]) >= clearance, "{point}");
        if k % 20 == 0 {
            let cut = app.get(&format!("{model}/cut?z_mm={}", point["s_mm"])).await.json();
            assert!(is_in_lumen(&cut, [1e3 * position[0], 1e3 * position[1]]), "{point}");
        }
    }
    let tag = reply.header("etag").unwrap();
    assert_eq!(app.get_with(&format!("{model}/way"), &[("if-none-match", tag)]).await.status, 304);
    assert_eq!(app.get(&format!("{model}/way")).await.body, reply.body);
    assert_eq!(app.get(&format!("{model}/way?z_um=3")).await.slug(), "invalid-request");
}

#[tokio::test]
async fn a_model_without_a_way_is_refused_with_the_reason() {
    let app = App::new().await;
    let none = "/models/00000000-0000-7000-8000-000000000000/way";
    assert_eq!(app.get(none).await.slug(), "model-not-found");
    let recorded = ("sections.bin", MEDIA_TYPE, sections::stored(3));
    let model = app.finished(7, std::slice::from_ref(&recorded)).await;
    assert_eq!(app.get(&format!("{model}/way")).await.slug(), "file-not-found");
    // These sections are triangles, whose lumen has no gates.
    let model = app.finished(8, &[recorded, ("model.obj", "model/obj", cut::stored())]).await;
    let reply = app.get(&format!("{model}/way")).await;
    assert_eq!((reply.status.as_u16(), reply.slug()), (404, "way-not-found".into()));
    assert!(reply.json()["detail"].as_str().unwrap().contains("beyond 0.0 µm"), "{}", reply.json());
}
