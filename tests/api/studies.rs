//! Parameter studies: batches with `vary`, their tables and their archives.

use super::app::{App, Reply};
use axum::body::Body;
use axum::http::{Method, Request, header};
use http_body_util::BodyExt;
use oviduct::http::Limits;
use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::io::{Cursor, Read};

/// Two gaps times two numbers of steps, each with the seeds 7 and 8.
fn grid() -> Value {
    json!({ "seeds": [7, 8], "spec": { "steps": 900 }, "vary": {
        "design": "grid", "values": { "/collision/gap_um": { "from": 25, "to": 50, "count": 2 }, "/steps": [800, null] } } })
}

fn ids(batch: &Value) -> Vec<String> {
    batch["models"].as_array().unwrap().iter().map(|id| id.as_str().unwrap().to_owned()).collect()
}

fn details(reply: &Reply) -> Vec<String> {
    reply.json()["errors"].as_array().unwrap().iter().map(|e| e["detail"].as_str().unwrap().to_owned()).collect()
}

/// Ends the next model with these files.
async fn finish(app: &App, report: &str) {
    let files = [
        ("model.glb", "model/gltf-binary", vec![7; 70_000]),
        ("report.json", "application/json", report.as_bytes().to_vec()),
    ];
    let job = app.claim().await;
    app.finish(job, &files).await;
}

#[tokio::test]
async fn a_study_is_one_request_and_is_echoed_whole() {
    let app = App::new().await;
    let reply = app.post("/batches", &grid()).await;
    assert_eq!(reply.status, 202, "{reply:?}");
    let batch = reply.json();
    assert_eq!((&batch["counts"]["total"], &batch["study"]["vary"]), (&json!(8), &grid()["vary"]));
    let expected = [
        (25, 800, 7),
        (25, 800, 8),
        (25, 900, 7),
        (25, 900, 8),
        (50, 800, 7),
        (50, 800, 8),
        (50, 900, 7),
        (50, 900, 8),
    ];
    for (i, (id, (gap, steps, seed))) in ids(&batch).iter().zip(expected).enumerate() {
        let model = app.get(&format!("/models/{id}")).await.json();
        let of = (&model["spec"]["collision"]["gap_um"], &model["spec"]["steps"], &model["seed"]);
        assert_eq!(of, (&json!(gap), &json!(steps), &json!(seed)));
        let given = if steps == 800 { json!(800) } else { Value::Null };
        assert_eq!(
            batch["study"]["models"][i],
            json!({ "id": id, "point": i / 2, "seed": seed, "values": { "/collision/gap_um": gap, "/steps": given } })
        );
    }
    let address = format!("/batches/{}", batch["id"].as_str().unwrap());
    assert_eq!(app.get(&address).await.json(), batch);
    // Deleting one model does not change the points of the others.
    app.delete(&format!("/models/{}", ids(&batch)[1])).await;
    let now = app.get(&address).await.json();
    let mut left = batch["study"]["models"].as_array().unwrap().clone();
    left.remove(1);
    assert_eq!(now["study"]["models"], json!(left));
    assert_eq!(app.post("/batches", &json!({ "count": 1 })).await.json()["study"], Value::Null);
}

#[tokio::test]
async fn without_seeds_all_points_have_one_seed() {
    let app = App::new().await;
    let vary = json!({ "design": "lhs", "samples": 12, "values": { "/collision/gap_um": { "from": 25, "to": 50 } } });
    let models = app.post("/batches", &json!({ "vary": vary })).await.json()["study"]["models"].clone();
    let models = models.as_array().unwrap();
    assert_eq!(models.len(), 12);
    assert!(models.iter().all(|model| model["seed"] == models[0]["seed"]));
    let again = app.post("/batches", &json!({ "vary": vary })).await.json()["study"]["models"].clone();
    let values = |models: &[Value]| models.iter().map(|model| model["values"].clone()).collect::<Vec<_>>();
    assert_eq!(values(models), values(again.as_array().unwrap()), "the points do not depend on the seeds of models");
}

