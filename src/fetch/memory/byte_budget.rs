//! [`ByteBudget`]: the bytes that loads hold in memory at once. Any thread.
//!
//! A load reserves bytes before it begins, and gives them back when what it has read is dropped. Nothing waits for bytes
//! while it holds some of the same budget. A load waits before it begins. One that turns out to be larger than what it has
//! reserved, and finds no more free, gives up and gives all back; then it waits for its real size. So the loads that hold
//! bytes never depend on those that wait, and no set of loads blocks itself. A load larger than the whole budget begins when
//! nothing else is held, but none takes more than the maximum of one load.
//!
//! Loads begin in the order in which they asked, those that a frame lacks before prefetches.
//!
//! `tests/models/budget_models.rs` runs this very file under thousands of schedules.

use std::collections::VecDeque;
use std::future::Future;
use std::pin::Pin;
use std::task::{Context, Poll, Waker};
use std::time::{Duration, Instant};

use crate::sync::primitives::{Arc, Mutex, MutexGuard, block_on};

/// The size that a load is expected to have before the first has ended.
const FIRST_LOAD_BYTES: u64 = 1 << 20;
/// At least this many loads begin before the first has ended, also if the limit is low.
const MIN_FIRST_LOADS: u64 = 32;
/// Prefetches begin while less than one part in this many is in use, so that those that a frame lacks find room.
const PREFETCH_SHARE: u64 = 2;

/// A maximum of bytes that loads share. Clones are the same budget.
#[derive(Clone, Debug)]
pub(crate) struct ByteBudget(Arc<Mutex<State>>);

/// Locked briefly; no other lock is taken meanwhile.
#[derive(Debug)]
struct State {
    limit: u64,
    /// Bytes that one load may take.
    max_load: u64,
    /// Bytes that permits hold, and those that are granted to reservations.
    used: u64,
    /// In the order in which they are granted.
    waiting: VecDeque<Waiter>,
    /// Numbers of the reservations that were granted and have not noticed yet.
    granted: Vec<u64>,
    next_number: u64,
    /// Moving mean of the sizes of loads; `None` before the first has ended.
    mean: Option<u64>,
    total: BudgetUse,
}

/// A reservation that waits.
#[derive(Debug)]
struct Waiter {
    number: u64,
    bytes: u64,
    is_prefetch: bool,
    waker: Waker,
}

/// How much of a budget is used and was used.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct BudgetUse {
    /// Bytes in use.
    pub bytes: u64,
    /// Maximum of `bytes`.
    pub peak: u64,
    /// The number of reservations that waited.
    pub waits: u64,
    /// The sum of the times that they waited.
    pub waited: Duration,
}

/// The number of loads of the mean size that may begin.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct LoadRoom {
    pub loads: usize,
    /// Prefetches of them.
    pub prefetches: usize,
}

impl LoadRoom {
    /// Room for any number.
    pub const UNLIMITED: Self = Self { loads: usize::MAX, prefetches: usize::MAX };
}

/// A permit has no room to grow. Its owner must drop it, and reserve as many bytes as are `needed`, or fail if that is more
/// than one load may take.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct NoRoom {
    pub needed: u64,
}

impl State {
    /// Returns true if `more` bytes fit beside what is used; `own` of that belong to who asks.
    fn fits(&self, more: u64, own: u64) -> bool {
        self.used == own || self.used.saturating_add(more) <= self.limit
    }

    fn add(&mut self, bytes: u64) {
        self.used = self.used.saturating_add(bytes);
        self.total.peak = self.total.peak.max(self.used);
    }

    /// Grants what has room, the first in order first. A large reservation is not overtaken by smaller ones. Returns the tasks
    /// to wake, without the lock.
    fn grant(&mut self) -> Vec<Waker> {
        let mut wakers = Vec::new();
        while let Some(first) = self.waiting.front()
            && self.fits(first.bytes, 0)
            && let Some(Waiter { number, bytes, waker, .. }) = self.waiting.pop_front()
        {
            self.add(bytes);
            self.granted.push(number);
            wakers.push(waker);
        }
        wakers
    }

    fn expected_bytes(&self) -> u64 {
        self.mean.unwrap_or(FIRST_LOAD_BYTES.min(self.limit / MIN_FIRST_LOADS))
    }
}

