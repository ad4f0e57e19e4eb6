//! Examples of requests and responses. The model is the default model with seed 7; its spec is
//! abridged. A test validates every example against its schema and sends the requests.

use serde_json::{Value, json};

const ID: &str = "019c3a5e-7d21-7c44-9a3f-5b6e1f0a2c11";
const BATCH: &str = "019c3a60-02b7-7f10-8d52-c4a9e3d1b702";

/// Adds the examples to the components, and references to the operations.
pub(super) fn add(document: &mut Value) {
    let examples = [
        ("DefaultModel", "The default preset with a random seed", json!({})),
        (
            "LabelledModel",
            "A seed, formats and a label",
            json!({
            "preset": "pig", "seed": 7, "outputs": ["glb", "obj"], "labels": { "study": "A3" } }),
        ),
        (
            "ChangedModel",
            "Another gap along the tube, and less friction",
            json!({
            "preset": "pig", "seed": 7, "backend": "cpu", "priority": 10,
            "spec": { "friction": 0.25, "collision": { "gap_um": { "keys": [[0, 60], [1, 40]], "ease": "smooth" } } } }),
        ),
        ("SeedsBatch", "Three seeds", json!({ "preset": "pig", "seeds": [1, 2, 3] })),
        ("CountBatch", "Ten drawn seeds", json!({ "count": 10, "labels": { "study": "A4" } })),
        (
            "StudyBatch",
            "A Latin hypercube of 50 points",
            json!({ "preset": "pig", "vary": {
            "design": "lhs", "samples": 50, "seed": 4, "values": {
                "/collision/gap_um": { "from": 35, "to": 50 },
                "/friction": { "distribution": "normal", "mean": 0.3, "sd": 0.03, "min": 0.2, "max": 0.4 } } } }),
        ),
        (
            "GridBatch",
            "A grid of six points, each with two seeds",
            json!({ "seeds": [1, 2], "vary": {
            "design": "grid", "values": {
                "/collision/gap_um": { "from": 40, "to": 50, "count": 3 }, "/solver/integrator": ["rk4", "euler"] } } }),
        ),
        ("TicketRequest", "For the events of a model", json!({ "path": format!("/models/{ID}/events") })),
        (
            "Ticket",
            "A ticket",
            json!({ "ticket": "ovt_3q2-7wEjRWeJq83vEjRWeJq83vEjRWeJq83vEjRWeJo",
            "path": format!("/models/{ID}/events"), "expires_at": "2026-02-08T09:31:00Z" }),
        ),
        ("Model", "A model that has succeeded", model()),
        ("ModelList", "The last page", json!({ "models": [model()], "next": null })),
        ("Batch", "A batch of two models", batch()),
        ("BatchList", "The last page", json!({ "batches": [listed_batch()], "next": null })),
        (
            "Table",
            "Two points of a study",
            json!({
            "columns": ["id", "status", "seed", "/friction", "problem", "summary.volume_mm3"],
            "rows": [[ID, "succeeded", 7, 0.28, null, 183.083_789_087_184_73],
                ["019c3a5e-7d22-7b10-b1c7-0f2d4e6a8b91", "running", 7, 0.32, null, null]] }),
        ),
        (
            "InvalidRequest",
            "Two faults of a request",
            json!({
            "type": "urn:oviduct:problem:invalid-request", "title": "The request is not valid", "status": 422,
            "detail": "2 values are invalid; see errors.", "instance": "/models", "request_id": "019c3a5e-7d20-7000-8000-3c1d2e4f5a6b",
            "errors": [{ "pointer": "/seed", "detail": "must be an integer from 0 to 9007199254740991, not -1" },
                { "pointer": "/spec/friction", "detail": "is 3, above the greatest allowed 2.5 1/step: the integration is unstable above it" }] }),
        ),
        ("Event", "A model was cancelled", json!({ "event": "end", "id": "3", "data": event().to_string() })),
        ("WorkerList", "One worker", json!({ "pause": null, "workers": [worker()] })),
        ("Worker", "A worker", worker()),
    ];
    for (name, summary, value) in examples {
        document["components"]["examples"][name] = json!({ "summary": summary, "value": value });
    }
    let models = ["DefaultModel", "LabelledModel", "ChangedModel"];
    let batches = ["SeedsBatch", "CountBatch", "StudyBatch", "GridBatch"];
    for (path, method, place, names) in [
        ("/models", "post", "requestBody", &models[..]),
        ("/models/validate", "post", "requestBody", &models),
        ("/batches", "post", "requestBody", &batches),
        ("/batches/validate", "post", "requestBody", &batches),
        ("/tickets", "post", "requestBody", &["TicketRequest"]),
        ("/tickets", "post", "responses/201", &["Ticket"]),
        ("/models", "post", "responses/200", &["Model"]),
        ("/models", "post", "responses/422", &["InvalidRequest"]),
        ("/models", "get", "responses/200", &["ModelList"]),
        ("/models/{id}", "get", "responses/200", &["Model"]),
        ("/models/{id}/events", "get", "responses/200", &["Event"]),
        ("/events", "get", "responses/200", &["Event"]),
        ("/batches", "post", "responses/202", &["Batch"]),
        ("/batches", "get", "responses/200", &["BatchList"]),
        ("/batches/{id}", "get", "responses/200", &["Batch"]),
        ("/batches/{id}/table", "get", "responses/200", &["Table"]),
        ("/workers", "get", "responses/200", &["WorkerList"]),
        ("/workers/{id}/pause", "post", "responses/200", &["Worker"]),
    ] {
        let found = document["paths"][path][method].pointer_mut(&format!("/{place}/content"));
        // If there are several media types, the first is JSON.
        let content = found.and_then(Value::as_object_mut).and_then(|content| content.values_mut().next());
        let content = content.unwrap_or_else(|| panic!("{method} {path} has no {place}"));
        for name in names {
            content["examples"][name] = json!({ "$ref": format!("#/components/examples/{name}") });
        }
    }
}

