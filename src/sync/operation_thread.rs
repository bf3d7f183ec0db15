//! [`OperationThread`]: a thread that owns an object and does to it what its queue says.

use super::operation::{Operation, OperationQueue};
use super::primitives::{Arc, Builder, JoinHandle};

/// A thread ended by a panic, and with it the object it owned.
#[derive(Debug, thiserror::Error)]
#[error("thread {name} panicked")]
pub struct Panicked {
    /// Name of the thread.
    pub name: String,
}

/// Runs the operations of a queue on an object of its own. Dropped, it is cancelled and waited for.
#[derive(Debug)]
pub struct OperationThread<T: Send + 'static> {
    name: String,
    queue: Arc<OperationQueue<T>>,
    join: Option<JoinHandle<T>>,
}

/// Releases what others wait for together with a thread that panics, once its object is gone.
struct CloseOnPanic<T>(Arc<OperationQueue<T>>);

impl<T> Drop for CloseOnPanic<T> {
    fn drop(&mut self) {
        // One that ended because it was told to is closed by who told it.
        if std::thread::panicking() {
            self.0.close();
        }
    }
}

impl<T: Send + 'static> OperationThread<T> {
    /// Starts a thread on an object and the operations that are to be there from the start.
    pub fn start(
        name: &str,
        object: T,
        operations: impl IntoIterator<Item = Arc<dyn Operation<T>>>,
    ) -> std::io::Result<Self> {
        let queue = Arc::new(OperationQueue::new());
        for operation in operations {
            queue.add(operation);
        }
        let of_thread = queue.clone();
        let work = move || {
            // Declared, and so dropped, in this order: whoever is let go finds the object's ends gone.
            let closing = CloseOnPanic(of_thread);
            let mut object = object;
            while let Some(operation) = closing.0.next_operation() {
                operation.run(&mut object);
            }
            object
        };
        let join = Builder::new().name(name.to_owned()).spawn(work)?;
        Ok(Self { name: name.to_owned(), queue, join: Some(join) })
    }

    /// What it does; operations may be added and removed while it runs.
    pub fn queue(&self) -> &OperationQueue<T> {
        &self.queue
    }

    /// Adds an operation at the end.
    pub fn add(&self, operation: Arc<dyn Operation<T>>) {
        self.queue.add(operation);
    }

    /// Tells the thread to end after the operation under way, which may wait for long; does not wait itself.
    /// [`Self::cancel`] is to follow.
    pub fn end(&self) {
        self.queue.end();
    }

    /// Tells the thread to end after the operation under way, which is released; does not wait.
    pub fn cancel(&self) {
        self.queue.close();
    }

    /// Ends the thread and takes its object back. Waits for the operation under way.
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
