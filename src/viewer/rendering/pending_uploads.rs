//! [`PendingUploads`]: uploads of pages to a device, in order, with the pipelines that they need. Draw thread.

use std::collections::{HashSet, VecDeque};

use crate::gpu::CompileOperation;

/// An entry of the queue.
pub(super) enum Upload<P> {
    /// Pipelines that must be there before the operations after them begin.
    Pipelines(P),
    Compile(CompileOperation),
}

/// Uploads in the order in which they arrived; `P` describes pipelines.
pub(super) struct PendingUploads<P>(VecDeque<Upload<P>>);

impl<P> Default for PendingUploads<P> {
    fn default() -> Self {
        Self(VecDeque::new())
    }
}

impl<P> PendingUploads<P> {
    pub(super) fn push(&mut self, upload: Upload<P>) {
        self.0.push_back(upload);
    }

    /// Takes the first one.
    pub(super) fn pop(&mut self) -> Option<Upload<P>> {
        self.0.pop_front()
    }

    /// Puts it back at the front.
    pub(super) fn put_back(&mut self, upload: Upload<P>) {
        self.0.push_front(upload);
    }

    /// Removes operations by ticket and returns them. Pipelines without an operation after them are dropped: they would keep
    /// a page's textures alive.
    pub(super) fn cancel(&mut self, tickets: &[u64]) -> Vec<CompileOperation> {
        let tickets: HashSet<u64> = tickets.iter().copied().collect();
        let mut cancelled = Vec::new();
        for upload in std::mem::take(&mut self.0) {
            match upload {
                Upload::Compile(operation) if tickets.contains(&operation.ticket) => cancelled.push(operation),
                Upload::Compile(operation) => self.0.push_back(Upload::Compile(operation)),
                Upload::Pipelines(pipelines) => {
                    self.drop_last_pipelines();
                    self.0.push_back(Upload::Pipelines(pipelines));
                }
            }
        }
        self.drop_last_pipelines();
        cancelled
    }

    /// Drops the last entry if it is pipelines.
    fn drop_last_pipelines(&mut self) {
        self.0.pop_back_if(|upload| matches!(upload, Upload::Pipelines(_)));
    }

    pub(super) fn clear(&mut self) {
        self.0.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Regression: the pipelines of a cancelled page waited to be created, and kept the textures of its states meanwhile.
    #[test]
    fn pipelines_are_dropped_with_their_last_operation() {
        let mut uploads = PendingUploads::default();
        for (pipelines, tickets) in [("a", &[1][..]), ("b", &[2, 3]), ("c", &[4])] {
            uploads.push(Upload::Pipelines(pipelines));
            for ticket in tickets {
                uploads.push(Upload::Compile(CompileOperation { ticket: *ticket, drawables: Vec::new() }));
            }
        }
        let mut cancel = |tickets: &[u64]| {
            let cancelled: Vec<u64> = uploads.cancel(tickets).iter().map(|operation| operation.ticket).collect();
            let left = uploads.0.iter().map(|upload| match upload {
                Upload::Pipelines(name) => (*name).to_owned(),
                Upload::Compile(operation) => operation.ticket.to_string(),
            });
            (cancelled, left.collect::<Vec<_>>().join(" "))
        };
        assert_eq!(cancel(&[3, 1, 9]), (vec![1, 3], "b 2 c 4".to_owned()));
        assert_eq!(cancel(&[4]), (vec![4], "b 2".to_owned()));
        assert_eq!(cancel(&[2]), (vec![2], String::new()));
    }
}
