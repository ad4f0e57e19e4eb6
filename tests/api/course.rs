//! Models that follow a course: their centre line and their cuts across it.

use super::app::App;
use super::cut::stored;
use serde_json::{Value, json};

/// Queues a model with this course; returns its path.
async fn queued(app: &App, course: Value) -> String {
    let reply = app
        .post("/models", &json!({ "seed": 3, "spec": { "course": course, "containment": { "wall_um": 1200 } } }))
        .await;
    assert_eq!(reply.status, 202, "{}", reply.json());
    reply.location()
}

#[tokio::test]
async fn the_course_is_known_before_the_model_has_grown() {
    let app = App::new().await;
    let model = queued(&app, json!({ "shape": "arc", "turn_deg": 180 })).await;
    let reply = app.get(&format!("{model}/course")).await;
    let course = reply.json();
    assert_eq!((reply.status.as_u16(), &course["shape"], &course["relaxed"]), (200, &json!("arc"), &json!(false)));
    assert_eq!(course["model"], model.strip_prefix("/models/").unwrap());
    let near = |found: &Value, expected: f64| assert!((found.as_f64().unwrap() - expected).abs() < 1e-3, "{found}");
    near(&course["tortuosity"], std::f64::consts::FRAC_PI_2);
    near(&course["end_distance_mm"], 120.0 / std::f64::consts::PI);
    near(&course["least_radius_mm"], 60.0 / std::f64::consts::PI);
    let points = course["points"].as_array().unwrap();
    let last = points.last().unwrap();
    near(&last["s_mm"], 60.0);
    near(&last["tangent"][2], -1.0);
    near(&last["position_mm"][0], 120.0 / std::f64::consts::PI);
    let tag = reply.header("etag").unwrap();
    assert_eq!(app.get_with(&format!("{model}/course"), &[("if-none-match", tag)]).await.status, 304);
    let straight = app.model(4).await;
    let course = app.get(&format!("{straight}/course")).await.json();
    assert_eq!((&course["shape"], course["points"].as_array().unwrap().len()), (&json!("straight"), 2));
    assert_eq!(app.get("/models/00000000-0000-7000-8000-000000000000/course").await.slug(), "model-not-found");
}

#[tokio::test]
async fn a_course_without_room_is_refused_with_its_place() {
    let app = App::new().await;
    let course = json!({ "shape": "sigmoid", "turn_deg": 700 });
    let reply = app.post("/models", &json!({ "seed": 3, "spec": { "course": course } })).await;
    assert_eq!((reply.status.as_u16(), reply.slug()), (422, "invalid-request".into()));
    assert_eq!(reply.places(), ["/spec/course/turn_deg"]);
    assert!(
        reply.json()["errors"][0]["detail"].as_str().unwrap().contains("mm from the isthmus end"),
        "{}",
        reply.json()
    );
}

#[tokio::test]
async fn a_model_is_cut_across_its_centre_line() {
    let app = App::new().await;
    // The course runs along x. In its cross sections, x points along −z and y along y.
    let model = queued(&app, json!({ "shape": "points", "points_mm": [[0, 0, 0], [60, 0, 0]] })).await;
    let job = app.claim().await;
    let text = String::from_utf8(stored()).unwrap();
    let tubes = text.lines().map(|line| {
        let Some(rest) = line.strip_prefix("v ") else { return line.to_owned() };
        let p: Vec<f64> = rest.split(' ').map(|x| x.parse().unwrap()).collect();
        format!("v {} {} {}", p[2], p[1], -p[0])
    });
    let lines: Vec<String> = tubes.collect();
    let mut obj = lines.join("\n");
    obj.push('\n');
    app.finish(job, &[("model.obj", "model/obj", obj.into_bytes())]).await;
    let reply = app.get(&format!("{model}/cut?z_um=1500")).await;
    assert_eq!(reply.status, 200, "{}", reply.json());
    let cut = reply.json();
    assert_eq!(cut["plane"]["normal"], json!([1.0, 0.0, 0.0]));
    let reach = cut["plane"]["reach_um"].as_f64().unwrap();
    assert!(reach > 1000.0 && reach < 4000.0, "{reach}");
    assert_eq!((&cut["islands"], &cut["pockets"]), (&json!(1), &json!(1)));
    let island = cut["rings"][2]["points"].as_array().unwrap();
    let x = island.iter().map(|p| p[0].as_f64().unwrap()).sum::<f64>() / island.len() as f64;
    assert!((x - 300.0).abs() < 0.5, "u is x of the section: {x}");
    let beyond = app.get(&format!("{model}/cut?z_um=60001")).await;
    assert_eq!((beyond.status.as_u16(), beyond.slug()), (404, "cut-not-found".into()));
    assert!(beyond.json()["detail"].as_str().unwrap().contains("from 0.0 to 60000.0 µm"));
    for more in ["&format=svg", "&labels=true&size=100"] {
        assert_eq!(app.get(&format!("{model}/cut?z_um=1500{more}")).await.status, 200);
    }
}
