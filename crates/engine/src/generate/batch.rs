//! Generates many models at a time. All are simulated together on a GPU; CPU threads build their
//! surfaces.
//!
//! The calling thread drives the device and does nothing else. Results of a member go to its inbox,
//! which one task of the pool at a time processes: it lofts the sections as they arrive, and
//! closes, certifies and writes the model when its simulation has ended. The device waits for a
//! member whose inbox is full. Members share only the device: a member that fails, panics or is
//! cancelled does not affect the others.

use super::grow::GrownSections;
use super::pace::ProgressMeter;
use super::types::{CancelToken, GenerateError, Outcome, Request, Sink, UsedBackend};
use super::walls::Walls;
use super::{RunInfo, check, finish};
use crate::clock::Stopwatch;
use crate::lock::Mutex;
use crate::model::Section;
use crate::sim::gpu::{BatchSink, Checkpoint, GpuDevice, GpuError, replay, run_batch};
use crate::sim::{Plan, SimError, Statistics};
use rayon::ThreadPool;
use std::any::Any;
use std::borrow::Cow;
use std::collections::VecDeque;
use std::ops::Range;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Condvar;
use std::sync::atomic::{AtomicBool, Ordering};

/// Maximum number of sections of a member that wait for the loft. With more, the device waits.
const INBOX: usize = 8;

/// One model of a batch.
#[derive(Clone, Copy)]
pub struct Member<'a> {
    /// Model to generate; the `backend` is ignored.
    pub request: &'a Request,
    /// Plan of the simulation, if the caller has one.
    pub plan: Option<&'a Plan>,
    /// Receiver of the progress. Called from several threads, one at a time.
    pub sink: &'a dyn Sink,
    /// Cancels only this member.
    pub cancel: &'a CancelToken,
}

/// Callbacks of a batch.
#[derive(Clone, Copy)]
pub struct Calls<'a> {
    /// Called once, on the thread of the caller, when the device is free for another batch. Slabs
    /// of this batch may still be simulated again.
    pub simulated: &'a dyn Fn(),
    /// Called once for each member, with its index, when the member has ended.
    pub ended: &'a (dyn Fn(usize, Result<Outcome, GenerateError>) + Sync),
}

/// A device that runs many simulations at a time.
pub(super) trait Device: Sync {
    /// State of a simulation at a recorded section, from which the following slab can be replayed.
    type Mark: Send;

    /// Description of the device.
    fn name(&self) -> String;
    /// Runs `plans` to their ends. Calls `sink` on this thread.
    fn run(&self, plans: &[Plan], sink: &mut dyn BatchSink<Self::Mark>) -> Result<(), GpuError>;
    /// Sections of every step after `mark`, up to and including the next recorded one.
    fn replay(&self, plan: &Plan, mark: &Self::Mark) -> Result<Vec<Section>, GpuError>;
}

impl Device for GpuDevice {
    type Mark = Checkpoint;

    fn name(&self) -> String {
        GpuDevice::name(self).to_owned()
    }

    fn run(&self, plans: &[Plan], sink: &mut dyn BatchSink) -> Result<(), GpuError> {
        run_batch(self, plans, sink).map(drop)
    }

    fn replay(&self, plan: &Plan, mark: &Checkpoint) -> Result<Vec<Section>, GpuError> {
        replay(self, plan, mark)
    }
}

