//! The compile thread under shuttle: the library's own file, between a thread that draws and a stand-in for the
//! adapter's staging memory. A schedule fails if an upload is lost, an operation ends before its bytes, or a thread
//! waits forever.

#[path = "../../src/gpu/upload/compile_thread.rs"]
mod compile_thread;

/// An operation whose slots are allocated.
pub struct Compiled {
    ticket: u64,
}

/// The units of one byte of an operation.
mod resource_upload {
    use super::staging::StagingWriter;

    pub struct Units {
        pub count: usize,
        pub unit_bytes: usize,
    }

    pub struct Upload {
        pub ticket: u64,
        pub units: usize,
    }

    impl Upload {
        pub fn remaining(&self) -> Option<Units> {
            (self.units > 0).then_some(Units { count: self.units, unit_bytes: 1 })
        }

        pub fn bytes(&self) -> u64 {
            self.units as u64
        }

        pub fn has_rows(&self) -> bool {
            false
        }

        pub fn write(&mut self, into: &mut StagingWriter, _scratch: &mut Vec<u8>, count: usize) -> u64 {
            into.write(self.ticket, count);
            self.units -= count;
            count as u64
        }
    }
}

/// A device that refuses memory a number of times.
mod memory {
    use shuttle::sync::Arc;
    use shuttle::sync::atomic::AtomicUsize;

    use super::staging::Device;

    #[derive(Clone)]
    pub struct Memory {
        pub device: Device,
        pub refusals: Arc<AtomicUsize>,
    }

    impl Memory {
        pub fn device(&self) -> &Device {
            &self.device
        }
    }
}

/// Buffers for two units each, and commands that list the operations of the copied units.
mod staging {
    use shuttle::sync::Arc;
    use shuttle::sync::atomic::{AtomicUsize, Ordering};

    use super::memory::Memory;

    /// Counts the existing buffers. After it is lost, some more can be written.
    #[derive(Clone)]
    pub struct Device {
        pub there: Arc<AtomicUsize>,
        pub writable: Arc<AtomicUsize>,
    }

    pub struct Buffer(Arc<AtomicUsize>);

    impl Drop for Buffer {
        fn drop(&mut self) {
            self.0.fetch_sub(1, Ordering::SeqCst);
        }
    }

    #[derive(Default)]
    pub struct CommandBuffer(pub Vec<u64>);

    pub fn create_buffer(memory: &Memory, _bytes: u64) -> Result<Buffer, String> {
        let is_refused = |left: usize| left.checked_sub(1);
        if memory.refusals.fetch_update(Ordering::SeqCst, Ordering::SeqCst, is_refused).is_ok() {
            return Err("no memory".to_owned());
        }
        let there = &memory.device().there;
        assert!(there.fetch_add(1, Ordering::SeqCst) < super::MAX_STAGINGS);
        Ok(Buffer(there.clone()))
    }

    pub struct StagingWriter {
        staging: Buffer,
        commands: CommandBuffer,
    }

    impl StagingWriter {
        pub fn new(device: &Device, staging: Buffer) -> Option<Self> {
            let is_writable = |left: usize| left.checked_sub(1);
            device.writable.fetch_update(Ordering::SeqCst, Ordering::SeqCst, is_writable).ok()?;
            Some(Self { staging, commands: CommandBuffer::default() })
        }

        pub fn free_units(&self, _unit_bytes: usize, _has_rows: bool) -> usize {
            2 - self.commands.0.len()
        }

        pub fn write(&mut self, ticket: u64, count: usize) {
            assert!(count <= self.free_units(1, false));
            self.commands.0.extend((0..count).map(|_| ticket));
        }

        pub fn finish(self) -> (CommandBuffer, Buffer) {
            (self.commands, self.staging)
        }
    }

    /// Submitted buffers are mapped by the next poll.
    #[derive(Default)]
    pub struct MapRequests(Vec<Buffer>);

    impl MapRequests {
        pub fn request(&mut self, staging: Buffer) {
            self.0.push(staging);
        }

        pub fn take_mapped(&mut self) -> impl Iterator<Item = Buffer> + '_ {
            self.0.drain(..)
        }
    }
}

use std::time::Duration;

