//! Steady frames allocate nothing. The allocator of this program counts, separately for each thread.
//!
//! The tests are a separate program, because a program has one global allocator.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

mod attribution;
mod cull;
mod draw;
mod frame;

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::{Cell, RefCell};

thread_local! {
    /// Allocations and reallocations of this thread so far.
    static COUNT: Cell<u64> = const { Cell::new(0) };
    /// True while the call stacks of this thread's allocations are recorded.
    static RECORDING: Cell<bool> = const { Cell::new(false) };
    /// One call stack per allocation: instruction addresses, innermost first.
    static RECORDED: RefCell<Vec<Vec<usize>>> = const { RefCell::new(Vec::new()) };
}

/// Returns the number of allocations that this thread has made so far.
fn count() -> u64 {
    COUNT.with(Cell::get)
}

/// Returns the call stacks of the allocations that this thread makes in `work`.
fn recorded(work: impl FnOnce()) -> Vec<Vec<usize>> {
    RECORDED.with(|all| all.borrow_mut().clear());
    RECORDING.with(|r| r.set(true));
    work();
    RECORDING.with(|r| r.set(false));
    RECORDED.with(|all| std::mem::take(&mut *all.borrow_mut()))
}

fn count_and_record() {
    // The variables of a thread are already destroyed while it ends.
    let _ = COUNT.try_with(|count| count.set(count.get() + 1));
    // Recording itself allocates.
    if RECORDING.try_with(|r| r.replace(false)).unwrap_or(false) {
        let mut trace = Vec::new();
        backtrace::trace(|frame| {
            trace.push(frame.ip() as usize);
            true
        });
        RECORDED.with(|all| all.borrow_mut().push(trace));
        RECORDING.with(|r| r.set(true));
    }
}

struct Counting;

#[allow(unsafe_code, reason = "GlobalAlloc is an unsafe trait; the only way to see allocations")]
// SAFETY: forwards all calls unchanged to the system allocator.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count_and_record();
        // SAFETY: the caller's contract is the system allocator's.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, ptr: *mut u8, layout: Layout) {
        // SAFETY: as above.
        unsafe { System.dealloc(ptr, layout) }
    }

    unsafe fn realloc(&self, ptr: *mut u8, layout: Layout, new_size: usize) -> *mut u8 {
        count_and_record();
        // SAFETY: as above.
        unsafe { System.realloc(ptr, layout, new_size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;
