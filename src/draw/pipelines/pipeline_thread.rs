//! [`PipelineThread`]: creates pipelines beside the draw thread, so that no frame waits for the driver's compiler.
//!
//! ```text
//! draw thread       order -> draws without it ...                 -> result of the order, in a later frame
//! pipeline thread            module, layout, pipeline, its errors
//! ```
//! Between [`PipelineThread::begin`] and [`PipelineThread::end`] the draw thread orders pipelines; otherwise it creates them
//! itself. The thread starts with the first order and ends with the renderer. It calls the device alone, never the queue.

use std::sync::atomic::{AtomicBool, AtomicU32, Ordering};
use std::sync::{Arc, OnceLock};
use std::thread::JoinHandle;

use crate::gpu::catch_errors;
use crate::sync::primitives::channel::{self, Sender};
use crate::trace;

type Job = Box<dyn FnOnce() + Send>;

/// Something that the pipeline thread creates.
#[derive(Debug)]
pub(in crate::draw) struct Order<T>(Arc<OnceLock<Result<T, String>>>);

impl<T: Clone> Order<T> {
    /// Returns what was created, or the device's error, once the thread has tried.
    fn result(&self) -> Option<Result<T, String>> {
        self.0.get().cloned()
    }

    /// Returns true if the thread has ended before it tried.
    pub(in crate::draw) fn is_abandoned(&self) -> bool {
        // The job has the other reference.
        Arc::strong_count(&self.0) == 1 && self.0.get().is_none()
    }
}

/// Counts an order as open until it is dropped, run or not.
struct OpenOrder(Arc<AtomicU32>);

impl OpenOrder {
    fn new(open: &Arc<AtomicU32>) -> Self {
        open.fetch_add(1, Ordering::AcqRel);
        Self(open.clone())
    }
}

impl Drop for OpenOrder {
    fn drop(&mut self) {
        self.0.fetch_sub(1, Ordering::AcqRel);
    }
}

/// The slot into which the thread puts a pipeline. The order counts as open until its result can be read.
struct Slot<T> {
    result: Arc<OnceLock<Result<T, String>>>,
    /// Dropped after `result`.
    _open: OpenOrder,
}

/// A running thread and the draw thread's end of its channel.
struct Running {
    /// Unbounded, since the draw thread must not block; it orders each pipeline once.
    jobs: Sender<Job>,
    thread: JoinHandle<()>,
}

/// The pipeline thread of a renderer, and whether missing pipelines are ordered from it. Owned by the draw thread.
#[derive(Default)]
pub(in crate::draw) struct PipelineThread {
    running: Option<Running>,
    /// Set by the draw thread when the renderer is dropped: the thread skips the orders that are left.
    is_stopping: Arc<AtomicBool>,
    /// The number of orders that the thread has not completed. The draw thread adds, both subtract.
    open: Arc<AtomicU32>,
    is_ordering: bool,
    /// The number of pipelines that were asked for since [`Self::begin`] and are not there.
    missing: u32,
    /// The number of ordered pipelines that are in use.
    created: u32,
}

impl PipelineThread {
    /// From now on missing pipelines are ordered.
    pub(in crate::draw) fn begin(&mut self) {
        (self.is_ordering, self.missing) = (true, 0);
    }

    /// From now on missing pipelines are created at once. Returns how many were asked for since [`Self::begin`] and are not
    /// there.
    pub(in crate::draw) fn end(&mut self) -> u32 {
        self.is_ordering = false;
        self.missing
    }

    /// Returns true while missing pipelines are ordered.
    pub(in crate::draw) fn is_ordering(&self) -> bool {
        self.is_ordering
    }

    /// Returns the number of orders that the thread has not completed.
    pub(in crate::draw) fn open(&self) -> u32 {
        self.open.load(Ordering::Acquire)
    }

    /// Returns the number of pipelines that the thread has created and that are in use.
    pub(in crate::draw) fn created(&self) -> u32 {
        self.created
    }

    /// Returns what an order has created, to be used from now on. Counts it as missing while the thread has not tried.
    pub(in crate::draw) fn take<T: Clone>(&mut self, order: &Order<T>) -> Option<Result<T, String>> {
        let result = order.result();
        match &result {
            Some(created) => self.created += u32::from(created.is_ok()),
            None => self.missing += 1,
        }
        result
    }

