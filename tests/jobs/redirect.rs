//! Downloads that the service redirects to S3 (`--redirect-downloads`): the `oviduct` program and a
//! plain HTTP client.

use crate::bucket::Bucket;
use reqwest::header::{
    CACHE_CONTROL, CONTENT_DISPOSITION, CONTENT_RANGE, CONTENT_TYPE, ETAG, HeaderName, IF_NONE_MATCH, LOCATION, RANGE,
};
use reqwest::redirect::Policy;
use reqwest::{Client, Response};
use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use std::io::{BufRead, BufReader};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

/// `oviduct serve` over a bucket; killed at the end of the test.
struct Server {
    child: Child,
    url: String,
}

impl Server {
    fn start(bucket: &Bucket, data: &std::path::Path, options: &[&str]) -> Self {
        let mut child = Command::new(env!("CARGO_BIN_EXE_oviduct"))
            .args(["serve", "--addr", "127.0.0.1:0", "--log", "warn", "--gpu", "off", "--artifacts", Bucket::URL])
            .args(options)
            .env_clear()
            .envs(bucket.variables())
            .current_dir(data)
            .stdout(Stdio::piped())
            .spawn()
            .unwrap();
        let mut url = String::new();
        BufReader::new(child.stdout.take().unwrap()).read_line(&mut url).unwrap();
        assert!(url.starts_with("http://127.0.0.1:"), "{url}");
        Self { child, url: url.trim().to_owned() }
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

fn header(answer: &Response, name: &HeaderName) -> String {
    answer.headers().get(name).unwrap_or_else(|| panic!("no {name}: {answer:?}")).to_str().unwrap().to_owned()
}

async fn model(client: &Client, url: &str) -> Value {
    let body =
        json!({ "seed": 7, "spec": { "steps": 200, "particles": { "total": { "keys": [[0, 400], [1, 900]] } } } });
    let asked: Value = client.post(format!("{url}/models")).json(&body).send().await.unwrap().json().await.unwrap();
    let address = format!("{url}/models/{}", asked["id"].as_str().unwrap());
    for _ in 0..6000 {
        let model: Value = client.get(&address).send().await.unwrap().json().await.unwrap();
        if !matches!(model["status"].as_str(), Some("queued" | "running")) {
            assert_eq!(model["status"], "succeeded", "{model}");
            return model;
        }
        tokio::time::sleep(Duration::from_millis(100)).await;
    }
    panic!("it did not end");
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn downloads_are_redirected_to_the_bucket() {
    oviduct::tls::install();
    let bucket = Bucket::start().await;
    let data = tempfile::tempdir().unwrap();
    let server = tokio::task::block_in_place(|| Server::start(&bucket, data.path(), &["--redirect-downloads"]));
    let asks = Client::builder().redirect(Policy::none()).build().unwrap();
    let follows = Client::new();
    let model = model(&asks, &server.url).await;
    let mut sent = Vec::new();
    for file in model["files"].as_array().unwrap() {
        let base = reqwest::Url::parse(&format!("{}/models/{}", server.url, model["id"].as_str().unwrap())).unwrap();
        let address = base.join(file["href"].as_str().unwrap()).unwrap();
        let bytes = file["bytes"].as_u64().unwrap();
        let answer = asks.get(address.clone()).send().await.unwrap();
        if answer.status() == 200 {
            // A file in a pack has no address of its own.
            let whole = answer.bytes().await.unwrap();
            assert_eq!(hex::encode(Sha256::digest(&whole)), file["sha256"].as_str().unwrap());
            sent.push(file["name"].as_str().unwrap());
            continue;
        }
        assert_eq!(answer.status(), 307);
        assert_eq!(header(&answer, &CACHE_CONTROL), "no-store", "the URL is valid for minutes");
        let signed = header(&answer, &LOCATION);
        let endpoint = &bucket.variables()[2].1;
        assert!(signed.starts_with(endpoint), "{signed} is not at {endpoint}");

        // The signed URL needs no credentials.
        let whole = asks.get(&signed).send().await.unwrap();
        assert_eq!(whole.status(), 200);
        assert_eq!(header(&whole, &CONTENT_TYPE), file["media_type"].as_str().unwrap());
        let name = format!("attachment; filename=\"pig-7-{}\"", file["name"].as_str().unwrap());
        assert_eq!(header(&whole, &CONTENT_DISPOSITION), name);
        let whole = whole.bytes().await.unwrap();
        assert_eq!(hex::encode(Sha256::digest(&whole)), file["sha256"].as_str().unwrap());
        assert_eq!(whole.len() as u64, bytes);

        // The signed URL supports ranges, and a client that follows redirects gets the same bytes.
        let some = asks.get(&signed).header(RANGE, "bytes=10-109").send().await.unwrap();
        assert_eq!((some.status().as_u16(), header(&some, &CONTENT_RANGE)), (206, format!("bytes 10-109/{bytes}")));
        assert_eq!(some.bytes().await.unwrap(), whole[10..110]);
        let some = follows.get(address.clone()).header(RANGE, "bytes=-20").send().await.unwrap();
        assert_eq!(some.status(), 206);
        assert_eq!(some.bytes().await.unwrap(), whole[whole.len() - 20..]);
        assert_eq!(follows.get(address.clone()).send().await.unwrap().bytes().await.unwrap(), whole);

        // A web page whose policy allows only its own origin requests the bytes without a redirect.
        let direct = asks.get(address.clone()).header("prefer", "redirect=no");
        assert_eq!(direct.send().await.unwrap().bytes().await.unwrap(), whole);

        // The service does not redirect requests that need no content.
        let head = asks.head(address.clone()).send().await.unwrap();
        assert_eq!(head.status(), 200);
        let known = asks.get(address.clone()).header(IF_NONE_MATCH, header(&head, &ETAG)).send().await.unwrap();
        assert_eq!(known.status(), 304);

        // The signature is valid neither for another file nor for a longer time.
        let other = signed.replacen("/models/of/tests/", "/models/of/others/", 1);
        assert!(!asks.get(&other).send().await.unwrap().status().is_success());
        assert!(
            !asks
                .get(signed.replace("X-Amz-Expires=300", "X-Amz-Expires=900"))
                .send()
                .await
                .unwrap()
                .status()
                .is_success()
        );
    }
    let files = model["files"].as_array().unwrap();
    let small = files.iter().filter(|file| file["bytes"].as_u64().unwrap() <= 256 << 10);
    assert_eq!(sent, small.map(|file| file["name"].as_str().unwrap()).collect::<Vec<_>>());
    assert!(sent.len() > 1 && sent.len() < files.len(), "{files:?}");
}
