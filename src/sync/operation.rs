//! [`Operation`] and [`OperationQueue`]: what a thread is to do, once or again and again.

use std::collections::VecDeque;
use std::sync::PoisonError;

use super::primitives::{Arc, Condvar, Mutex, MutexGuard};

/// Something done to an object of a thread: a graphics context, a camera, a scene.
pub trait Operation<T>: Send + Sync {
    /// Tells it from others in its queue.
    fn name(&self) -> &str;

    /// Stays in the queue after it ran, to run again in its turn.
    fn keep(&self) -> bool {
        false
    }

    /// Does it, on the thread of the object.
    fn run(&self, object: &mut T);

    /// Ends it early where it waits, called from another thread when its own is to stop. It must not wait again.
    fn release(&self) {}
}

/// A closure as an operation.
struct Closure<F> {
    name: String,
    keep: bool,
    /// Locked by the one thread that runs it.
    work: Mutex<F>,
}

impl<T, F: FnMut(&mut T) + Send> Operation<T> for Closure<F> {
    fn name(&self) -> &str {
        &self.name
    }

    fn keep(&self) -> bool {
        self.keep
    }

    fn run(&self, object: &mut T) {
        // One that panicked half way is not to be trusted again.
        if let Ok(mut work) = self.work.lock() {
            work(object);
        }
    }
}

struct Waiting<T> {
    /// With their numbers, which rise.
    operations: VecDeque<(u64, Arc<dyn Operation<T>>)>,
    /// Number of the next that is put at the end.
    next: u64,
    /// What was taken last and has not returned.
    current: Option<Arc<dyn Operation<T>>>,
    closed: bool,
}

impl<T> Waiting<T> {
    fn push(&mut self, operation: Arc<dyn Operation<T>>) {
        self.operations.push_back((self.next, operation));
        self.next += 1;
    }

    /// Takes the first, which comes again at the end where it is kept.
    fn take(&mut self) -> Option<Arc<dyn Operation<T>>> {
        let (_, operation) = self.operations.pop_front()?;
        if operation.keep() {
            self.push(operation.clone());
        }
        Some(operation)
    }
}

/// Operations in the order to be done; those that are kept come again and again.
pub struct OperationQueue<T> {
    /// Written by who adds and removes and by the thread that takes.
    waiting: Mutex<Waiting<T>>,
    changed: Condvar,
}

impl<T> Default for OperationQueue<T> {
    fn default() -> Self {
        let waiting = Waiting { operations: VecDeque::new(), next: 0, current: None, closed: false };
        Self { waiting: Mutex::new(waiting), changed: Condvar::new() }
    }
}

impl<T> OperationQueue<T> {
    /// An empty one.
    pub fn new() -> Self {
        Self::default()
    }

    fn waiting(&self) -> MutexGuard<'_, Waiting<T>> {
        // No operation runs while it is locked.
        self.waiting.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Adds an operation at the end.
    pub fn add(&self, operation: Arc<dyn Operation<T>>) {
        self.waiting().push(operation);
        self.changed.notify_one();
    }

    /// Takes out all operations of a name; one that is running ends its turn.
    pub fn remove(&self, name: &str) {
        self.waiting().operations.retain(|(_, o)| o.name() != name);
    }

    /// Takes out all operations.
    pub fn remove_all(&self) {
        self.waiting().operations.clear();
    }

    /// Operations that will run, one under way that is kept included.
    pub fn len(&self) -> usize {
        self.waiting().operations.len()
    }

    /// True when there is nothing to do.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Takes the next operation, waiting for one to be added; `None` once the queue is closed. The one taken before
    /// has ended.
    pub fn next_operation(&self) -> Option<Arc<dyn Operation<T>>> {
        let mut waiting = self.waiting();
        waiting.current = None;
        loop {
            if waiting.closed {
                return None;
            }
            if let Some(operation) = waiting.take() {
                waiting.current = Some(operation.clone());
                return Some(operation);
            }
            waiting = self.changed.wait(waiting).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Runs what is there now, each once, but for what is removed before its turn; waits for nothing.
    pub fn run_operations(&self, object: &mut T) {
        let end = self.waiting().next;
        loop {
            let mut waiting = self.waiting();
            if waiting.operations.front().is_none_or(|(number, _)| *number >= end) {
                return;
            }
            let operation = waiting.take();
            drop(waiting);
            operation.iter().for_each(|operation| operation.run(object));
        }
    }

    /// Nothing is taken any more; what is under way goes on, and what waits in it is not released. For queues whose
    /// operations wait for each other: those released by the first to be closed would otherwise run again.
    pub fn end(&self) {
        self.waiting().closed = true;
        self.changed.notify_all();
    }

    /// Nothing is taken any more: who waits for an operation gets `None`, and all operations, one under way included,
    /// are released.
    pub fn close(&self) {
        let mut waiting = self.waiting();
        waiting.closed = true;
        let mut all: Vec<_> = waiting.operations.drain(..).map(|(_, operation)| operation).collect();
        all.extend(waiting.current.take());
        drop(waiting);
        self.changed.notify_all();
        for operation in all {
            operation.release();
        }
    }
}

impl<T: 'static> OperationQueue<T> {
    /// Adds a closure as an operation.
    pub fn add_fn(&self, name: &str, keep: bool, work: impl FnMut(&mut T) + Send + 'static) {
        self.add(Arc::new(Closure { name: name.to_owned(), keep, work: Mutex::new(work) }));
    }
}

impl<T> std::fmt::Debug for OperationQueue<T> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let waiting = self.waiting();
        f.debug_list().entries(waiting.operations.iter().map(|(_, o)| o.name())).finish()
    }
}
