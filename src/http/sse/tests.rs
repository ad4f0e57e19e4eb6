//! What a stream sends and what it leaves out.

use super::*;
use crate::generate::{Backend, Stage};
use crate::jobs::LiveSection;
use proptest::prelude::*;
use serde_json::json;

fn job() -> Job {
    Job {
        id: JobId(uuid::Uuid::from_u128(7)),
        status: Status::Queued,
        version: 1,
        preset: "pig".into(),
        seed: 7,
        spec: json!({}),
        outputs: vec![],
        labels: Default::default(),
        priority: Default::default(),
        trace: None,
        backend: BackendReport { requested: Backend::Auto, used: None, device: None, fallback: None },
        queue_position: Some(0),
        progress: None,
        section: None,
        attempts: 0,
        cancel_requested: false,
        created_at: jiff::Timestamp::UNIX_EPOCH,
        started_at: None,
        finished_at: None,
        files: vec![],
        summary: None,
        problem: None,
        digest: String::new(),
        engine: String::new(),
        batch: None,
        checkpoint: None,
        reused_from: None,
    }
}

fn running(step: u32) -> Job {
    let progress = Progress {
        stage: Stage::Simulate,
        fraction: f64::from(step) / 1000.0,
        step,
        steps: 1000,
        particles: 710,
        sections: step / 10,
        eta_seconds: None,
    };
    let section = LiveSection { index: step / 10, step, z_um: 1.0, inner: vec![], outer: vec![] };
    Job {
        status: Status::Running,
        queue_position: None,
        attempts: 1,
        progress: Some(progress),
        section: Some(section),
        ..job()
    }
}

const MS: Duration = Duration::from_millis(1);

#[test]
fn the_first_event_is_the_status_and_the_contour_if_there_is_one() {
    assert_eq!(Track::new(250 * MS).next(&job(), Duration::ZERO).0, [Name::Status]);
    assert_eq!(Track::new(250 * MS).next(&running(10), Duration::ZERO).0, [Name::Status, Name::Section]);
}

#[test]
fn nothing_new_makes_no_event() {
    let mut track = Track::knowing(250 * MS, &running(10));
    assert_eq!(track.next(&running(10), Duration::ZERO), (vec![], None));
    assert_eq!(track.next(&running(20), Duration::ZERO).0, [Name::Progress, Name::Section]);
}

#[test]
fn progress_is_held_back_and_then_told() {
    let mut track = Track::new(250 * MS);
    track.next(&running(10), Duration::ZERO);
    assert_eq!(track.next(&running(20), 100 * MS), (vec![], Some(150 * MS)));
    assert_eq!(track.next(&running(20), 250 * MS), (vec![Name::Progress, Name::Section], None));
}

#[test]
fn moving_up_in_the_queue_is_told() {
    let mut track = Track::new(250 * MS);
    let behind = Job { queue_position: Some(3), ..job() };
    track.next(&behind, Duration::ZERO);
    assert_eq!(track.next(&job(), MS).0, [Name::Status]);
}

#[test]
fn an_event_holds_the_whole_model_on_one_line() {
    let stream = axum::response::sse::Sse::new(futures_util::stream::iter([
        Ok::<_, std::convert::Infallible>(event(Name::Section, &running(10), "14", None)),
        Ok(deleted(job().id, "15")),
    ]));
    let body = axum::response::IntoResponse::into_response(stream).into_body();
    let text =
        futures_util::FutureExt::now_or_never(http_body_util::BodyExt::collect(body)).unwrap().unwrap().to_bytes();
    let text = String::from_utf8(text.to_vec()).unwrap();
    let lines: Vec<_> = text.lines().collect();
    assert_eq!((lines[0], lines[1]), ("event: section", "id: 14"));
    let data: serde_json::Value = serde_json::from_str(lines[2].strip_prefix("data: ").unwrap()).unwrap();
    assert_eq!((&data["status"], &data["section"]["index"]), (&json!("running"), &json!(1)));
    assert_eq!(lines[3..6], ["", "event: end", "id: 15"]);
}

proptest! {
    /// However a model runs: every change of state is told, progress at most once an interval, and what was held
    /// back comes when asked for again.
    #[test]
    fn thinning_never_loses_the_last_state(steps in prop::collection::vec((0u64..200, 0u32..3), 1..60)) {
        let interval = 250 * MS;
        let mut track = Track::new(interval);
        let (mut now, mut step, mut attempts) = (Duration::ZERO, 0, 1);
        let (mut told_at, mut last): (Vec<Duration>, _) = (vec![], running(0));
        for (gap, what) in steps {
            now += Duration::from_millis(gap);
            match what { 0 => attempts += 1, _ => step += 10 }
            last = Job { attempts, ..running(step) };
            let fresh = track.told.is_none();
            let (names, again) = track.next(&last, now);
            prop_assert!(what != 0 || fresh || names.contains(&Name::Status));
            if names.contains(&Name::Progress) { told_at.push(now); }
            prop_assert!(again.is_none_or(|a| a <= interval));
        }
        prop_assert!(told_at.windows(2).all(|w| w[1] - w[0] >= interval));
        track.next(&last, now + interval);
        prop_assert_eq!(&track.told, &Some(Told::of(&last)));
        prop_assert_eq!(track.next(&last, now + interval * 2), (vec![], None));
        let ended = Job { status: Status::Cancelled, ..last };
        prop_assert_eq!(track.next(&ended, now + interval * 2), (vec![Name::End], None));
    }
}
