//! [`Tracks`]: which image each sequence should show, and which it shows. Update thread, once a frame, before cull.

use std::sync::Arc;
use std::time::{Duration, Instant};

use super::sequence::{ImageSequence, SequenceImage};
use super::store::ImageStore;
use crate::scene::Texture;
use crate::state::TextureObject;

/// A new image for a texture, for every context.
#[derive(Clone, Debug)]
pub(crate) struct ImageChange {
    pub(crate) texture: Arc<TextureObject>,
    pub(crate) image: Arc<Texture>,
}

/// An overdue image is due before the images of the present moment.
const OVERDUE_S: f64 = -1.0;

/// How long an overdue image is waited for after one was shown; doubled each time that it does not arrive.
const PATIENCE: Duration = Duration::from_secs(1);

/// An image of an earlier moment that is still loading. It is shown if the image of the moment is not loaded yet: otherwise
/// a sequence that is faster than its images load would show none.
#[derive(Clone, Copy)]
struct Overdue {
    index: usize,
    /// Then another image is waited for, twice as long.
    until: Instant,
}

/// A sequence, and which of its images its texture shows.
struct Track {
    sequence: ImageSequence,
    shown: Option<usize>,
    is_playing: bool,
    /// True while the image of the moment is not loaded and may still be.
    is_late: bool,
    overdue: Option<Overdue>,
    /// How long the next overdue image is waited for.
    patience: Duration,
}

/// An image of a sequence by its index.
type Indexed = (usize, SequenceImage);

/// The images that a sequence could show now.
pub(super) struct Candidates {
    track: usize,
    /// The image of the moment.
    now: Indexed,
    overdue: Option<Indexed>,
}

impl Track {
    /// Creates the track of a sequence that shows nothing yet.
    fn new(sequence: ImageSequence) -> Self {
        Self { sequence, shown: None, is_playing: false, is_late: true, overdue: None, patience: PATIENCE }
    }

    /// Moves time on, notes in the store which files the sequence needs, and returns what it could show. Returns `None`
    /// for a sequence without images or without users.
    fn advance(&mut self, store: &mut ImageStore, time_s: f64, now: Instant) -> Option<(Indexed, Option<Indexed>)> {
        let moment = self.sequence.advance(time_s);
        self.is_playing = moment.is_playing && self.sequence.image_count() > 1;
        if !self.sequence.is_used() {
            return None;
        }
        let mut want = |index: usize, due_s: f64| {
            let image = self.sequence.image(index)?;
            if let SequenceImage::File(uri) = &image {
                store.want(uri, due_s, moment.discards, now);
            }
            Some((index, image))
        };
        self.overdue = self.overdue.filter(|_| moment.is_continuous);
        let overdue = self.overdue.and_then(|overdue| want(overdue.index, OVERDUE_S));
        let mut present = None;
        for wanted in &moment.wanted {
            let image = want(wanted.index, wanted.due_s);
            present = present.or(image);
        }
        present.map(|present| (present, overdue))
    }

    /// Chooses the image to show from now on: that of the moment, or an overdue one that is loaded. Returns `None` if the
    /// texture does not change, and whether the image of the moment is missing.
    fn choose(&mut self, candidates: &Candidates, store: &ImageStore, at: Instant) -> (Option<Arc<Texture>>, bool) {
        let Candidates { now, overdue, .. } = candidates;
        let shown = self.shown;
        let differs = |image: &&Indexed| shown != Some(image.0);
        let load = |image: &Indexed| Some((image.0, loaded(store, image)?));
        let present = Some(now).filter(differs);
        let mut shows = present.and_then(load);
        let is_missing = present.is_some() && shows.is_none();
        let is_late = is_missing && is_coming(store, now);
        let mut waits =
            self.overdue.filter(|_| is_missing && overdue.as_ref().is_some_and(|image| is_coming(store, image)));
        let mut patience = self.patience;
        if is_missing && waits.is_none() {
            shows = overdue.as_ref().filter(differs).and_then(load);
        }
        if shows.is_some() {
            patience = PATIENCE;
        } else if waits.is_some_and(|overdue| overdue.until <= at) {
            (waits, patience) = (None, patience.saturating_mul(2));
        }
        if is_late && waits.is_none() {
            waits = at.checked_add(patience).map(|until| Overdue { index: now.0, until });
        }
        (self.is_late, self.overdue, self.patience) = (is_late, waits, patience);
        let image = shows.map(|(index, image)| {
            self.shown = Some(index);
            image
        });
        (image, is_missing)
    }
}

fn loaded(store: &ImageStore, (_, image): &Indexed) -> Option<Arc<Texture>> {
    match image {
        SequenceImage::Image(image) => Some(image.clone()),
        SequenceImage::File(uri) => store.image(uri).cloned(),
    }
}

fn is_coming(store: &ImageStore, (_, image): &Indexed) -> bool {
    matches!(image, SequenceImage::File(uri) if store.is_coming(uri))
}

/// The sequences of a pager.
#[derive(Default)]
pub(super) struct Tracks {
    tracks: Vec<Track>,
}

impl Tracks {
    /// Adds a sequence unless it is known.
    pub fn add(&mut self, sequence: &ImageSequence) {
        let is_known = |t: &Track| Arc::ptr_eq(t.sequence.shared_texture(), sequence.shared_texture());
        if !self.tracks.iter().any(is_known) {
            self.tracks.push(Track::new(sequence.clone()));
        }
    }

    /// Removes the sequences that only the pager refers to.
    pub fn remove_forgotten(&mut self) {
        self.tracks.retain(|track| !track.sequence.is_forgotten());
    }

    /// Shows every image again.
    pub fn show_again(&mut self) {
        for track in &mut self.tracks {
            track.shown = None;
        }
    }

    /// Returns true while a sequence plays or an image of the moment is loading.
    pub fn is_active(&self) -> bool {
        self.tracks.iter().any(|track| track.sequence.is_used() && (track.is_late || track.is_playing))
    }

    /// Moves time on and notes in the store which files are needed; returns what each used sequence could show.
    pub fn advance(&mut self, store: &mut ImageStore, time_s: f64, now: Instant) -> Vec<Candidates> {
        let mut candidates = Vec::with_capacity(self.tracks.len());
        for (index, track) in self.tracks.iter_mut().enumerate() {
            let shows = track.advance(store, time_s, now);
            candidates.extend(shows.map(|(now, overdue)| Candidates { track: index, now, overdue }));
        }
        candidates
    }

    /// Returns what textures show from now on, and how many sequences lack the image of the moment.
    pub fn changes(&mut self, candidates: &[Candidates], store: &ImageStore, at: Instant) -> (Vec<ImageChange>, u64) {
        let (mut changes, mut late) = (Vec::new(), 0);
        for track in &mut self.tracks {
            track.is_late = false;
        }
        for candidates in candidates {
            let Some(track) = self.tracks.get_mut(candidates.track) else { continue };
            let (image, is_missing) = track.choose(candidates, store, at);
            late += u64::from(is_missing);
            changes.extend(image.map(|image| ImageChange { texture: track.sequence.texture(), image }));
        }
        (changes, late)
    }
}

impl Candidates {
    /// Returns true if the image of the moment is not loaded and will be.
    pub fn is_loading(&self, store: &ImageStore) -> bool {
        is_coming(store, &self.now)
    }
}
