//! The Grafana dashboard and the alert rules name only existing metrics and labels, and
//! `docs/operations.md` describes both. `tests/outside/promql.py` checks the syntax of their
//! expressions.
#![expect(clippy::unwrap_used, reason = "a test fails by panic")]

use oviduct::metrics::{Fallback, Metrics};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::time::Duration;

/// Labels by the name of a series, such as `oviduct_http_requests_total`.
type Series = BTreeMap<String, BTreeSet<String>>;

/// Labels that Prometheus adds to every series.
const ADDED: [&str; 2] = ["job", "instance"];

fn read(path: &str) -> String {
    std::fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join(path)).unwrap()
}

/// All series of a registry in which each metric has been used.
fn series() -> Series {
    let metrics = Metrics::default();
    metrics.set_jobs([("queued", 1)]);
    metrics.set_queued([("auto", 1)]);
    metrics.set_oldest([("auto", Duration::from_secs(1))]);
    metrics.set_workers([("cpu", "active", 1)]);
    metrics.add_slot("cpu");
    metrics.set_connections("readers", 1, 1, 4);
    metrics.stage("simulate", 1.0);
    metrics.made("cpu", "a device".to_owned());
    metrics.fallback(Fallback::NoGpu);
    metrics.attempt("lost");
    metrics.bytes_in(1);
    metrics.task_panicked("claims", 1);
    metrics.picture("kept");
    metrics.request("GET", "/models/{id}", 200, Duration::from_millis(1), false);
    let mut series = Series::new();
    for line in metrics.text().lines().filter(|line| !line.starts_with('#')) {
        let name = line.split(['{', ' ']).next().unwrap();
        let labels = line.split_once('{').map_or_else(Vec::new, |(_, rest)| matchers(rest.rsplit_once('}').unwrap().0));
        series.entry(name.to_owned()).or_default().extend(labels.into_iter().map(|(label, _)| label));
    }
    assert!(series.len() > 40, "{series:?}");
    series
}

/// Labels and values in `a="b", c=~"d|e"`.
fn matchers(text: &str) -> Vec<(String, String)> {
    let mut found = Vec::new();
    let mut rest = text;
    while let Some((label, after)) = rest.split_once(['=', '!']) {
        let (_, quoted) = after.split_once('"').unwrap();
        let (value, after) = quoted.split_once('"').unwrap();
        found.push((label.trim_matches([',', ' ']).to_owned(), value.to_owned()));
        rest = after;
    }
    found
}

/// The words of an expression, each with the text after it. Quoted text is skipped.
fn words(expression: &str) -> Vec<(&str, &str)> {
    let is_word = |c: char| c.is_ascii_alphanumeric() || c == '_';
    let (mut found, mut at) = (Vec::new(), 0);
    while let Some(c) = expression[at..].chars().next() {
        if c == '"' {
            at += expression[at + 1..].find('"').unwrap() + 2;
        } else if is_word(c) {
            let end = expression[at..].find(|c| !is_word(c)).map_or(expression.len(), |length| at + length);
            found.push((&expression[at..end], &expression[end..]));
            at = end;
        } else {
            at += c.len_utf8();
        }
    }
    found
}

/// Labels and the values that an expression compares with them.
type Matchers = Vec<(String, String)>;

/// Series that an expression names, each with its matchers; and the labels in `by`, `on`,
/// `ignoring` and `without`.
fn names(expression: &str) -> (Vec<(String, Matchers)>, BTreeSet<String>) {
    let (mut selected, mut grouped) = (Vec::new(), BTreeSet::new());
    for (word, after) in words(expression) {
        if word.starts_with("oviduct_") || word.starts_with("process_") {
            let braces = after.strip_prefix('{').map(|rest| matchers(rest.split_once('}').unwrap().0));
            selected.push((word.to_owned(), braces.unwrap_or_default()));
        }
        if ["by", "on", "ignoring", "without"].contains(&word) {
            let labels = after.trim_start().strip_prefix('(').unwrap().split_once(')').unwrap().0;
            grouped.extend(labels.split(',').map(|label| label.trim().to_owned()).filter(|label| !label.is_empty()));
        }
    }
    (selected, grouped)
}

/// Names in an expression that do not exist in the metrics or in the table of the guide.
fn faults(place: &str, expression: &str, series: &Series, guide: &BTreeMap<String, Described>) -> Vec<String> {
    let mut faults = Vec::new();
    let (selected, grouped) = names(expression);
    if selected.is_empty() {
        faults.push(format!("{place}: names no metric"));
    }
    let mut all: BTreeSet<&str> = ADDED.into();
    for (name, matchers) in &selected {
        let Some(labels) = series.get(name) else {
            faults.push(format!("{place}: there is no {name}"));
            continue;
        };
        all.extend(labels.iter().map(String::as_str));
        for (label, value) in matchers {
            if ADDED.contains(&label.as_str()) {
                continue;
            }
            if !labels.contains(label) {
                faults.push(format!("{place}: {name} has no label {label}"));
            }
            // The guide lists neither routes nor Grafana's variables.
            let plain = value.split('|').filter(|value| value.bytes().all(|b| b.is_ascii_lowercase() || b == b'-'));
            let meaning = guide.get(family(name)).map_or("", |described| described.meaning.as_str());
            for value in plain.filter(|value| !value.is_empty() && !meaning.contains(&format!("`{value}`"))) {
                faults.push(format!("{place}: docs/operations.md lacks `{value}` of {name}"));
            }
        }
    }
    for label in grouped.iter().filter(|label| !all.contains(label.as_str())) {
        faults.push(format!("{place}: nothing there has the label {label}"));
    }
    faults
}

