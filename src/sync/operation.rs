//! [`Operation`] and [`OperationQueue`]: work for a thread, done once or repeatedly.

use std::collections::VecDeque;
use std::sync::PoisonError;

use super::primitives::{Arc, Condvar, Mutex, MutexGuard};

/// Work on an object that a thread owns: a graphics context, a camera, a scene.
pub trait Operation<T>: Send + Sync {
    /// Returns the name by which it is removed from a queue.
    fn name(&self) -> &str;

    /// Returns true if it stays in the queue after it ran, to run again.
    fn keep(&self) -> bool {
        false
    }

    /// Runs on the thread of the object.
    fn run(&self, object: &mut T);

    /// Cuts its waits short, and all later ones. Called from another thread when the operation's thread must stop.
    fn release(&self) {}
}

impl<T> std::fmt::Debug for dyn Operation<T> {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Operation").field("name", &self.name()).field("keep", &self.keep()).finish()
    }
}

/// A closure as an operation.
struct Closure<F> {
    name: String,
    keep: bool,
    /// Locked while it runs, by the one thread that runs it.
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
        // A closure that panicked half way is not called again.
        if let Ok(mut work) = self.work.lock() {
            work(object);
        }
    }
}

struct State<T> {
    /// Operations with their numbers, in ascending order.
    operations: VecDeque<(u64, Arc<dyn Operation<T>>)>,
    /// Number of the next operation.
    next: u64,
    /// The operation that [`OperationQueue::next_operation`] returned last, until the next call.
    current: Option<Arc<dyn Operation<T>>>,
    closed: bool,
}

impl<T> State<T> {
    fn push(&mut self, operation: Arc<dyn Operation<T>>) {
        self.operations.push_back((self.next, operation));
        self.next += 1;
    }

    /// Takes the first operation and puts it back at the end if it is kept.
    fn take(&mut self) -> Option<Arc<dyn Operation<T>>> {
        let (_, operation) = self.operations.pop_front()?;
        if operation.keep() {
            self.push(operation.clone());
        }
        Some(operation)
    }
}

/// A queue of operations in first-in, first-out order. Those that are kept are run repeatedly.
pub struct OperationQueue<T> {
    /// Written by threads that add and remove, and by the thread that runs the operations.
    state: Mutex<State<T>>,
    changed: Condvar,
}

impl<T> Default for OperationQueue<T> {
    fn default() -> Self {
        let state = State { operations: VecDeque::new(), next: 0, current: None, closed: false };
        Self { state: Mutex::new(state), changed: Condvar::new() }
    }
}

impl<T> OperationQueue<T> {
    /// Creates an empty queue.
    pub fn new() -> Self {
        Self::default()
    }

    fn state(&self) -> MutexGuard<'_, State<T>> {
        // No operation runs while the lock is held.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Adds an operation at the end.
    pub fn add(&self, operation: Arc<dyn Operation<T>>) {
        self.state().push(operation);
        self.changed.notify_one();
    }

    /// Removes all operations of a name; one that is running completes.
    pub fn remove(&self, name: &str) {
        self.state().operations.retain(|(_, o)| o.name() != name);
    }

    /// Removes all operations.
    pub fn remove_all(&self) {
        self.state().operations.clear();
    }

    /// Returns the number of operations that will run, including a running one that is kept.
    pub fn len(&self) -> usize {
        self.state().operations.len()
    }

    /// Returns true if there is nothing to do.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Takes the next operation and waits for one if the queue is empty. Returns `None` once the queue is closed. Marks the
    /// operation that was taken before as finished.
    pub fn next_operation(&self) -> Option<Arc<dyn Operation<T>>> {
        let mut state = self.state();
        state.current = None;
        loop {
            if state.closed {
                return None;
            }
            if let Some(operation) = state.take() {
                state.current = Some(operation.clone());
                return Some(operation);
            }
            state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Runs each operation that is queued now once, except those that are removed before their turn. Does not wait.
    pub fn run_operations(&self, object: &mut T) {
        let end = self.state().next;
        loop {
            let mut state = self.state();
            if state.operations.front().is_none_or(|(number, _)| *number >= end) {
                return;
            }
            let operation = state.take();
            drop(state);
            operation.iter().for_each(|operation| operation.run(object));
        }
    }

    /// Stops the queue without releasing operations: none is taken from now on, and a running one completes. For queues whose
    /// operations wait for each other: those released by the first closed queue would otherwise run again.
    pub fn end(&self) {
        self.state().closed = true;
        self.changed.notify_all();
    }

    /// Closes the queue: a thread that waits for an operation gets `None`, and all operations are released, including a
    /// running one.
    pub fn close(&self) {
        let mut state = self.state();
        state.closed = true;
        let mut all: Vec<_> = state.operations.drain(..).map(|(_, operation)| operation).collect();
        all.extend(state.current.take());
        drop(state);
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
        let state = self.state();
        f.debug_list().entries(state.operations.iter().map(|(_, o)| o.name())).finish()
    }
}
