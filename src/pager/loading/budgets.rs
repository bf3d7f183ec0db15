//! [`LoadBudgets`]: the bytes that are on their way between a server or a disk and a scene.

use crate::fetch::{BudgetUse, ByteBudget, LargeContents};

/// The two budgets of a set of loading threads. Clones are the same budgets.
///
/// A load passes through both: first its bytes, as read, are in `bodies` until they are decoded, then the content is in
/// `contents` until update has used or dropped it. A decode thread waits for room in `contents` while its bytes stay in
/// `bodies`. That blocks nothing: update takes contents, uploads, merges and drops them without waiting for a load.
#[derive(Clone, Debug)]
pub(in crate::pager) struct LoadBudgets {
    pub bodies: ByteBudget,
    pub contents: ByteBudget,
    /// Contents whose decoders need more than is free in `contents`.
    pub large: LargeContents,
}

impl LoadBudgets {
    /// Creates budgets of half of `max_bytes` each. That of contents has no limit if `waits_for_contents` is false. The files of
    /// one content may have `max_load` bytes.
    pub fn new(max_bytes: u64, waits_for_contents: bool, max_load: u64) -> Self {
        let contents = if waits_for_contents { max_bytes / 2 } else { u64::MAX };
        Self {
            bodies: ByteBudget::new(max_bytes / 2).with_max_load(max_load),
            contents: ByteBudget::new(contents),
            large: LargeContents::default(),
        }
    }

    /// Returns what both use together. Their maxima may be of different times.
    pub fn total(&self) -> BudgetUse {
        let (a, b) = (self.bodies.total(), self.contents.total());
        let (bytes, peak) = (a.bytes + b.bytes, a.peak + b.peak);
        BudgetUse { bytes, peak, waits: a.waits + b.waits, waited: a.waited + b.waited }
    }

    /// Lets all threads go on that wait, for their end.
    pub fn close(&self) {
        self.bodies.close();
        self.contents.close();
        self.large.close();
    }
}

#[cfg(all(test, feature = "http"))]
mod tests {
    use std::future::Future;
    use std::pin::{Pin, pin};
    use std::task::{Context, Poll, Waker};

    use super::*;
    use crate::fetch::{LoadRoom, NoRoom, Permit};

    fn poll(reservation: Pin<&mut impl Future<Output = Permit>>) -> Option<Permit> {
        match reservation.poll(&mut Context::from_waker(Waker::noop())) {
            Poll::Ready(permit) => Some(permit),
            Poll::Pending => None,
        }
    }

    #[test]
    fn load_beyond_the_maximum_of_one_is_refused_although_it_is_alone() {
        let budget = ByteBudget::new(100).with_max_load(150);
        let permit = budget.hold(10);
        let mut claim = permit.claim(150).expect("a load that is alone may be larger than the budget");
        assert_eq!(claim.grow_to(151).unwrap_err(), NoRoom { needed: 151 });
        assert_eq!(budget.total().bytes, 150);
    }

    #[test]
    fn loads_begin_in_order_and_prefetches_last() {
        let budget = ByteBudget::new(100);
        let held = budget.hold(90);
        let mut prefetch = pin!(budget.reserve(1, true));
        let mut large = pin!(budget.reserve(80, false));
        let mut small = pin!(budget.reserve(15, false));
        assert!(poll(prefetch.as_mut()).is_some(), "nothing waits and it fits");
        let mut prefetch = pin!(budget.reserve(1, true));
        assert!(poll(large.as_mut()).is_none());
        assert!(poll(prefetch.as_mut()).is_none() && poll(small.as_mut()).is_none(), "none overtakes the large one");
        assert_eq!(budget.room(), LoadRoom { loads: 0, prefetches: 0 });
        drop(held);
        let large = poll(large).expect("its turn");
        let small = poll(small).expect("it fits beside");
        assert!(budget.total().bytes == 96 && poll(prefetch).is_some());
        drop((large, small));
        assert_eq!((budget.total().bytes, budget.total().peak, budget.total().waits), (0, 96, 3));
    }

    #[test]
    fn prefetch_that_waits_delays_only_prefetches() {
        let budget = ByteBudget::new(100);
        let held = budget.hold(40);
        let mut large = pin!(budget.reserve(90, true));
        let mut small = pin!(budget.reserve(1, true));
        assert!(poll(large.as_mut()).is_none() && poll(small.as_mut()).is_none());
        budget.learn(10);
        assert_eq!(budget.room(), LoadRoom { loads: 6, prefetches: 0 });
        let wanted = poll(pin!(budget.reserve(50, false))).expect("it fits");
        drop((held, wanted));
        let _large = poll(large).expect("its turn");
        assert!(poll(small).is_some());
    }

    #[test]
    fn load_larger_than_the_budget_begins_alone_and_may_grow() {
        let budget = ByteBudget::new(100);
        let held = budget.hold(1);
        let mut large = pin!(budget.reserve(500, false));
        assert!(poll(large.as_mut()).is_none());
        drop(held);
        let large = poll(large).expect("nothing else is held");
        large.claim(600).expect("it is alone").keep(600);
        let mut next = pin!(budget.reserve(1, false));
        assert!(poll(next.as_mut()).is_none());
        drop(large);
        assert!(poll(next).is_some());
    }

    #[test]
    fn claims_take_what_is_reserved_and_then_what_is_free() {
        let budget = ByteBudget::new(100);
        let (first, second) = (budget.hold(30), budget.hold(50));
        let mut claim = first.claim(20).unwrap();
        claim.grow_to(50).unwrap();
        assert_eq!((claim.bytes(), budget.total().bytes), (50, 100));
        assert_eq!(claim.grow_to(51).unwrap_err(), NoRoom { needed: 51 });
        let failed = second.claim(50).unwrap();
        assert_eq!(second.claim(1).unwrap_err(), NoRoom { needed: 51 });
        drop(failed);
        second.claim(50).expect("a body that failed takes no bytes").keep(40);
        assert_eq!(second.claim(11).unwrap_err(), NoRoom { needed: 51 });
        claim.keep(50);
        second.set_bytes(70);
        assert_eq!(budget.total().bytes, 120, "what is known only afterwards may exceed the limit");
        let copy = first.clone();
        drop(first);
        assert_eq!(budget.total().bytes, 120, "the last copy gives back");
        drop((copy, second));
        assert_eq!(budget.total().bytes, 0);
    }

    #[test]
    fn as_many_loads_may_begin_as_have_room_at_the_mean_size() {
        let budget = ByteBudget::new(100 << 20);
        assert_eq!(budget.room(), LoadRoom { loads: 100, prefetches: 50 }, "a megabyte before the first");
        budget.learn(10 << 20);
        let held = budget.hold(45 << 20);
        assert_eq!(budget.room(), LoadRoom { loads: 5, prefetches: 0 });
        drop(held);
        budget.learn(8000 << 20);
        assert_eq!(budget.room(), LoadRoom { loads: 1, prefetches: 1 }, "one may always begin");
    }
}
