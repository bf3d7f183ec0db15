//! [`ImageSequence`]: images over time as a texture; OSG's ImageSequence. Plain values behind a lock, any thread.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::scene::Texture;
use crate::state::TextureObject;

/// Images ahead of the present one that are loaded before their time, unless told otherwise.
const PRE_LOAD_FRAMES: usize = 8;

/// What comes after the last image.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LoopingMode {
    /// It stays, and the sequence pauses.
    NoLooping,
    /// The first.
    #[default]
    Looping,
    /// The last but one, and so on back to the first; OSG's `Sequence::SWING`.
    Swing,
}

/// What is loaded when, and kept how long.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum SequenceMode {
    /// All images as soon as possible, as far as the pager's budgets go.
    PreLoadAllImages,
    /// Some images ahead; what was shown stays while there is room.
    #[default]
    PageAndRetainImages,
    /// Some images ahead; what was shown goes at once.
    PageAndDiscardUsedImages,
}

/// Whether time passes in a sequence.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum StreamStatus {
    /// It was never played.
    #[default]
    Invalid,
    /// Time passes.
    Playing,
    /// Time stands, or has reached the end.
    Paused,
}

/// One image of a sequence.
#[derive(Clone, Debug)]
pub enum SequenceImage {
    /// Read when it is needed: a path or a URL of a PNG or JPEG.
    File(Arc<str>),
    /// The application's, which stays.
    Image(Arc<Texture>),
}

/// What control and update share.
#[derive(Debug)]
struct Control {
    images: Vec<SequenceImage>,
    mode: SequenceMode,
    looping: LoopingMode,
    /// Of all images once.
    length_s: f64,
    time_multiplier: f64,
    pre_load_frames: usize,
    status: StreamStatus,
    /// Time in the sequence at `since_s`; runs on without bound where it loops.
    position_s: f64,
    /// Simulation time at which `position_s` held; set by update.
    since_s: Option<f64>,
    /// Simulation time between the last two updates.
    frame_s: f64,
}

#[derive(Debug)]
struct Inner {
    texture: Arc<TextureObject>,
    control: Mutex<Control>,
}

/// Images over simulation time, shown by one texture. A handle: clones control the same sequence, from any thread.
///
/// The texture goes into a state set with [`TextureBinding`](crate::state::TextureBinding); what it shows changes once
/// an [`ImagePager`](super::ImagePager) has the sequence (`Viewer::add_image_sequence`). Until the first image is there
/// it is white. Nothing is loaded while no state set holds the texture.
#[derive(Clone, Debug)]
pub struct ImageSequence {
    inner: Arc<Inner>,
}

/// An image and the seconds until it is to be shown.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Wanted {
    pub index: usize,
    pub due_s: f64,
}

/// Which images a moment needs.
#[derive(Debug, Default)]
pub(super) struct Moment {
    /// First the present one, then those ahead; each once. Empty without images.
    pub wanted: Vec<Wanted>,
    pub discards: bool,
    pub is_playing: bool,
    /// Time has passed since the moment before, and did not jump.
    pub goes_on: bool,
}

impl ImageSequence {
    /// A sequence of images in the order shown, one second long, which loops once it is played.
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

    /// A sequence of files or URLs.
    pub fn from_files<S: Into<Arc<str>>>(name: &str, files: impl IntoIterator<Item = S>) -> Self {
        Self::new(name, files.into_iter().map(|file| SequenceImage::File(file.into())).collect())
    }

    /// What shows the sequence: for a texture unit of a state set.
    pub fn texture(&self) -> Arc<TextureObject> {
        self.inner.texture.clone()
    }

    fn control(&self) -> MutexGuard<'_, Control> {
        self.inner.control.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Adds an image at the end; the length stays.
    pub fn add_image(&self, image: SequenceImage) {
        self.control().images.push(image);
    }

    /// How many images there are.
    pub fn image_count(&self) -> usize {
        self.control().images.len()
    }

    /// What is loaded when.
    pub fn set_mode(&self, mode: SequenceMode) {
        self.control().mode = mode;
    }

