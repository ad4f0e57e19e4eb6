//! The bytes of events, and which events a reader lacks.

use super::super::samples::{job, running};
use super::*;
use crate::http::models::model::ModelEvent;
use crate::jobs::Status;
use serde_json::{Value, json};

const STATUS: Changes = Changes { status: true, progress: false };
const PROGRESS: Changes = Changes { status: false, progress: true };

fn snapshot(job: &Job, number: u64, changes: Changes, previous: Option<&Snapshot>) -> Snapshot {
    Snapshot::new(job, &JobContext::default(), number, changes, previous)
}

fn text(snapshot: &Snapshot, position: u64) -> String {
    String::from_utf8(snapshot.events_after(position, "14", Detail::Summary, LinkBase::Root).concat()).unwrap()
}

/// Names of the events after `position`.
fn names(snapshot: &Snapshot, position: u64) -> Vec<String> {
    let text = text(snapshot, position);
    text.lines().filter_map(|line| Some(line.strip_prefix("event: ")?.to_owned())).collect()
}

#[test]
fn an_event_holds_the_model_on_one_line() {
    let job = running(10);
    let text = text(&snapshot(&job, 5, STATUS, None), 0);
    let lines: Vec<_> = text.lines().collect();
    assert_eq!((lines[0], lines[1], lines[3], lines[4]), ("event: status", "id: 14", "", "event: section"));
    let data = |line: &str| serde_json::from_str::<Value>(line.strip_prefix("data: ").unwrap()).unwrap();
    let model = Model::of(&job, &JobContext::default(), Detail::Summary, LinkBase::Root);
    assert_eq!(data(lines[2]), serde_json::to_value(&model).unwrap());
    let event = ModelEvent { model, section: job.section };
    assert_eq!(data(lines[6]), serde_json::to_value(event).unwrap());
    assert!(lines.len() == 8 && text.ends_with("\n\n"));
}

#[test]
fn the_spec_comes_with_the_full_view() {
    let job = Job { spec: json!({ "steps": 2000 }).into(), ..running(10) };
    let snapshot = snapshot(&job, 5, STATUS, None);
    let events = String::from_utf8(snapshot.events_after(0, "14", Detail::Full, LinkBase::Root).concat()).unwrap();
    let data: Vec<Value> =
        events.lines().filter_map(|line| serde_json::from_str(line.strip_prefix("data: ")?).ok()).collect();
    let model = Model::of(&job, &JobContext::default(), Detail::Full, LinkBase::Root);
    assert_eq!(model.spec, Some(job.spec.clone()));
    let event = ModelEvent { model: model.clone(), section: job.section.clone() };
    assert_eq!(data, [serde_json::to_value(model).unwrap(), serde_json::to_value(event).unwrap()]);
    assert!(!text(&snapshot, 0).contains("2000"), "and not with the other");
    let end = Snapshot::deleted(job.id, 6, Some(&snapshot));
    let [full, summary] =
        [Detail::Full, Detail::Summary].map(|detail| end.events_after(5, "14", detail, LinkBase::Root).concat());
    assert_eq!(full, summary);
}

#[test]
fn a_fit_is_sent_without_its_request() {
    let fit = Job { kind: JobKind::Fit, section: None, spec: json!({ "steps": 2000 }).into(), ..running(10) };
    let expected = serde_json::to_string(&Fit::of(&fit, &JobContext::default(), FitDetail::Result)).unwrap();
    for detail in [Detail::Summary, Detail::Full] {
        let events = snapshot(&fit, 5, STATUS, None).events_after(0, "14", detail, LinkBase::Model).concat();
        assert_eq!(String::from_utf8(events).unwrap(), format!("event: status\nid: 14\ndata: {expected}\n\n"));
    }
}

#[test]
fn a_reader_gets_the_events_that_it_lacks() {
    let first = snapshot(&running(10), 5, STATUS, None);
    assert_eq!(names(&first, 0), ["status", "section"]);
    assert_eq!(names(&first, 4), ["status", "section"]);
    let second = snapshot(&Job { section: running(10).section, ..running(20) }, 8, PROGRESS, Some(&first));
    assert_eq!(names(&second, 4), ["status", "section"], "a reader that never had the model");
    assert_eq!(names(&second, 5), ["progress"]);
    let third = snapshot(&running(30), 9, PROGRESS, Some(&second));
    assert_eq!(names(&third, 8), ["progress", "section"]);
    let fourth = snapshot(&running(40), 10, Changes { status: true, progress: true }, Some(&third));
    assert_eq!(names(&fourth, 9), ["status", "progress", "section"]);
    assert_eq!(names(&fourth, 4), ["status", "section"]);
    let end = snapshot(&Job { status: Status::Succeeded, ..running(40) }, 12, STATUS, Some(&fourth));
    assert_eq!((names(&end, 4), names(&end, 9), end.is_last), (vec!["end".to_owned()], vec!["end".to_owned()], true));
}

#[test]
fn a_deleted_model_has_an_end() {
    let deleted = Snapshot::deleted(job().id, 6, None);
    let data = json!({ "id": job().id.to_string(), "status": "deleted" });
    assert_eq!(text(&deleted, 5), format!("event: end\nid: 14\ndata: {data}\n\n"));
}

#[test]
fn readers_share_the_bytes_of_a_state() {
    let snapshot = snapshot(&running(10), 5, STATUS, None);
    let [one, two] = [0, 0].map(|position| snapshot.events_after(position, "14", Detail::Summary, LinkBase::Root));
    assert!(one.len() == 5 && one[1].as_ptr() == two[1].as_ptr() && one[1].as_ptr() == one[3].as_ptr());
    assert_eq!(one[4].as_ptr(), two[4].as_ptr(), "the section");
    // A section that has not changed is not serialized again.
    let next = super::Snapshot::new(&running(10), &JobContext::default(), 6, STATUS, Some(&snapshot));
    assert_eq!(next.events_after(0, "15", Detail::Summary, LinkBase::Root)[4].as_ptr(), one[4].as_ptr());
    // Neither is the spec; a reader of the full view shares the other members.
    let [one, next] = [snapshot, next].map(|snapshot| snapshot.events_after(0, "15", Detail::Full, LinkBase::Root));
    assert_eq!(one[2], ",\"spec\":{}");
    assert_eq!((one[2].as_ptr(), one[2].as_ptr()), (next[2].as_ptr(), one[6].as_ptr()));
    assert_eq!(one[1].as_ptr(), two[1].as_ptr());
}
