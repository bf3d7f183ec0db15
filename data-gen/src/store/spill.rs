//! A temporary file for decoded images.

use std::fs::File;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

/// A temporary file for the pixels of all images of a run. It has no name, and the system deletes it when it is closed.
#[derive(Default)]
pub(crate) struct SpillFile {
    /// Created when the first image needs it. Locked while it is created.
    file: Mutex<Option<Arc<File>>>,
    /// The offset of the bytes that no image has.
    end: AtomicU64,
}

impl SpillFile {
    /// Returns a part of the file for a number of pixels.
    pub fn part(&self, pixels: u64) -> std::io::Result<SpillPart> {
        let mut file = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        let file = match &*file {
            Some(file) => Arc::clone(file),
            None => Arc::clone(file.insert(Arc::new(tempfile::tempfile()?))),
        };
        Ok(SpillPart { file, start: self.end.fetch_add(4 * pixels, Ordering::Relaxed) })
    }
}

/// The part of a temporary file that belongs to one image.
pub(crate) struct SpillPart {
    file: Arc<File>,
    start: u64,
}

impl SpillPart {
    /// Reads pixels, the first of which has an index in the part.
    pub fn read(&self, first: u64, count: usize) -> std::io::Result<Vec<u32>> {
        let mut bytes = vec![0; 4 * count];
        read_at(&self.file, &mut bytes, self.start + 4 * first)?;
        Ok(bytes.as_chunks().0.iter().map(|b| u32::from_ne_bytes(*b)).collect())
    }

    /// Writes pixels, the first of which gets an index in the part.
    pub fn write(&self, first: u64, pixels: &[u32]) -> std::io::Result<()> {
        let bytes: Vec<u8> = pixels.iter().flat_map(|pixel| pixel.to_ne_bytes()).collect();
        write_at(&self.file, &bytes, self.start + 4 * first)
    }
}

#[cfg(unix)]
fn read_at(file: &File, bytes: &mut [u8], offset: u64) -> std::io::Result<()> {
    std::os::unix::fs::FileExt::read_exact_at(file, bytes, offset)
}

#[cfg(unix)]
fn write_at(file: &File, bytes: &[u8], offset: u64) -> std::io::Result<()> {
    std::os::unix::fs::FileExt::write_all_at(file, bytes, offset)
}

#[cfg(windows)]
fn read_at(file: &File, mut bytes: &mut [u8], mut offset: u64) -> std::io::Result<()> {
    while !bytes.is_empty() {
        match std::os::windows::fs::FileExt::seek_read(file, bytes, offset)? {
            0 => return Err(std::io::ErrorKind::UnexpectedEof.into()),
            count => (bytes, offset) = (&mut bytes[count..], offset + count as u64),
        }
    }
    Ok(())
}

#[cfg(windows)]
fn write_at(file: &File, mut bytes: &[u8], mut offset: u64) -> std::io::Result<()> {
    while !bytes.is_empty() {
        match std::os::windows::fs::FileExt::seek_write(file, bytes, offset)? {
            0 => return Err(std::io::ErrorKind::WriteZero.into()),
            count => (bytes, offset) = (&bytes[count..], offset + count as u64),
        }
    }
    Ok(())
}