#[tokio::test]
async fn all_faults_of_a_study_come_at_once() {
    let app = App::new().await;
    let vary = |vary: Value| json!({ "seeds": [1], "vary": vary });
    for (body, places) in [
        (vary(json!(7)), vec!["/vary"]),
        (
            vary(
                json!({ "design": "lhs", "values": { "/collision/gap_um": { "from": 50, "to": 5000 }, "/gap": [1] } }),
            ),
            vec!["/vary/samples", "/vary/values/~1collision~1gap_um/to", "/vary/values/~1gap"],
        ),
        (
            vary(
                json!({ "design": "grid", "values": { "/collision/gap_um": [30, "wide", -3], "/friction": [0.1, 0.2] } }),
            ),
            vec!["/vary/values/~1collision~1gap_um/1", "/vary/values/~1collision~1gap_um/2"],
        ),
        (
            json!({ "preset": "dragon", "priority": 1000, "spec": { "steps": -1 }, "vary": { "design": "grid", "values": { "/steps": [1, 1.5] } } }),
            vec!["/priority", "/preset"],
        ),
        (
            json!({ "priority": 1000, "spec": { "colour": 1 }, "vary": { "design": "grid", "values": { "/steps": [900, 1.5] } } }),
            vec!["/priority", "/spec/colour", "/vary/values/~1steps/1"],
        ),
        (
            json!({ "spec": { "steps": -1 }, "vary": { "design": "grid", "values": { "/steps": [900, 1000] } } }),
            vec!["/spec/steps"],
        ),
        (vary(json!({ "design": "grid", "values": { "/steps": [900, 900.0] } })), vec!["/vary/values"]),
        (
            vary(json!({ "design": "lhs", "samples": 4, "values": { "/wall/lobes": { "from": 1, "to": 2 } } })),
            vec!["/vary/values", "/vary/values"],
        ),
    ] {
        let reply = app.post("/batches", &body).await;
        assert_eq!(
            (reply.status.as_u16(), reply.places()),
            (422, places.into_iter().map(str::to_owned).collect()),
            "{body}"
        );
        assert_eq!(app.post("/batches/validate", &body).await.places(), reply.places());
    }
    // If only some points violate a rule between parameters, the problem names these points.
    let vary = json!({ "design": "grid", "values": { "/collision/gap_um": [30, 40], "/particles/total": [900, 20] } });
    let reply = app.post("/batches", &json!({ "vary": vary })).await;
    let text = details(&reply).join("\n");
    assert!(text.contains("so at point 1 (/collision/gap_um: 30, /particles/total: 20) and 1 more"), "{text}");
    assert_eq!(app.get("/models").await.json()["models"], json!([]));
}

#[tokio::test]
async fn a_study_keeps_to_the_limits() {
    let app = App::with(Limits { batch: 10, ..Limits::default() }, 7).await;
    let points = |n: usize, seeds: usize| json!({ "count": seeds, "vary": { "design": "lhs", "samples": n, "values": { "/collision/gap_um": { "from": 25, "to": 50 } } } });
    for (body, place) in [(points(11, 1), "/vary/samples"), (points(6, 2), "/vary"), (points(1, 11), "/count")] {
        assert_eq!(app.post("/batches", &body).await.places(), [place], "{body}");
    }
    assert_eq!(app.post("/batches", &points(4, 2)).await.slug(), "queue-full");
    assert_eq!(app.get("/models").await.json()["models"], json!([]));
    assert_eq!(app.post("/batches", &points(7, 1)).await.status, 202);

    let most = oviduct::generate::CostLimits { max_vertices: 1_000_000, ..oviduct::generate::CostLimits::default() };
    let app = App::with(Limits { cost: most, ..Limits::default() }, 100).await;
    let vary = json!({ "design": "grid", "values": { "/solver/record_every": [10, 5, 20] } });
    let reply = app.post("/batches", &json!({ "vary": vary })).await;
    assert_eq!((reply.slug().as_str(), reply.places()), ("cost-limit", vec!["/vary".to_owned()]));
    assert!(details(&reply)[0].contains("so at point 1 (/solver/record_every: 5)"), "{reply:?}");
    assert!(reply.json()["prediction"]["vertices"].as_u64().unwrap() > 1_000_000);
}

