//! `oviduct load`: a load test of a service.
//!
//! The open loop sends calls at a rate, without waiting for responses. The closed loop has a number
//! of users who wait for their responses. Errors are counted and do not end a run.

mod calls;
mod closed;
mod direct;
mod errors;
mod known;
mod mix;
mod models;
mod open;
mod plan;
mod record;
mod report;
mod seeds;
mod target;
#[cfg(test)]
mod tests;
mod text;
mod times;

pub use closed::through;
pub use direct::{Grown, Model, direct};
pub use errors::Lost;
pub(super) use mix::Mix;
pub(super) use plan::{Arrivals, Rate};
pub use seeds::Seeds;

use crate::cli::args::LoadArgs;
use crate::cli::exit::{Ended, Failure};
use crate::cli::interrupt::Signals;
use crate::cli::remote::client::{Client, Followed};
use crate::cli::remote::submit;
use crate::cli::service::connections;
use crate::cli::{model, term};
use crate::clock::Stopwatch;
use crate::generate::Backend;
use anyhow::anyhow;
use closed::Users;
use mix::Call;
use models::Models;
use plan::Plan;
use record::{Outcome, Record, Timed};
use report::{Efficiency, Mode, Report, Run};
use std::sync::Arc;
use std::time::Duration;
use target::Target;
use times::Times;
use tokio::task::JoinSet;

/// Length of a run by default.
const LENGTH: Duration = Duration::from_secs(60);
/// Warm-up of an open loop by default.
const WARM_UP: Duration = Duration::from_secs(5);
/// Number of models of a closed loop by default.
const MODELS: u64 = 100;
/// Time for the last events to arrive once all models have ended.
const LAST_EVENTS: Duration = Duration::from_secs(10);
/// Pause of an event stream while there is no model to follow, and after an error.
const STREAM_PAUSE: Duration = Duration::from_millis(100);
/// Descriptors for everything except calls and streams.
const DESCRIPTORS: u64 = 64;

pub(super) async fn run(args: LoadArgs) -> Ended {
    let mut signals = Signals::listen();
    let first = args.model.of.seed.unwrap_or_else(|| crate::random::draw_seed() >> 1);
    let report = if args.direct {
        tokio::select! {
            report = without_service(&args, first) => report?,
            () = signals.asked_to_stop() => return Err(Failure::Interrupted),
        }
    } else {
        through_service(&args, first, &mut signals).await?
    };
    if args.json {
        term::print_json(&report)?;
    } else {
        for line in text::lines(&report) {
            term::print(&line)?;
        }
    }
    match (report.run.interrupted, report.failed()) {
        (true, _) => Err(Failure::Interrupted),
        (false, true) => Err(Failure::Negative),
        (false, false) => Ok(()),
    }
}

/// Values of the options, with defaults that depend on each other.
struct Settings {
    seeds: Seeds,
    warm_up: Duration,
    /// Length after the warm-up; `None` to continue until all seeds are taken.
    length: Option<Duration>,
    /// The calls; `None` for whole models.
    mix: Option<Mix>,
}

impl Settings {
    fn of(args: &LoadArgs, first: u64) -> Result<Self, Failure> {
        let mix = args.mix.clone().or_else(|| args.rate.map(|_| Mix::default()));
        let by_time = mix.is_some() || args.direct || args.models.is_none() && args.duration.is_some();
        let most = (crate::spec::SEED_MAX + 1).saturating_sub(first);
        let models = match args.models {
            Some(models) if models > most => {
                return Err(Failure::usage(format!("--models {models}: there are only {most} seeds from {first} on")));
            }
            Some(models) => models,
            None if by_time && !args.direct => most,
            None => MODELS.min(most),
        };
        let in_flight = if args.rate.is_some() { args.max_in_flight } else { args.concurrency };
        let (needed, limit) =
            (u64::from(in_flight) + u64::from(args.streams) + DESCRIPTORS, connections::descriptors());
        if needed > limit && !args.direct {
            let said =
                format!("{in_flight} calls in flight and {} streams need {needed} file descriptors", args.streams);
            return Err(Failure::usage(format!("{said}, the limit is {limit}: raise it with `ulimit -n`")));
        }
        Ok(Self {
            seeds: Seeds::new(first, models),
            warm_up: args.warm_up.unwrap_or(if args.rate.is_some() { WARM_UP } else { Duration::ZERO }),
            length: args.duration.or(mix.is_some().then_some(LENGTH)),
            mix,
        })
    }
}

