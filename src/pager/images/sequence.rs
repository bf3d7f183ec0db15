//! [`ImageSequence`]: images over time as a texture; OSG's ImageSequence. Plain values behind a lock; any thread.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::scene::Texture;
use crate::state::TextureObject;

/// The default number of images that are loaded ahead of their time.
const PRE_LOAD_FRAMES: usize = 8;

/// Determines what follows the last image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LoopingMode {
    /// The last image stays, and the sequence pauses.
    NoLooping,
    /// The first image follows.
    #[default]
    Looping,
    /// The images follow in reverse order, down to the first; OSG's `Sequence::SWING`.
    Swing,
}

/// Determines when images are loaded, and how long they are kept.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SequenceMode {
    /// Loads all images as soon as possible, within the pager's budgets.
    PreLoadAllImages,
    /// Loads some images ahead; shown images stay while there is room.
    #[default]
    PageAndRetainImages,
    /// Loads some images ahead; shown images are paged out at once.
    PageAndDiscardUsedImages,
}

/// Tells whether time passes in a sequence.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum StreamStatus {
    /// The sequence was never played.
    #[default]
    Invalid,
    /// Time passes.
    Playing,
    /// Time is paused, or has reached the end.
    Paused,
}

/// One image of a sequence.
#[derive(Clone, Debug)]
pub enum SequenceImage {
    /// A path or a URL of a PNG or JPEG, loaded when it is needed.
    File(Arc<str>),
    /// An image of the application, which stays in memory.
    Image(Arc<Texture>),
}

/// The state that the application controls and update advances.
#[derive(Debug)]
struct Control {
    images: Vec<SequenceImage>,
    mode: SequenceMode,
    looping: LoopingMode,
    /// Seconds that all images take at a time multiplier of 1.
    length_s: f64,
    time_multiplier: f64,
    pre_load_frames: usize,
    status: StreamStatus,
    /// Time in the sequence at `since_s`, seconds; unbounded if it loops.
    position_s: f64,
    /// Simulation time of `position_s`, seconds; set by update.
    since_s: Option<f64>,
    /// Simulation time between the last two updates, seconds.
    frame_s: f64,
}

#[derive(Debug)]
struct Inner {
    texture: Arc<TextureObject>,
    control: Mutex<Control>,
}

/// Images over simulation time, shown by one texture. This is a handle: clones control the same sequence, from any thread.
///
/// Bind the texture in a state set with [`TextureBinding`](crate::state::TextureBinding), and add the sequence to an
/// [`ImagePager`](super::ImagePager) (`Viewer::add_image_sequence`), which then changes what it shows. It is white until
/// the first image is loaded. Nothing is loaded while no state set refers to the texture.
#[derive(Clone, Debug)]
pub struct ImageSequence {
    inner: Arc<Inner>,
}

/// An image, and the seconds until it is shown.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Wanted {
    pub index: usize,
    pub due_s: f64,
}

/// The images that a moment needs.
#[derive(Debug, Default)]
pub(super) struct Moment {
    /// The present image, then those ahead; each once. Empty without images.
    pub wanted: Vec<Wanted>,
    /// True if images are paged out as soon as they are no longer wanted.
    pub discards: bool,
    pub is_playing: bool,
    /// True if time has passed since the last moment without a jump.
    pub is_continuous: bool,
}

impl ImageSequence {
    /// Creates a sequence of images in the order shown, one second long. It loops once it is played.
    pub fn new(name: &str, images: Vec<SequenceImage>) -> Self {
        let white = TextureObject::image(name, [1, 1], vec![255; 4]);
        let texture = Arc::new(TextureObject { is_changing: true, ..Arc::unwrap_or_clone(white) });
        let control = Control {
            images,
            mode: SequenceMode::default(),
            looping: LoopingMode::default(),
            length_s: 1.0,
            time_multiplier: 1.0,
            pre_load_frames: PRE_LOAD_FRAMES,
            status: StreamStatus::Invalid,
            position_s: 0.0,
            since_s: None,
            frame_s: 0.0,
        };
        Self { inner: Arc::new(Inner { texture, control: Mutex::new(control) }) }
    }