#[tokio::test]
async fn a_study_is_validated_without_queueing_it() {
    let app = App::new().await;
    let reply = app.post("/batches/validate", &grid()).await;
    assert_eq!(reply.status, 200, "{reply:?}");
    let told = reply.json();
    assert_eq!((&told["models"], &told["seeds"]), (&json!(8), &json!([7, 8])));
    assert_eq!(told["points"].as_array().unwrap().len(), 4);
    assert_eq!(told["points"][3]["values"], json!({ "/collision/gap_um": 50, "/steps": null }));
    let sum: f64 = told["points"]
        .as_array()
        .unwrap()
        .iter()
        .map(|p| p["cost"]["seconds"]["cpu"]["seconds"].as_f64().unwrap())
        .sum();
    assert!((told["cost"]["seconds"]["cpu"].as_f64().unwrap() - 2.0 * sum).abs() < 1e-9);
    let plain = app.post("/batches/validate", &json!({ "count": 3 })).await.json();
    assert_eq!(
        (&plain["models"], &plain["seeds"], &plain["points"][0]["values"]),
        (&json!(3), &Value::Null, &json!({}))
    );
    assert_eq!(app.get("/models").await.json()["models"], json!([]));
}

#[tokio::test]
async fn an_idempotency_key_gives_the_same_study() {
    let app = App::new().await;
    let first = app.post_with("/batches", &[("idempotency-key", "k")], &grid()).await;
    let second = app.post_with("/batches", &[("idempotency-key", "k")], &grid()).await;
    assert_eq!((first.json(), second.header("idempotency-replayed")), (second.json(), Some("true")));
    let mut other = grid();
    other["vary"]["values"]["/steps"] = json!([800, 801]);
    assert_eq!(app.post_with("/batches", &[("idempotency-key", "k")], &other).await.slug(), "idempotency-key-reused");
}

#[tokio::test]
async fn a_table_has_a_row_for_each_model() {
    let app = App::new().await;
    let batch = app.post("/batches", &grid()).await.json();
    finish(&app, "{}").await;
    app.post(&format!("/models/{}/cancel", ids(&batch)[7]), &json!({})).await;
    let path = format!("/batches/{}/table", batch["id"].as_str().unwrap());
    let reply = app.get(&path).await;
    assert_eq!(reply.header(header::CONTENT_TYPE), Some("application/json"));
    let table = reply.json();
    let figures = [
        "area_mm2",
        "min_gap_um",
        "particles.end",
        "particles.start",
        "sections",
        "triangles",
        "vertices",
        "volume_mm3",
    ];
    let figures = figures.map(|name| format!("summary.{name}"));
    let columns: Vec<&str> = ["id", "status", "seed", "/collision/gap_um", "/steps", "problem"]
        .into_iter()
        .chain(figures.iter().map(String::as_str))
        .collect();
    assert_eq!(table["columns"], json!(columns));
    assert_eq!(table["rows"].as_array().unwrap().len(), 8);
    assert_eq!(
        table["rows"][0],
        json!([ids(&batch)[0], "succeeded", 7, 25, 800, null, 2710.5, 6.2, 8300, 710, 201, 1_580_422, 790_211, 41.7])
    );
    assert_eq!(
        table["rows"][7],
        json!([ids(&batch)[7], "cancelled", 8, 50, null, null, null, null, null, null, null, null, null, null])
    );

    for reply in [app.get(&format!("{path}?format=csv")).await, app.get_with(&path, &[("accept", "text/csv")]).await] {
        assert!(reply.header(header::CONTENT_TYPE).unwrap().starts_with("text/csv"));
        let text = String::from_utf8(reply.body.to_vec()).unwrap();
        let lines: Vec<&str> = text.split("\r\n").collect();
        assert_eq!((lines.len(), lines[0]), (10, columns.join(",").as_str()));
        assert_eq!(
            lines[1],
            format!("{},succeeded,7,25,800,,2710.5,6.2,8300,710,201,1580422,790211,41.7", ids(&batch)[0])
        );
        assert_eq!(lines[3], format!("{},queued,7,25,,,,,,,,,,", ids(&batch)[2]));
    }
    assert_eq!(app.get_with(&path, &[("accept", "text/html")]).await.slug(), "not-acceptable");
    assert_eq!(app.get(&format!("{path}?format=xml&x=1")).await.places(), ["x", "format"]);
    assert_eq!(app.get("/batches/nonsense/table").await.slug(), "batch-not-found");
}