/// Puts a service under load until the time is over or a signal arrives.
async fn through_service(args: &LoadArgs, first: u64, signals: &mut Signals) -> Result<Report, Failure> {
    let settings = Settings::of(args, first)?;
    let alone = if args.efficiency { Some(local(args)?) } else { None };
    let body = submit::request(&args.model)?;
    let client = Client::new(&args.service.url, args.service.key.as_ref())?;
    let target = Arc::new(Target::new(client, body, settings.seeds.clone(), settings.warm_up, args.timeout));
    let mut interrupted = tokio::select! {
        driven = drive(args, &settings, first, &target) => {
            driven?;
            false
        }
        () = signals.asked_to_stop() => true,
    };
    // Stops sending and counting.
    target.stop.cancel();
    let numbers = target.record.numbers();
    let seconds = target.length().saturating_sub(settings.warm_up).as_secs_f64();
    let after = async {
        let models = models::read(&target).await;
        let per_second = models.as_ref().map_or(0.0, |models| models.per_second);
        match alone.filter(|_| !interrupted) {
            Some(model) => (models, compare(&model, first, per_second).await.map(Some)),
            None => (models, Ok(None)),
        }
    };
    let (models, efficiency) = tokio::select! {
        found = after => found,
        () = signals.asked_to_stop() => {
            interrupted = true;
            (Err(Failure::Interrupted.into()), Ok(None))
        }
    };
    let mode = match args.rate {
        Some(Rate(rate)) => Mode::Open { rate, arrivals: args.arrivals, max_in_flight: args.max_in_flight },
        None => Mode::Closed { concurrency: args.concurrency },
    };
    let warm_up = settings.warm_up.as_secs_f64();
    let run = Run { mode, seed: first, interrupted, warm_up, seconds, waited: !args.wait.is_zero() };
    let efficiency = efficiency.unwrap_or_else(|failure| {
        term::note(&format!("no efficiency: {}", failure.report().1.join("; ")));
        None
    });
    Ok(Report::of(run, numbers, models, efficiency))
}

/// Makes the calls and waits for the models and streams.
async fn drive(args: &LoadArgs, settings: &Settings, seed: u64, target: &Arc<Target>) -> Ended {
    let mut held = hold_streams(target, args.streams);
    let mut scouts = JoinSet::new();
    if settings.mix.as_ref().is_some_and(|mix| mix.has(Call::Download)) {
        scouts.spawn(models::scout(Arc::clone(target)));
    }
    let until = settings.length.map(|length| settings.warm_up + length);
    match (args.rate, settings.mix.clone(), until) {
        (Some(rate), Some(mix), Some(length)) => {
            let plan = Plan { seed, rate, arrivals: args.arrivals, mix, length };
            open::run(target, plan, args.max_in_flight).await?;
            target.end(length);
        }
        (_, mix, until) => {
            let users = Users {
                count: args.concurrency,
                until,
                patience: args.wait.max(args.timeout),
                mix: mix.map(|mix| (mix, seed)),
            };
            closed::run(target, users).await?;
            target.end(target.watch.elapsed());
        }
    }
    if let Some(faults) = target.invalid.get() {
        return Err(Failure::Usage(faults.clone()));
    }
    drop(scouts);
    // The closed loop has already waited.
    let left =
        args.wait.saturating_sub(until.map_or(Duration::ZERO, |until| target.watch.elapsed().saturating_sub(until)));
    let ended = target.known.is_empty() || tokio::time::timeout(left, models::wait(target)).await.is_ok();
    if ended {
        let told = async { while held.join_next().await.is_some() {} };
        // Streams that miss an end are counted in the report.
        let _ = tokio::time::timeout(LAST_EVENTS, told).await;
    }
    Ok(())
}