use crate::schedules::check;
use compile_thread::{Batch, CompileThread};
use memory::Memory;
use resource_upload::Upload;
use shuttle::sync::Arc;
use shuttle::thread;
use staging::{Buffer, Device};

/// The units of the operations, in order. The first needs more buffers than the limit.
const UNITS: [usize; 4] = [19, 0, 1, 4];
/// The limit of staging buffers.
const MAX_STAGINGS: usize = 8;

/// Creates a device with this many writable buffers, whose memory is refused this many times.
fn memory(writable: usize, refusals: usize) -> Memory {
    let device = Device { there: Arc::default(), writable: Arc::new(writable.into()) };
    Memory { device, refusals: Arc::new(refusals.into()) }
}

/// Sends an operation as `compile_thread_uploads.rs` does: its uploads, then its end.
fn send(thread: &mut CompileThread, ticket: usize) {
    if UNITS[ticket] > 0 {
        thread.send_upload(Upload { ticket: ticket as u64, units: UNITS[ticket] });
    }
    thread.send_end(Compiled { ticket: ticket as u64 });
}

/// The draw thread's side.
#[derive(Default)]
struct Drawn {
    /// Tickets of the copied units.
    copied: Vec<u64>,
    finished: Vec<u64>,
    /// The commands that are recorded and not submitted.
    recorded: Vec<Buffer>,
    refusals: usize,
}

impl Drawn {
    fn take(&mut self, batch: Batch) {
        self.copied.extend(batch.commands.into_iter().flat_map(|commands| commands.0));
        self.recorded.extend(batch.staging);
        self.refusals += usize::from(batch.allocation_error.is_some());
        for Compiled { ticket } in batch.finished {
            let there = self.copied.iter().filter(|of| **of == ticket).count();
            assert_eq!(there, UNITS[ticket as usize], "operation {ticket} is complete");
            self.finished.push(ticket);
        }
    }

    /// Submits the recorded commands to the adapter.
    fn submit(&mut self, thread: &mut CompileThread) {
        self.recorded.drain(..).for_each(|staging| thread.request_map(staging));
    }
}

/// Frames submit the finished uploads. The thread, out of staging memory, continues with buffers that are mapped again,
/// or retries an allocation that the adapter refused.
#[test]
fn all_operations_end_in_order_after_their_bytes() {
    check(|| {
        let mut thread = CompileThread::start(&memory(usize::MAX, 2)).unwrap();
        let mut drawn = Drawn::default();
        let mut sent = 0;
        while drawn.finished.len() < UNITS.len() {
            thread.return_mapped();
            if sent < UNITS.len() {
                send(&mut thread, sent);
                sent += 1;
            }
            let mut patience = Duration::from_millis(1);
            while let Some(batch) = thread.receive_batch(patience) {
                drawn.take(batch);
                patience = Duration::ZERO;
            }
            assert!(!thread.has_stopped());
            drawn.submit(&mut thread);
        }
        assert_eq!((drawn.finished, thread.bytes_in_flight(), thread.operations_in_flight()), (vec![0, 1, 2, 3], 0, 0));
        assert_eq!((drawn.copied.len(), drawn.refusals), (UNITS.iter().sum::<usize>(), 2));
    });
}

/// The thread may be ended at any time: while it waits for work, or for staging memory that is never returned.
#[test]
fn thread_ends_in_any_wait() {
    check(|| {
        let mut thread = CompileThread::start(&memory(usize::MAX, 0)).unwrap();
        send(&mut thread, 0);
        thread::yield_now();
        drop(thread);
        drop(CompileThread::start(&memory(usize::MAX, 0)).unwrap());
    });
}

/// The device is lost after some buffers. The draw thread notices it and does not wait.
#[test]
fn ended_thread_is_noticed() {
    check(|| {
        let mut thread = CompileThread::start(&memory(3, 0)).unwrap();
        let mut drawn = Drawn::default();
        send(&mut thread, 0);
        while !thread.has_stopped() {
            thread.return_mapped();
            if let Some(batch) = thread.receive_batch(Duration::from_millis(1)) {
                drawn.take(batch);
            }
            drawn.submit(&mut thread);
        }
        assert!(drawn.finished.is_empty() && drawn.copied.len() <= 6);
        send(&mut thread, 3);
        assert!(thread.receive_batch(Duration::ZERO).is_none_or(|batch| batch.finished.is_empty()));
    });
}
