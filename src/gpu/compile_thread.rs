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

use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, TryRecvError};

use super::Compiled;
use super::texture_pool::Rows;
use super::uploads::{Sink, Upload};
use crate::timeline;

/// Bytes of a staging buffer.
const STAGING_BYTES: u64 = 2 << 20;
/// Staging buffers that a context may have.
const MOST_STAGINGS: usize = 8;
/// Those that are kept while there is nothing to do.
const KEPT_STAGINGS: usize = 2;

const IN_FLIGHT: u8 = 0;
const MAPPED: u8 = 1;
const FAILED: u8 = 2;

/// What the thread is given.
enum Work {
    Upload(Upload),
    /// All uploads of the operation were sent before.
    Finish(Compiled),
}

/// What comes back: one staging buffer's worth.
pub(super) struct Batch {
    pub(super) commands: Option<wgpu::CommandBuffer>,
    /// To be mapped again once the commands were submitted.
    pub(super) staging: Option<wgpu::Buffer>,
    /// Operations that are complete with this batch.
    pub(super) finished: Vec<Compiled>,
    pub(super) bytes: u64,
}

/// The draw thread's end.
pub(super) struct CompileThread {
    /// `None` only while dropped.
    work: Option<Sender<Work>>,
    batches: Receiver<Batch>,
    /// Mapped staging buffers on their way back.
    free: Option<Sender<wgpu::Buffer>>,
    /// Submitted, and asked to be mapped.
    mapping: Vec<(wgpu::Buffer, Arc<AtomicU8>)>,
    thread: Option<JoinHandle<()>>,
    /// Bytes sent that have not come back.
    bytes_in_flight: u64,
    /// Operations sent that have not come back.
    pub(super) operations: usize,
    /// It has stopped although nobody told it to.
    pub(super) has_died: bool,
}

impl CompileThread {
    pub(super) fn start(device: &wgpu::Device) -> std::io::Result<Self> {
        // Bounded by what the draw thread lets be in flight.
        let (work, work_in) = crossbeam_channel::unbounded();
        let (batches_out, batches) = crossbeam_channel::unbounded();
        let (free, free_in) = crossbeam_channel::unbounded();
        let worker = Worker {
            device: device.clone(),
            work: work_in,
            batches: batches_out,
            free: free_in,
            idle: Vec::new(),
            made: 0,
        };
        let thread = std::thread::Builder::new().name("compile".to_owned()).spawn(move || worker.run())?;
        Ok(Self {
            work: Some(work),
            batches,
            free: Some(free),
            mapping: Vec::new(),
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
    pub(super) fn submitted(&mut self, staging: wgpu::Buffer) {
        let state = Arc::new(AtomicU8::new(IN_FLIGHT));
        let mapped = state.clone();
        staging.map_async(wgpu::MapMode::Write, .., move |result| {
            mapped.store(if result.is_ok() { MAPPED } else { FAILED }, Ordering::Release);
        });
        self.mapping.push((staging, state));
    }

    /// Gives back what was mapped since.
    pub(super) fn give_back(&mut self) {
        let done = |(_, state): &mut (_, Arc<AtomicU8>)| state.load(Ordering::Acquire) != IN_FLIGHT;
        for (staging, state) in self.mapping.extract_if(.., done) {
            if state.load(Ordering::Acquire) == MAPPED
                && let Some(free) = &self.free
            {
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
    device: wgpu::Device,
    work: Receiver<Work>,
    batches: Sender<Batch>,
    free: Receiver<wgpu::Buffer>,
    /// Mapped.
    idle: Vec<wgpu::Buffer>,
    /// Staging buffers that there are.
    made: usize,
}

/// A staging buffer that is being filled.
struct Filling {
    staging: wgpu::Buffer,
    view: wgpu::BufferViewMut,
    used: u64,
    encoder: wgpu::CommandEncoder,
}

/// What a row takes in a staging buffer.
fn padded(row_bytes: u64) -> u64 {
    row_bytes.next_multiple_of(u64::from(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT))
}

impl Sink for Filling {
    fn write_rows(&mut self, texture: &wgpu::Texture, rows: &Rows, data: &[u8]) {
        let row_bytes = rows.width as usize * 4;
        let stride = padded(row_bytes as u64);
        let offset = self.used;
        for (row, place) in data.chunks_exact(row_bytes).zip((offset as usize..).step_by(stride as usize)) {
            self.view.slice(place..place + row_bytes).copy_from_slice(row);
        }
        self.used += stride * u64::from(rows.count);
        self.encoder.copy_buffer_to_texture(
            wgpu::TexelCopyBufferInfo {
                buffer: &self.staging,
                layout: wgpu::TexelCopyBufferLayout {
                    offset,
                    bytes_per_row: Some(stride as u32),
                    rows_per_image: None,
                },
            },
            wgpu::TexelCopyTextureInfo {
                texture,
                mip_level: rows.level,
                origin: wgpu::Origin3d { x: 0, y: rows.first, z: rows.layer },
                aspect: wgpu::TextureAspect::All,
            },
            wgpu::Extent3d { width: rows.width, height: rows.count, depth_or_array_layers: 1 },
        );
    }

    fn write_bytes(&mut self, buffer: &wgpu::Buffer, offset: u64, data: &[u8]) {
        let from = self.used;
        self.view.slice(from as usize..from as usize + data.len()).copy_from_slice(data);
        // Rows that follow begin where textures may be copied from.
        self.used += padded(data.len() as u64);
        self.encoder.copy_buffer_to_buffer(&self.staging, from, buffer, offset, data.len() as u64);
    }
}

impl Filling {
    /// Units of so many bytes that still fit.
    fn room(&self, unit_bytes: usize, has_rows: bool) -> usize {
        let left = STAGING_BYTES.saturating_sub(self.used);
        let unit_bytes = if has_rows { padded(unit_bytes as u64) } else { unit_bytes as u64 };
        (left / unit_bytes.max(1)) as usize
    }
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
            let _span = timeline::span("upload");
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
        let (commands, staging) = match filling.take() {
            Some(Filling { staging, view, encoder, .. }) => {
                drop(view);
                staging.unmap();
                (Some(encoder.finish()), Some(staging))
            }
            None => (None, None),
        };
        let batch = Batch { commands, staging, finished: std::mem::take(finished), bytes: std::mem::take(bytes) };
        self.batches.send(batch).is_ok()
    }

    /// A staging buffer to fill; waits where there are enough. `None` where none comes any more.
    fn staging(&mut self) -> Option<Filling> {
        self.idle.extend(self.free.try_iter());
        let staging = match self.idle.pop() {
            Some(staging) => staging,
            None if self.made < MOST_STAGINGS => {
                self.made += 1;
                self.device.create_buffer(&wgpu::BufferDescriptor {
                    label: Some("staging"),
                    size: STAGING_BYTES,
                    usage: wgpu::BufferUsages::MAP_WRITE | wgpu::BufferUsages::COPY_SRC,
                    mapped_at_creation: true,
                })
            }
            None => {
                let _span = timeline::span("wait for staging");
                self.free.recv().ok()?
            }
        };
        match staging.get_mapped_range_mut(..) {
            Ok(view) => {
                let descriptor = wgpu::CommandEncoderDescriptor { label: Some("uploads") };
                let encoder = self.device.create_command_encoder(&descriptor);
                Some(Filling { staging, view, used: 0, encoder })
            }
            Err(error) => {
                // The device is lost; who draws finds out.
                log::error!("uploads: a staging buffer cannot be written: {error}");
                None
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