/// Opens `count` event streams for the whole run. Each follows a model to its end, then the next
/// one. The tasks end when the run is over and each stream has received the end that it waits for.
/// Dropping the tasks closes the streams.
fn hold_streams(target: &Arc<Target>, count: u32) -> JoinSet<()> {
    target.record.streams(|streams| streams.held = count);
    let mut tasks = JoinSet::new();
    for place in 0..count {
        let target = Arc::clone(target);
        tasks.spawn(async move {
            while !target.over.is_cancelled() {
                // Neighbouring streams follow different models if there are enough models.
                match target.known.open(place as usize) {
                    Some(id) => follow(&target, &id).await,
                    None => tokio::time::sleep(STREAM_PAUSE).await,
                }
            }
        });
    }
    tasks
}

/// Follows a model to its end, over any number of connections.
async fn follow(target: &Target, id: &str) {
    let record = &target.record;
    record.streams(|streams| streams.followed += 1);
    let lost = |followed: Followed<'_>| {
        if matches!(followed, Followed::Disconnected) {
            record.streams(|streams| streams.cut += 1);
        }
    };
    match target.client.follow(id, lost).await {
        Ok(()) => {
            target.known.end(id, None);
            record.streams(|streams| streams.told += 1);
        }
        Err(failure) => {
            record.streams(|streams| streams.errors.add(failure.into()));
            tokio::time::sleep(STREAM_PAUSE).await;
        }
    }
}

/// Returns the model of the options for generation in this process.
fn local(args: &LoadArgs) -> Result<Model, Failure> {
    if args.model.backend == Backend::Gpu {
        return Err(Failure::usage("--backend gpu: models are grown without the service on the CPU alone"));
    }
    let (preset, spec) = model::resolve(&args.model.of)?;
    Ok(Model {
        preset: preset.name.clone(),
        spec: Arc::new(spec),
        backend: args.model.backend,
        outputs: args.model.outputs(),
    })
}

fn cores() -> usize {
    std::thread::available_parallelism().map_or(1, std::num::NonZero::get)
}

/// Grows some of the models again without the service, one on each core, and compares the rates.
async fn compare(model: &Model, first: u64, per_second: f64) -> Result<Efficiency, Failure> {
    let cores = cores() as u32;
    let sample = 4 * u64::from(cores);
    let watch = Stopwatch::start();
    let grown = direct(model, Seeds::new(first, sample), cores, 1).await?;
    let direct_per_second = sample as f64 / watch.seconds();
    for one in grown {
        match one {
            Ok(Grown { succeeded: true, .. }) => {}
            Ok(_) => return Err(anyhow!("a model that was grown without the service failed").into()),
            Err(lost) => {
                return Err(anyhow!("a model could not be grown without the service: {}", lost.message).into());
            }
        }
    }
    Ok(Efficiency { sample, direct_per_second, ratio: per_second / direct_per_second })
}

/// Grows the models in this process.
async fn without_service(args: &LoadArgs, first: u64) -> Result<Report, Failure> {
    let settings = Settings::of(args, first)?;
    let record = Record::new(Duration::ZERO);
    let watch = Stopwatch::start();
    let grown = direct(&local(args)?, settings.seeds, args.concurrency, cores()).await?;
    let seconds = watch.seconds();
    let mut models = Models { models: grown.len() as u64, ..Models::default() };
    models.per_second = grown.iter().filter(|one| one.is_ok()).count() as f64 / seconds;
    for one in grown {
        record.due(Call::Model, Duration::ZERO);
        let mut timed =
            Timed { call: Call::Model, planned: Duration::ZERO, sent: Duration::ZERO, ended: Duration::ZERO };
        let outcome = match one {
            Ok(Grown { seconds, succeeded, bytes }) => {
                timed.ended = Duration::from_secs_f64(seconds);
                models.succeeded += u64::from(succeeded);
                models.bytes += bytes;
                Outcome::Answered(bytes)
            }
            Err(lost) => Outcome::Lost(lost),
        };
        record.ended(timed, outcome);
    }
    models.failed = models.models - models.succeeded;
    let mode = Mode::Direct { concurrency: args.concurrency };
    let run = Run { mode, seed: first, interrupted: false, warm_up: 0.0, seconds, waited: true };
    let numbers = record.numbers();
    models.end_to_end = numbers.calls.get(&Call::Model).map(|tally| Times::of(&tally.latency)).unwrap_or_default();
    Ok(Report::of(run, numbers, Ok(models), None))
}
