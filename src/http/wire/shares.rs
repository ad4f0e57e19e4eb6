//! Limited resources of the service: downloads, event streams, held responses, bytes of bodies, and
//! turns to compute. One owner can hold only a share of each, so others can always use the rest.
//!
//! A service without keys knows no owners, so only the total limits its callers.

use crate::lock::Mutex;
use std::collections::{HashMap, VecDeque};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::oneshot;

/// A resource with a total, and a maximum per owner. The unit is that of the resource.
pub(in crate::http) struct Shares {
    total: usize,
    of_owner: usize,
    used: Mutex<Used>,
}

/// Amounts in use, in total and by owner of the key.
#[derive(Default)]
struct Used {
    all: usize,
    by_owner: HashMap<Arc<str>, usize>,
}

/// An amount in use, until it is dropped.
pub(in crate::http) struct Share {
    shares: Arc<Shares>,
    owner: Option<Arc<str>>,
    amount: usize,
}

/// The limit that an amount would exceed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::http) enum Exhausted {
    /// The total.
    Total(usize),
    /// The maximum per owner.
    OfOwner(usize),
}

impl Exhausted {
    /// The limit.
    pub(in crate::http) fn limit(self) -> usize {
        match self {
            Self::Total(limit) | Self::OfOwner(limit) => limit,
        }
    }

    /// The callers who share the limit, as the end of a sentence.
    pub(in crate::http) fn callers(self) -> &'static str {
        match self {
            Self::Total(_) => "for all callers together",
            Self::OfOwner(_) => "with keys of your owner",
        }
    }
}

impl Shares {
    /// A resource of which one owner can hold `of_owner`.
    pub(in crate::http) fn new(total: usize, of_owner: usize) -> Arc<Self> {
        Arc::new(Self { total, of_owner, used: Mutex::default() })
    }

    /// A resource of which one owner can hold half, but at least 1.
    pub(in crate::http) fn halves(total: usize) -> Arc<Self> {
        Self::new(total, total.div_ceil(2))
    }

    /// Takes an amount for a caller with this owner.
    ///
    /// # Errors
    /// The limit that the amount would exceed.
    pub(in crate::http) fn take(self: &Arc<Self>, owner: Option<&str>, amount: usize) -> Result<Share, Exhausted> {
        let mut share = Share { shares: Arc::clone(self), owner: owner.map(Arc::from), amount: 0 };
        share.grow(amount)?;
        Ok(share)
    }

    /// The amount in use.
    pub(in crate::http) fn used(&self) -> usize {
        self.used.lock().all
    }
}

impl Share {
    /// Takes another amount.
    ///
    /// # Errors
    /// The limit that the amount would exceed. The share then keeps what it has.
    pub(in crate::http) fn grow(&mut self, amount: usize) -> Result<(), Exhausted> {
        let mut used = self.shares.used.lock();
        let all = used.all.saturating_add(amount);
        if all > self.shares.total {
            return Err(Exhausted::Total(self.shares.total));
        }
        if let Some(owner) = &self.owner {
            let own = used.by_owner.get(owner).copied().unwrap_or(0).saturating_add(amount);
            if own > self.shares.of_owner {
                return Err(Exhausted::OfOwner(self.shares.of_owner));
            }
            if own > 0 {
                used.by_owner.insert(Arc::clone(owner), own);
            }
        }
        used.all = all;
        self.amount += amount;
        Ok(())
    }

    /// Gives a part of the amount back.
    pub(in crate::http) fn shrink(&mut self, amount: usize) {
        let amount = amount.min(self.amount);
        let mut used = self.shares.used.lock();
        used.all -= amount;
        self.amount -= amount;
        if let Some(owner) = &self.owner
            && let Some(own) = used.by_owner.get_mut(owner)
        {
            *own -= amount;
            if *own == 0 {
                used.by_owner.remove(owner);
            }
        }
    }

    /// The amount.
    pub(in crate::http) fn amount(&self) -> usize {
        self.amount
    }
}

impl Drop for Share {
    fn drop(&mut self) {
        self.shrink(self.amount);
    }
}

/// Turns to compute something large, and the requests that wait for one.
///
/// A free turn goes to the owner who has the fewest turns, or who got one longest ago. An owner
/// therefore waits for the end of one turn, even if another owner has sent many requests before.
pub(in crate::http) struct Turns {
    queue: Arc<Mutex<TurnQueue>>,
    places: Arc<Shares>,
}

#[derive(Default)]
struct TurnQueue {
    free: usize,
    /// Turns of the owners who have one or wait for one.
    given: HashMap<Option<Arc<str>>, OwnerTurns>,
    /// Number of turns given so far.
    count: u64,
    /// Requests without a turn, in the order of their arrival.
    waiting: VecDeque<(Option<Arc<str>>, oneshot::Sender<GivenTurn>)>,
}