/// Grows, certifies and writes `members`, simulated together on `device`. Returns when all members
/// have ended.
///
/// A batch that does not fit into the memory of the device is halved, and the halves are simulated
/// one after the other.
///
/// The calling thread drives the device and must not belong to `pool`, whose threads loft, certify
/// and write; `None` is the global pool. Members that the device could not simulate or did not
/// finish end with [`GenerateError::Gpu`]. They can be grown on the CPU from the beginning, in the
/// same directories.
pub fn generate_batch(device: &GpuDevice, pool: Option<&ThreadPool>, members: &[Member<'_>], calls: Calls<'_>) {
    on(device, pool, members, calls);
}

fn on<D: Device>(device: &D, pool: Option<&ThreadPool>, members: &[Member<'_>], calls: Calls<'_>) {
    let (mut growing, mut plans) = (Vec::new(), Vec::new());
    for (index, member) in members.iter().enumerate() {
        match check(member.request) {
            Ok(()) => {
                let Request { spec, seed, .. } = member.request;
                plans.push(member.plan.cloned().unwrap_or_else(|| Plan::new(spec, *seed)));
                growing.push(Growing::new(index, growing.len(), member));
            }
            Err(error) => (calls.ended)(index, Err(error)),
        }
    }
    let batch = Batch { device, growing, plans, ended: calls.ended, total: Stopwatch::start() };
    match pool {
        Some(pool) => pool.in_place_scope(|scope| batch.simulate(scope, calls.simulated)),
        None => rayon::in_place_scope(|scope| batch.simulate(scope, calls.simulated)),
    }
}

/// Result of the simulation of a member.
enum Item<M> {
    Section(Section, M),
    /// The last step is done. Contains the seconds since the simulation began.
    Simulated(Statistics, f64),
    Broken(GenerateError),
}

/// Unfinished surface; `None` before the first section.
type Loft<M> = Option<Lofting<M>>;

struct Lofting<M> {
    walls: Walls,
    /// State at the last section of the surface.
    mark: M,
}

struct Inbox<M> {
    items: VecDeque<Item<M>>,
    /// True if a task processes the inbox, or is scheduled to.
    scheduled: bool,
}

struct Growing<'a, M> {
    /// Index among the members of the caller.
    index: usize,
    /// Index among the members that the device runs.
    slot: usize,
    member: Member<'a>,
    /// Step of the first section of the model. The device also reports earlier sections.
    first: u32,
    pace: Mutex<ProgressMeter<'a>>,
    inbox: Mutex<Inbox<M>>,
    /// Notified when an item is taken from the inbox.
    taken: Condvar,
    /// `None` once the member has ended.
    loft: Mutex<Option<Loft<M>>>,
    /// True if the device has reported the end of the simulation.
    simulated: AtomicBool,
    ended: AtomicBool,
}

impl<'a, M> Growing<'a, M> {
    fn new(index: usize, slot: usize, member: &Member<'a>) -> Self {
        Self {
            index,
            slot,
            member: *member,
            first: *member.request.spec.recorded().start(),
            pace: Mutex::new(ProgressMeter::new(member.request, member.sink)),
            inbox: Mutex::new(Inbox { items: VecDeque::new(), scheduled: false }),
            taken: Condvar::new(),
            loft: Mutex::new(Some(None)),
            simulated: AtomicBool::new(false),
            ended: AtomicBool::new(false),
        }
    }
}

struct Batch<'a, D: Device> {
    device: &'a D,
    growing: Vec<Growing<'a, D::Mark>>,
    plans: Vec<Plan>,
    ended: &'a (dyn Fn(usize, Result<Outcome, GenerateError>) + Sync),
    total: Stopwatch,
}

