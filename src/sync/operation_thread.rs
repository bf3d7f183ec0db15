//! [`OperationThread`]: a thread that owns an object and runs the operations of a queue on it.

use super::operation::{Operation, OperationQueue};
use super::primitives::{Arc, Builder, JoinHandle};

/// The error for a thread that panicked; the object that it owned is lost.
#[derive(Debug, thiserror::Error)]
#[error("thread {name} panicked")]
pub struct Panicked {
    /// The name of the thread.
    pub name: String,
}

/// A thread that runs the operations of its queue on its object. Drop cancels it and waits for it.
#[derive(Debug)]
pub struct OperationThread<T: Send + 'static> {
    name: String,
    queue: Arc<OperationQueue<T>>,
    join: Option<JoinHandle<T>>,
}

/// Closes the queue of a thread that panics, after its object was dropped, so that threads that wait for its operations are
/// released.
struct CloseOnPanic<T>(Arc<OperationQueue<T>>);

impl<T> Drop for CloseOnPanic<T> {
    fn drop(&mut self) {
        // Without a panic the thread ended because its queue was closed already.
        if std::thread::panicking() {
            self.0.close();
        }
    }
}

impl<T: Send + 'static> OperationThread<T> {
    /// Starts a thread for an object, with its first operations.
    pub fn start(
        name: &str,
        object: T,
        operations: impl IntoIterator<Item = Arc<dyn Operation<T>>>,
    ) -> std::io::Result<Self> {
        let queue = Arc::new(OperationQueue::new());
        for operation in operations {
            queue.add(operation);
        }
        let thread_queue = queue.clone();
        let work = move || {
            // Dropped in reverse order: when waiting threads are released, the object is gone, with its channel ends.
            let closing = CloseOnPanic(thread_queue);
            let mut object = object;
            while let Some(operation) = closing.0.next_operation() {
                operation.run(&mut object);
            }
            object
        };
        let join = Builder::new().name(name.to_owned()).spawn(work)?;
        Ok(Self { name: name.to_owned(), queue, join: Some(join) })
    }

    /// Returns the queue; operations may be added and removed while the thread runs.
    pub fn queue(&self) -> &OperationQueue<T> {
        &self.queue
    }

    /// Adds an operation at the end.
    pub fn add(&self, operation: Arc<dyn Operation<T>>) {
        self.queue.add(operation);
    }

    /// Makes the thread end after the running operation, which is not released and may take long. Does not wait.
    /// [`Self::cancel`] must follow.
    pub fn end(&self) {
        self.queue.end();
    }

    /// Makes the thread end after the running operation, which is released. Does not wait.
    pub fn cancel(&self) {
        self.queue.close();
    }

    /// Ends the thread, waits for the running operation, and returns the object.
    pub fn join(mut self) -> Result<T, Panicked> {
        self.cancel();
        let panicked = || Panicked { name: self.name.clone() };
        let Some(join) = self.join.take() else { return Err(panicked()) };
        join.join().map_err(|_| panicked())
    }
}

impl<T: Send + 'static> Drop for OperationThread<T> {
    fn drop(&mut self) {
        self.cancel();
        if let Some(join) = self.join.take()
            && join.join().is_err()
        {
            log::error!("thread {} panicked", self.name);
        }
    }
}
