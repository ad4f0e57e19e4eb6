//! Many models at a time: one simulation of all of them on a GPU, and their surfaces on the threads of the CPU.
//!
//! The calling thread drives the device. What the device yields for a member goes to the member's inbox, which one task
//! of the pool at a time works off: it lofts the sections as they come, and closes, proves and writes the model once its
//! simulation has ended. Members share nothing but the device: one that fails, panics or is cancelled leaves the others
//! as they are.

use super::device::{Device, Told};
use super::grow::{Grown, lofter, unsound};
use super::pace::Pace;
use super::types::{Backend, CancelToken, GenerateError, Outcome, Request, Sink};
use super::{Ran, check_memory, finish};
use crate::clock::Stopwatch;
use crate::model::Section;
use crate::sim::gpu::{GpuDevice, GpuError};
use crate::sim::{Plan, SimError, Statistics};
use std::any::Any;
use std::collections::VecDeque;
use std::ops::Range;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Sections waiting for the loft beyond which the device is slowed down.
const BACKLOG: usize = 64;
/// How long a section waits at most where the loft is behind. Never for good: the loft may need this very thread.
const BACKLOG_WAIT: Duration = Duration::from_millis(50);

/// One model of a batch.
#[derive(Clone, Copy)]
pub struct Member<'a> {
    /// What to generate; its `backend` is not looked at.
    pub request: &'a Request,
    /// Where its progress goes: called from several threads, one at a time.
    pub sink: &'a dyn Sink,
    /// Asks this member alone to stop.
    pub cancel: &'a CancelToken,
}

/// Grows, proves and writes `members`, simulated together on `device`. Calls `ended` once for each, as soon as it has
/// ended, with its place in `members`; comes back when all have.
///
/// What does not get its memory on the device is halved, and the halves are simulated one after the other.
///
/// Takes up one thread of the rayon pool that it is called in, to drive the device; the others loft, prove and write.
/// [`GenerateError::Gpu`] comes to members that the device could not do or did not finish: they may be grown on
/// the CPU from their beginning, in the same folders.
pub fn generate_batch(
    device: &GpuDevice,
    members: &[Member<'_>],
    ended: &(dyn Fn(usize, Result<Outcome, GenerateError>) + Sync),
) {
    on(device, members, ended);
}

fn on<D: Device>(device: &D, members: &[Member<'_>], ended: &(dyn Fn(usize, Result<Outcome, GenerateError>) + Sync)) {
    let (mut growing, mut plans) = (Vec::new(), Vec::new());
    for (index, member) in members.iter().enumerate() {
        match check_memory(member.request) {
            Ok(()) => {
                plans.push(Plan::new(&member.request.spec, member.request.seed));
                growing.push(Growing::new(index, growing.len(), member));
            }
            Err(error) => ended(index, Err(error)),
        }
    }
    if growing.is_empty() {
        return;
    }
    let batch = Batch {
        device,
        growing,
        plans,
        ended,
        backlog: Mutex::new(0),
        shorter: Condvar::new(),
        total: Stopwatch::start(),
    };
    // Members that are simulated together; those to be run first come last.
    let mut groups: Vec<Range<usize>> = std::iter::once(0..batch.growing.len()).collect();
    rayon::in_place_scope(|scope| {
        while let Some(group) = groups.pop() {
            let mut feed = Feed { batch: &batch, scope, first: group.start, begun: Stopwatch::start(), told: false };
            let result = device.run(&batch.plans[group.clone()], &mut feed);
            if matches!(result, Err(GpuError::OutOfMemory)) && group.len() > 1 && !feed.told {
                tracing::warn!(members = group.len(), "the device has no memory for the batch, which is halved");
                let middle = group.start + group.len().div_ceil(2);
                groups.extend([middle..group.end, group.start..middle]);
                continue;
            }
            for member in &batch.growing[group] {
                if !member.simulated.load(Ordering::Relaxed) {
                    let why = match &result {
                        Err(error) => GenerateError::Gpu(error.clone()),
                        // A device that is well leaves out only what was asked to stop.
                        Ok(()) => GenerateError::Cancelled,
                    };
                    batch.drop_sections(member);
                    batch.post(scope, member, Item::Broken(why));
                }
            }
        }
    });
}

/// What is told of a member.
enum Item<M> {
    Section(Section, M),
    /// Its last step is done; with the seconds since the device began with it.
    Simulated(Statistics, f64),
    Broken(GenerateError),
}

/// A surface on its way; `None` before the first section.
type Loft<M> = Option<Lofting<M>>;

struct Lofting<M> {
    grown: Grown,
    /// The state at the last section of it.
    mark: M,
}

impl<M> Lofting<M> {
    fn new(request: &Request, section: Section, mark: M) -> Result<Self, GenerateError> {
        let sections = vec![section.clone()];
        let lofter = lofter(request, section)?;
        let grown = Grown { lofter, sections, flipped: 0, statistics: Statistics::default(), loft_seconds: 0.0 };
        Ok(Self { grown, mark })
    }
}

struct Inbox<M> {
    items: VecDeque<Item<M>>,
    /// Whether a task works it off, or will.
    scheduled: bool,
}

struct Growing<'a, M> {
    /// Place among the members that the caller gave.
    index: usize,
    /// Place among those that the device runs.
    slot: usize,
    member: Member<'a>,
    pace: Mutex<Pace<'a>>,
    inbox: Mutex<Inbox<M>>,
    /// `None` once the member has ended.
    loft: Mutex<Option<Loft<M>>>,
    /// Whether the device has nothing more to tell of it.
    simulated: AtomicBool,
    ended: AtomicBool,
}

impl<'a, M> Growing<'a, M> {
    fn new(index: usize, slot: usize, member: &Member<'a>) -> Self {
        Self {
            index,
            slot,
            member: *member,
            pace: Mutex::new(Pace::new(&member.request.spec, member.sink)),
            inbox: Mutex::new(Inbox { items: VecDeque::new(), scheduled: false }),
            loft: Mutex::new(Some(None)),
            simulated: AtomicBool::new(false),
            ended: AtomicBool::new(false),
        }
    }
}

/// A panic of one member is caught before it can leave anything half changed that another one reads.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

struct Batch<'a, D: Device> {
    device: &'a D,
    growing: Vec<Growing<'a, D::Mark>>,
    plans: Vec<Plan>,
    ended: &'a (dyn Fn(usize, Result<Outcome, GenerateError>) + Sync),
    /// Items in all inboxes.
    backlog: Mutex<usize>,
    shorter: Condvar,
    total: Stopwatch,
}