    /// Creates a sequence of files or URLs.
    pub fn from_files<S: Into<Arc<str>>>(name: &str, files: impl IntoIterator<Item = S>) -> Self {
        Self::new(name, files.into_iter().map(|file| SequenceImage::File(file.into())).collect())
    }

    /// Returns the texture that shows the sequence, for a texture unit of a state set.
    pub fn texture(&self) -> Arc<TextureObject> {
        self.inner.texture.clone()
    }

    fn control(&self) -> MutexGuard<'_, Control> {
        self.inner.control.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Adds an image at the end; the length in seconds stays.
    pub fn add_image(&self, image: SequenceImage) {
        self.control().images.push(image);
    }

    /// Returns the number of images.
    pub fn image_count(&self) -> usize {
        self.control().images.len()
    }

    /// Sets when images are loaded, and how long they are kept.
    pub fn set_mode(&self, mode: SequenceMode) {
        self.control().mode = mode;
    }

    /// Sets how many images are loaded ahead of their time; 8 by default. If two or more images pass between frames, these
    /// are the images of coming frames, without those between.
    pub fn set_pre_load_frames(&self, frames: usize) {
        self.control().pre_load_frames = frames;
    }

    /// Sets what follows the last image.
    pub fn set_looping_mode(&self, looping: LoopingMode) {
        self.control().looping = looping;
    }

    /// Sets the seconds that all images take at a time multiplier of 1. The present image stays. A value that is not finite
    /// or not positive is ignored.
    pub fn set_length(&self, length_s: f64) {
        let mut control = self.control();
        if length_s.is_finite() && length_s > 0.0 {
            control.position_s *= length_s / control.length_s;
            control.length_s = length_s;
        }
    }

    /// Returns the seconds that all images take at a time multiplier of 1.
    pub fn length(&self) -> f64 {
        self.control().length_s
    }

    /// Sets the length so that `images_per_s` images are shown per second.
    pub fn set_frame_rate(&self, images_per_s: f64) {
        self.set_length(self.image_count().max(1) as f64 / images_per_s);
    }

    /// Sets how fast time passes: 1 as fast as simulation time, below 0 backwards. A value that is not finite is ignored.
    pub fn set_time_multiplier(&self, multiplier: f64) {
        if multiplier.is_finite() {
            self.control().time_multiplier = multiplier;
        }
    }

    /// Starts or resumes time from the next update on.
    pub fn play(&self) {
        self.control().status = StreamStatus::Playing;
    }

    /// Pauses time from the next update on.
    pub fn pause(&self) {
        self.control().status = StreamStatus::Paused;
    }

    /// Seeks to the first image.
    pub fn rewind(&self) {
        self.seek(0.0);
    }

    /// Seeks to a time in the sequence, in seconds at a time multiplier of 1; a paused sequence stays paused. A value that
    /// is not finite is ignored.
    pub fn seek(&self, time_s: f64) {
        let mut control = self.control();
        if time_s.is_finite() {
            control.position_s = time_s;
            // Counts from the next update, because the call is not at the time of a frame.
            control.since_s = None;
        }
    }

    /// Returns whether time passes.
    pub fn status(&self) -> StreamStatus {
        self.control().status
    }

    /// Returns the time in the sequence at the last update, seconds; unbounded if it loops.
    pub fn position(&self) -> f64 {
        self.control().position_s
    }

    /// Returns true if a state set or the application refers to its texture.
    pub(super) fn is_used(&self) -> bool {
        Arc::strong_count(&self.inner.texture) > 1
    }

    /// Returns true if only the pager refers to the sequence.
    pub(super) fn is_forgotten(&self) -> bool {
        Arc::strong_count(&self.inner) == 1 && !self.is_used()
    }

    pub(super) fn shared_texture(&self) -> &Arc<TextureObject> {
        &self.inner.texture
    }

    pub(super) fn image(&self, index: usize) -> Option<SequenceImage> {
        self.control().images.get(index).cloned()
    }

    /// Advances to a simulation time; returns the images to show now and soon.
    pub(super) fn advance(&self, simulation_time_s: f64) -> Moment {
        self.control().advance(simulation_time_s)
    }
}

