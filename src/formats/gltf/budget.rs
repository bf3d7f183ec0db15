//! [`Budget`]: counts what a glTF would take in memory, before memory is allocated for it.

use crate::fetch::{IoError, Limits};

/// A primitive takes about as much memory as this many vertices.
const VERTICES_PER_PRIMITIVE: usize = 16;

/// Counters of one glTF. Meshes that are drawn several times count each time.
pub(super) struct Budget<'a> {
    uri: &'a str,
    limits: &'a Limits,
    primitives: usize,
    vertices: usize,
    /// Indices of accessors and of lists converted from strips and fans.
    indices: usize,
    /// Bytes of decoded images with their mip levels.
    image_bytes: u64,
}

impl<'a> Budget<'a> {
    pub fn new(uri: &'a str, limits: &'a Limits) -> Self {
        Self { uri, limits, primitives: 0, vertices: 0, indices: 0, image_bytes: 0 }
    }

    pub fn add_primitives(&mut self, count: usize) -> Result<(), IoError> {
        self.primitives = self.primitives.saturating_add(count);
        self.check(self.primitives, self.limits.max_elements / VERTICES_PER_PRIMITIVE, "primitives")
    }

    pub fn add_vertices(&mut self, count: usize) -> Result<(), IoError> {
        self.vertices = self.vertices.saturating_add(count);
        self.check(self.vertices, self.limits.max_elements, "vertices")
    }

    pub fn add_indices(&mut self, count: usize) -> Result<(), IoError> {
        self.indices = self.indices.saturating_add(count);
        self.check(self.indices, self.limits.max_elements.saturating_mul(8), "indices")
    }

    /// Fails if the images so far exceed the limit. The size of the next one is known only after decoding it.
    pub fn check_images(&self) -> Result<(), IoError> {
        let (got, limit) = (self.image_bytes, self.limits.max_image_bytes.saturating_mul(4));
        if got > limit {
            return Err(IoError::TooLarge { uri: self.uri.to_owned(), what: "images of a glTF", got, limit });
        }
        Ok(())
    }

    pub fn add_image(&mut self, bytes: u64) {
        self.image_bytes = self.image_bytes.saturating_add(bytes);
    }

    fn check(&self, got: usize, limit: usize, what: &str) -> Result<(), IoError> {
        if got > limit { Err(IoError::invalid(self.uri, format!("glTF: {got} {what}"))) } else { Ok(()) }
    }
}
