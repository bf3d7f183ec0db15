//! [`ScreenCaptureHandler`]: writes images of the view to files, one or every frame. Main thread; a separate
//! thread writes each file.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;

use image::RgbaImage;

use crate::viewer::GuiActionAdapter;
use crate::viewer::events::{Bindings, EventMask, GuiEventAdapter, Key, Usage};
use crate::viewer::input::GuiEventHandler;

#[derive(Clone, Copy, Debug)]
enum Action {
    One,
    Continuous,
}

const KEYS: Bindings<Action> = Bindings(&[
    (&[Key::Char('c'), Key::F(12)], Action::One, "write an image"),
    (&[Key::Char('C')], Action::Continuous, "start or stop writing every frame"),
]);

/// The most images that may be in flight; further ones are skipped.
const MAX_IN_FLIGHT: usize = 8;

/// Writes images as `terrane-001.png` and so on; OSG's `ScreenCaptureHandler`.
///
/// Each image is encoded and written on a separate thread; drop joins these threads.
pub struct ScreenCaptureHandler {
    folder: PathBuf,
    taken: u32,
    is_continuous: bool,
    shared: Arc<Writing>,
}

/// The state shared between the handler on the main thread and the threads that write.
#[derive(Default)]
struct Writing {
    /// The number of images requested and not yet written, counted by [`InFlight`].
    count: AtomicUsize,
    /// The threads that write. Added and joined by the main thread, guarded because captures arrive in a callback.
    threads: Mutex<Vec<JoinHandle<()>>>,
    /// Results for the user. Each thread adds its own; the main thread takes them.
    messages: Mutex<Vec<String>>,
}

/// Counts an image from its request until it is written or given up.
struct InFlight(Arc<Writing>);

impl InFlight {
    /// Counts an image; returns `None` when too many are in flight.
    fn new(writing: &Arc<Writing>) -> Option<Self> {
        let in_flight = Self(writing.clone());
        (writing.count.fetch_add(1, Ordering::Relaxed) < MAX_IN_FLIGHT).then_some(in_flight)
    }
}

impl Drop for InFlight {
    fn drop(&mut self) {
        self.0.count.fetch_sub(1, Ordering::Relaxed);
    }
}

/// Writes a PNG file. It is encoded in memory first, because a buffered file writer loses the errors of its last write.
fn write_png(image: &RgbaImage, file: &Path) -> image::ImageResult<()> {
    let mut png = std::io::Cursor::new(Vec::new());
    image.write_to(&mut png, image::ImageFormat::Png)?;
    std::fs::write(file, png.into_inner()).map_err(Into::into)
}

impl ScreenCaptureHandler {
    /// Creates a handler that writes into a folder.
    pub fn new(folder: &Path) -> Self {
        Self { folder: folder.to_owned(), taken: 0, is_continuous: false, shared: Arc::default() }
    }

    /// Captures the image of this frame.
    fn take(&mut self, viewer: &mut GuiActionAdapter<'_>) {
        let Some(in_flight) = InFlight::new(&self.shared) else { return };
        self.taken += 1;
        let mut file = self.folder.join(format!("terrane-{:03}.png", self.taken));
        while file.exists() {
            self.taken += 1;
            file = self.folder.join(format!("terrane-{:03}.png", self.taken));
        }
        let shared = self.shared.clone();
        viewer.capture(Box::new(move |_, image| {
            let write = move || {
                // If the folder cannot be created, writing the file reports the error.
                let _ = file.parent().map(std::fs::create_dir_all);
                let text = match write_png(&image, &file) {
                    Ok(()) => format!("wrote {}", file.display()),
                    Err(error) => format!("{}: {error}", file.display()),
                };
                if let Ok(mut messages) = in_flight.0.messages.lock() {
                    messages.push(text);
                }
            };
            if let (Ok(mut threads), Ok(thread)) =
                (shared.threads.lock(), std::thread::Builder::new().name("capture".to_owned()).spawn(write))
            {
                threads.retain(|t| !t.is_finished());
                threads.push(thread);
            }
        }));
    }
}

impl GuiEventHandler for ScreenCaptureHandler {
    fn handle(&mut self, event: &GuiEventAdapter, viewer: &mut GuiActionAdapter<'_>) -> bool {
        match KEYS.action(event) {
            Some(Action::One) => self.take(viewer),
            Some(Action::Continuous) => {
                self.is_continuous = !self.is_continuous;
                viewer.notify(if self.is_continuous { "writing every frame" } else { "stopped writing frames" });
            }
            None => {
                if event.mask() == EventMask::FRAME {
                    let messages = self
                        .shared
                        .messages
                        .lock()
                        .map(|mut messages| std::mem::take(&mut *messages))
                        .unwrap_or_default();
                    messages.into_iter().for_each(|text| {
                        log::info!("{text}");
                        viewer.notify(text);
                    });
                    if self.is_continuous {
                        self.take(viewer);
                    }
                }
                return false;
            }
        }
        true
    }

    fn event_mask(&self) -> EventMask {
        EventMask::KEY_DOWN | EventMask::FRAME
    }

    fn usage(&self) -> Vec<Usage> {
        KEYS.usage()
    }
}

impl Drop for ScreenCaptureHandler {
    fn drop(&mut self) {
        let threads = self.shared.threads.lock().map(|mut threads| std::mem::take(&mut *threads)).unwrap_or_default();
        for thread in threads {
            if thread.join().is_err() {
                log::error!("a thread that writes captured images panicked");
            }
        }
    }
}
