//! [`Operations`]: the compile operations of a device in the order of their arrival. Draw thread.

use std::collections::{HashSet, VecDeque};
use std::sync::Arc;

use super::compile_operation::{CompileOperation, Compiled};
use super::placement::place_drawable;
use super::resource_upload::Upload;
use crate::gpu::pools::{BlockCopy, CompileInfo, Pools};
use crate::scene::Drawable;
use crate::state::TextureObject;

struct CurrentOperation {
    /// Drawables that have no slot yet.
    drawables: std::vec::IntoIter<Drawable>,
    compiled: Compiled,
    effects: Effects,
}

/// The effects of an operation that begin when its uploads are complete.
#[derive(Default)]
struct Effects {
    /// The copies of blocks that have grown for it.
    copies: Vec<BlockCopy>,
    /// The texture of state sets that the operation consists of. Such an operation is not reported as finished.
    texture: Option<Arc<TextureObject>>,
}

enum Waiting {
    Drawables(CompileOperation),
    Texture(Arc<TextureObject>, wgpu::Texture),
}

/// The result of a step of [`Operations::place_next`].
pub(super) enum Placed {
    /// A drawable has its slots. Custom drawables are complete; they have this size in bytes.
    Drawable { custom_bytes: Option<u64> },
    /// The upload of a texture of state sets is queued.
    Texture,
    /// All drawables of an operation have their slots.
    Operation(Compiled),
}

/// Operations that wait, the one in progress and the finished ones.
#[derive(Default)]
pub(super) struct Operations {
    waiting: VecDeque<Waiting>,
    current: Option<CurrentOperation>,
    finished: Vec<Compiled>,
    /// The effects of each operation whose drawables all have slots and that is not finished, in order.
    effects: VecDeque<Effects>,
    /// The copies of finished operations.
    copied: Vec<BlockCopy>,
    /// The textures of finished operations.
    textures: Vec<Arc<TextureObject>>,
}

impl Operations {
    pub(super) fn push(&mut self, operation: CompileOperation) {
        self.waiting.push_back(Waiting::Drawables(operation));
    }

    /// Queues the upload of a texture of state sets, before the operations that are pushed later.
    pub(super) fn push_texture(&mut self, object: Arc<TextureObject>, texture: wgpu::Texture) {
        self.waiting.push_back(Waiting::Texture(object, texture));
    }

    /// Finishes operations that have not begun, without slots.
    pub(super) fn cancel(&mut self, tickets: &[u64]) {
        let Self { waiting, finished, .. } = self;
        // Both may be thousands.
        let tickets: HashSet<u64> = tickets.iter().copied().collect();
        waiting.retain(|waiting| {
            let Waiting::Drawables(operation) = waiting else { return true };
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
            match self.waiting.pop_front()? {
                Waiting::Drawables(CompileOperation { ticket, drawables }) => {
                    let compiled = Compiled::empty(ticket, drawables.len());
                    let (drawables, effects) = (drawables.into_iter(), Effects::default());
                    self.current = Some(CurrentOperation { drawables, compiled, effects });
                }
                Waiting::Texture(object, texture) => {
                    uploads.push_back(Upload::to_state_texture(object.clone(), texture));
                    let effects = Effects { texture: Some(object), ..Effects::default() };
                    let (drawables, compiled) = (Vec::new().into_iter(), Compiled::empty(0, 0));
                    self.current = Some(CurrentOperation { drawables, compiled, effects });
                    return Some(Placed::Texture);
                }
            }
        }
        let current = self.current.as_mut()?;
        match current.drawables.next() {
            Some(drawable) => {
                let mut queued = VecDeque::new();
                let custom_bytes = place_drawable(info, pools, drawable, &mut current.compiled, &mut queued);
                // Uploads to a block that has grown follow its copy, which would overwrite them.
                for copy in pools.take_copies() {
                    uploads.push_back(Upload::copy(copy.clone()));
                    current.effects.copies.push(copy);
                }
                uploads.append(&mut queued);
                Some(Placed::Drawable { custom_bytes })
            }
            None => self.end_current().map(Placed::Operation),
        }
    }

    fn end_current(&mut self) -> Option<Compiled> {
        let CurrentOperation { compiled, effects, .. } = self.current.take()?;
        self.effects.push_back(effects);
        Some(compiled)
    }

    /// Ends the current operation if all its drawables have their slots.
    pub(super) fn end_if_placed(&mut self) -> Option<Compiled> {
        let is_placed = self.current.as_ref().is_some_and(|current| current.drawables.len() == 0);
        if is_placed { self.end_current() } else { None }
    }

    /// Adds operations whose uploads are complete, in the order in which their drawables got their slots.
    pub(super) fn finish(&mut self, compiled: impl IntoIterator<Item = Compiled>) {
        for compiled in compiled {
            let Effects { copies, texture } = self.effects.pop_front().unwrap_or_default();
            match texture {
                Some(texture) => self.textures.push(texture),
                None => self.finished.push(compiled),
            }
            self.copied.extend(copies);
        }
    }

    /// Takes the copies that finished operations needed: they are recorded.
    pub(super) fn take_copied(&mut self) -> impl Iterator<Item = BlockCopy> + '_ {
        self.copied.drain(..)
    }

    /// Takes the textures of state sets whose uploads are recorded.
    pub(super) fn take_textures(&mut self) -> Vec<Arc<TextureObject>> {
        std::mem::take(&mut self.textures)
    }

    pub(super) fn take_finished(&mut self) -> Vec<Compiled> {
        std::mem::take(&mut self.finished)
    }
}
