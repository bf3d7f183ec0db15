//! Which image each sequence is to show, and which it shows. Update thread, once a frame, before cull.

use std::sync::Arc;
use std::time::{Duration, Instant};

use super::sequence::{ImageSequence, SequenceImage};
use super::store::{ImagePager, Slot, State};
use crate::scene::Texture;
use crate::state::TextureObject;

/// Another image for a texture, for every context.
#[derive(Clone, Debug)]
pub(crate) struct ImageChange {
    pub(crate) texture: Arc<TextureObject>,
    pub(crate) image: Arc<Texture>,
}

/// A sequence, and which of its images its texture shows.
pub(super) struct Track {
    pub(super) sequence: ImageSequence,
    pub(super) shown: Option<usize>,
    pub(super) is_playing: bool,
    /// The image of the moment is not there, and may come.
    pub(super) is_late: bool,
    overdue: Option<Overdue>,
    /// How long the next overdue image is waited for.
    patience: Duration,
}

/// An image of an earlier moment that is still to come: shown where that of its moment is not there yet. Without it a
/// sequence that is faster than its images come would show none.
#[derive(Clone, Copy)]
struct Overdue {
    index: usize,
    /// Then another is waited for, twice as long.
    until: Instant,
}

/// What is due before the images of this moment.
const OVERDUE_S: f64 = -1.0;

/// How long an overdue image is waited for after one was shown.
const PATIENCE: Duration = Duration::from_secs(1);

/// The images that a sequence could show now: that of the moment, and one that is overdue.
pub(super) struct Present {
    track: usize,
    pub(super) now: (usize, SequenceImage),
    overdue: Option<(usize, SequenceImage)>,
}

impl Track {
    /// Nothing of it is shown yet.
    pub(super) fn new(sequence: ImageSequence) -> Self {
        Self { sequence, shown: None, is_playing: false, is_late: true, overdue: None, patience: PATIENCE }
    }
}

impl ImagePager {
    /// Moves time on and notes which files it needs; what each used sequence could show.
    pub(super) fn want(&mut self, simulation_time_s: f64, now: Instant) -> Vec<Present> {
        let mut present = Vec::with_capacity(self.tracks.len());
        for slot in self.slots.values_mut() {
            slot.due_s = f64::INFINITY;
        }
        for (place, track) in self.tracks.iter_mut().enumerate() {
            let moment = track.sequence.advance(simulation_time_s);
            track.is_playing = moment.is_playing && track.sequence.image_count() > 1;
            if !track.sequence.is_used() {
                continue;
            }
            let mut need = |index: usize, due_s: f64| {
                let image = track.sequence.image(index)?;
                if let SequenceImage::File(uri) = &image {
                    let slot = self.slots.entry(uri.clone()).or_insert_with(|| Slot::new(now));
                    (slot.wanted, slot.wanted_at) = (self.updates, now);
                    slot.due_s = slot.due_s.min(due_s);
                    slot.discards = moment.discards;
                }
                Some((index, image))
            };
            track.overdue = track.overdue.filter(|_| moment.goes_on);
            let overdue = track.overdue.and_then(|overdue| need(overdue.index, OVERDUE_S));
            let mut of_now = None;
            for wanted in &moment.wanted {
                let image = need(wanted.index, wanted.due_s);
                of_now = of_now.or(image);
            }
            present.extend(of_now.map(|of_now| Present { track: place, now: of_now, overdue }));
        }
        present
    }

    /// The image, where it is there.
    fn found(&self, (_, image): &(usize, SequenceImage)) -> Option<Arc<Texture>> {
        match image {
            SequenceImage::Image(image) => Some(image.clone()),
            SequenceImage::File(uri) => match &self.slots.get(uri)?.state {
                State::Loaded(image) => Some(image.clone()),
                _ => None,
            },
        }
    }

    /// What textures show from now on: the image of the moment, or one that was overdue and has come.
    pub(super) fn changes(&mut self, present: &[Present], at: Instant) -> Vec<ImageChange> {
        let mut changes = Vec::new();
        for track in &mut self.tracks {
            track.is_late = false;
        }
        for Present { track: place, now, overdue } in present {
            let Some(track) = self.tracks.get(*place) else { continue };
            let differs = |image: &&(usize, SequenceImage)| track.shown != Some(image.0);
            let found = |image: &(usize, SequenceImage)| Some((image.0, self.found(image)?));
            let of_now = Some(now).filter(differs);
            let mut shows = of_now.and_then(found);
            let lacks = of_now.is_some() && shows.is_none();
            let is_late = lacks && self.is_coming(now);
            let mut waits = track.overdue.filter(|_| lacks && overdue.as_ref().is_some_and(|o| self.is_coming(o)));
            let mut patience = track.patience;
            if lacks && waits.is_none() {
                shows = overdue.as_ref().filter(differs).and_then(found);
            }
            if shows.is_some() {
                patience = PATIENCE;
            } else if waits.is_some_and(|overdue| overdue.until <= at) {
                (waits, patience) = (None, patience.saturating_mul(2));
            }
            if is_late && waits.is_none() {
                waits = at.checked_add(patience).map(|until| Overdue { index: now.0, until });
            }
            self.stats.late += u64::from(lacks);
            let track = &mut self.tracks[*place];
            (track.is_late, track.overdue, track.patience) = (is_late, waits, patience);
            if let Some((index, image)) = shows {
                track.shown = Some(index);
                self.stats.shown += 1;
                changes.push(ImageChange { texture: track.sequence.texture(), image });
            }
        }
        changes
    }
}