impl ByteBudget {
    /// Creates a budget of this many bytes.
    pub fn new(limit: u64) -> Self {
        Self(Arc::new(Mutex::new(State {
            limit,
            max_load: u64::MAX,
            used: 0,
            waiting: VecDeque::new(),
            granted: Vec::new(),
            next_number: 0,
            mean: None,
            total: BudgetUse::default(),
        })))
    }

    /// Refuses loads that claim more than a number of bytes.
    pub fn with_max_load(self, bytes: u64) -> Self {
        self.lock().max_load = bytes;
        self
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.0.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
    }

    /// Changes the state, and lets those go on that have room then.
    fn change(&self, change: impl FnOnce(&mut State)) {
        let mut state = self.lock();
        change(&mut state);
        let wakers = state.grant();
        drop(state);
        wakers.into_iter().for_each(Waker::wake);
    }

    /// Waits for its turn and for room. Dropping the future ends the wait.
    pub fn reserve(&self, bytes: u64, is_prefetch: bool) -> Reservation<'_> {
        Reservation { budget: self, bytes, is_prefetch, waits: None }
    }

    /// Blocks the calling thread until its turn and until there is room.
    pub fn reserve_blocking(&self, bytes: u64, is_prefetch: bool) -> Permit {
        block_on(self.reserve(bytes, is_prefetch))
    }

    /// Takes bytes without waiting, beyond the limit if there is no room. Later loads wait until they are given back.
    pub fn hold(&self, bytes: u64) -> Permit {
        self.lock().add(bytes);
        Permit::new(self, bytes)
    }

    /// Learns the size of a load that has ended.
    pub fn learn(&self, bytes: u64) {
        let mut state = self.lock();
        state.mean = Some(state.mean.map_or(bytes, |mean| (7 * mean + bytes) / 8));
    }

    /// Returns the size that a load is expected to have: the mean of recent ones.
    pub fn expected_bytes(&self) -> u64 {
        self.lock().expected_bytes()
    }

    /// Returns how many loads of the mean size may begin without waiting. At least one may if nothing is in use.
    pub fn room(&self) -> LoadRoom {
        let state = self.lock();
        let begin_below = |limit: u64| {
            let fit = limit.saturating_sub(state.used) / state.expected_bytes().max(1);
            usize::try_from(fit).unwrap_or(usize::MAX).max(usize::from(state.used == 0))
        };
        match state.waiting.front() {
            None => LoadRoom { loads: begin_below(state.limit), prefetches: begin_below(state.limit / PREFETCH_SHARE) },
            Some(first) if first.is_prefetch => LoadRoom { loads: begin_below(state.limit), prefetches: 0 },
            Some(_) => LoadRoom { loads: 0, prefetches: 0 },
        }
    }

    /// Returns how much is used and was used.
    pub fn total(&self) -> BudgetUse {
        let state = self.lock();
        BudgetUse { bytes: state.used, ..state.total }
    }

    /// Removes the limit, so that all that wait go on. For the end of the threads that wait.
    pub fn close(&self) {
        self.change(|state| state.limit = u64::MAX);
    }
}

/// Waits for a [`Permit`]; see [`ByteBudget::reserve`].
pub(crate) struct Reservation<'a> {
    budget: &'a ByteBudget,
    bytes: u64,
    is_prefetch: bool,
    /// Its number among those that wait, and the beginning of the wait.
    waits: Option<(u64, Instant)>,
}

impl Future for Reservation<'_> {
    type Output = Permit;

    fn poll(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Permit> {
        let mut state = self.budget.lock();
        let Some((number, since)) = self.waits else {
            let (bytes, is_prefetch) = (self.bytes, self.is_prefetch);
            let place = state.waiting.partition_point(|waiter| is_prefetch || !waiter.is_prefetch);
            if place == 0 && state.fits(bytes, 0) {
                state.add(bytes);
                return Poll::Ready(Permit::new(self.budget, bytes));
            }
            let (number, waker) = (state.next_number, context.waker().clone());
            state.next_number += 1;
            state.waiting.insert(place, Waiter { number, bytes, is_prefetch, waker });
            state.total.waits += 1;
            drop(state);
            self.waits = Some((number, Instant::now()));
            return Poll::Pending;
        };
        if let Some(place) = state.granted.iter().position(|granted| *granted == number) {
            state.granted.swap_remove(place);
            state.total.waited += since.elapsed();
            drop(state);
            self.waits = None;
            return Poll::Ready(Permit::new(self.budget, self.bytes));
        }
        if let Some(waiter) = state.waiting.iter_mut().find(|waiter| waiter.number == number) {
            waiter.waker.clone_from(context.waker());
        }
        Poll::Pending
    }
}