impl<'a, D: Device> Batch<'a, D> {
    /// Puts an item into a member's inbox, and a task on it where there is none.
    fn post<'s>(&'s self, scope: &rayon::Scope<'s>, member: &'s Growing<'a, D::Mark>, item: Item<D::Mark>) {
        *lock(&self.backlog) += 1;
        let mut inbox = lock(&member.inbox);
        inbox.items.push_back(item);
        if !inbox.scheduled {
            inbox.scheduled = true;
            scope.spawn(move |_| self.work_off(member));
        }
    }

    /// Forgets what waits for the loft of a member that will not be finished.
    fn drop_sections(&self, member: &Growing<'a, D::Mark>) {
        let mut inbox = lock(&member.inbox);
        *lock(&self.backlog) -= inbox.items.len();
        inbox.items.clear();
    }

    fn work_off(&self, member: &Growing<'a, D::Mark>) {
        loop {
            let item = {
                let mut inbox = lock(&member.inbox);
                let Some(item) = inbox.items.pop_front() else {
                    inbox.scheduled = false;
                    return;
                };
                item
            };
            *lock(&self.backlog) -= 1;
            self.shorter.notify_all();
            let mut place = lock(&member.loft);
            let Some(mut loft) = place.take() else { continue };
            match catch_unwind(AssertUnwindSafe(|| self.handle(member, &mut loft, item))) {
                Ok(Ok(None)) => *place = Some(loft),
                Ok(Ok(Some(outcome))) => self.end(member, Ok(outcome)),
                Ok(Err(error)) => self.end(member, Err(error)),
                Err(panic) => self.end(member, Err(GenerateError::Panic { detail: message(panic.as_ref()) })),
            }
        }
    }

    /// Gives the loft time where it is behind.
    fn keep_pace(&self) {
        if rayon::current_num_threads() == 1 {
            // The only thread of its pool: nobody else works the inboxes off. Elsewhere there is nothing to do here.
            while rayon::yield_now() == Some(rayon::Yield::Executed) {}
        }
        let backlog = lock(&self.backlog);
        if *backlog > BACKLOG {
            // Whether the time ran out does not matter.
            drop(self.shorter.wait_timeout_while(backlog, BACKLOG_WAIT, |items| *items > BACKLOG));
        }
    }

    fn end(&self, member: &Growing<'a, D::Mark>, result: Result<Outcome, GenerateError>) {
        member.ended.store(true, Ordering::Relaxed);
        (self.ended)(member.index, result);
    }

    /// Does what an item asks for; gives the model once it is made.
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
                match loft {
                    Some(loft) => {
                        self.advance(member, loft, &section)?;
                        loft.mark = mark;
                    }
                    None => *loft = Some(Lofting::new(member.member.request, section.clone(), mark)?),
                }
                lock(&member.pace).section(&section);
                Ok(None)
            }
            Item::Simulated(statistics, simulate) => {
                tracing::debug!(seed = request.seed, ?statistics, "the device has done the steps of a member");
                let none = || GenerateError::Simulation { detail: "the device recorded no section".to_owned() };
                let grown = Grown { statistics, ..loft.take().ok_or_else(none)?.grown };
                let ran = Ran { used: Backend::Gpu, device: self.device.name(), simulate, total: self.total };
                finish(request, grown, ran, |stage| lock(&member.pace).stage(stage), cancel).map(Some)
            }
        }
    }

    /// Lofts the slab up to `section`; where that needs mending, the steps in between are simulated again.
    fn advance(
        &self,
        member: &Growing<'a, D::Mark>,
        loft: &mut Lofting<D::Mark>,
        section: &Section,
    ) -> Result<(), GenerateError> {
        let watch = Stopwatch::start();
        let accepted = match loft.grown.lofter.try_advance(section).map_err(unsound)? {
            Some(accepted) => accepted,
            None => {
                let history = self.device.replay(&self.plans[member.slot], &loft.mark)?;
                loft.grown.lofter.advance(&history).map_err(unsound)?
            }
        };
        loft.grown.loft_seconds += watch.seconds();
        loft.grown.flipped += accepted.flipped;
        loft.grown.sections.extend(accepted.sections);
        Ok(())
    }
}