impl Control {
    fn advance(&mut self, now_s: f64) -> Moment {
        let count = self.images.len();
        if count == 0 || !now_s.is_finite() {
            return Moment::default();
        }
        let mut between_frames_s = 0.0;
        let is_continuous = self.status == StreamStatus::Playing && self.since_s.is_some();
        if let (StreamStatus::Playing, Some(since_s)) = (self.status, self.since_s) {
            let frame_s = now_s - since_s;
            self.position_s += frame_s * self.time_multiplier;
            // A single long frame does not predict the next.
            between_frames_s = frame_s.min(std::mem::replace(&mut self.frame_s, frame_s)) * self.time_multiplier.abs();
        }
        self.since_s = Some(now_s);
        if self.looping == LoopingMode::NoLooping {
            let stays = self.position_s.clamp(0.0, self.length_s);
            let forwards = self.time_multiplier >= 0.0;
            let has_ended = if forwards { stays >= self.length_s } else { stays <= 0.0 };
            self.position_s = stays;
            if has_ended && self.status == StreamStatus::Playing {
                self.status = StreamStatus::Paused;
            }
        }
        let ahead = match self.mode {
            SequenceMode::PreLoadAllImages => 2 * count,
            _ => self.pre_load_frames.min(2 * count),
        };
        let image_s = self.length_s / count as f64;
        let skips = self.mode != SequenceMode::PreLoadAllImages && between_frames_s >= 2.0 * image_s;
        let step_s = if skips { between_frames_s } else { image_s };
        let direction = if self.time_multiplier < 0.0 { -1.0 } else { 1.0 };
        let rate = self.time_multiplier.abs().max(1e-3);
        let mut seen = vec![false; count];
        let mut wanted = Vec::with_capacity(ahead.min(count) + 1);
        for k in 0..=ahead {
            let index = self.index_at(self.position_s + direction * step_s * k as f64);
            if !std::mem::replace(&mut seen[index], true) {
                wanted.push(Wanted { index, due_s: step_s * k as f64 / rate });
            }
        }
        let is_playing = self.status == StreamStatus::Playing && self.time_multiplier != 0.0;
        let discards = self.mode == SequenceMode::PageAndDiscardUsedImages;
        Moment { wanted, discards, is_playing, is_continuous }
    }

