//! Writes image files on a separate thread, so that encoding does not count as frame time.

use std::path::PathBuf;
use std::thread::JoinHandle;

use anyhow::{Context as _, Result, anyhow};
use crossbeam_channel::Sender;
use image::RgbaImage;

/// Maximum number of images that wait for the encoder. The flight waits when the queue is full.
const MAX_QUEUED: usize = 8;

/// Encodes and writes images in the given order. [`Self::finish`] waits and returns the first error.
pub struct ImageWriter {
    sender: Option<Sender<(PathBuf, RgbaImage)>>,
    join: Option<JoinHandle<Result<usize>>>,
}

impl ImageWriter {
    /// Starts the thread.
    pub fn new() -> Result<Self> {
        let (sender, receiver) = crossbeam_channel::bounded::<(PathBuf, RgbaImage)>(MAX_QUEUED);
        let work = move || {
            let mut written = 0;
            for (path, image) in receiver {
                write(&path, &image)?;
                written += 1;
            }
            Ok(written)
        };
        let join = std::thread::Builder::new().name("images".into()).spawn(work).context("images thread")?;
        Ok(Self { sender: Some(sender), join: Some(join) })
    }

    /// Queues an image. Returns the error of an earlier image that could not be written.
    pub fn write(&mut self, path: PathBuf, image: RgbaImage) -> Result<()> {
        let sender = self.sender.as_ref().ok_or_else(|| anyhow!("the writer is finished"))?;
        match sender.send((path, image)) {
            Ok(()) => Ok(()),
            // The thread has ended, so its result is the error.
            Err(_) => self.end().and(Err(anyhow!("the images thread stopped"))),
        }
    }

    /// Waits until all images are written and returns their number.
    pub fn finish(mut self) -> Result<usize> {
        self.end()
    }

    fn end(&mut self) -> Result<usize> {
        self.sender = None;
        match self.join.take().map(JoinHandle::join) {
            Some(Ok(result)) => result,
            _ => Err(anyhow!("the images thread stopped")),
        }
    }
}

impl Drop for ImageWriter {
    fn drop(&mut self) {
        self.sender = None;
        if let Some(join) = self.join.take() {
            // The writer is dropped without `finish` only after another error, which is reported already.
            let _ = join.join();
        }
    }
}

/// Quality of JPEG files.
const JPEG_QUALITY: u8 = 85;

/// Writes one image as RGB: JPEG if the name ends in .jpg or .jpeg, otherwise PNG. Frames are opaque, so alpha is left out.
pub fn write(path: &std::path::Path, image: &RgbaImage) -> Result<()> {
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
    }
    let rgb = image::DynamicImage::ImageRgba8(image.clone()).into_rgb8();
    // The file is written from memory, because a buffered writer would ignore errors when it is dropped.
    let mut bytes = std::io::Cursor::new(Vec::new());
    let is_jpeg = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("jpg") || e.eq_ignore_ascii_case("jpeg"));
    let encoded = if is_jpeg {
        rgb.write_with_encoder(image::codecs::jpeg::JpegEncoder::new_with_quality(&mut bytes, JPEG_QUALITY))
    } else {
        rgb.write_to(&mut bytes, image::ImageFormat::Png)
    };
    encoded.with_context(|| path.display().to_string())?;
    std::fs::write(path, bytes.into_inner()).with_context(|| path.display().to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Regression: `terrane fly` refused the names of the pictures that `tools/gallery` draws.
    #[test]
    fn names_choose_the_format() {
        let folder = tempfile::tempdir().unwrap();
        for (name, magic) in
            [("a.png", &b"\x89PNG"[..]), ("below/a.jpg", b"\xff\xd8"), ("a.JPEG", b"\xff\xd8"), ("a", b"\x89PNG")]
        {
            let file = folder.path().join(name);
            assert!(!super::super::is_other_image(&file), "{name}");
            write(&file, &RgbaImage::new(4, 4)).unwrap();
            assert!(std::fs::read(&file).unwrap().starts_with(magic), "{name}");
        }
        assert!(super::super::is_other_image(std::path::Path::new("a.TIF")));
    }
}
