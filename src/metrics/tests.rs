//! Tests of the metrics.

use super::*;

#[test]
fn the_text_contains_the_counts() {
    let metrics = Metrics::default();
    metrics.set_jobs([("queued", 7), ("running", 2)]);
    metrics.set_queued([("auto", 4), ("gpu", 3)]);
    assert!(metrics.text().contains("oviduct_artifact_store_up 1\n"), "before the first write");
    metrics.set_artifact_store_up(false);
    metrics.waited(Duration::from_millis(300));
    metrics.stage("simulate", 1.5);
    metrics.attempt("succeeded");
    metrics.attempt("lost");
    metrics.made("gpu", "NVIDIA H200".to_owned());
    metrics.fallback(Fallback::Busy);
    metrics.bytes_in(10);
    metrics.bytes_out(5);
    metrics.request("GET", "/models/{id}", 200, Duration::from_millis(2), false);
    metrics.request("GET", "/models/{id}", 404, Duration::from_millis(2), false);
    metrics.request("POST", "/models", 200, Duration::from_secs(9), true);
    metrics.set_oldest([("auto", Duration::from_millis(1500))]);
    metrics.set_workers([("gpu", "draining", 2)]);
    metrics.set_paused(true);
    metrics.add_slot("cpu");
    metrics.add_slot("cpu");
    metrics.slot_busy("cpu", true);
    metrics.set_connections("readers", 3, 1, 4);
    metrics.set_streams(5, 10);
    metrics.set_held(1, 2);
    metrics.set_downloads(3, 4);
    let text = metrics.text();
    for line in [
        "oviduct_jobs{status=\"queued\"} 7",
        "oviduct_queued_jobs{backend=\"gpu\"} 3",
        "oviduct_artifact_store_up 0",
        "oviduct_queue_wait_seconds_count 1",
        "oviduct_stage_seconds_sum{stage=\"simulate\"} 1.5",
        "oviduct_attempts_total{end=\"lost\"} 1",
        "oviduct_leases_lost_total 1",
        "oviduct_models_made_total{backend=\"gpu\",device=\"NVIDIA H200\"} 1",
        "oviduct_fallbacks_total{cause=\"busy\"} 1",
        "oviduct_artifact_bytes_total{direction=\"out\"} 5",
        "oviduct_http_requests_total{method=\"GET\",route=\"/models/{id}\",status=\"200\"} 1",
        "oviduct_http_requests_total{method=\"POST\",route=\"/models\",status=\"200\"} 1",
        "oviduct_http_request_seconds_count 3",
        "oviduct_http_request_duration_seconds_count{method=\"GET\",route=\"/models/{id}\",status=\"2xx\"} 1",
        "oviduct_http_request_duration_seconds_bucket{le=\"0.001\",method=\"GET\",route=\"/models/{id}\",status=\"4xx\"} 0",
        "oviduct_http_request_duration_seconds_bucket{le=\"0.0025\",method=\"GET\",route=\"/models/{id}\",status=\"4xx\"} 1",
        "oviduct_oldest_queued_seconds{backend=\"auto\"} 1.5",
        "oviduct_workers{backend=\"gpu\",state=\"draining\"} 2",
        "oviduct_claiming_paused 1",
        "oviduct_worker_slots{backend=\"cpu\"} 2",
        "oviduct_worker_slots_busy{backend=\"cpu\"} 1",
        "oviduct_database_connections{pool=\"readers\",state=\"busy\"} 3",
        "oviduct_database_connections{pool=\"readers\",state=\"idle\"} 1",
        "oviduct_database_connections_max{pool=\"readers\"} 4",
        "oviduct_event_streams 5",
        "oviduct_event_streams_max 10",
        "oviduct_held_answers 1",
        "oviduct_held_answers_max 2",
        "oviduct_downloads 3",
        "oviduct_downloads_max 4",
    ] {
        assert!(text.lines().any(|l| l == line), "{line} in\n{text}");
    }
    assert!(!text.contains("route=\"/models\",status=\"2xx\""), "a held answer is not timed:\n{text}");
    let build = format!("oviduct_build_info{{version=\"{0}\",engine=\"{0}\"", crate::ENGINE_VERSION);
    assert!(text.contains(&build), "{build} in\n{text}");
    #[cfg(target_os = "linux")]
    for name in ["process_resident_memory_bytes", "process_open_fds", "process_max_fds"] {
        let value = text.lines().find_map(|line| line.strip_prefix(name)?.trim().parse::<f64>().ok());
        assert!(value.is_some_and(|value| value > 0.0), "{name} in\n{text}");
    }
    assert!(text.ends_with("# EOF\n") && text.matches("# EOF").count() == 1);
}
