//! The budgets of bytes on their way under shuttle: the library's own file, between loads, decoders and an update as the
//! pagers have them. A schedule fails if a load waits forever or if more is in use than the limit.

#[path = "../../src/fetch/memory/byte_budget.rs"]
mod byte_budget;

use std::future::Future;
use std::pin::pin;
use std::task::{Context, Poll, Waker};

use crate::schedules::channel::bounded;
use crate::schedules::check;
use byte_budget::{ByteBudget, NoRoom, Permit};
use shuttle::sync::Arc;
use shuttle::sync::atomic::{AtomicU64, Ordering};
use shuttle::thread;

const LIMIT: u64 = 10;

/// The bytes in use, counted independently of the budget.
#[derive(Clone, Default)]
struct InUse(Arc<AtomicU64>);

impl InUse {
    /// Counts bytes; they may exceed the limit only if nothing else is in use.
    fn add(&self, bytes: u64) {
        let before = self.0.fetch_add(bytes, Ordering::SeqCst);
        assert!(before == 0 || before + bytes <= LIMIT, "{before} + {bytes}");
    }

    fn remove(&self, bytes: u64) {
        self.0.fetch_sub(bytes, Ordering::SeqCst);
    }
}

/// Reads a load of `bytes` bytes that was expected to be smaller, as the HTTP thread does.
fn load(budget: &ByteBudget, expected: u64, bytes: u64) -> Permit {
    let mut reserved = expected;
    loop {
        let permit = budget.reserve_blocking(reserved, false);
        let claimed = permit.claim(bytes).map(|claim| claim.keep(bytes));
        match claimed {
            Ok(()) => {
                permit.set_bytes(bytes);
                return permit;
            }
            Err(NoRoom { needed }) => reserved = needed,
        }
    }
}

#[test]
fn loads_of_unexpected_sizes_all_end_within_the_limit() {
    check(|| {
        let (budget, in_use) = (ByteBudget::new(LIMIT), InUse::default());
        let threads = [(1, 6), (2, 8), (4, 4), (1, 30)].map(|(expected, bytes)| {
            let (budget, in_use) = (budget.clone(), in_use.clone());
            thread::spawn(move || {
                let permit = load(&budget, expected, bytes);
                in_use.add(bytes);
                thread::yield_now();
                in_use.remove(bytes);
                drop(permit);
            })
        });
        threads.into_iter().for_each(|thread| thread.join().unwrap());
        assert_eq!((budget.total().bytes, budget.room().loads > 0), (0, true));
    });
}

/// Bodies wait for decoders, decoders for pages to be merged, and nothing the other way round.
#[test]
fn decoders_that_wait_for_the_update_block_no_load() {
    check(|| {
        let (bodies, contents) = (ByteBudget::new(LIMIT), ByteBudget::new(LIMIT));
        let ((read, received), (answers, answered)) = (bounded(4), bounded(4));
        let loads = [6, 8, 30, 4].map(|bytes| {
            let (bodies, read) = (bodies.clone(), read.clone());
            thread::spawn(move || read.send((bytes, load(&bodies, 1, bytes))).unwrap())
        });
        let decoders = [0; 2].map(|_| {
            let (contents, received, answers) = (contents.clone(), received.clone(), answers.clone());
            thread::spawn(move || {
                while let Ok((bytes, body)) = received.recv() {
                    let permit = contents.reserve_blocking(bytes, false);
                    drop(body);
                    // A page that is larger than its bytes.
                    permit.set_bytes(bytes + 3);
                    answers.send(permit).unwrap();
                }
            })
        });
        drop((read, received, answers));
        let merged = std::iter::from_fn(|| answered.recv().ok()).count();
        loads.into_iter().chain(decoders).for_each(|thread| thread.join().unwrap());
        assert_eq!((merged, bodies.total().bytes, contents.total().bytes), (4, 0, 0));
    });
}

/// An aborted request drops its reservation at any time, also when it was granted and has not noticed.
#[test]
fn dropped_reservations_let_the_next_one_go_on() {
    check(|| {
        let budget = ByteBudget::new(LIMIT);
        let first = budget.hold(LIMIT);
        let aborted = {
            let budget = budget.clone();
            thread::spawn(move || {
                let mut reservation = pin!(budget.reserve(LIMIT, false));
                let polled = reservation.as_mut().poll(&mut Context::from_waker(Waker::noop()));
                thread::yield_now();
                matches!(polled, Poll::Ready(_))
            })
        };
        let next = {
            let budget = budget.clone();
            thread::spawn(move || drop(budget.reserve_blocking(1, true)))
        };
        thread::yield_now();
        drop(first);
        aborted.join().unwrap();
        next.join().unwrap();
        assert_eq!(budget.total().bytes, 0);
    });
}

#[test]
fn closing_lets_all_go_on() {
    check(|| {
        let budget = ByteBudget::new(LIMIT);
        let held = budget.hold(LIMIT);
        let threads = [5, 50].map(|bytes| {
            let budget = budget.clone();
            thread::spawn(move || drop(budget.reserve_blocking(bytes, false)))
        });
        budget.close();
        threads.into_iter().for_each(|thread| thread.join().unwrap());
        drop(held);
        assert_eq!(budget.total().bytes, 0);
    });
}