/// Name of the metric to which a series belongs, as the guide lists it.
fn family(series: &str) -> &str {
    ["_bucket", "_sum", "_count"].iter().find_map(|suffix| series.strip_suffix(suffix)).unwrap_or(series)
}

/// Description of a metric in `docs/operations.md`.
#[derive(Debug)]
struct Described {
    labels: BTreeSet<String>,
    meaning: String,
}

/// The metrics in the table of `docs/operations.md`.
fn guide() -> BTreeMap<String, Described> {
    let mut found = BTreeMap::new();
    for line in read("docs/operations.md")
        .lines()
        .filter(|line| line.starts_with("| `oviduct_") || line.starts_with("| `process_"))
    {
        let (names, meaning) = line.trim_matches(['|', ' ']).split_once(" | ").unwrap();
        for name in names.split('`').skip(1).step_by(2) {
            let (name, labels) = name.strip_suffix('}').and_then(|name| name.split_once('{')).unwrap_or((name, ""));
            let labels = labels.split(',').filter(|label| !label.is_empty()).map(str::to_owned).collect();
            assert!(
                found.insert(name.to_owned(), Described { labels, meaning: meaning.to_owned() }).is_none(),
                "{name}"
            );
        }
    }
    found
}

#[test]
fn the_guide_describes_every_metric_with_its_labels() {
    let mut series = series();
    series.values_mut().for_each(|labels| {
        labels.remove("le");
    });
    let mut real: Series = Series::new();
    for (name, labels) in series {
        real.entry(family(&name).to_owned()).or_default().extend(labels);
    }
    let described: Series = guide().into_iter().map(|(name, Described { labels, .. })| (name, labels)).collect();
    assert_eq!(described, real);
}

#[test]
fn the_dashboard_shows_metrics_that_exist() {
    let dashboard: Value = serde_json::from_str(&read("deploy/grafana/oviduct.json")).unwrap();
    let (series, guide) = (series(), guide());
    let mut faults_found = Vec::new();
    let mut ids = BTreeSet::new();
    for panel in dashboard["panels"].as_array().unwrap() {
        let title = panel["title"].as_str().unwrap();
        assert!(ids.insert(panel["id"].as_u64().unwrap()), "two panels have the id of {title}");
        if panel["type"] == "row" {
            continue;
        }
        assert_eq!(panel["datasource"]["uid"], "${datasource}", "{title}");
        assert!(panel["fieldConfig"]["defaults"]["unit"].is_string(), "{title} has no unit");
        let targets = panel["targets"].as_array().unwrap();
        assert!(!targets.is_empty(), "{title}");
        for target in targets {
            faults_found.extend(faults(title, target["expr"].as_str().unwrap(), &series, &guide));
        }
    }
    assert!(ids.len() > 20);
    for variable in dashboard["templating"]["list"].as_array().unwrap().iter().filter(|v| v["type"] == "query") {
        let query = variable["definition"].as_str().unwrap();
        faults_found.extend(faults(query, query, &series, &guide));
    }
    assert!(faults_found.is_empty(), "\n{}\n", faults_found.join("\n"));
}

#[test]
fn alerts_name_metrics_that_exist_and_are_in_the_guide() {
    let rules: Value = yaml_serde::from_str(&read("deploy/prometheus/oviduct.rules.yaml")).unwrap();
    let (series, guide) = (series(), guide());
    let listed: BTreeSet<String> = read("docs/operations.md")
        .lines()
        .filter_map(|line| Some(line.strip_prefix("| `Oviduct")?.split_once('`')?.0.to_owned()))
        .collect();
    let mut faults_found = Vec::new();
    let mut alerts = BTreeSet::new();
    for group in rules["groups"].as_array().unwrap() {
        for rule in group["rules"].as_array().unwrap() {
            let name = rule["alert"].as_str().unwrap();
            assert!(alerts.insert(name.strip_prefix("Oviduct").unwrap().to_owned()), "{name} is there twice");
            assert!(["critical", "warning"].contains(&rule["labels"]["severity"].as_str().unwrap()), "{name}");
            assert!(rule["annotations"]["summary"].as_str().is_some_and(|text| !text.is_empty()), "{name}");
            faults_found.extend(faults(name, rule["expr"].as_str().unwrap(), &series, &guide));
        }
    }
    assert!(faults_found.is_empty(), "\n{}\n", faults_found.join("\n"));
    assert_eq!(alerts, listed, "the alerts in docs/operations.md");
}

#[test]
fn unknown_metrics_and_labels_are_reported() {
    let (series, guide) = (series(), guide());
    let faults = |expression| faults("x", expression, &series, &guide);
    assert_eq!(
        faults("sum by (end) (rate(oviduct_attempts_total{end=~\"failed|retried\"}[5m]))"),
        Vec::<String>::new()
    );
    assert_eq!(faults("oviduct_jobs{instance=\"a\"} / on (job) oviduct_workers"), Vec::<String>::new());
    assert_eq!(faults("oviduct_attempts"), ["x: there is no oviduct_attempts"]);
    assert_eq!(faults("oviduct_jobs{colour=\"5..\"}"), ["x: oviduct_jobs has no label colour"]);
    assert_eq!(faults("oviduct_jobs{status=\"asleep\"}"), ["x: docs/operations.md lacks `asleep` of oviduct_jobs"]);
    assert_eq!(faults("sum by (colour) (oviduct_jobs)"), ["x: nothing there has the label colour"]);
    assert_eq!(faults("1 + 1"), ["x: names no metric"]);
}
