//! The compile thread of a context that has one: fills staging buffers and records the copies out of them, so that the
//! thread that draws has them to submit and nothing to copy.
//!
//! ```text
//! draw thread      places allocated | uploads ->          | batches -> submitted with the next frame -> staging mapped again
//! compile thread                      bytes into staging, copies recorded -> batch
//! ```
//! Pools, tables and the queue stay the draw thread's: this one gets textures and buffers whose places no frame reads yet,
//! and never calls the queue (writing by it while another thread submits deadlocks in wgpu 30.0.1, upstream issue 9460).
//! All goes through one FIFO, so that what shares an earlier operation's place is told to be there after it.
//!
//! `tests/compile_models.rs` runs this very file under thousands of schedules.

use std::time::Duration;

use super::Compiled;
use super::memory::Memory;
use super::staging::{self, Buffer, CommandBuffer, Filling, Mapping};
use super::uploads::Upload;
use crate::sync::primitives::channel::{self, Receiver, RecvTimeoutError, Sender, TryRecvError};
use crate::sync::primitives::{Builder, JoinHandle};
use crate::trace;

/// Bytes of a staging buffer.
const STAGING_BYTES: u64 = 2 << 20;
/// Staging buffers that a context may have.
const MOST_STAGINGS: usize = 8;
/// Those that are kept while there is nothing to do.
const KEPT_STAGINGS: usize = 2;

/// Until memory is asked for again that there was none of.
const RETRY: Duration = Duration::from_millis(50);

/// What the thread is given.
enum Work {
    Upload(Upload),
    /// All uploads of the operation were sent before.
    Finish(Compiled),
}

/// What comes back: one staging buffer's worth.
pub(super) struct Batch {
    pub(super) commands: Option<CommandBuffer>,
    /// To be mapped again once the commands were submitted.
    pub(super) staging: Option<Buffer>,
    /// Operations that are complete with this batch.
    pub(super) finished: Vec<Compiled>,
    pub(super) bytes: u64,
    /// Why there is no staging buffer; then there is nothing else.
    pub(super) refusal: Option<String>,
}

/// The draw thread's end.
pub(super) struct CompileThread {
    /// `None` only while dropped.
    work: Option<Sender<Work>>,
    batches: Receiver<Batch>,
    /// Mapped staging buffers on their way back.
    free: Option<Sender<Buffer>>,
    /// Submitted, and asked to be mapped.
    mapping: Mapping,
    thread: Option<JoinHandle<()>>,
    /// Bytes sent that have not come back.
    bytes_in_flight: u64,
    /// Operations sent that have not come back.
    pub(super) operations: usize,
    /// It has stopped although nobody told it to.
    pub(super) has_died: bool,
}

impl CompileThread {
    pub(super) fn start(memory: &Memory) -> std::io::Result<Self> {
        // Bounded by what the draw thread lets be in flight.
        let (work, work_in) = channel::unbounded();
        let (batches_out, batches) = channel::unbounded();
        let (free, free_in) = channel::unbounded();
        let worker = Worker {
            memory: memory.clone(),
            work: work_in,
            batches: batches_out,
            free: free_in,
            idle: Vec::new(),
            made: 0,
        };
        let thread = Builder::new().name("compile".to_owned()).spawn(move || worker.run())?;
        Ok(Self {
            work: Some(work),
            batches,
            free: Some(free),
            mapping: Mapping::default(),
            thread: Some(thread),
            bytes_in_flight: 0,
            operations: 0,
            has_died: false,
        })
    }

    fn send(&mut self, work: Work) {
        self.has_died |= self.work.as_ref().is_none_or(|out| out.send(work).is_err());
    }

    pub(super) fn upload(&mut self, upload: Upload) {
        self.bytes_in_flight += upload.bytes();
        self.send(Work::Upload(upload));
    }

    pub(super) fn finish(&mut self, compiled: Compiled) {
        self.operations += 1;
        self.send(Work::Finish(compiled));
    }

    /// Bytes sent that have not come back.
    pub(super) fn bytes_in_flight(&self) -> u64 {
        self.bytes_in_flight
    }

    /// A batch that is ready; waits for one where `patience` says so.
    pub(super) fn batch(&mut self, patience: Duration) -> Option<Batch> {
        let batch = if patience.is_zero() {
            match self.batches.try_recv() {
                Ok(batch) => Some(batch),
                Err(TryRecvError::Empty) => None,
                Err(TryRecvError::Disconnected) => {
                    self.has_died = true;
                    None
                }
            }
        } else {
            match self.batches.recv_timeout(patience) {
                Ok(batch) => Some(batch),
                Err(RecvTimeoutError::Timeout) => None,
                Err(RecvTimeoutError::Disconnected) => {
                    self.has_died = true;
                    None
                }
            }
        }?;
        self.bytes_in_flight = self.bytes_in_flight.saturating_sub(batch.bytes);
        self.operations = self.operations.saturating_sub(batch.finished.len());
        Some(batch)
    }

