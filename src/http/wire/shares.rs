//! Limited resources of the service: downloads, event streams, held responses, bytes of bodies, and
//! turns to compute. One owner can hold only a share of each, so others can always use the rest.
//!
//! A service without keys knows no owners, so only the total limits its callers.

use crate::lock::Mutex;
use std::collections::HashMap;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};

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

/// Turns to compute something large, and the places of the requests that wait for one.
pub(in crate::http) struct Turns {
    turns: Arc<Semaphore>,
    places: Arc<Shares>,
}

/// The turn of a request, until all clones are dropped. Work on a blocking thread has a clone, so a
/// client that disconnects does not end the turn before the work.
#[derive(Clone)]
pub(in crate::http) struct Turn {
    _held: Arc<(Share, OwnedSemaphorePermit)>,
}

impl Turns {
    /// Maximum number of requests that wait for a turn or have one.
    const PLACES: usize = 64;
    /// Maximum number of these requests per owner. A browser sends six at a time.
    const PLACES_OF_OWNER: usize = 16;

    /// Grants at most `max_turns` turns at a time.
    pub(in crate::http) fn new(max_turns: usize) -> Self {
        let places = Shares::new(Self::PLACES, Self::PLACES_OF_OWNER);
        Self { turns: Arc::new(Semaphore::new(max_turns)), places }
    }

    /// Waits for a turn, first come, first served. `None` if the turn takes longer than `wait`, or
    /// if too many requests wait.
    pub(in crate::http) async fn turn(&self, owner: Option<&str>, wait: Duration) -> Option<Turn> {
        let place = self.places.take(owner, 1).ok()?;
        let permit = tokio::time::timeout(wait, Arc::clone(&self.turns).acquire_owned()).await.ok()?.ok()?;
        Some(Turn { _held: Arc::new((place, permit)) })
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
}
