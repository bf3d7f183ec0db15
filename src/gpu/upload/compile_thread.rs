//! [`CompileThread`]: the compile thread of a context that has one. It fills staging buffers and records the copies from
//! them, so that the draw thread has nothing to copy and submits finished commands.
//!
//! ```text
//! draw thread      slots allocated | uploads ->           | batches -> submitted with the next frame -> staging mapped again
//! compile thread                     bytes into staging, copies recorded -> batch
//! ```
//! Pools, tables and the queue belong to the draw thread. The compile thread gets textures and buffers whose slots no frame
//! reads yet, and never calls the queue. (A write by one thread while another submits deadlocks in wgpu 30.0.1, upstream
//! issue 9460.) All uploads go through one FIFO, so that an operation that shares an earlier one's slot is reported as
//! finished after it.
//!
//! | channel | length |
//! |---|---|
//! | work, to the thread | unbounded, since the draw thread must not block; it stops to send at 32 MiB in flight, and an operation waits here instead of in the queue |
//! | batches, from the thread | one per staging buffer; a full channel blocks the compile thread alone |
//! | free staging buffers, to the thread | all staging buffers fit, so that the draw thread never blocks |
//!
//! `tests/models/compile_models.rs` compiles this file and runs it under thousands of schedules.

use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use super::resource_upload::Upload;
use super::staging::{self, Buffer, CommandBuffer, Device, MapRequests, StagingWriter};
use super::{Compiled, Memory};
use crate::sync::OperationQueue;
use crate::sync::primitives::channel::{self, Receiver, RecvTimeoutError, Sender, TryRecvError};
use crate::sync::primitives::{Arc, Builder, JoinHandle};
use crate::trace;

/// The size of a staging buffer.
const STAGING_BYTES: u64 = 2 << 20;
/// The maximum number of staging buffers of a context.
const MAX_STAGING_BUFFERS: usize = 8;
/// The number of free staging buffers that an idle thread keeps.
const MAX_IDLE_BUFFERS: usize = 2;
/// The time after which a failed allocation is tried again.
const RETRY_INTERVAL: Duration = Duration::from_millis(50);

/// A message to the thread.
enum Work {
    Upload(Upload),
    /// The end of an operation, all of whose uploads were sent before.
    End(Compiled),
    /// Runs the application's operations, each once.
    Operations(Arc<OperationQueue<Device>>),
}

/// A message from the thread: the contents of one staging buffer.
pub(super) struct Batch {
    pub(super) commands: Option<CommandBuffer>,
    /// The buffer that the commands copy from. It must be mapped again after they were submitted.
    pub(super) staging: Option<Buffer>,
    /// Operations that are complete once the commands are executed.
    pub(super) finished: Vec<Compiled>,
    pub(super) bytes: u64,
    /// The error of a staging buffer that could not be allocated. The batch is empty then.
    pub(super) allocation_error: Option<String>,
}

/// The draw thread's end of the channels. `None` only while dropped.
struct Channels {
    work: Sender<Work>,
    batches: Receiver<Batch>,
    /// Mapped staging buffers.
    free: Sender<Buffer>,
}

/// A running compile thread.
pub(super) struct CompileThread {
    /// `None` only while dropped.
    channels: Option<Channels>,
    /// Staging buffers whose commands were submitted.
    map_requests: MapRequests,
    thread: Option<JoinHandle<()>>,
    bytes_in_flight: u64,
    operations_in_flight: usize,
    /// True from when [`Work::Operations`] is sent until the thread has begun it.
    are_operations_sent: Arc<AtomicBool>,
    has_stopped: bool,
}

