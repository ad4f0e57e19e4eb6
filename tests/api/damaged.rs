//! Files that were changed in the artifact store: no client takes them for the files of the model.

use super::app::{App, Reply};
use super::cut::stored;
use axum::body::Body;
use axum::http::{Method, Request, header};
use bytes::Bytes;
use http_body_util::BodyExt;
use serde_json::json;

/// Larger than a piece of a stream.
const LARGE: usize = 3 << 20;

fn large() -> Vec<u8> {
    (0..LARGE).map(|i| (i * 31 % 251) as u8).collect()
}

/// Replaces a stored file of a model.
async fn replace(app: &App, model: &str, name: &str, content: Vec<u8>) {
    let key = format!("models/{}/1/{name}", model.strip_prefix("/models/").unwrap());
    app.artifacts.put_bytes(&key, Bytes::from(content)).await.unwrap();
}

/// Reads a response to its end, or to its error. Returns its status and the number of bytes.
async fn download(app: &App, path: &str, headers: &[(&str, &str)]) -> (u16, Result<usize, usize>) {
    let mut request = Request::builder().uri(path);
    for (name, value) in headers {
        request = request.header(*name, *value);
    }
    let (parts, mut body) = app.start(request.body(Body::empty()).unwrap()).await.into_parts();
    let mut bytes = 0;
    while let Some(frame) = body.frame().await {
        match frame {
            Ok(frame) => bytes += frame.into_data().unwrap().len(),
            Err(_) => return (parts.status.as_u16(), Err(bytes)),
        }
    }
    (parts.status.as_u16(), Ok(bytes))
}

async fn damaged_reads(app: &App) -> String {
    let text = String::from_utf8(app.get("/metrics").await.body.to_vec()).unwrap();
    text.lines().find_map(|line| line.strip_prefix("oviduct_damaged_files_total ")).unwrap().to_owned()
}

fn is_refused(reply: &Reply) {
    assert_eq!((reply.status.as_u16(), reply.slug().as_str()), (500, "internal"));
    assert!(reply.header(header::ETAG).is_none() && reply.json()["detail"].as_str().unwrap().contains("damaged"));
}

#[tokio::test]
async fn a_download_of_a_changed_file_is_cut_off_before_its_end() {
    let app = App::new().await;
    let model = app.finished(7, &[("model.glb", "model/gltf-binary", large())]).await;
    let path = format!("{model}/files/model.glb");
    assert_eq!(download(&app, &path, &[]).await, (200, Ok(LARGE)));
    assert_eq!(damaged_reads(&app).await, "0");
    for place in [0, LARGE / 2, LARGE - 1] {
        let mut changed = large();
        changed[place] ^= 1;
        replace(&app, &model, "model.glb", changed).await;
        for headers in [&[][..], &[("range", "bytes=0-")]] {
            let (status, read) = download(&app, &path, headers).await;
            assert!(status < 300 && read.is_err_and(|bytes| bytes < LARGE), "{place}: {status} {read:?}");
        }
    }
    assert_eq!(damaged_reads(&app).await, "6");
    // A part cannot be compared with the hash of the whole.
    assert_eq!(download(&app, &path, &[("range", "bytes=5-9")]).await, (206, Ok(5)));
    let head = app.request(Method::HEAD, &path, &[], Body::empty()).await;
    assert_eq!(head.status, 200, "nothing is read");

    // Another size is found before the first byte, of a part too.
    app.expect_faults();
    for size in [LARGE - 1, LARGE + 1, 0, 7] {
        replace(&app, &model, "model.glb", large().into_iter().chain([1]).take(size).collect()).await;
        is_refused(&app.get(&path).await);
        is_refused(&app.get_with(&path, &[("range", "bytes=5-9")]).await);
        is_refused(&app.get_with(&path, &[("range", "bytes=-9")]).await);
    }
    replace(&app, &model, "model.glb", large()).await;
    assert_eq!(download(&app, &path, &[]).await, (200, Ok(LARGE)));
}

#[tokio::test]
async fn what_is_made_of_a_changed_file_is_not_served_or_kept() {
    let app = App::new().await;
    let report = |length| format!(r#"{{"length_mm":{length}}}"#).into_bytes();
    let files = [("model.obj", "model/obj", stored()), ("report.json", "application/json", report(1))];
    let model = app.finished(7, &files).await;
    app.expect_faults();
    // Both are valid documents, so only the records tell the difference.
    replace(&app, &model, "report.json", report(2)).await;
    let moved = String::from_utf8(stored()).unwrap().replacen("v -0.001 ", "v -0.002 ", 1).into_bytes();
    assert!(moved != stored() && moved.len() == stored().len());
    replace(&app, &model, "model.obj", moved).await;
    let cut = format!("{model}/cut?z_um=1500");
    let compressed = [("accept-encoding", "gzip")];
    assert!(matches!(download(&app, &format!("{model}/files/model.obj"), &compressed).await, (200, Err(_))));
    is_refused(&app.get(&format!("{model}/report")).await);
    is_refused(&app.get(&cut).await);
    assert_eq!(damaged_reads(&app).await, "3");

    // After the repair nothing of the changed files is left.
    replace(&app, &model, "report.json", report(1)).await;
    replace(&app, &model, "model.obj", stored()).await;
    assert_eq!(app.get(&format!("{model}/report")).await.json()["length_mm"], 1);
    let repaired = app.get(&cut).await;
    let fresh = App::new().await;
    let other = fresh.finished(7, &files).await;
    assert_eq!(repaired.json()["rings"], fresh.get(&format!("{other}/cut?z_um=1500")).await.json()["rings"]);
}

#[tokio::test]
async fn an_archive_with_a_changed_file_is_broken_off() {
    let app = App::new().await;
    let batch = app.post("/batches", &json!({ "seeds": [1, 2] })).await.json();
    for _ in 0..2 {
        let job = app.claim().await;
        app.finish(job, &[("model.glb", "model/gltf-binary", large())]).await;
    }
    let path = format!("/batches/{}/archive?format=tar", batch["id"].as_str().unwrap());
    assert!(matches!(download(&app, &path, &[]).await, (200, Ok(_))));
    let mut changed = large();
    changed[LARGE - 1] ^= 1;
    replace(&app, &format!("/models/{}", batch["models"][1].as_str().unwrap()), "model.glb", changed).await;
    assert!(matches!(download(&app, &path, &[]).await, (200, Err(_))));
    assert_eq!(damaged_reads(&app).await, "1");
}
