//! The service accepts the example requests in `openapi.yaml`.

use super::app::App;
use serde_json::Value;

#[tokio::test]
async fn examples_of_requests_are_accepted() {
    let app = App::new().await;
    let document: Value = yaml_serde::from_str(&oviduct::http::openapi_yaml()).unwrap();
    let mut sent = 0;
    for (path, status) in [("/models/validate", 200), ("/batches/validate", 200), ("/tickets", 201)] {
        let content = &document["paths"][path]["post"]["requestBody"]["content"]["application/json"];
        for (name, example) in content["examples"].as_object().unwrap() {
            let pointer = example["$ref"].as_str().unwrap().strip_prefix('#').unwrap();
            let reply = app.post(path, &document.pointer(pointer).unwrap()["value"]).await;
            assert_eq!(reply.status, status, "{name}: {:?}", reply.body);
            sent += 1;
        }
    }
    assert_eq!(sent, 8);
}
