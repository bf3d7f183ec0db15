//! [`Budget`]: counts what a glTF would take in memory, before memory is allocated for it.

use std::cell::Cell;

use crate::fetch::{IoError, Limits, about_to_allocate};

/// About the bytes that a vertex takes while it is assembled, with its attributes.
const VERTEX_BYTES: u64 = 64;
/// A primitive takes about as much memory as this many vertices.
const VERTICES_PER_PRIMITIVE: usize = 16;

/// Counters of one glTF, which all parts of its reader share. A mesh that several nodes draw is counted once with its
/// vertices, and each time with its primitives.
pub(super) struct Budget<'a> {
    uri: &'a str,
    limits: &'a Limits,
    primitives: Cell<usize>,
    vertices: Cell<usize>,
    /// Indices of accessors and of lists converted from strips and fans.
    indices: Cell<usize>,
    /// Bytes of decoded images with their mip levels.
    image_bytes: Cell<u64>,
    /// Bytes of accessors and buffer views that were decompressed or assembled.
    decoded_bytes: Cell<u64>,
}

impl<'a> Budget<'a> {
    pub fn new(uri: &'a str, limits: &'a Limits) -> Self {
        Self {
            uri,
            limits,
            primitives: Cell::default(),
            vertices: Cell::default(),
            indices: Cell::default(),
            image_bytes: Cell::default(),
            decoded_bytes: Cell::default(),
        }
    }

    /// Asks for bytes that count in no limit but that of the whole content.
    pub fn ask(&self, bytes: u64) -> Result<(), IoError> {
        about_to_allocate(bytes).map_err(|error| error.at(self.uri))
    }

    pub fn add_primitives(&self, count: usize) -> Result<(), IoError> {
        self.add(&self.primitives, count, self.limits.max_elements / VERTICES_PER_PRIMITIVE, "primitives of a glTF")?;
        self.ask(VERTICES_PER_PRIMITIVE as u64 * VERTEX_BYTES * count as u64)
    }

    pub fn add_vertices(&self, count: usize) -> Result<(), IoError> {
        self.add(&self.vertices, count, self.limits.max_elements, "vertices of a glTF")?;
        self.ask(VERTEX_BYTES.saturating_mul(count as u64))
    }

    pub fn add_indices(&self, count: usize) -> Result<(), IoError> {
        self.add(&self.indices, count, self.limits.max_elements.saturating_mul(8), "indices of a glTF")?;
        self.ask(4 * count as u64)
    }

    /// Counts bytes that a decompressor is about to write.
    pub fn add_decoded(&self, bytes: u64) -> Result<(), IoError> {
        let (got, limit) = (self.decoded_bytes.get().saturating_add(bytes), self.limits.max_file_bytes);
        self.decoded_bytes.set(got);
        if got > limit {
            return Err(IoError::TooLarge { uri: self.uri.to_owned(), what: "decompressed glTF", got, limit });
        }
        self.ask(bytes)
    }

    /// Fails if the images so far exceed the limit. The size of the next one is known only after decoding it.
    pub fn check_images(&self) -> Result<(), IoError> {
        let (got, limit) = (self.image_bytes.get(), self.limits.max_image_bytes.saturating_mul(4));
        if got > limit {
            return Err(IoError::TooLarge { uri: self.uri.to_owned(), what: "images of a glTF", got, limit });
        }
        Ok(())
    }

    /// Fails if an RGBA8 image that is about to be made exceeds the limit of one image.
    pub fn check_image(&self, width: u32, height: u32) -> Result<(), IoError> {
        let (got, limit) = (4 * u64::from(width) * u64::from(height), self.limits.max_image_bytes);
        if got > limit {
            return Err(IoError::TooLarge { uri: self.uri.to_owned(), what: "converted image of a glTF", got, limit });
        }
        Ok(())
    }

    pub fn add_image(&self, bytes: u64) {
        self.image_bytes.set(self.image_bytes.get().saturating_add(bytes));
    }

    fn add(&self, counter: &Cell<usize>, count: usize, limit: usize, what: &'static str) -> Result<(), IoError> {
        let got = counter.get().saturating_add(count);
        counter.set(got);
        if got > limit {
            let (got, limit) = (got as u64, limit as u64);
            return Err(IoError::TooLarge { uri: self.uri.to_owned(), what, got, limit });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fetch::{ByteBudget, LargeContents};

    #[test]
    fn counts_are_also_those_of_the_decode_thread() {
        let (memory, limits) = (ByteBudget::new(u64::MAX), Limits::default());
        let (_, _held) = LargeContents::default().decode(memory.hold(0), || {
            let budget = Budget::new("a", &limits);
            budget.add_vertices(10).unwrap();
            budget.add_indices(10).unwrap();
            budget.add_decoded(1000).unwrap();
        });
        assert_eq!(memory.total().bytes, 640 + 40 + 1000);
    }
}