impl CompileThread {
    pub(super) fn start(memory: &Memory) -> std::io::Result<Self> {
        let (work, work_receiver) = channel::unbounded();
        let (batch_sender, batches) = channel::bounded(MAX_STAGING_BUFFERS);
        let (free, free_receiver) = channel::bounded(MAX_STAGING_BUFFERS);
        let are_operations_sent = Arc::new(AtomicBool::new(false));
        let worker = Worker {
            memory: memory.clone(),
            work: work_receiver,
            batches: batch_sender,
            free: free_receiver,
            idle: Vec::new(),
            buffers: 0,
            batch: OpenBatch::default(),
            are_operations_sent: are_operations_sent.clone(),
        };
        let thread = Builder::new().name("compile".to_owned()).spawn(move || worker.run())?;
        Ok(Self {
            channels: Some(Channels { work, batches, free }),
            map_requests: MapRequests::default(),
            thread: Some(thread),
            bytes_in_flight: 0,
            operations_in_flight: 0,
            are_operations_sent,
            has_stopped: false,
        })
    }

    fn send(&mut self, work: Work) {
        self.has_stopped |= self.channels.as_ref().is_none_or(|channels| channels.work.send(work).is_err());
    }

    pub(super) fn send_upload(&mut self, upload: Upload) {
        self.bytes_in_flight += upload.bytes();
        self.send(Work::Upload(upload));
    }

    /// Ends an operation. It is returned as finished with the batch of its last upload, or a later one.
    pub(super) fn send_end(&mut self, compiled: Compiled) {
        self.operations_in_flight += 1;
        self.send(Work::End(compiled));
    }

    /// Has the application's operations run once, unless the thread has not begun those that were sent before.
    pub(super) fn run_operations(&mut self, operations: &Arc<OperationQueue<Device>>) {
        if !self.are_operations_sent.swap(true, Ordering::AcqRel) {
            self.send(Work::Operations(operations.clone()));
        }
    }

    /// Returns the size of the uploads that were sent and have not returned in a batch.
    pub(super) fn bytes_in_flight(&self) -> u64 {
        self.bytes_in_flight
    }

    /// Returns the number of operations that were ended and have not returned in a batch.
    pub(super) fn operations_in_flight(&self) -> usize {
        self.operations_in_flight
    }

    /// Returns true after the thread has stopped unexpectedly, because its device is lost or because it panicked.
    pub(super) fn has_stopped(&self) -> bool {
        self.has_stopped
    }

    /// Takes the next batch, and waits for one up to `timeout`.
    pub(super) fn receive_batch(&mut self, timeout: Duration) -> Option<Batch> {
        let batches = &self.channels.as_ref()?.batches;
        let received = if timeout.is_zero() {
            batches.try_recv().map_err(|error| error == TryRecvError::Disconnected)
        } else {
            batches.recv_timeout(timeout).map_err(|error| error == RecvTimeoutError::Disconnected)
        };
        match received {
            Ok(batch) => {
                self.bytes_in_flight = self.bytes_in_flight.saturating_sub(batch.bytes);
                self.operations_in_flight = self.operations_in_flight.saturating_sub(batch.finished.len());
                Some(batch)
            }
            Err(is_disconnected) => {
                self.has_stopped |= is_disconnected;
                None
            }
        }
    }

    /// Requests that a staging buffer is mapped again, after its commands were submitted.
    pub(super) fn request_map(&mut self, staging: Buffer) {
        self.map_requests.request(staging);
    }

    /// Returns the staging buffers that were mapped since the last call to the thread.
    pub(super) fn return_mapped(&mut self) {
        for staging in self.map_requests.take_mapped() {
            if let Some(channels) = &self.channels {
                // A stopped thread is noticed when batches are received.
                let _ = channels.free.send(staging);
            }
        }
    }
}

impl Drop for CompileThread {
    fn drop(&mut self) {
        // Wakes the thread, whatever it waits for.
        self.channels = None;
        if let Some(thread) = self.thread.take()
            && thread.join().is_err()
        {
            log::error!("the compile thread panicked");
        }
    }
}

/// The batch that the thread is filling.
#[derive(Default)]
struct OpenBatch {
    writer: Option<StagingWriter>,
    bytes: u64,
    finished: Vec<Compiled>,
}

/// The thread is asked to stop: the draw thread's end of a channel is closed, or the device is lost.
struct Stopped;

struct Worker {
    memory: Memory,
    work: Receiver<Work>,
    batches: Sender<Batch>,
    free: Receiver<Buffer>,
    /// Mapped staging buffers.
    idle: Vec<Buffer>,
    /// The number of staging buffers that exist.
    buffers: usize,
    batch: OpenBatch,
    are_operations_sent: Arc<AtomicBool>,
}