#[tokio::test]
async fn a_table_quotes_what_needs_it() {
    let app = App::new().await;
    let wave = json!({ "fluctuation": { "amplitude": 0.1, "period": 90 } });
    let vary =
        json!({ "design": "zip", "values": { "/friction": [wave, 0.3], "/solver/integrator": ["rk4", "euler"] } });
    let batch = app.post("/batches", &json!({ "seeds": [1], "vary": vary })).await.json();
    let path = format!("/batches/{}/table?format=csv", batch["id"].as_str().unwrap());
    let body = app.get(&path).await.body;
    let rows: Vec<csv::StringRecord> = csv::Reader::from_reader(&body[..]).records().map(Result::unwrap).collect();
    assert_eq!(serde_json::from_str::<Value>(&rows[0][3]).unwrap(), wave);
    assert_eq!((&rows[1][3], &rows[1][4]), ("0.3", "euler"));
}

/// The files of a zip or tar archive, by path.
fn unpacked(reply: &Reply) -> BTreeMap<String, Vec<u8>> {
    let mut found = BTreeMap::new();
    if reply.header(header::CONTENT_TYPE) == Some("application/zip") {
        let mut archive = zip::ZipArchive::new(Cursor::new(&reply.body)).unwrap();
        for i in 0..archive.len() {
            let mut file = archive.by_index(i).unwrap();
            let mut bytes = Vec::new();
            file.read_to_end(&mut bytes).unwrap();
            found.insert(file.name().unwrap().into_owned(), bytes);
        }
    } else {
        for file in tar::Archive::new(&reply.body[..]).entries().unwrap() {
            let mut file = file.unwrap();
            let mut bytes = Vec::new();
            file.read_to_end(&mut bytes).unwrap();
            found.insert(file.path().unwrap().to_str().unwrap().to_owned(), bytes);
        }
    }
    found
}

