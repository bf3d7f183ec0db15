//! [`Operations`]: the compile operations of a device in the order of their arrival. Draw thread.

use std::collections::VecDeque;

use super::compile_operation::{CompileOperation, Compiled};
use super::placement::place_drawable;
use super::resource_upload::Upload;
use crate::gpu::pools::{CompileInfo, Pools};
use crate::scene::Drawable;

struct CurrentOperation {
    /// Drawables that have no slot yet.
    drawables: std::vec::IntoIter<Drawable>,
    compiled: Compiled,
}

/// The result of a step of [`Operations::place_next`].
pub(super) enum Placed {
    /// A drawable has its slots. A custom drawable is complete; it has this size in bytes.
    Drawable { custom_bytes: Option<u64> },
    /// All drawables of an operation have their slots.
    Operation(Compiled),
}

/// Operations that wait, the one in progress and the finished ones.
#[derive(Default)]
pub(super) struct Operations {
    waiting: VecDeque<CompileOperation>,
    current: Option<CurrentOperation>,
    finished: Vec<Compiled>,
}

impl Operations {
    pub(super) fn push(&mut self, operation: CompileOperation) {
        self.waiting.push_back(operation);
    }

    /// Finishes operations that have not begun, without slots.
    pub(super) fn cancel(&mut self, tickets: &[u64]) {
        let Self { waiting, finished, .. } = self;
        waiting.retain(|operation| {
            let is_cancelled = tickets.contains(&operation.ticket);
            finished.extend(is_cancelled.then(|| Compiled::empty(operation.ticket, 0)));
            !is_cancelled
        });
    }

    /// Returns the number of operations whose drawables do not all have slots.
    pub(super) fn pending(&self) -> usize {
        self.waiting.len() + usize::from(self.current.is_some())
    }

    /// Gives the next drawable its slots and queues its uploads; or ends the current operation if all its drawables have
    /// theirs. Returns `None` without operations.
    pub(super) fn place_next(
        &mut self,
        info: &CompileInfo<'_>,
        pools: &mut Pools,
        uploads: &mut VecDeque<Upload>,
    ) -> Option<Placed> {
        if self.current.is_none() {
            let operation = self.waiting.pop_front()?;
            let compiled = Compiled::empty(operation.ticket, operation.drawables.len());
            self.current = Some(CurrentOperation { drawables: operation.drawables.into_iter(), compiled });
        }
        let current = self.current.as_mut()?;
        match current.drawables.next() {
            Some(drawable) => {
                let custom_bytes = place_drawable(info, pools, drawable, &mut current.compiled, uploads);
                Some(Placed::Drawable { custom_bytes })
            }
            None => self.current.take().map(|current| Placed::Operation(current.compiled)),
        }
    }

    /// Ends the current operation if all its drawables have their slots.
    pub(super) fn end_if_placed(&mut self) -> Option<Compiled> {
        let current = self.current.take_if(|current| current.drawables.len() == 0)?;
        Some(current.compiled)
    }

    /// Adds operations whose uploads are complete.
    pub(super) fn finish(&mut self, compiled: impl IntoIterator<Item = Compiled>) {
        self.finished.extend(compiled);
    }

    pub(super) fn take_finished(&mut self) -> Vec<Compiled> {
        std::mem::take(&mut self.finished)
    }
}