    /// Has a pipeline created. Errors of the device begin with `label`.
    pub(in crate::draw) fn order<T: Send + Sync + 'static>(
        &mut self,
        device: &wgpu::Device,
        label: String,
        create: impl FnOnce(&wgpu::Device) -> T + Send + 'static,
    ) -> Order<T> {
        let result = Arc::new(OnceLock::new());
        let slot = Slot { result: result.clone(), _open: OpenOrder::new(&self.open) };
        let device = device.clone();
        let job: Job = Box::new(move || {
            // The whole slot is moved in, so that the order stays open until the job ends.
            let slot = slot;
            let _span = trace::span("create pipeline");
            let (created, error) = catch_errors(&device, || create(&device));
            let _ = slot.result.set(error.map_or(Ok(created), |error| Err(format!("{label}: {error}"))));
        });
        if self.running.is_none() {
            self.running = start(self.is_stopping.clone());
        }
        let unsent = match &self.running {
            Some(running) => running.jobs.send(job).err().map(|unsent| unsent.0),
            None => Some(job),
        };
        // Without a thread, or after it has died, the draw thread creates it.
        if let Some(job) = unsent {
            job();
        }
        Order(result)
    }
}

/// Starts the thread; `None` if the system has none left.
fn start(is_stopping: Arc<AtomicBool>) -> Option<Running> {
    let (jobs, orders) = channel::unbounded::<Job>();
    let work = move || {
        while let Ok(job) = orders.recv() {
            if !is_stopping.load(Ordering::Acquire) {
                job();
            }
        }
    };
    match std::thread::Builder::new().name("pipelines".to_owned()).spawn(work) {
        Ok(thread) => Some(Running { jobs, thread }),
        Err(error) => {
            log::warn!("the draw thread creates all pipelines: {error}");
            None
        }
    }
}

impl Drop for PipelineThread {
    fn drop(&mut self) {
        self.is_stopping.store(true, Ordering::Release);
        if let Some(Running { jobs, thread }) = self.running.take() {
            drop(jobs);
            // The hook has reported a panic.
            let _ = thread.join();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gpu::{AdapterChoice, ContextTraits, GraphicsContext};

    fn device() -> wgpu::Device {
        let traits = ContextTraits { size_px: [4, 4], adapter: AdapterChoice::Noop, ..ContextTraits::default() };
        GraphicsContext::new_offscreen(&traits).unwrap().device().clone()
    }

    #[test]
    fn orders_are_completed_by_another_thread_and_counted() {
        let (device, mut thread) = (device(), PipelineThread::default());
        let (go, wait) = channel::bounded::<()>(1);
        thread.begin();
        let order = thread.order(&device, "name".to_owned(), move |_| {
            wait.recv().unwrap();
            std::thread::current().name().map(str::to_owned)
        });
        assert!(thread.take(&order).is_none());
        assert_eq!((thread.end(), thread.open(), thread.created()), (1, 1, 0));
        go.send(()).unwrap();
        while thread.open() > 0 {
            std::thread::yield_now();
        }
        assert_eq!(thread.take(&order), Some(Ok(Some("pipelines".to_owned()))));
        thread.begin();
        assert_eq!((thread.end(), thread.created()), (0, 1));
    }

    /// The draw thread creates what a thread that has died leaves.
    #[test]
    fn thread_that_dies_leaves_no_order_open() {
        let (device, mut thread) = (device(), PipelineThread::default());
        let fail = |_: &wgpu::Device| -> u32 { std::panic::panic_any("on purpose") };
        let order = thread.order(&device, String::new(), fail);
        thread.running.take().unwrap().thread.join().unwrap_err();
        assert!(order.is_abandoned() && order.result().is_none() && thread.open() == 0);
        let (jobs, _) = channel::unbounded();
        thread.running = Some(Running { jobs, thread: std::thread::spawn(|| {}) });
        let order = thread.order(&device, String::new(), |_| 1);
        assert_eq!((thread.take(&order), thread.open()), (Some(Ok(1)), 0));
    }

    #[test]
    fn renderer_that_ends_waits_for_one_order() {
        let (device, mut thread, (go, wait)) = (device(), PipelineThread::default(), channel::bounded::<()>(1));
        let orders =
            [wait.clone(), wait].map(|wait| thread.order(&device, String::new(), move |_| wait.recv().is_ok()));
        let stopping = thread.is_stopping.clone();
        let dropped = std::thread::spawn(move || drop(thread));
        while !stopping.load(Ordering::Acquire) {
            std::thread::yield_now();
        }
        // Fails if the thread has skipped both orders.
        let _ = go.send(());
        dropped.join().unwrap();
        let [first, second] = &orders;
        // The thread may have found that it must end before it began.
        assert!(second.is_abandoned() && (first.is_abandoned() || first.result() == Some(Ok(true))));
    }
}
