//! Files in a pack are served like files that are stored alone.

use super::app::{App, Reply};
use super::{cut, sections};
use axum::body::Body;
use axum::http::{Method, header};
use bytes::Bytes;
use oviduct::export::sections_bin;

/// A model whose first and last files frame the others.
fn contents() -> [(&'static str, &'static str, Vec<u8>); 4] {
    [
        ("report.json", "application/json", br#"{"certificate":{"passed":true}}"#.to_vec()),
        ("model.obj", "model/obj", cut::stored()),
        ("sections.bin", sections_bin::MEDIA_TYPE, sections::stored(3)),
        ("model.bin", "application/octet-stream", (0..200).collect()),
    ]
}

/// Two services: one with the files in a pack, one with each file alone. Returns the paths of the
/// models.
async fn apps() -> [(App, String); 2] {
    let (packed, alone) = (App::new().await, App::new().await);
    let path = packed.model(7).await;
    packed.finish_packed(packed.claim().await, &contents()).await;
    let other = alone.finished(7, &contents()).await;
    [(packed, path), (alone, other)]
}

/// What a client sees of a response.
fn seen(reply: &Reply) -> (u16, Vec<Option<&str>>, &Bytes) {
    let headers = [
        header::CONTENT_TYPE,
        header::CONTENT_LENGTH,
        header::CONTENT_RANGE,
        header::CONTENT_DISPOSITION,
        header::ACCEPT_RANGES,
        header::CACHE_CONTROL,
    ];
    (reply.status.as_u16(), headers.map(|name| reply.header(name)).to_vec(), &reply.body)
}

#[tokio::test]
async fn downloads_ranges_and_tags_are_those_of_files_alone() {
    let [(packed, path), (alone, other)] = apps().await;
    for (name, _, content) in contents() {
        let (path, other) = (format!("{path}/files/{name}"), format!("{other}/files/{name}"));
        let whole = packed.get(&path).await;
        assert!(whole.status == 200 && whole.body == content, "{name}: {whole:?}");
        let tag = whole.header(header::ETAG).unwrap().to_owned();
        let (size, last) = (content.len(), content.len() - 1);
        let ranges = [
            "bytes=0-0".to_owned(),
            "bytes=3-9".to_owned(),
            "bytes=-5".to_owned(),
            format!("bytes={last}-"),
            format!("bytes={last}-{}", size + 50),
            format!("bytes={size}-"),
            "bytes=0-".to_owned(),
        ];
        let mut requests: Vec<Vec<(&str, &str)>> = vec![vec![], vec![("if-none-match", &tag)]];
        requests.extend(ranges.iter().map(|range| vec![("range", range.as_str())]));
        for headers in &requests {
            for method in [Method::GET, Method::HEAD] {
                let here = packed.request(method.clone(), &path, headers, Body::empty()).await;
                let there = alone.request(method.clone(), &other, headers, Body::empty()).await;
                assert_eq!(here.header(header::ETAG), there.header(header::ETAG), "{name} {method} {headers:?}");
                if here.status == 416 {
                    assert_eq!((there.status, here.slug()), (here.status, there.slug()));
                    continue;
                }
                assert_eq!(seen(&here), seen(&there), "{name} {method} {headers:?}");
            }
        }
        let middle = packed.get_with(&path, &[("range", "bytes=3-9")]).await;
        assert_eq!((middle.status.as_u16(), &middle.body[..]), (206, &content[3..10]), "{name}");
    }
}

#[tokio::test]
async fn what_is_made_of_files_is_the_same() {
    let [(packed, path), (alone, other)] = apps().await;
    for what in [
        "report",
        "sections/0",
        "sections/2?format=svg",
        "sections/1?format=png",
        "cut?z_um=1500",
        "preview.png?size=64",
    ] {
        let here = packed.get(&format!("{path}/{what}")).await;
        let there = alone.get(&format!("{other}/{what}")).await;
        assert_eq!(here.status, there.status, "{what}");
        let text =
            |reply: &Reply, of: &str| String::from_utf8_lossy(&reply.body).replace(&of["/models/".len()..], "id");
        assert!(here.status == 200 && text(&here, &path) == text(&there, &other), "{what}: {here:?} {there:?}");
    }
}

#[tokio::test]
async fn a_changed_byte_damages_one_file_of_a_pack() {
    let [(app, path), _] = apps().await;
    let key = format!("{}/1/pack", path.strip_prefix('/').unwrap());
    let pack = contents().map(|(_, _, content)| content).concat();
    assert!(app.artifacts.read_all(&key).await.unwrap() == pack);
    let at = contents()[0].2.len();
    let mut changed = pack.clone();
    changed[at] ^= 1;
    app.artifacts.put_bytes(&key, Bytes::from(changed)).await.unwrap();
    app.expect_faults();
    assert_eq!(app.get(&format!("{path}/cut?z_um=1500")).await.slug(), "internal");
    for name in ["report.json", "sections.bin", "model.bin"] {
        assert_eq!(app.get(&format!("{path}/files/{name}")).await.status, 200, "{name}");
    }
    // The last file of a pack that is too short.
    app.artifacts.put_bytes(&key, Bytes::from(pack[..pack.len() - 1].to_vec())).await.unwrap();
    assert_eq!(app.get(&format!("{path}/files/model.obj")).await.status, 200);
    for range in [&[][..], &[("range", "bytes=0-0")]] {
        assert_eq!(app.get_with(&format!("{path}/files/model.bin"), range).await.slug(), "internal");
    }
}