#[derive(Clone, Copy, Default, PartialEq, Eq, PartialOrd, Ord)]
struct OwnerTurns {
    running: usize,
    /// Number of the last turn; 0 for none.
    last: u64,
}

/// A turn that the queue gets back when it is dropped.
struct GivenTurn {
    queue: Arc<Mutex<TurnQueue>>,
    owner: Option<Arc<str>>,
}

/// The turn of a request, until all clones are dropped. Work on a blocking thread has a clone, so a
/// client that disconnects does not end the turn before the work.
#[derive(Clone)]
pub(in crate::http) struct Turn {
    _held: Arc<(Share, GivenTurn)>,
}

impl Turns {
    /// Maximum number of requests that wait for a turn or have one.
    const PLACES: usize = 64;
    /// Maximum number of these requests per owner. A browser sends six at a time.
    const PLACES_OF_OWNER: usize = 16;

    /// Gives at most `max_turns` turns at a time.
    pub(in crate::http) fn new(max_turns: usize) -> Self {
        let queue = TurnQueue { free: max_turns, ..TurnQueue::default() };
        Self { queue: Arc::new(Mutex::new(queue)), places: Shares::new(Self::PLACES, Self::PLACES_OF_OWNER) }
    }

    /// Waits for a turn. Requests of one owner get their turns in the order of their arrival.
    /// `None` if the turn takes longer than `wait`, or if too many requests wait.
    pub(in crate::http) async fn turn(&self, owner: Option<&str>, wait: Duration) -> Option<Turn> {
        let place = self.places.take(owner, 1).ok()?;
        let (sender, turn) = oneshot::channel();
        self.queue.lock().push(owner, sender);
        TurnQueue::give(&self.queue);
        let turn = tokio::time::timeout(wait, turn).await.ok()?.ok()?;
        Some(Turn { _held: Arc::new((place, turn)) })
    }
}

impl TurnQueue {
    fn push(&mut self, owner: Option<&str>, sender: oneshot::Sender<GivenTurn>) {
        self.forget();
        self.waiting.push_back((owner.map(Arc::from), sender));
    }

    /// Forgets requests that have stopped waiting, and owners without requests.
    fn forget(&mut self) {
        self.waiting.retain(|(_, sender)| !sender.is_closed());
        let waits = |owner: &Option<Arc<str>>| self.waiting.iter().any(|(waiting, _)| waiting == owner);
        self.given.retain(|owner, turns| turns.running > 0 || waits(owner));
    }

    /// Takes a free turn for the next request.
    fn next(&mut self) -> Option<(Option<Arc<str>>, oneshot::Sender<GivenTurn>)> {
        self.free.checked_sub(1)?;
        let turns_of = |owner: &Option<Arc<str>>| self.given.get(owner).copied().unwrap_or_default();
        let (first, _) = self.waiting.iter().enumerate().min_by_key(|(_, (owner, _))| turns_of(owner))?;
        let (owner, sender) = self.waiting.remove(first)?;
        self.free -= 1;
        self.count += 1;
        let turns = self.given.entry(owner.clone()).or_default();
        *turns = OwnerTurns { running: turns.running + 1, last: self.count };
        Some((owner, sender))
    }

    /// Gives free turns to requests that wait.
    fn give(queue: &Arc<Mutex<Self>>) {
        loop {
            let next = queue.lock().next();
            let Some((owner, sender)) = next else { return };
            // A turn whose request has stopped waiting is dropped, and so returns to the queue.
            let _ = sender.send(GivenTurn { queue: Arc::clone(queue), owner });
        }
    }
}

