//! The files of `src/sync` on shuttle's mutexes, in schedules that switch threads at every step. A deadlock, a lost
//! wake-up or a wrong count in any schedule is a failure.

use std::sync::atomic::Ordering;

use crate::schedules::{check, primitives};
use crate::sync::{Barrier, Block, BlockCount, Operation, OperationQueue, OperationThread};
use shuttle::sync::Arc;
use shuttle::sync::atomic::{AtomicBool, AtomicUsize};
use shuttle::thread;

#[test]
fn block_holds_until_released_and_again_after_a_reset() {
    check(|| {
        let block = Arc::new(Block::new());
        let released = Arc::new(AtomicBool::new(false));
        let waiters: Vec<_> = (0..2)
            .map(|_| {
                let (block, released) = (block.clone(), released.clone());
                thread::spawn(move || {
                    block.block();
                    assert!(released.load(Ordering::SeqCst));
                })
            })
            .collect();
        released.store(true, Ordering::SeqCst);
        block.release();
        for waiter in waiters {
            waiter.join().unwrap();
        }
        block.reset();
        let again = block.clone();
        let waiter = thread::spawn(move || again.block());
        block.release();
        waiter.join().unwrap();
    });
}

#[test]
fn block_count_opens_with_the_last_completion_in_every_frame() {
    check(|| {
        let done = Arc::new(AtomicUsize::new(0));
        let block = Arc::new(BlockCount::new(2));
        for frame in 1..=2 {
            block.reset();
            let workers: Vec<_> = (0..2)
                .map(|_| {
                    let (block, done) = (block.clone(), done.clone());
                    thread::spawn(move || {
                        done.fetch_add(1, Ordering::SeqCst);
                        block.completed();
                    })
                })
                .collect();
            assert!(block.block());
            assert_eq!(done.load(Ordering::SeqCst), 2 * frame);
            for worker in workers {
                worker.join().unwrap();
            }
        }
        // A release replaces completions that never arrive.
        block.reset();
        let waits = block.clone();
        let waiter = thread::spawn(move || waits.block());
        block.release();
        assert!(!waiter.join().unwrap());
    });
}

#[test]
fn threads_meet_at_a_barrier_repeatedly() {
    check(|| {
        let barrier = Arc::new(Barrier::new(3));
        let came = Arc::new(AtomicUsize::new(0));
        let threads: Vec<_> = (0..3)
            .map(|_| {
                let (barrier, came) = (barrier.clone(), came.clone());
                thread::spawn(move || {
                    for meeting in 1..=3 {
                        came.fetch_add(1, Ordering::SeqCst);
                        assert!(barrier.block());
                        assert!(came.load(Ordering::SeqCst) >= 3 * meeting);
                    }
                })
            })
            .collect();
        for thread in threads {
            thread.join().unwrap();
        }
        assert_eq!((came.load(Ordering::SeqCst), barrier.waiting()), (9, 0));
    });
}

#[test]
fn released_barrier_blocks_no_thread() {
    check(|| {
        let barrier = Arc::new(Barrier::new(3));
        let threads: Vec<_> = (0..2)
            .map(|_| {
                let barrier = barrier.clone();
                thread::spawn(move || while barrier.block() {})
            })
            .collect();
        // It ends after one meeting or none.
        barrier.block();
        barrier.release();
        for thread in threads {
            thread.join().unwrap();
        }
        assert!(!barrier.block());
    });
}

#[test]
fn operations_run_in_order_and_kept_ones_repeatedly() {
    check(|| {
        let thread = OperationThread::start("t", Vec::new(), []).unwrap();
        let done = Arc::new(BlockCount::new(3));
        thread.queue().add_fn("once", false, |ran: &mut Vec<u32>| ran.push(1));
        let completed = done.clone();
        thread.queue().add_fn("kept", true, move |ran: &mut Vec<u32>| {
            ran.push(2);
            completed.completed();
            thread::yield_now();
        });
        done.block();
        thread.queue().remove("kept");
        let last = Arc::new(Block::new());
        let seen = last.clone();
        thread.queue().add_fn("last", false, move |ran: &mut Vec<u32>| {
            ran.push(3);
            seen.release();
        });
        last.block();
        let ran = thread.join().unwrap();
        assert_eq!((ran[0], ran.last()), (1, Some(&3)));
        assert!(ran[1..ran.len() - 1].iter().all(|n| *n == 2) && ran.len() >= 5, "{ran:?}");
    });
}

