//! Pictures of what is seen.

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;

use super::GuiActionAdapter;
use crate::viewer::events::{Bindings, EventMask, GuiEventAdapter, GuiEventHandler, Key, Usage};

#[derive(Clone, Copy, Debug)]
enum Action {
    One,
    Continuous,
}

const KEYS: Bindings<Action> = Bindings(&[
    (&[Key::Char('c'), Key::F(12)], Action::One, "write a picture"),
    (&[Key::Char('C')], Action::Continuous, "write every picture, or no longer"),
]);

/// Pictures that may be waiting to be written; more are left out.
const MOST_WRITING: usize = 8;

/// Writes pictures as `terrane-001.png` and so on; OSG's `ScreenCaptureHandler`. Encoding and writing happen on
/// threads of their own, which are joined on drop.
pub struct ScreenCaptureHandler {
    folder: PathBuf,
    taken: u32,
    is_continuous: bool,
    shared: Arc<Writing>,
}

/// What the threads that write share with the handler.
#[derive(Default)]
struct Writing {
    /// Pictures asked for and not yet written: [`Asked`].
    count: AtomicUsize,
    /// Threads under way; main.
    threads: Mutex<Vec<JoinHandle<()>>>,
    /// What went wrong or well, to be told to the user; by each thread, taken by main.
    said: Mutex<Vec<String>>,
}

/// A picture until it is written, or will never come.
struct Asked(Arc<Writing>);

impl Asked {
    /// `None` where too many are.
    fn new(writing: &Arc<Writing>) -> Option<Self> {
        let asked = Self(writing.clone());
        (writing.count.fetch_add(1, Ordering::Relaxed) < MOST_WRITING).then_some(asked)
    }
}

impl Drop for Asked {
    fn drop(&mut self) {
        self.0.count.fetch_sub(1, Ordering::Relaxed);
    }
}

/// Not straight to the file: what a buffer could not write when it goes is told to nobody.
fn write_png(picture: &image::RgbaImage, file: &Path) -> image::ImageResult<()> {
    let mut png = std::io::Cursor::new(Vec::new());
    picture.write_to(&mut png, image::ImageFormat::Png)?;
    std::fs::write(file, png.into_inner()).map_err(Into::into)
}

impl ScreenCaptureHandler {
    /// Writes into a folder.
    pub fn new(folder: &Path) -> Self {
        Self { folder: folder.to_owned(), taken: 0, is_continuous: false, shared: Arc::default() }
    }

    /// Asks for this frame's picture.
    fn take(&mut self, viewer: &mut GuiActionAdapter<'_>) {
        let Some(asked) = Asked::new(&self.shared) else { return };
        self.taken += 1;
        let mut file = self.folder.join(format!("terrane-{:03}.png", self.taken));
        while file.exists() {
            self.taken += 1;
            file = self.folder.join(format!("terrane-{:03}.png", self.taken));
        }
        let shared = self.shared.clone();
        viewer.capture(Box::new(move |_, picture| {
            let write = move || {
                // A view's folder may not be there yet; where it cannot be made, saving says so.
                let _ = file.parent().map(std::fs::create_dir_all);
                let text = match write_png(&picture, &file) {
                    Ok(()) => format!("wrote {}", file.display()),
                    Err(error) => format!("{}: {error}", file.display()),
                };
                if let Ok(mut said) = asked.0.said.lock() {
                    said.push(text);
                }
            };
            if let (Ok(mut threads), Ok(thread)) =
                (shared.threads.lock(), std::thread::Builder::new().name("picture".to_owned()).spawn(write))
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
                viewer.notify(if self.is_continuous { "writing every picture" } else { "no more pictures" });
            }
            None => {
                if event.mask() == EventMask::FRAME {
                    let said = self.shared.said.lock().map(|mut said| std::mem::take(&mut *said)).unwrap_or_default();
                    said.into_iter().for_each(|text| {
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
                log::error!("a thread that writes a picture panicked");
            }
        }
    }
}
