//! [`ImageCache`]: decoded images that neighbouring tiles share. Decode threads.

use std::collections::HashSet;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};

use lru::LruCache;

use crate::fetch::{IoError, Limits};
use crate::formats::image;
use crate::scene::Texture;

/// Decoded images, the least recently used first.
#[derive(Debug)]
pub(super) struct ImageCache {
    max_bytes: u64,
    /// Locked briefly, never while an image is decoded.
    state: Mutex<State>,
    /// Notified when a thread has decoded an image, or failed.
    decoded: Condvar,
}

#[derive(Debug)]
struct State {
    images: LruCache<Arc<str>, Arc<Texture>>,
    bytes: u64,
    /// The images that threads decode now.
    decoding: HashSet<Arc<str>>,
}

/// Ends the decoding of an image for other threads, also if a decoder panics.
struct Decoding<'a> {
    cache: &'a ImageCache,
    uri: &'a Arc<str>,
}

impl Drop for Decoding<'_> {
    fn drop(&mut self) {
        self.cache.lock().decoding.remove(self.uri);
        self.cache.decoded.notify_all();
    }
}

impl ImageCache {
    /// Creates a cache for images of this many bytes together. The last image is kept if it is larger.
    pub fn new(max_bytes: u64) -> Self {
        let state = State { images: LruCache::unbounded(), bytes: 0, decoding: HashSet::new() };
        Self { max_bytes, state: Mutex::new(state), decoded: Condvar::new() }
    }

    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Returns a decoded image.
    pub fn get(&self, uri: &str) -> Option<Arc<Texture>> {
        self.lock().images.get(uri).cloned()
    }

    /// Returns true if an image is decoded.
    pub fn contains(&self, uri: &str) -> bool {
        self.lock().images.contains(uri)
    }

    /// Returns the bytes of all images.
    pub fn bytes(&self) -> u64 {
        self.lock().bytes
    }

    /// Decodes an image and keeps it. Threads that ask for an image that another one decodes wait for it.
    pub fn decode(&self, uri: &Arc<str>, bytes: &[u8], limits: &Limits) -> Result<Arc<Texture>, IoError> {
        let mut state = self.lock();
        let _decoding = loop {
            if let Some(image) = state.images.get(uri) {
                return Ok(image.clone());
            }
            if state.decoding.insert(uri.clone()) {
                break Decoding { cache: self, uri };
            }
            state = self.decoded.wait(state).unwrap_or_else(PoisonError::into_inner);
        };
        drop(state);
        let image = image::decode_file(uri, bytes, limits)?;
        let mut state = self.lock();
        state.bytes += image.size_bytes();
        if let Some((_, replaced)) = state.images.push(uri.clone(), image.clone()) {
            state.bytes = state.bytes.saturating_sub(replaced.size_bytes());
        }
        while state.bytes > self.max_bytes && state.images.len() > 1 {
            let Some((_, oldest)) = state.images.pop_lru() else { break };
            state.bytes = state.bytes.saturating_sub(oldest.size_bytes());
        }
        Ok(image)
    }
}

/// Checks that bytes are an image of a tile's size, without decoding its pixels: `expected` pixels wide and high, or two or
/// four times as many or as few. `None` allows any size.
pub(in crate::formats) fn check(
    uri: &str,
    bytes: &[u8],
    expected: Option<[u32; 2]>,
    limits: &Limits,
) -> Result<(), IoError> {
    if bytes.is_empty() {
        return Err(IoError::NotFound { uri: uri.to_owned() });
    }
    let [width, height] = image::size_of(uri, bytes, limits)?;
    let Some([tile_width, tile_height]) = expected else { return Ok(()) };
    let fits = [1, 2, 4].iter().any(|n| {
        (width, height) == (tile_width * n, tile_height * n) || (width * n, height * n) == (tile_width, tile_height)
    });
    match fits {
        true => Ok(()),
        false => {
            let reason = format!("image of {width} x {height} pixels, expected {tile_width} x {tile_height}");
            Err(IoError::invalid(uri, reason))
        }
    }
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use super::*;

    fn png(width: u32, height: u32) -> Vec<u8> {
        let mut bytes = Cursor::new(Vec::new());
        ::image::RgbImage::new(width, height).write_to(&mut bytes, ::image::ImageFormat::Png).unwrap();
        bytes.into_inner()
    }

    #[test]
    fn cache_keeps_the_latest_images_within_its_bytes() {
        // An image of 16 by 16 pixels has 1,364 bytes with its mip levels.
        let cache = ImageCache::new(3000);
        let name = |i: u32| Arc::<str>::from(format!("http://h/{i}.png"));
        for i in 0..4 {
            cache.decode(&name(i), &png(16, 16), &Limits::default()).unwrap();
        }
        assert_eq!([0, 1, 2, 3].map(|i| cache.contains(&name(i))), [false, false, true, true]);
        assert_eq!(cache.bytes(), 2 * 1364);
        cache.decode(&name(3), &png(16, 16), &Limits::default()).unwrap();
        assert_eq!(cache.bytes(), 2 * 1364, "a second decoder of the same image");
        cache.decode(&name(9), &png(64, 64), &Limits::default()).unwrap();
        assert!(cache.get(&name(9)).is_some() && !cache.contains(&name(3)), "larger than the cache");
    }

    /// Neighbouring tiles arrive together and need the same coarse image.
    #[test]
    fn threads_that_need_an_image_at_once_decode_it_once() {
        let (cache, bytes) = (ImageCache::new(1 << 20), png(256, 256));
        let uri = Arc::from("http://h/1.png");
        let start = std::sync::Barrier::new(4);
        let images: Vec<Arc<Texture>> = std::thread::scope(|scope| {
            let decode = || {
                start.wait();
                cache.decode(&uri, &bytes, &Limits::default()).unwrap()
            };
            let threads: Vec<_> = (0..4).map(|_| scope.spawn(decode)).collect();
            threads.into_iter().map(|thread| thread.join().unwrap()).collect()
        });
        assert!(images.iter().all(|image| Arc::ptr_eq(image, &images[0])));
        // A failure lets the next thread try.
        let broken = Arc::from("http://h/2.png");
        for _ in 0..2 {
            assert!(cache.decode(&broken, b"none", &Limits::default()).is_err());
        }
    }

    #[test]
    fn other_bytes_than_a_tile_are_named() {
        let check = |bytes: &[u8]| check("http://h/1.png", bytes, Some([256, 256]), &Limits::default());
        for (width, height) in [(256, 256), (512, 512), (1024, 1024), (128, 128)] {
            assert_eq!(check(&png(width, height)), Ok(()));
        }
        for (bytes, part) in [
            (png(1, 1), "1 x 1 pixels, expected 256 x 256"),
            (png(256, 512), "256 x 512"),
            (Vec::new(), "not found"),
            (b"<!DOCTYPE html><html></html>".to_vec(), "http://h/1.png"),
            (png(256, 256)[..20].to_vec(), "image"),
        ] {
            let error = check(&bytes).unwrap_err().to_string();
            assert!(error.contains(part), "{error}");
        }
    }
}
