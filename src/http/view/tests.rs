//! What events look like on the wire, and which of them a reader lacks.

use super::super::dto::ModelEvent;
use super::super::samples::{job, running};
use super::*;
use serde_json::{Value, json};

fn view(job: &Job, names: &[Name], number: u64, before: Option<&View>) -> View {
    View::of(job, None, names, number, before)
}

fn text(view: &View, number: u64) -> String {
    String::from_utf8(view.events_after(number, "14", Detail::Summary).concat()).unwrap()
}

/// Names of the events after `number`.
fn names(view: &View, number: u64) -> Vec<String> {
    let text = text(view, number);
    text.lines().filter_map(|line| Some(line.strip_prefix("event: ")?.to_owned())).collect()
}

#[test]
fn an_event_holds_the_model_on_one_line() {
    let job = running(10);
    let text = text(&view(&job, &[Name::Status, Name::Section], 5, None), 0);
    let lines: Vec<_> = text.lines().collect();
    assert_eq!((lines[0], lines[1], lines[3], lines[4]), ("event: status", "id: 14", "", "event: section"));
    let data = |line: &str| serde_json::from_str::<Value>(line.strip_prefix("data: ").unwrap()).unwrap();
    let model = Model::of(&job, None, Detail::Summary, At::Root);
    assert_eq!(data(lines[2]), serde_json::to_value(&model).unwrap());
    let event = ModelEvent { model, section: job.section };
    assert_eq!(data(lines[6]), serde_json::to_value(event).unwrap());
    assert!(lines.len() == 8 && text.ends_with("\n\n"));
}

#[test]
fn the_spec_comes_with_the_full_view() {
    let job = Job { spec: json!({ "steps": 2000 }), ..running(10) };
    let view = view(&job, &[Name::Status, Name::Section], 5, None);
    let events = String::from_utf8(view.events_after(0, "14", Detail::Full).concat()).unwrap();
    let data: Vec<Value> =
        events.lines().filter_map(|line| serde_json::from_str(line.strip_prefix("data: ")?).ok()).collect();
    let model = Model::of(&job, None, Detail::Full, At::Root);
    assert_eq!(model.spec, Some(job.spec.clone()));
    let event = ModelEvent { model: model.clone(), section: job.section.clone() };
    assert_eq!(data, [serde_json::to_value(model).unwrap(), serde_json::to_value(event).unwrap()]);
    assert!(!text(&view, 0).contains("2000"), "and not with the other");
    let end = View::deleted(job.id, 6, Some(&view), None);
    assert_eq!(end.events_after(5, "14", Detail::Full).concat(), end.events_after(5, "14", Detail::Summary).concat());
}

#[test]
fn a_reader_gets_the_events_that_it_lacks() {
    let first = view(&running(10), &[Name::Status, Name::Section], 5, None);
    assert_eq!(names(&first, 0), ["status", "section"]);
    assert_eq!(names(&first, 4), ["status", "section"]);
    let second = view(&running(20), &[Name::Progress], 8, Some(&first));
    assert_eq!(names(&second, 4), ["status", "section"], "a reader that never had the model");
    assert_eq!(names(&second, 5), ["progress"]);
    let third = view(&running(30), &[Name::Status, Name::Progress, Name::Section], 9, Some(&second));
    assert_eq!(names(&third, 8), ["status", "progress", "section"]);
    let end = view(&Job { status: Status::Succeeded, ..running(40) }, &[Name::End], 12, Some(&third));
    assert_eq!((names(&end, 4), names(&end, 9), end.is_last()), (vec!["end".to_owned()], vec!["end".to_owned()], true));
}

#[test]
fn a_deleted_model_ends_with_the_next_version() {
    let before = view(&job(), &[Name::Status], 5, None);
    let deleted = View::deleted(job().id, 6, Some(&before), None);
    assert_eq!((deleted.version(), deleted.is_last()), (before.version() + 1, true));
    let data = json!({ "id": job().id.to_string(), "status": "deleted" });
    assert_eq!(text(&deleted, 5), format!("event: end\nid: 14\ndata: {data}\n\n"));
}

#[test]
fn readers_share_the_bytes_of_a_state() {
    let view = view(&running(10), &[Name::Status], 5, None);
    let [one, two] = [0, 0].map(|number| view.events_after(number, "14", Detail::Summary));
    assert!(one.len() == 5 && one[1].as_ptr() == two[1].as_ptr() && one[1].as_ptr() == one[3].as_ptr());
    assert_eq!(one[4].as_ptr(), two[4].as_ptr(), "the contour");
    // A contour that has not changed is not serialised again.
    let next = super::View::of(&running(10), None, &[Name::Status], 6, Some(&view));
    assert_eq!(next.events_after(0, "15", Detail::Summary)[4].as_ptr(), one[4].as_ptr());
    // Neither is the spec; a reader of all members shares the others.
    let [one, next] = [view, next].map(|view| view.events_after(0, "15", Detail::Full));
    assert_eq!(one[2], ",\"spec\":{}");
    assert_eq!((one[2].as_ptr(), one[2].as_ptr()), (next[2].as_ptr(), one[6].as_ptr()));
    assert_eq!(one[1].as_ptr(), two[1].as_ptr());
}
