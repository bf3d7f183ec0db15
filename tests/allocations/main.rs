//! Steady frames allocate nothing, and hostile contents no more than they may. The allocator of this program counts,
//! separately for each thread.
//!
//! The tests are a separate program, because a program has one global allocator.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

mod attribution;
mod cull;
mod draw;
mod frame;
mod hostile;
mod hostile_compressed;

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::{Cell, RefCell};

thread_local! {
    /// Allocations and reallocations of this thread so far.
    static COUNT: Cell<u64> = const { Cell::new(0) };
    /// Bytes that this thread has allocated and not freed. Those of other threads that it freed count as negative.
    static LIVE_BYTES: Cell<i64> = const { Cell::new(0) };
    /// Maximum of `LIVE_BYTES` since it was reset.
    static PEAK_BYTES: Cell<i64> = const { Cell::new(0) };
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

/// Returns what `work` returns, and the most bytes that this thread held at once in it beyond those before.
fn peak_bytes<T>(work: impl FnOnce() -> T) -> (T, u64) {
    let before = LIVE_BYTES.with(Cell::get);
    PEAK_BYTES.with(|peak| peak.set(before));
    let done = work();
    (done, PEAK_BYTES.with(Cell::get).saturating_sub(before) as u64)
}

fn add_live(bytes: i64) {
    let live = LIVE_BYTES.try_with(|live| {
        live.set(live.get() + bytes);
        live.get()
    });
    if let Ok(live) = live {
        let _ = PEAK_BYTES.try_with(|peak| peak.set(peak.get().max(live)));
    }
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
        add_live(layout.size() as i64);
        // SAFETY: the caller's contract is the system allocator's.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, ptr: *mut u8, layout: Layout) {
        add_live(-(layout.size() as i64));
        // SAFETY: as above.
        unsafe { System.dealloc(ptr, layout) }
    }

    unsafe fn realloc(&self, ptr: *mut u8, layout: Layout, new_size: usize) -> *mut u8 {
        count_and_record();
        // Both blocks exist while the bytes are moved.
        add_live(new_size as i64);
        add_live(-(layout.size() as i64));
        // SAFETY: as above.
        unsafe { System.realloc(ptr, layout, new_size) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;