impl Drop for Reservation<'_> {
    fn drop(&mut self) {
        let Some((number, _)) = self.waits else { return };
        // The next one may be smaller, and have room.
        self.budget.change(|state| match state.granted.iter().position(|granted| *granted == number) {
            Some(place) => {
                state.granted.swap_remove(place);
                state.used = state.used.saturating_sub(self.bytes);
            }
            None => state.waiting.retain(|waiter| waiter.number != number),
        });
    }
}

/// Bytes of a budget. Clones are the same permit; the bytes are given back when the last is dropped.
#[derive(Clone, Debug)]
pub(crate) struct Permit(Arc<Held>);

#[derive(Debug)]
struct Held {
    budget: ByteBudget,
    amounts: Mutex<Amounts>,
}

/// Locked briefly, before the state of the budget.
#[derive(Clone, Copy, Debug)]
struct Amounts {
    /// Bytes that are taken from the budget.
    reserved: u64,
    /// Bytes of them that are in memory, or announced.
    claimed: u64,
}

impl Permit {
    fn new(budget: &ByteBudget, reserved: u64) -> Self {
        let amounts = Mutex::new(Amounts { reserved, claimed: 0 });
        Self(Arc::new(Held { budget: budget.clone(), amounts }))
    }

    /// Returns a permit that may grow without limit, for reads that are not part of a pager's loads.
    pub fn unlimited() -> Self {
        ByteBudget::new(u64::MAX).hold(0)
    }

    /// Returns the budget.
    pub fn budget(&self) -> &ByteBudget {
        &self.0.budget
    }

    fn amounts(&self) -> MutexGuard<'_, Amounts> {
        self.0.amounts.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
    }

    /// Claims bytes before they are put into memory: of those that are reserved, and then of those that are free.
    ///
    /// # Errors
    /// [`NoRoom`] if too few are free.
    pub fn claim(&self, bytes: u64) -> Result<Claim<'_>, NoRoom> {
        let mut claim = Claim { permit: self, bytes: 0 };
        claim.grow_to(bytes)?;
        Ok(claim)
    }

    /// Holds exactly this many bytes from now on. Does not wait: if there is no room, later loads wait.
    pub fn set_bytes(&self, bytes: u64) {
        let mut amounts = self.amounts();
        let before = std::mem::replace(&mut *amounts, Amounts { reserved: bytes, claimed: bytes }).reserved;
        drop(amounts);
        self.budget().change(|state| {
            state.used = state.used.saturating_sub(before);
            state.add(bytes);
        });
    }
}

impl Drop for Held {
    fn drop(&mut self) {
        let reserved = self.amounts.get_mut().unwrap_or_else(std::sync::PoisonError::into_inner).reserved;
        self.budget.change(|state| state.used = state.used.saturating_sub(reserved));
    }
}

/// Bytes of a permit that one body takes. Others of the same permit get them when it is dropped, unless it is
/// [kept](Self::keep).
#[derive(Debug)]
pub(crate) struct Claim<'a> {
    permit: &'a Permit,
    bytes: u64,
}

impl Claim<'_> {
    /// Returns the number of bytes.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Claims as many more that it has this many. Has no effect if it has more.
    ///
    /// # Errors
    /// [`NoRoom`] if too few are free.
    pub fn grow_to(&mut self, bytes: u64) -> Result<(), NoRoom> {
        let more = bytes.saturating_sub(self.bytes);
        let mut amounts = self.permit.amounts();
        let claimed = amounts.claimed.saturating_add(more);
        if claimed > amounts.reserved {
            let mut state = self.permit.budget().lock();
            if claimed > state.max_load || !state.fits(claimed - amounts.reserved, amounts.reserved) {
                return Err(NoRoom { needed: claimed });
            }
            state.add(claimed - amounts.reserved);
            amounts.reserved = claimed;
        }
        amounts.claimed = claimed;
        self.bytes += more;
        Ok(())
    }

    /// Leaves this many of the bytes claimed for as long as the permit lives.
    pub fn keep(mut self, bytes: u64) {
        self.bytes = self.bytes.saturating_sub(bytes);
    }
}

impl Drop for Claim<'_> {
    fn drop(&mut self) {
        let mut amounts = self.permit.amounts();
        amounts.claimed = amounts.claimed.saturating_sub(self.bytes);
    }
}