impl<'a, D: Device> Batch<'a, D> {
    /// Runs all simulations and posts their results, then calls `simulated`.
    fn simulate<'s>(&'s self, scope: &rayon::Scope<'s>, simulated: &dyn Fn()) {
        // Stack of groups of members that are simulated together; the first group to run is last.
        let mut groups: Vec<Range<usize>> = Vec::from_iter((!self.growing.is_empty()).then_some(0..self.growing.len()));
        while let Some(group) = groups.pop() {
            let mut feed = Feed { batch: self, scope, first: group.start, begun: Stopwatch::start(), reported: false };
            let result = self.device.run(&self.plans[group.clone()], &mut feed);
            if matches!(result, Err(GpuError::OutOfMemory)) && group.len() > 1 && !feed.reported {
                tracing::warn!(members = group.len(), "the device has no memory for the batch, which is halved");
                let middle = group.start + group.len().div_ceil(2);
                groups.extend([middle..group.end, group.start..middle]);
                continue;
            }
            for member in &self.growing[group] {
                if !member.simulated.load(Ordering::Relaxed) {
                    let why = match &result {
                        Err(error) => GenerateError::Gpu(error.clone()),
                        // A working device omits only cancelled members.
                        Ok(()) => GenerateError::Cancelled,
                    };
                    // The remaining sections belong to a member that will not be finished.
                    member.inbox.lock().items.clear();
                    self.post(scope, member, Item::Broken(why));
                }
            }
        }
        simulated();
    }

    /// Puts an item into the inbox of a member, and schedules a task for it if there is none.
    fn post<'s>(&'s self, scope: &rayon::Scope<'s>, member: &'s Growing<'a, D::Mark>, item: Item<D::Mark>) {
        let mut inbox = member.inbox.lock();
        inbox.items.push_back(item);
        if !inbox.scheduled {
            inbox.scheduled = true;
            scope.spawn(move |_| self.process(member));
        }
    }

    fn process(&self, member: &Growing<'a, D::Mark>) {
        loop {
            let item = {
                let mut inbox = member.inbox.lock();
                let Some(item) = inbox.items.pop_front() else {
                    inbox.scheduled = false;
                    return;
                };
                item
            };
            member.taken.notify_one();
            let mut place = member.loft.lock();
            let Some(mut loft) = place.take() else { continue };
            match catch_unwind(AssertUnwindSafe(|| self.handle(member, &mut loft, item))) {
                Ok(Ok(None)) => *place = Some(loft),
                Ok(Ok(Some(outcome))) => self.end(member, Ok(outcome)),
                Ok(Err(error)) => self.end(member, Err(error)),
                Err(panic) => self.end(member, Err(GenerateError::Panic { detail: message(panic.as_ref()) })),
            }
        }
    }

    fn end(&self, member: &Growing<'a, D::Mark>, result: Result<Outcome, GenerateError>) {
        member.ended.store(true, Ordering::Relaxed);
        (self.ended)(member.index, result);
    }

    /// Processes an item. Returns the model when it is finished.
    fn handle(
        &self,
        member: &Growing<'a, D::Mark>,
        loft: &mut Loft<D::Mark>,
        item: Item<D::Mark>,
    ) -> Result<Option<Outcome>, GenerateError> {
        let Member { request, cancel, .. } = member.member;
        if cancel.is_cancelled() {
            return Err(GenerateError::Cancelled);
        }
        match item {
            Item::Broken(error) => Err(error),
            Item::Section(section, mark) => {
                if let Some(loft) = loft {
                    let steps = || Ok(Cow::Owned(self.device.replay(&self.plans[member.slot], &loft.mark)?));
                    loft.walls.extend(&section, steps)?;
                    loft.mark = mark;
                    if !loft.walls.shows(section.step as u32) {
                        return Ok(None);
                    }
                } else if section.step as u32 == member.first {
                    *loft = Some(Lofting { walls: Walls::new(request, &section)?, mark });
                } else {
                    // The section lies before the piece.
                    return Ok(None);
                }
                member.pace.lock().section(&section);
                Ok(None)
            }
            Item::Simulated(statistics, seconds) => {
                tracing::debug!(seed = request.seed, ?statistics, "the device has done the steps of a member");
                let none = || GenerateError::Simulation { detail: "the device recorded no section".to_owned() };
                let walls = loft.take().ok_or_else(none)?.walls;
                let ran = RunInfo { used: UsedBackend::Gpu, device: self.device.name(), total: self.total };
                finish(request, GrownSections { walls, statistics, seconds }, ran, &member.pace, cancel).map(Some)
            }
        }
    }
}

/// Sink of a group of members: forwards the results to their inboxes.
struct Feed<'s, 'scope, 'a, D: Device> {
    batch: &'scope Batch<'a, D>,
    scope: &'s rayon::Scope<'scope>,
    /// Index of the first member of the group.
    first: usize,
    begun: Stopwatch,
    /// True if the device has reported anything.
    reported: bool,
}

impl<'scope, 'a, D: Device> Feed<'_, 'scope, 'a, D> {
    fn member(&self, place: usize) -> &'scope Growing<'a, D::Mark> {
        &self.batch.growing[self.first + place]
    }

    fn forward(&mut self, place: usize, item: Item<D::Mark>) {
        self.reported = true;
        self.batch.post(self.scope, self.member(place), item);
    }
}

impl<D: Device> BatchSink<D::Mark> for Feed<'_, '_, '_, D> {
    fn section(&mut self, member: usize, section: Section, mark: D::Mark) {
        self.forward(member, Item::Section(section, mark));
        let member = self.member(member);
        // Waits for the loft if it is behind.
        drop(member.taken.wait_while(member.inbox.lock(), |inbox| inbox.items.len() > INBOX));
    }

    fn progress(&mut self, member: usize, step: i64, particles: u32) {
        let member = self.member(member);
        if !member.ended.load(Ordering::Relaxed) {
            member.pace.lock().step(step, particles);
        }
    }

    fn cancelled(&mut self, member: usize) -> bool {
        let member = self.member(member);
        member.ended.load(Ordering::Relaxed) || member.member.cancel.is_cancelled()
    }

    fn failed(&mut self, member: usize, error: SimError) {
        self.member(member).simulated.store(true, Ordering::Relaxed);
        self.forward(member, Item::Broken(error.into()));
    }

    fn finished(&mut self, member: usize, statistics: Statistics) {
        self.member(member).simulated.store(true, Ordering::Relaxed);
        let seconds = self.begun.seconds();
        self.forward(member, Item::Simulated(statistics, seconds));
    }
}

/// Message of a panic.
fn message(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().map(|text| (*text).to_owned());
    text.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_else(|| "a panic without a message".to_owned())
}

#[cfg(test)]
mod tests;
