//! The closed loop: a number of users, each of whom makes the next request when the previous one
//! has ended.

use super::calls;
use super::errors::Lost;
use super::mix::{Call, Mix};
use super::plan::{self, Planned};
use super::record::{Outcome, Timed};
use super::seeds::Seeds;
use super::target::Target;
use crate::cli::exit::Failure;
use crate::cli::remote::client::Client;
use crate::cli::remote::submit;
use anyhow::{Context, anyhow};
use serde_json::Value;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;
use tokio::task::JoinSet;

/// Pause of a user after an error, so that a service that is down does not get thousands of
/// requests per second.
const PAUSE: Duration = Duration::from_millis(200);

/// Users of a closed loop.
#[derive(Clone, Debug)]
pub(super) struct Users {
    pub(super) count: u32,
    /// Time of the run at which the users begin nothing more; `None` to continue until all seeds
    /// are taken.
    pub(super) until: Option<Duration>,
    /// Time after `until` for calls and models in flight. Later ones are not in the latencies: a
    /// full queue or paused workers could hold them forever.
    pub(super) patience: Duration,
    /// Calls of the users with the seed of the draws; `None` for whole models.
    pub(super) mix: Option<(Mix, u64)>,
}

/// Runs the users and returns the number of whole models that succeeded.
///
/// # Errors
/// If a task panics.
pub(super) async fn run(target: &Arc<Target>, users: Users) -> Result<u64, Failure> {
    let (mut tasks, calls) = (JoinSet::new(), Arc::new(AtomicU64::new(0)));
    for _ in 0..users.count {
        let (target, users, calls) = (Arc::clone(target), users.clone(), Arc::clone(&calls));
        let most = users.until.map(|until| (until + users.patience).saturating_sub(target.watch.elapsed()));
        let work = async move {
            let mut succeeded = 0;
            while !target.stop.is_cancelled() && users.until.is_none_or(|until| target.watch.elapsed() < until) {
                let went_well = match &users.mix {
                    Some((mix, seed)) => mixed(&target, mix, *seed, calls.fetch_add(1, Ordering::Relaxed)).await,
                    None => match target.seeds.take() {
                        Some(seed) => match whole(&target, seed).await {
                            Some(model_succeeded) => {
                                succeeded += u64::from(model_succeeded);
                                true
                            }
                            None => false,
                        },
                        None => return succeeded,
                    },
                };
                if !went_well {
                    tokio::time::sleep(PAUSE).await;
                }
            }
            succeeded
        };
        tasks.spawn(async move {
            match most {
                Some(most) => tokio::time::timeout(most, work).await.unwrap_or_default(),
                None => work.await,
            }
        });
    }
    let mut succeeded = 0;
    while let Some(done) = tasks.join_next().await {
        succeeded += done.context("a task panicked")?;
    }
    Ok(succeeded)
}

/// Makes the call of a mix with this index. Returns true if the response was valid.
async fn mixed(target: &Target, mix: &Mix, seed: u64, index: u64) -> bool {
    let [_, call, word] = plan::words(seed, index);
    let planned = Planned { at: target.watch.elapsed(), call: mix.call(call), word };
    target.record.due(planned.call, planned.at);
    calls::make(target, planned).await
}

/// Requests a model and waits for its end. Returns whether it succeeded; `None` after an error.
async fn whole(target: &Target, seed: u64) -> Option<bool> {
    let began = target.watch.elapsed();
    let timed = |call| Timed { call, planned: began, sent: began, ended: target.watch.elapsed() };
    target.record.due(Call::Submit, began);
    let id = match accepted(target, seed, began).await {
        Ok((id, bytes)) => {
            target.record.ended(timed(Call::Submit), Outcome::Answered(bytes));
            id
        }
        Err(lost) => {
            target.record.ended(timed(Call::Submit), Outcome::Lost(lost));
            return None;
        }
    };
    target.record.due(Call::Model, began);
    let ended = match target.client.wait_for(&id).await {
        Ok(ended) => submit::read(&ended),
        Err(failure) => Err(failure),
    };
    match ended {
        Ok(model) => {
            target.record.ended(timed(Call::Model), Outcome::Answered(0));
            target.known.end(&id, calls::largest(&model));
            Some(model.status == "succeeded")
        }
        Err(failure) => {
            target.record.ended(timed(Call::Model), Outcome::Lost(failure.into()));
            None
        }
    }
}

/// Requests a model, and retries while the queue is full. Returns its id and the length of the
/// response.
async fn accepted(target: &Target, seed: u64, began: Duration) -> Result<(String, u64), Lost> {
    let key = uuid::Uuid::now_v7().to_string();
    match target.client.submit_patiently(&target.body(seed), &key).await {
        Ok((accepted, refused)) => {
            target.record.repeated(Call::Submit, began, refused);
            let id = submit::read(&accepted)?.id;
            target.known.accept(&id, target.record.counts(began));
            Ok((id, accepted.to_string().len() as u64))
        }
        Err(failure) => {
            if let (Failure::Usage(faults), true) = (&failure, target.known.is_empty()) {
                target.refuse(faults.clone());
            }
            Err(failure.into())
        }
    }
}

/// Requests the models of these seeds from a service, `concurrency` at a time, and waits until all
/// have succeeded.
///
/// # Errors
/// If a model does not succeed, or a task panics.
pub async fn through(client: &Client, body: &Value, seeds: Seeds, concurrency: u32) -> Result<(), Failure> {
    let count = seeds.left();
    // Whole models do not use the limit of single calls.
    let target = Arc::new(Target::new(client.clone(), body.clone(), seeds, Duration::ZERO, Duration::MAX));
    let succeeded =
        run(&target, Users { count: concurrency, until: None, patience: Duration::ZERO, mix: None }).await?;
    if succeeded == count {
        return Ok(());
    }
    let errors = target.record.numbers().errors();
    let example = errors.examples().next().unwrap_or("the others failed");
    Err(anyhow!("{succeeded} of {count} models succeeded: {example}").into())
}
