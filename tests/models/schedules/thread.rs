//! Threads like those of the standard library on shuttle's. A thread may panic on purpose, which `join` returns. Any
//! other panic is a failure of the schedule.

use std::any::Any;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};

/// The payload of a deliberate panic.
struct OnPurpose;

/// Panics deliberately, without a message.
pub fn panic_on_purpose() -> ! {
    resume_unwind(Box::new(OnPurpose))
}

#[derive(Default)]
pub struct Builder(shuttle::thread::Builder);

#[derive(Debug)]
pub struct JoinHandle<T>(shuttle::thread::JoinHandle<Result<T, Box<dyn Any + Send>>>);

impl Builder {
    pub fn new() -> Self {
        Self::default()
    }

    pub fn name(self, name: String) -> Self {
        Self(self.0.name(name))
    }

    pub fn spawn<T: Send + 'static>(self, work: impl FnOnce() -> T + Send + 'static) -> std::io::Result<JoinHandle<T>> {
        let work = move || match catch_unwind(AssertUnwindSafe(work)) {
            Err(panic) if !panic.is::<OnPurpose>() => resume_unwind(panic),
            ended => ended,
        };
        self.0.spawn(work).map(JoinHandle)
    }
}

impl<T> JoinHandle<T> {
    pub fn join(self) -> Result<T, Box<dyn Any + Send>> {
        self.0.join().flatten()
    }
}