    /// Asks for a staging buffer to be mapped again, after its commands were submitted.
    pub(super) fn submitted(&mut self, staging: Buffer) {
        self.mapping.ask(staging);
    }

    /// Gives back what was mapped since.
    pub(super) fn give_back(&mut self) {
        for staging in self.mapping.mapped() {
            if let Some(free) = &self.free {
                // A thread that has ended shows where batches are taken.
                let _ = free.send(staging);
            }
        }
    }
}

impl Drop for CompileThread {
    fn drop(&mut self) {
        (self.work, self.free) = (None, None);
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            log::error!("the compile thread panicked");
        }
    }
}

struct Worker {
    memory: Memory,
    work: Receiver<Work>,
    batches: Sender<Batch>,
    free: Receiver<Buffer>,
    /// Mapped.
    idle: Vec<Buffer>,
    /// Staging buffers that there are.
    made: usize,
}

impl Worker {
    fn run(mut self) {
        let mut filling: Option<Filling> = None;
        let mut bytes = 0;
        let (mut finished, mut scratch) = (Vec::new(), Vec::new());
        loop {
            let work = match self.work.try_recv() {
                Ok(work) => work,
                Err(TryRecvError::Disconnected) => return,
                Err(TryRecvError::Empty) => {
                    let is_rest = filling.is_some() || !finished.is_empty();
                    if is_rest && !self.send(&mut filling, &mut bytes, &mut finished) {
                        return;
                    }
                    self.trim();
                    match self.work.recv() {
                        Ok(work) => work,
                        Err(_) => return,
                    }
                }
            };
            let _span = trace::span("upload");
            match work {
                Work::Finish(compiled) => finished.push(compiled),
                Work::Upload(mut upload) => {
                    while let Some((units, unit_bytes)) = upload.left() {
                        let Some(into) = &mut filling else {
                            filling = self.staging();
                            if filling.is_none() {
                                return;
                            }
                            continue;
                        };
                        let room = into.room(unit_bytes, upload.has_rows());
                        if room > 0 {
                            bytes += upload.write(into, &mut scratch, units.min(room));
                        } else if !self.send(&mut filling, &mut bytes, &mut finished) {
                            return;
                        }
                    }
                }
            }
        }
    }

    /// Sends what there is; false where nobody takes it any more.
    fn send(&self, filling: &mut Option<Filling>, bytes: &mut u64, finished: &mut Vec<Compiled>) -> bool {
        let (commands, staging) = filling.take().map(Filling::finish).unzip();
        let (finished, bytes) = (std::mem::take(finished), std::mem::take(bytes));
        let batch = Batch { commands, staging, finished, bytes, refusal: None };
        self.batches.send(batch).is_ok()
    }

    /// A staging buffer to fill; waits where there are enough. `None` where none comes any more.
    fn staging(&mut self) -> Option<Filling> {
        self.idle.extend(self.free.try_iter());
        let staging = match self.idle.pop() {
            Some(staging) => staging,
            None if self.made < MOST_STAGINGS => self.another()?,
            None => {
                let _span = trace::span("wait for staging");
                self.free.recv().ok()?
            }
        };
        Filling::new(self.memory.device(), staging)
    }

    /// One more staging buffer; where there is no memory for it, one that comes back, or one after a while.
    fn another(&mut self) -> Option<Buffer> {
        loop {
            match staging::make(&self.memory, STAGING_BYTES) {
                Ok(staging) => {
                    self.made += 1;
                    return Some(staging);
                }
                Err(error) => {
                    let refusal = Some(error);
                    let batch = Batch { commands: None, staging: None, finished: Vec::new(), bytes: 0, refusal };
                    self.batches.send(batch).ok()?;
                }
            }
            let _span = trace::span("wait for staging");
            match self.free.recv_timeout(RETRY) {
                Ok(staging) => return Some(staging),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return None,
            }
        }
    }

    /// Frees what is too much while nothing is to be done.
    fn trim(&mut self) {
        self.idle.extend(self.free.try_iter());
        let spare = self.idle.len().saturating_sub(KEPT_STAGINGS);
        self.idle.drain(..spare);
        self.made -= spare;
    }
}
