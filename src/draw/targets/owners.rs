//! Decides which render targets of a frame share a depth buffer or multisampled buffer, and whether a multisampled buffer
//! still holds the same colours as its texture. Draw thread.

use std::sync::Arc;

use crate::scene::{Attachment, CameraTarget};

/// An owner of buffers: a camera's target, or a level and layer of a texture.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Owner {
    /// By address, which is only compared.
    Camera(usize),
    Attachment {
        texture: usize,
        level: u32,
        layer: u32,
    },
}

/// The owners of buffers in a frame.
#[derive(Debug, Default)]
pub(in crate::draw) struct Owners {
    /// In the order met; an owner's number is its index plus 1, since the context's own target has 0.
    known: Vec<Owner>,
    /// The numbers of owners whose multisampled buffer was the last thing drawn into in this frame.
    resolved: Vec<u32>,
}

impl Owners {
    pub(in crate::draw) fn start_frame(&mut self) {
        self.known.clear();
        self.resolved.clear();
    }

    /// Returns the number of a camera's target in this frame.
    pub(in crate::draw) fn of_camera(&mut self, camera: &Arc<CameraTarget>) -> u32 {
        self.number(Owner::Camera(Arc::as_ptr(camera).addr()))
    }

    /// Returns the number of an attachment's texture, level and layer in this frame, whichever camera draws into it.
    pub(in crate::draw) fn of_attachment(&mut self, attachment: &Attachment) -> u32 {
        let Attachment { texture, level, layer, .. } = attachment;
        self.number(Owner::Attachment { texture: Arc::as_ptr(texture).addr(), level: *level, layer: *layer })
    }

    fn number(&mut self, owner: Owner) -> u32 {
        let index = self.known.iter().position(|known| *known == owner).unwrap_or_else(|| {
            self.known.push(owner);
            self.known.len() - 1
        });
        index as u32 + 1
    }

    /// Notes that an owner is drawn into. Returns true if its multisampled buffer lacks the contents of its texture.
    pub(in crate::draw) fn draw_into(&mut self, owner: u32, samples: u32) -> bool {
        let resolved = self.resolved.iter().position(|resolved| *resolved == owner);
        match (samples > 1, resolved) {
            (true, None) => self.resolved.push(owner),
            (false, Some(index)) => drop(self.resolved.swap_remove(index)),
            _ => {}
        }
        samples > 1 && resolved.is_none()
    }
}