    /// Returns the index of the image at a time in the sequence, which has at least one image.
    fn index_at(&self, position_s: f64) -> usize {
        let (count, length_s) = (self.images.len(), self.length_s);
        let position_s = match self.looping {
            LoopingMode::NoLooping => position_s.clamp(0.0, length_s),
            LoopingMode::Looping => position_s.rem_euclid(length_s),
            LoopingMode::Swing => {
                let there_and_back_s = position_s.rem_euclid(2.0 * length_s);
                there_and_back_s.min(2.0 * length_s - there_and_back_s)
            }
        };
        // A time summed up from frames may be a rounding error before the image's own.
        let index = (position_s / length_s * count as f64 + 1e-6).floor() as usize;
        match self.looping {
            LoopingMode::Looping if index >= count => 0,
            _ => index.min(count - 1),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sequence(looping: LoopingMode) -> ImageSequence {
        let sequence = ImageSequence::from_files("test", (0..4).map(|i| format!("{i}.png")));
        sequence.set_looping_mode(looping);
        sequence.set_length(4.0);
        sequence.play();
        sequence
    }

    fn shown(sequence: &ImageSequence, times: &[f64]) -> Vec<usize> {
        times.iter().map(|t| sequence.advance(*t).wanted[0].index).collect()
    }

    #[test]
    fn images_follow_in_the_order_of_the_looping_mode() {
        let times: Vec<f64> = (0..10).map(|k| 100.0 + f64::from(k)).collect();
        assert_eq!(shown(&sequence(LoopingMode::Looping), &times), [0, 1, 2, 3, 0, 1, 2, 3, 0, 1]);
        assert_eq!(shown(&sequence(LoopingMode::NoLooping), &times), [0, 1, 2, 3, 3, 3, 3, 3, 3, 3]);
        let halves: Vec<f64> = (0..10).map(|k| 100.5 + f64::from(k)).collect();
        assert_eq!(shown(&sequence(LoopingMode::Swing), &times)[..4], [0, 1, 2, 3]);
        let swing = sequence(LoopingMode::Swing);
        swing.seek(0.5);
        assert_eq!(shown(&swing, &halves), [0, 1, 2, 3, 3, 2, 1, 0, 0, 1]);
        let backwards = sequence(LoopingMode::Looping);
        backwards.set_time_multiplier(-1.0);
        backwards.seek(0.5);
        assert_eq!(shown(&backwards, &halves[..6]), [0, 3, 2, 1, 0, 3]);
    }

    #[test]
    fn time_starts_with_play_stops_when_paused_and_jumps_with_seek() {
        let sequence = sequence(LoopingMode::Looping);
        sequence.pause();
        assert_eq!(shown(&sequence, &[0.0, 10.0]), [0, 0]);
        sequence.play();
        assert_eq!(shown(&sequence, &[10.0, 11.0, 12.5]), [0, 1, 2]);
        sequence.pause();
        assert_eq!(shown(&sequence, &[13.0, 20.0]), [2, 2]);
        sequence.seek(3.2);
        assert_eq!(shown(&sequence, &[21.0, 22.0]), [3, 3]);
        sequence.play();
        sequence.set_time_multiplier(2.0);
        assert_eq!(shown(&sequence, &[22.0, 22.5, 23.0]), [3, 0, 1]);
        sequence.rewind();
        assert_eq!(shown(&sequence, &[30.0, 30.5]), [0, 1]);
        sequence.set_length(400.0);
        assert_eq!(shown(&sequence, &[30.5]), [1], "another length keeps the image");
        for bad in [f64::NAN, f64::INFINITY, -1.0, 0.0] {
            sequence.set_length(bad);
        }
        sequence.seek(f64::NAN);
        assert_eq!((sequence.length(), sequence.status()), (400.0, StreamStatus::Playing));
    }

    #[test]
    fn end_without_looping_pauses() {
        let sequence = sequence(LoopingMode::NoLooping);
        assert_eq!(shown(&sequence, &[0.0, 5.0]), [0, 3]);
        assert_eq!(sequence.status(), StreamStatus::Paused);
        sequence.rewind();
        sequence.play();
        assert_eq!(shown(&sequence, &[9.0, 10.0]), [0, 1]);
    }

    #[test]
    fn images_that_pass_between_frames_are_not_loaded_ahead() {
        let sequence = ImageSequence::from_files("test", (0..20).map(|i| format!("{i}.png")));
        sequence.set_length(20.0);
        sequence.set_pre_load_frames(3);
        sequence.play();
        let ahead = |time_s| sequence.advance(time_s).wanted.iter().map(|w| w.index).collect::<Vec<_>>();
        assert_eq!(ahead(0.0), [0, 1, 2, 3]);
        assert_eq!(ahead(3.1), [3, 4, 5, 6], "a single long frame changes nothing");
        assert_eq!(ahead(6.2), [6, 9, 12, 15]);
        assert_eq!(ahead(8.1), [8, 9, 10, 11], "no image is skipped");
        sequence.set_mode(SequenceMode::PreLoadAllImages);
        sequence.advance(11.2);
        assert_eq!(sequence.advance(14.3).wanted.len(), 20);
    }

    #[test]
    fn images_ahead_follow_the_direction_of_play() {
        let sequence = sequence(LoopingMode::Swing);
        sequence.set_pre_load_frames(4);
        sequence.advance(0.0);
        let ahead = |moment: Moment| moment.wanted.iter().map(|w| w.index).collect::<Vec<_>>();
        let moment = sequence.advance(2.5);
        assert_eq!(moment.wanted.iter().map(|w| w.due_s).collect::<Vec<_>>(), [0.0, 1.0, 4.0]);
        assert_eq!(ahead(moment), [2, 3, 1]);
        sequence.set_mode(SequenceMode::PreLoadAllImages);
        assert_eq!(ahead(sequence.advance(2.5)), [2, 3, 1, 0]);
        sequence.set_looping_mode(LoopingMode::NoLooping);
        assert_eq!(ahead(sequence.advance(2.5)), [2, 3]);
        assert!(ImageSequence::new("none", Vec::new()).advance(1.0).wanted.is_empty());
    }
}