fn model() -> Value {
    json!({
        "id": ID, "status": "succeeded", "version": 12, "preset": "pig", "seed": 7, "outputs": ["glb"], "bodies": ["tissue"], "units": null,
        "labels": { "study": "A3" }, "priority": 0, "owner": "smith-lab", "batch": null,
        "backend": { "requested": "cpu", "used": "cpu", "device": "cpu, 2 threads", "fallback": null },
        "worker": "node3-812-0", "queue": { "position": null, "wait_seconds": 0.003_909 },
        "progress": { "stage": "store", "fraction": 1.0, "step": 2000, "steps": 2000, "particles": 8300, "sections": 201,
            "eta_seconds": null },
        "attempts": 1, "created_at": "2026-02-08T09:12:00Z", "started_at": "2026-02-08T09:12:00.003909Z",
        "finished_at": "2026-02-08T09:12:03.365964Z", "expires_at": null,
        "files": [{ "name": "model.glb", "media_type": "model/gltf-binary", "bytes": 37_991_564,
            "sha256": "34fd790e8767e0311c7de2165a8156f61210d212167afbfdb5f6e10c339e6937",
            "href": format!("{ID}/files/model.glb") }],
        "summary": { "sections": 201, "sections_added": 0, "diagonals_flipped": 0, "particles": { "start": 710, "end": 8300 },
            "splits_deferred": 0, "splits_missing": 0, "vertices": 798_315, "triangles": 1_596_630,
            "min_gap_um": 4.430_645_642_790_343, "volume_mm3": 183.417_057_648_667_62,
            "area_mm2": 2_013.645_312_659_674, "warnings": [] },
        "warnings": [], "problem": null,
        "digest": "5e87226f5acbf7b58f2408b4d9c286a99686fd491532ec4ded66856d2b9fe044",
        "reused_from": null, "retry_of": null,
        "spec": { "friction": 0.3, "steps": 2000 }
    })
}

/// Data of an event of a model that was cancelled before it started.
fn event() -> Value {
    let mut event = model();
    if let Some(members) = event.as_object_mut() {
        members.remove("spec");
        members.extend([
            ("status".to_owned(), json!("cancelled")),
            ("version".to_owned(), json!(3)),
            ("files".to_owned(), json!([])),
            ("summary".to_owned(), Value::Null),
            ("progress".to_owned(), Value::Null),
        ]);
    }
    event
}

fn listed_batch() -> Value {
    json!({ "id": BATCH, "owner": "smith-lab", "created_at": "2026-02-08T09:20:00Z", "priority": 0,
        "counts": { "total": 2, "queued": 1, "running": 1, "succeeded": 0, "failed": 0, "cancelled": 0 } })
}

fn batch() -> Value {
    let mut batch = listed_batch();
    let second = "019c3a60-02b9-7c03-a6d8-91e5b7c3d204";
    let study = |id: &str, point: u32, friction: f64| json!({ "id": id, "point": point, "seed": 7, "values": { "/friction": friction } });
    batch["models"] = json!([ID, second]);
    batch["study"] = json!({
        "vary": { "design": "grid", "values": { "/friction": [0.28, 0.32] } },
        "models": [study(ID, 0, 0.28), study(second, 1, 0.32)] });
    batch
}

fn worker() -> Value {
    json!({ "id": "node3-812-0", "host": "node3", "backend": "cpu", "device": "cpu, 2 threads", "job": ID, "jobs": [ID],
        "jobs_done": 311, "heartbeat_at": "2026-02-08T09:14:30Z", "state": "active", "pause": null })
}