/// Regression: an operation that removes another one ran twice.
#[test]
fn operations_run_once_while_others_are_added_and_removed() {
    check(|| {
        let queue = Arc::new(OperationQueue::<Vec<u32>>::new());
        let of_first = queue.clone();
        queue.add_fn("a", true, move |ran| {
            ran.push(1);
            of_first.remove("b");
            of_first.add_fn("d", false, |ran| ran.push(4));
        });
        queue.add_fn("b", true, |ran| ran.push(2));
        queue.add_fn("c", true, |ran| ran.push(3));
        let of_other = queue.clone();
        let other = thread::spawn(move || of_other.add_fn("e", false, |ran| ran.push(5)));
        let mut ran = Vec::new();
        queue.run_operations(&mut ran);
        other.join().unwrap();
        let of_other = ran.iter().filter(|n| **n == 5).count();
        ran.retain(|n| *n != 5);
        // The queue keeps the two that stay, the one that the first added, and the one that the other thread added too
        // late.
        assert_eq!((&ran[..], queue.len()), (&[1, 3][..], 4 - of_other));
        // The closures hold references to the queue.
        queue.remove_all();
    });
}

/// A barrier as an operation, like those of the viewer.
struct Meet(Arc<Barrier>);

impl Operation<usize> for Meet {
    fn name(&self) -> &str {
        "meet"
    }

    fn keep(&self) -> bool {
        true
    }

    fn run(&self, met: &mut usize) {
        match self.0.block() {
            true => *met += 1,
            // Another thread was stopped; this one is stopped next.
            false => thread::yield_now(),
        }
    }

    fn release(&self) {
        self.0.release();
    }
}

#[test]
fn threads_that_wait_for_each_other_stop_in_any_order() {
    check(|| {
        let start = Arc::new(Barrier::new(3));
        let swap = Arc::new(Barrier::new(2));
        let operations = || [&start, &swap].map(|b| Arc::new(Meet(b.clone())) as Arc<dyn Operation<usize>>);
        let a = OperationThread::start("a", 0, operations()).unwrap();
        let b = OperationThread::start("b", 0, operations()).unwrap();
        assert!(start.block());
        // The threads may be between the barriers, at the second one, or back at the first.
        let (met_a, met_b) = (a.join().unwrap(), b.join().unwrap());
        assert!((1..=2).contains(&met_a) && (1..=2).contains(&met_b), "{met_a} {met_b}");
    });
}

/// Like [`Meet`], and counts releases of the barrier.
struct Refused(Arc<Barrier>);

impl Operation<usize> for Refused {
    fn name(&self) -> &str {
        "refused"
    }

    fn keep(&self) -> bool {
        true
    }

    fn run(&self, refused: &mut usize) {
        *refused += usize::from(!self.0.block());
    }

    fn release(&self) {
        self.0.release();
    }
}

#[test]
fn ended_threads_do_not_continue_when_their_barrier_is_released() {
    check(|| {
        let start = Arc::new(Barrier::new(3));
        let operations = || [Arc::new(Refused(start.clone())) as Arc<dyn Operation<usize>>];
        let a = OperationThread::start("a", 0, operations()).unwrap();
        let b = OperationThread::start("b", 0, operations()).unwrap();
        assert!(start.block());
        a.end();
        b.end();
        let refused = [a.join().unwrap(), b.join().unwrap()];
        assert!(refused.iter().all(|n| *n <= 1), "{refused:?}");
    });
}

#[test]
fn operation_added_while_the_thread_falls_asleep_is_not_lost() {
    check(|| {
        let queue = Arc::new(OperationQueue::<usize>::new());
        let taker = queue.clone();
        let thread = thread::spawn(move || {
            let mut ran = 0;
            while let Some(operation) = taker.next_operation() {
                operation.run(&mut ran);
            }
            ran
        });
        let done = Arc::new(BlockCount::new(4));
        let adders: Vec<_> = (0..2)
            .map(|_| {
                let (queue, done) = (queue.clone(), done.clone());
                thread::spawn(move || {
                    for _ in 0..2 {
                        let done = done.clone();
                        queue.add_fn("count", false, move |ran: &mut usize| {
                            *ran += 1;
                            done.completed();
                        });
                    }
                })
            })
            .collect();
        done.block();
        queue.close();
        assert_eq!(thread.join().unwrap(), 4);
        for adder in adders {
            adder.join().unwrap();
        }
    });
}
