//! What workers run in earnest: the stored spec, resolved again, to files.

use super::generator::{BatchEnds, BatchGenerator, BatchWork, Work, WorkError};
use crate::generate::{
    CancelToken, Checkpoint, GenerateError, Member, Outcome, Request, Sink, generate, generate_batch, resume,
};
use crate::jobs::Job;
use crate::sim::Plan;
use crate::sim::gpu::{Adapter, GpuDevice, GpuError, GpuOptions, adapters};
use crate::spec::{self, ModelSpec};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// By how much the particles of the members of a batch may differ: all wait for the largest.
const ALIKE: f64 = 1.25;

/// The CPU's generator.
///
/// # Errors
/// [`WorkError`].
pub fn generate_on_cpu(work: Work<'_>, sink: &dyn Sink, cancel: &CancelToken) -> Result<Outcome, WorkError> {
    let request = request(work)?;
    Ok(match work.checkpoint.map(|bytes| Checkpoint::read(&request, bytes)) {
        Some(Ok(checkpoint)) => {
            tracing::info!(job = %work.job.id, "the model goes on from a checkpoint");
            resume(&request, checkpoint, sink, cancel)?
        }
        Some(Err(error)) => {
            tracing::warn!(job = %work.job.id, %error, "the model is grown anew");
            generate(&request, sink, cancel)?
        }
        None => generate(&request, sink, cancel)?,
    })
}

fn resolve(job: &Job) -> Result<ModelSpec, WorkError> {
    // A canonical spec names every parameter, so it means the same on whichever preset it is laid.
    let preset = spec::preset(&job.preset).unwrap_or(&spec::presets()[0]);
    ModelSpec::resolve(preset, &job.spec).map_err(|faults| {
        let faults: Vec<String> = faults.iter().map(ToString::to_string).collect();
        WorkError::Spec { detail: faults.join("; ") }
    })
}

fn request(work: Work<'_>) -> Result<Request, WorkError> {
    let job = work.job;
    Ok(Request {
        preset: job.preset.clone(),
        spec: resolve(job)?,
        seed: job.seed,
        backend: work.backend,
        outputs: job.outputs.clone(),
        dir: work.dir.to_owned(),
        memory_limit_bytes: work.memory_limit_bytes,
    })
}

/// The generator of one GPU. Opens its device when it is first needed, and anew where it was lost.
#[derive(Debug)]
pub struct GpuGenerator {
    name: String,
    /// Which one it is of the adapters of this name.
    ordinal: usize,
    options: GpuOptions,
    device: Mutex<Option<GpuDevice>>,
}

impl GpuGenerator {
    /// A generator for each adapter that `options` allow, best first.
    ///
    /// # Errors
    /// [`GpuError`] where there is none.
    pub fn all(options: GpuOptions) -> Result<Vec<Self>, GpuError> {
        let found = adapters(&options)?;
        let of = |(place, adapter): (usize, &Adapter)| Self {
            name: adapter.name.clone(),
            ordinal: found[..place].iter().filter(|other| other.name == adapter.name).count(),
            options,
            device: Mutex::new(None),
        };
        Ok(found.iter().enumerate().map(of).collect())
    }

    /// The open device.
    ///
    /// # Errors
    /// [`GpuError`] where it cannot be opened.
    pub fn device(&self) -> Result<GpuDevice, GpuError> {
        let mut place = self.place();
        if let Some(device) = place.as_ref().filter(|device| !device.is_lost()) {
            return Ok(device.clone());
        }
        // What was lost is given back before a new one is asked for.
        *place = None;
        let found = adapters(&self.options)?;
        let mut same = found.iter().filter(|adapter| adapter.name == self.name);
        let gone = || GpuError::NotOpened { adapter: self.name.clone(), detail: "it is no longer there".to_owned() };
        let device = GpuDevice::open(same.nth(self.ordinal).ok_or_else(gone)?, &self.options)?;
        Ok(place.insert(device).clone())
    }