    /// How many images ahead are loaded before their time; 8 unless set. Where two or more images pass between frames
    /// these are the images of coming frames, not all of those between them.
    pub fn set_pre_load_frames(&self, frames: usize) {
        self.control().pre_load_frames = frames;
    }

    /// What comes after the last image.
    pub fn set_looping_mode(&self, looping: LoopingMode) {
        self.control().looping = looping;
    }

    /// Seconds that all images take at a time multiplier of 1; not finite or not positive changes nothing. The present
    /// image stays.
    pub fn set_length(&self, length_s: f64) {
        let mut control = self.control();
        if length_s.is_finite() && length_s > 0.0 {
            control.position_s *= length_s / control.length_s;
            control.length_s = length_s;
        }
    }

    /// Seconds that all images take at a time multiplier of 1.
    pub fn length(&self) -> f64 {
        self.control().length_s
    }

    /// Sets the length so that so many images are shown a second.
    pub fn set_frame_rate(&self, images_per_s: f64) {
        self.set_length(self.image_count().max(1) as f64 / images_per_s);
    }

    /// How fast time passes, 1 as the simulation's; below 0 backwards. Not finite changes nothing.
    pub fn set_time_multiplier(&self, multiplier: f64) {
        if multiplier.is_finite() {
            self.control().time_multiplier = multiplier;
        }
    }

    /// Lets time pass from the next update on.
    pub fn play(&self) {
        self.control().status = StreamStatus::Playing;
    }

    /// Lets time stand from the next update on.
    pub fn pause(&self) {
        self.control().status = StreamStatus::Paused;
    }

    /// Goes to the first image.
    pub fn rewind(&self) {
        self.seek(0.0);
    }

    /// Goes to a time in the sequence in seconds, at a time multiplier of 1; playing or not stays. Not finite changes
    /// nothing.
    pub fn seek(&self, time_s: f64) {
        let mut control = self.control();
        if time_s.is_finite() {
            control.position_s = time_s;
            // Counts from the next update: the time it is asked in is no frame's.
            control.since_s = None;
        }
    }

    /// Whether time passes.
    pub fn status(&self) -> StreamStatus {
        self.control().status
    }

    /// The time in the sequence at the last update, seconds; runs on where it loops.
    pub fn position(&self) -> f64 {
        self.control().position_s
    }

    /// Its texture is in some state set.
    pub(super) fn is_used(&self) -> bool {
        Arc::strong_count(&self.inner.texture) > 1
    }

    /// Only the pager has it.
    pub(super) fn is_forgotten(&self) -> bool {
        Arc::strong_count(&self.inner) == 1 && !self.is_used()
    }

    pub(super) fn shared_texture(&self) -> &Arc<TextureObject> {
        &self.inner.texture
    }

    pub(super) fn image(&self, index: usize) -> Option<SequenceImage> {
        self.control().images.get(index).cloned()
    }

    /// Goes on to a simulation time: what is to be shown now and soon.
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
        let goes_on = self.status == StreamStatus::Playing && self.since_s.is_some();
        if let (StreamStatus::Playing, Some(since_s)) = (self.status, self.since_s) {
            let frame_s = now_s - since_s;
            self.position_s += frame_s * self.time_multiplier;
            // One long frame says nothing of the next.
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
        Moment { wanted, discards, is_playing, goes_on }
    }

    /// The image of a time in the sequence; there is one.
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
        // A time that a sum of frames gave may lie a rounding before the image's own.
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
    fn images_come_in_the_order_of_the_looping_mode() {
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
    fn time_starts_with_play_stands_when_paused_and_jumps_where_asked() {
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
    fn the_end_without_looping_is_a_pause() {
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
        assert_eq!(ahead(3.1), [3, 4, 5, 6], "one long frame");
        assert_eq!(ahead(6.2), [6, 9, 12, 15]);
        assert_eq!(ahead(8.1), [8, 9, 10, 11], "as slow as images");
        sequence.set_mode(SequenceMode::PreLoadAllImages);
        sequence.advance(11.2);
        assert_eq!(sequence.advance(14.3).wanted.len(), 20);
    }

    #[test]
    fn images_ahead_follow_the_way_it_plays() {
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
