//! [`ImageFiles`]: the files that textures were decoded from, for programs that write them again.

use std::collections::HashMap;
use std::fmt;
use std::sync::{Arc, Mutex, PoisonError};

use crate::scene::Texture;

/// A texture and the file that it was decoded from.
type Known = (Arc<Texture>, Arc<[u8]>);

/// Keeps the bytes of each image file that is decoded with
/// [`ReadOptions::image_files`](crate::formats::ReadOptions::image_files). Clones share them. They are freed with the last
/// clone. Written by the threads that decode, read by any thread.
#[derive(Clone, Default)]
pub struct ImageFiles(Arc<Mutex<HashMap<usize, Known>>>);

impl ImageFiles {
    /// Returns the file that a texture was decoded from: an image file of any format that is read. Returns `None` for a texture that was
    /// made of raw texels or converted.
    pub fn file_of(&self, texture: &Arc<Texture>) -> Option<Arc<[u8]>> {
        let known = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        known.get(&Arc::as_ptr(texture).addr()).map(|(_, file)| file.clone())
    }

    /// Keeps the file of a texture.
    pub(super) fn add(&self, texture: &Arc<Texture>, file: &[u8]) {
        // The texture is kept too, so that no other one gets its address.
        let known = (texture.clone(), file.into());
        self.0.lock().unwrap_or_else(PoisonError::into_inner).insert(Arc::as_ptr(texture).addr(), known);
    }
}

impl fmt::Debug for ImageFiles {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "ImageFiles({})", self.0.lock().unwrap_or_else(PoisonError::into_inner).len())
    }
}