impl Drop for GivenTurn {
    fn drop(&mut self) {
        {
            let mut queue = self.queue.lock();
            queue.free += 1;
            if let Some(turns) = queue.given.get_mut(&self.owner) {
                turns.running -= 1;
            }
            queue.forget();
        }
        TurnQueue::give(&self.queue);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_owner_has_a_share_and_anyone_the_total() {
        let shares = Shares::halves(5);
        let of_one = shares.take(Some("a"), 3).unwrap();
        assert_eq!(shares.take(Some("a"), 1).err(), Some(Exhausted::OfOwner(3)));
        let mut of_other = shares.take(Some("b"), 1).unwrap();
        assert_eq!(of_other.grow(2), Err(Exhausted::Total(5)));
        of_other.grow(1).unwrap();
        assert_eq!((shares.used(), shares.take(Some("c"), 1).err()), (5, Some(Exhausted::Total(5))));
        of_other.shrink(1);
        assert_eq!((of_other.amount(), shares.used()), (1, 4));
        of_other.grow(1).unwrap();
        drop(of_one);
        let anonymous = shares.take(None, 3).unwrap();
        assert_eq!(shares.take(None, 1).err(), Some(Exhausted::Total(5)));
        drop((of_other, anonymous));
        assert!(shares.used() == 0 && shares.used.lock().by_owner.is_empty());
    }

    #[test]
    fn a_refusal_leaves_no_trace() {
        let shares = Shares::halves(1);
        assert!(shares.take(Some("a"), 2).is_err());
        assert!(shares.used() == 0 && shares.used.lock().by_owner.is_empty());
        drop(shares.take(Some("a"), 0).unwrap());
        assert!(shares.take(Some("a"), 1).is_ok(), "half of one is one");
    }

    #[tokio::test]
    async fn no_owner_takes_all_places() {
        let turns = Turns::new(1);
        let place = |owner| turns.places.take(owner, 1);
        let mut of_one: Vec<Share> = (0..Turns::PLACES_OF_OWNER).map(|_| place(Some("a")).unwrap()).collect();
        assert!(place(Some("a")).is_err());
        let others: Vec<Share> = (Turns::PLACES_OF_OWNER..Turns::PLACES).map(|_| place(None).unwrap()).collect();
        assert!(place(Some("b")).is_err(), "all places are taken");
        drop(of_one.pop());
        assert!(turns.turn(Some("a"), Duration::from_secs(60)).await.is_some());
        drop((of_one, others));
        assert_eq!(turns.places.used(), 0);
    }

    #[tokio::test]
    async fn who_stops_waiting_leaves_no_trace() {
        let turns = Turns::new(0);
        assert!(turns.turn(Some("a"), Duration::from_millis(1)).await.is_none());
        let waits = turns.turn(Some("a"), Duration::from_secs(60));
        assert!(tokio::time::timeout(Duration::from_millis(1), waits).await.is_err());
        assert_eq!(turns.places.used(), 0);
    }

    #[tokio::test]
    async fn a_turn_lasts_until_its_last_clone_is_dropped() {
        let turns = Turns::new(1);
        let turn = turns.turn(None, Duration::ZERO).await.unwrap();
        let clone = turn.clone();
        drop(turn);
        assert!(turns.turn(None, Duration::ZERO).await.is_none());
        drop(clone);
        assert!(turns.turn(None, Duration::ZERO).await.is_some());
    }

    /// The numbers of waiting requests in the order of their turns. The greedy owner has all turns
    /// when the requests arrive.
    async fn order(max_turns: usize, requests: &[&'static str]) -> Vec<usize> {
        let (turns, long) = (Arc::new(Turns::new(max_turns)), Duration::from_secs(60));
        let mut running = VecDeque::new();
        for _ in 0..max_turns {
            running.push_back(turns.turn(Some("greedy"), long).await);
        }
        let (told, mut given) = tokio::sync::mpsc::unbounded_channel();
        for (number, &owner) in requests.iter().enumerate() {
            let (own, told) = (Arc::clone(&turns), told.clone());
            tokio::spawn(async move { told.send((number, own.turn(Some(owner), long).await)) });
            while turns.queue.lock().waiting.len() <= number {
                tokio::task::yield_now().await;
            }
        }
        let mut numbers = Vec::new();
        for _ in requests {
            running.pop_front();
            let (number, turn) = given.recv().await.unwrap();
            numbers.push(number);
            running.push_back(turn);
        }
        running.clear();
        let queue = turns.queue.lock();
        assert!(queue.free == max_turns && queue.given.is_empty() && queue.waiting.is_empty());
        assert_eq!(turns.places.used(), 0);
        numbers
    }

    #[tokio::test]
    async fn a_free_turn_goes_to_the_owner_with_the_fewest_turns() {
        assert_eq!(order(1, &["greedy", "greedy", "modest", "greedy", "modest"]).await, [2, 0, 4, 1, 3]);
        assert_eq!(order(2, &["greedy", "greedy", "modest", "greedy"]).await, [2, 0, 1, 3]);
        assert_eq!(order(3, &["a", "b", "a", "c", "b", "greedy"]).await, [0, 1, 3, 5, 2, 4]);
    }

    #[tokio::test]
    async fn a_request_that_stops_waiting_costs_no_turn() {
        let turns = Turns::new(1);
        let first = turns.turn(None, Duration::ZERO).await.unwrap();
        for _ in 0..100 {
            assert!(turns.turn(Some("a"), Duration::ZERO).await.is_none());
        }
        assert_eq!(turns.queue.lock().waiting.len(), 1, "those that have stopped are forgotten");
        drop(first);
        assert!(turns.turn(Some("b"), Duration::ZERO).await.is_some());
    }
}
