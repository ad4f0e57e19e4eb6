//! The models of a batch, page by page.

use crate::http::AppState;
use crate::jobs::{Batch, Job, JobId, StoreError};
use std::collections::BTreeMap;

/// Models read at a time.
const PAGE: u32 = 100;

/// Calls `each` with the place and the record of every model of a batch, in their order. A model that is deleted meanwhile
/// is left out.
pub(super) async fn each_model(
    state: &AppState,
    batch: &Batch,
    mut each: impl FnMut(u32, &Job),
) -> Result<(), StoreError> {
    let places: BTreeMap<JobId, u32> = batch.jobs.iter().copied().zip(batch.places.iter().copied()).collect();
    let mut after = None;
    loop {
        let page = state.store.batch_jobs(batch.id, after, PAGE).await?;
        let Some(last) = page.last() else { return Ok(()) };
        after = Some(last.id);
        for job in &page {
            if let Some(place) = places.get(&job.id) {
                each(*place, job);
            }
        }
    }
}
