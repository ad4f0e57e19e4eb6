//! Target of the fuzzers: the body of `POST /batches`, with the study that it may have.

use super::request::{BatchRequest, Seeds};
use crate::http::fuzzing::{document, members, resolved};
use crate::http::wire::faults::Faults;
use serde_json::json;

/// Models of a batch, as by default.
const BATCH_MAX: usize = 1000;

/// What is accepted is accepted again as it was understood; a study has as many points as its design says, and its patches
/// are those of its values.
pub fn batch(bytes: &[u8]) {
    let Some(body) = document(bytes) else { return };
    let mut faults = Faults::default();
    let batch = BatchRequest::read(&body, BATCH_MAX, &mut faults);
    if resolved(&batch.each, faults).is_none() {
        return;
    }
    let mut again = members(&batch.each);
    match &batch.seeds {
        Seeds::These(seeds) => again["seeds"] = json!(seeds),
        Seeds::Count(count) => again["count"] = json!(count),
    }
    if let Some(study) = &batch.study {
        assert!((1..=BATCH_MAX).contains(&(study.points() * batch.seeds.len())));
        for point in 0..study.points() {
            let patch = study.patch(point);
            for (pointer, value) in study.pointers().iter().zip(study.values(point)) {
                assert_eq!(patch.pointer(pointer), Some(value), "{pointer} of point {point}");
            }
        }
        again["vary"] = body["vary"].clone();
    }
    let mut faults = Faults::default();
    assert_eq!(BatchRequest::read(&again, BATCH_MAX, &mut faults), batch);
    assert_eq!(faults, Faults::default());
}