impl Worker {
    fn run(mut self) {
        let mut scratch = Vec::new();
        while let Ok(work) = self.next_work() {
            match work {
                Work::End(compiled) => self.batch.finished.push(compiled),
                Work::Upload(upload) => {
                    let _span = trace::span("upload");
                    if self.upload(upload, &mut scratch).is_err() {
                        return;
                    }
                }
                Work::Operations(operations) => {
                    let _span = trace::span("operations");
                    self.are_operations_sent.store(false, Ordering::Release);
                    operations.run_operations(&mut self.memory.device().clone());
                }
            }
        }
    }

    /// Returns the next work. Before the thread waits for some, it sends the open batch and frees surplus buffers.
    fn next_work(&mut self) -> Result<Work, Stopped> {
        match self.work.try_recv() {
            Ok(work) => Ok(work),
            Err(TryRecvError::Disconnected) => Err(Stopped),
            Err(TryRecvError::Empty) => {
                if self.batch.writer.is_some() || !self.batch.finished.is_empty() {
                    self.send_batch()?;
                }
                self.trim();
                self.work.recv().map_err(|_| Stopped)
            }
        }
    }

    fn upload(&mut self, mut upload: Upload, scratch: &mut Vec<u8>) -> Result<(), Stopped> {
        while let Some(remaining) = upload.remaining() {
            let Some(writer) = &mut self.batch.writer else {
                self.batch.writer = Some(self.new_writer()?);
                continue;
            };
            let free_units = writer.free_units(remaining.unit_bytes, upload.has_rows());
            if free_units > 0 {
                self.batch.bytes += upload.write(writer, scratch, remaining.count.min(free_units));
            } else {
                self.send_batch()?;
            }
        }
        Ok(())
    }

    fn send_batch(&mut self) -> Result<(), Stopped> {
        let OpenBatch { writer, bytes, finished } = std::mem::take(&mut self.batch);
        let (commands, staging) = writer.map(StagingWriter::finish).unzip();
        let batch = Batch { commands, staging, finished, bytes, allocation_error: None };
        self.batches.send(batch).map_err(|_| Stopped)
    }

    /// Begins to fill a staging buffer. Waits for one if there are [`MAX_STAGING_BUFFERS`].
    fn new_writer(&mut self) -> Result<StagingWriter, Stopped> {
        self.idle.extend(self.free.try_iter());
        let staging = match self.idle.pop() {
            Some(staging) => staging,
            None if self.buffers < MAX_STAGING_BUFFERS => self.create_buffer()?,
            None => {
                let _span = trace::span("wait for staging");
                self.free.recv().map_err(|_| Stopped)?
            }
        };
        StagingWriter::new(self.memory.device(), staging).ok_or(Stopped)
    }

    /// Creates a staging buffer. While there is no memory, reports it, waits for a buffer to return and tries again after
    /// [`RETRY_INTERVAL`].
    fn create_buffer(&mut self) -> Result<Buffer, Stopped> {
        loop {
            match staging::create_buffer(&self.memory, STAGING_BYTES) {
                Ok(staging) => {
                    self.buffers += 1;
                    return Ok(staging);
                }
                Err(error) => {
                    let allocation_error = Some(error);
                    let batch =
                        Batch { commands: None, staging: None, finished: Vec::new(), bytes: 0, allocation_error };
                    self.batches.send(batch).map_err(|_| Stopped)?;
                }
            }
            let _span = trace::span("wait for staging");
            match self.free.recv_timeout(RETRY_INTERVAL) {
                Ok(staging) => return Ok(staging),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return Err(Stopped),
            }
        }
    }

    /// Frees surplus staging buffers while there is nothing to upload.
    fn trim(&mut self) {
        self.idle.extend(self.free.try_iter());
        let surplus = self.idle.len().saturating_sub(MAX_IDLE_BUFFERS);
        self.idle.drain(..surplus);
        self.buffers -= surplus;
    }
}
