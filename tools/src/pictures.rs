//! PNG files written on a thread of their own, so that encoding does not count as frame time.

use std::path::PathBuf;
use std::thread::JoinHandle;

use anyhow::{Context as _, Result, anyhow};
use crossbeam_channel::Sender;
use image::RgbaImage;

/// Pictures that may wait for the encoder before the flight does.
const WAITING: usize = 8;

/// Encodes and writes in the order given; [`Self::finish`] waits and tells the first failure.
pub struct PictureWriter {
    sender: Option<Sender<(PathBuf, RgbaImage)>>,
    join: Option<JoinHandle<Result<usize>>>,
}

impl PictureWriter {
    pub fn new() -> Result<Self> {
        let (sender, receiver) = crossbeam_channel::bounded::<(PathBuf, RgbaImage)>(WAITING);
        let work = move || {
            let mut written = 0;
            for (path, image) in receiver {
                write(&path, &image)?;
                written += 1;
            }
            Ok(written)
        };
        let join = std::thread::Builder::new().name("pictures".into()).spawn(work).context("pictures thread")?;
        Ok(Self { sender: Some(sender), join: Some(join) })
    }

    /// Hands a picture over; fails when an earlier one could not be written.
    pub fn write(&mut self, path: PathBuf, image: RgbaImage) -> Result<()> {
        let sender = self.sender.as_ref().ok_or_else(|| anyhow!("the writer is finished"))?;
        match sender.send((path, image)) {
            Ok(()) => Ok(()),
            // The thread ended: it says why.
            Err(_) => self.end().and(Err(anyhow!("the pictures thread stopped"))),
        }
    }

    /// Waits for all pictures and counts them.
    pub fn finish(mut self) -> Result<usize> {
        self.end()
    }

    fn end(&mut self) -> Result<usize> {
        self.sender = None;
        match self.join.take().map(JoinHandle::join) {
            Some(Ok(result)) => result,
            _ => Err(anyhow!("the pictures thread stopped")),
        }
    }
}

impl Drop for PictureWriter {
    fn drop(&mut self) {
        self.sender = None;
        if let Some(join) = self.join.take() {
            // Only on the way out of a failure that is told already.
            let _ = join.join();
        }
    }
}

/// Writes one picture; alpha is left out, pictures have no transparency.
pub fn write(path: &std::path::Path, image: &RgbaImage) -> Result<()> {
    if let Some(folder) = path.parent() {
        std::fs::create_dir_all(folder).with_context(|| folder.display().to_string())?;
    }
    let rgb = image::DynamicImage::ImageRgba8(image.clone()).into_rgb8();
    // Not straight to a file: what a buffer could not write when it goes is told to nobody.
    let mut png = std::io::Cursor::new(Vec::new());
    rgb.write_to(&mut png, image::ImageFormat::Png).with_context(|| path.display().to_string())?;
    std::fs::write(path, png.into_inner()).with_context(|| path.display().to_string())
}