/// Hands on what the device tells of a group of members.
struct Feed<'s, 'scope, 'a, D: Device> {
    batch: &'scope Batch<'a, D>,
    scope: &'s rayon::Scope<'scope>,
    /// The first member of the group.
    first: usize,
    begun: Stopwatch,
    /// Whether anything was told.
    told: bool,
}

impl<'scope, 'a, D: Device> Feed<'_, 'scope, 'a, D> {
    fn member(&self, place: usize) -> &'scope Growing<'a, D::Mark> {
        &self.batch.growing[self.first + place]
    }

    fn tell(&mut self, place: usize, item: Item<D::Mark>) {
        self.told = true;
        self.batch.post(self.scope, self.member(place), item);
    }
}

impl<D: Device> Told<D::Mark> for Feed<'_, '_, '_, D> {
    fn section(&mut self, member: usize, section: Section, mark: D::Mark) {
        self.tell(member, Item::Section(section, mark));
        self.batch.keep_pace();
    }

    fn progress(&mut self, member: usize, step: i64, particles: u32) {
        let member = self.member(member);
        if !member.ended.load(Ordering::Relaxed) {
            lock(&member.pace).step(step, particles);
        }
    }

    fn cancelled(&mut self, member: usize) -> bool {
        let member = self.member(member);
        member.ended.load(Ordering::Relaxed) || member.member.cancel.is_cancelled()
    }

    fn failed(&mut self, member: usize, error: SimError) {
        self.member(member).simulated.store(true, Ordering::Relaxed);
        self.tell(member, Item::Broken(GenerateError::Simulation { detail: error.to_string() }));
    }

    fn finished(&mut self, member: usize, statistics: Statistics) {
        self.member(member).simulated.store(true, Ordering::Relaxed);
        let seconds = self.begun.seconds();
        self.tell(member, Item::Simulated(statistics, seconds));
    }
}

/// What a panic said.
fn message(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().map(|text| (*text).to_owned());
    text.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_else(|| "a panic without a message".to_owned())
}

#[cfg(test)]
mod tests;