#[tokio::test]
async fn an_archive_has_the_files_and_a_manifest() {
    let app = App::new().await;
    let batch = app.post("/batches", &grid()).await.json();
    for report in ["{\"a\":1}", "{\"b\":2}"] {
        finish(&app, report).await;
    }
    let path = format!("/batches/{}/archive", batch["id"].as_str().unwrap());
    let models = ids(&batch);
    for (query, names) in [
        ("", ["model.glb", "report.json"].as_slice()),
        ("?format=tar", &["model.glb", "report.json"]),
        ("?files=report.json", &["report.json"]),
        ("?files=report.json,model.glb&format=tar", &["model.glb", "report.json"]),
        ("?files=sections.bin", &[]),
    ] {
        let reply = app.get(&format!("{path}{query}")).await;
        assert_eq!(reply.status, 200, "{query}");
        let mut files = unpacked(&reply);
        let manifest: Value = serde_json::from_slice(&files.remove("manifest.json").unwrap()).unwrap();
        assert_eq!((&manifest["batch"], &manifest["vary"]), (&batch["id"], &grid()["vary"]));
        let listed = manifest["models"].as_array().unwrap();
        assert_eq!(listed.len(), 8);
        for (i, model) in listed.iter().enumerate() {
            assert_eq!((&model["id"], &model["index"]), (&json!(models[i]), &json!(i)));
            assert_eq!(model["values"], batch["study"]["models"][i]["values"]);
            assert_eq!(model["seed"], batch["study"]["models"][i]["seed"]);
            assert_eq!(model["status"], if i < 2 { "succeeded" } else { "queued" });
            assert_eq!(model["files"].as_array().unwrap().len(), if i < 2 { names.len() } else { 0 });
            for file in model["files"].as_array().unwrap() {
                let name = file["name"].as_str().unwrap();
                let path = file["path"].as_str().unwrap();
                assert_eq!(path, format!("{i:04}-{}/{name}", models[i]));
                let bytes = files.remove(path).unwrap();
                assert_eq!(
                    (&file["bytes"], &file["sha256"]),
                    (&json!(bytes.len()), &json!(hex::encode(Sha256::digest(&bytes))))
                );
                assert!(names.contains(&name));
            }
        }
        assert!(files.is_empty(), "{query}: {:?}", files.keys());
    }
    let head = app.request(Method::HEAD, &path, &[], Body::empty()).await;
    assert_eq!((head.status.as_u16(), head.body.len()), (200, 0));
    for (query, place) in [
        ("format=rar", "format"),
        ("files=", "files"),
        ("files=model.stl", "files"),
        ("files=a&files=b", "files"),
        ("x=1", "x"),
    ] {
        let reply = app.get(&format!("{path}?{query}")).await;
        assert_eq!((reply.status.as_u16(), reply.places()), (422, vec![place.to_owned()]), "{query}");
    }
    assert_eq!(app.get("/batches/nonsense/archive").await.slug(), "batch-not-found");
}

/// A transfer that lacks a file must not appear complete.
#[tokio::test]
async fn an_archive_that_lacks_a_file_is_aborted() {
    let app = App::new().await;
    let batch = app.post("/batches", &json!({ "seeds": [1, 2] })).await.json();
    finish(&app, "{}").await;
    finish(&app, "{}").await;
    let path = format!("/batches/{}/archive", batch["id"].as_str().unwrap());
    let second = app.store.get(super::app::id(&format!("/models/{}", ids(&batch)[1]))).await.unwrap().unwrap();
    app.artifacts.delete(&[second.files[0].key.clone()]).await.unwrap();
    for format in ["zip", "tar"] {
        let request = Request::get(format!("{path}?format={format}")).body(Body::empty()).unwrap();
        let response = app.start(request).await;
        assert_eq!(response.status(), 200);
        assert!(response.into_body().collect().await.is_err(), "{format}");
    }
    // The service opens the first file before it sends the response.
    let first = app.store.get(super::app::id(&format!("/models/{}", ids(&batch)[0]))).await.unwrap().unwrap();
    app.artifacts.delete(&[first.files[0].key.clone()]).await.unwrap();
    assert_eq!(app.get(&path).await.slug(), "file-not-found");
}

#[tokio::test]
async fn an_archive_is_one_download_until_it_ends() {
    let app = App::with(Limits { downloads: 1, ..Limits::default() }, 10).await;
    let batch = app.post("/batches", &json!({ "seeds": [1, 2, 3] })).await.json();
    for _ in 0..3 {
        finish(&app, "{}").await;
    }
    let path = format!("/batches/{}/archive", batch["id"].as_str().unwrap());
    app.expect_faults();
    let running = app.start(Request::get(&path).body(Body::empty()).unwrap()).await;
    assert_eq!(app.get(&path).await.slug(), "too-many-downloads");
    drop(running);
    // The task that writes the archive ends once it notices that its client has disconnected.
    for _ in 0..6000 {
        if app.get(&path).await.status == 200 {
            return;
        }
        tokio::time::sleep(std::time::Duration::from_millis(10)).await;
    }
    panic!("the archive still holds its permit");
}