    /// Gives up the device as if it had been lost, in the middle of whatever it does: for tests of the fall-back.
    pub fn lose(&self) {
        if let Some(device) = self.place().as_ref() {
            device.lose();
        }
    }

    fn place(&self) -> MutexGuard<'_, Option<GpuDevice>> {
        self.device.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Whether two simulations are of like size: in step with each other, and neither waits long for the other.
fn alike(a: &Plan, b: &Plan) -> bool {
    let particles = |plan: &Plan| f64::from(plan.at(i64::from(plan.steps)).inner_target.max(plan.start[0]).max(1));
    let ratio = particles(a) / particles(b);
    (a.steps, a.burn_in, a.grow_every, a.record_every) == (b.steps, b.burn_in, b.grow_every, b.record_every)
        && a.integrator == b.integrator
        && ratio.max(1.0 / ratio) <= ALIKE
}

impl BatchGenerator for GpuGenerator {
    fn device(&self) -> String {
        self.name.clone()
    }

    fn open(&self) -> Result<(), String> {
        Self::device(self).map(drop).map_err(|error| error.to_string())
    }

    fn admit(&self, jobs: &[&Job]) -> Result<Vec<bool>, String> {
        let device = Self::device(self).map_err(|error| error.to_string())?;
        let plan = |job: &Job| resolve(job).map(|spec| Plan::new(&spec, job.seed)).ok();
        let mut admitted = vec![false; jobs.len()];
        admitted[0] = true;
        let Some(first) = plan(jobs[0]) else {
            // It will fail, and say why.
            return Ok(admitted);
        };
        device.fits(&[&first]).map_err(|error| error.to_string())?;
        let mut plans = vec![first];
        for (job, admitted) in jobs.iter().zip(&mut admitted).skip(1) {
            let Some(plan) = plan(job).filter(|plan| alike(&plans[0], plan)) else { continue };
            plans.push(plan);
            let together: Vec<&Plan> = plans.iter().collect();
            *admitted = device.fits(&together).is_ok();
            if !*admitted {
                plans.pop();
            }
        }
        Ok(admitted)
    }

    fn generate(&self, members: &[BatchWork<'_>], ended: BatchEnds<'_>) {
        let mut places = Vec::with_capacity(members.len());
        let mut requests = Vec::with_capacity(members.len());
        for (place, member) in members.iter().enumerate() {
            match request(member.work) {
                Ok(request) => {
                    places.push(place);
                    requests.push(request);
                }
                Err(error) => ended(place, Err(error)),
            }
        }
        match Self::device(self) {
            Ok(device) => {
                let member = |(request, &place): (_, &usize)| Member {
                    request,
                    sink: members[place].sink,
                    cancel: members[place].cancel,
                };
                let batch: Vec<Member<'_>> = requests.iter().zip(&places).map(member).collect();
                generate_batch(&device, &batch, &|index, result| ended(places[index], result.map_err(WorkError::from)));
            }
            Err(error) => {
                for &place in &places {
                    ended(place, Err(GenerateError::Gpu(error.clone()).into()));
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::spec::preset;
    use serde_json::{Value, json};

    #[test]
    fn likeness() {
        let plan = |patch: &Value, seed| Plan::new(&ModelSpec::resolve(preset("paper").unwrap(), patch).unwrap(), seed);
        let paper = plan(&json!({}), 1);
        assert!(alike(&paper, &plan(&json!({ "friction": 0.31 }), 2)));
        for other in [
            json!({ "steps": 1000 }),
            json!({ "burn_in": 10 }),
            json!({ "solver": { "integrator": "euler" } }),
            json!({ "particles": { "total": { "keys": [[0, 710], [1, 4000]] } } }),
        ] {
            assert!(!alike(&paper, &plan(&other, 1)), "{other}");
        }
    }
}
