//! [`ImagePager`]: which images are wanted, loaded, shown and paged out. Update thread.

use std::collections::HashMap;
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::config::{ImagePagerConfig, ImagePagerStats};
use super::sequence::{ImageSequence, SequenceImage};
use super::threads::{Loaded, Threads};
use super::tracks::{ImageChange, Track};
use crate::io::IoError;
use crate::pager::stats::Errors;
use crate::pager::tries::Tries;
use crate::pager::{ErrorRecord, PagerError};
use crate::scene::Texture;

/// Failures that are remembered; with more, those that nobody wants are forgotten.
const MOST_FAILURES: usize = 4096;

pub(super) enum State {
    Waiting,
    Loading,
    Loaded(Arc<Texture>),
    /// Not asked for again before this; `None` for never.
    Failed {
        retry_at: Option<Instant>,
    },
}

/// An image from a file, for all sequences that name it.
pub(super) struct Slot {
    pub(super) state: State,
    tries: Tries,
    /// Of the image when it was last there; `None` before.
    size_bytes: Option<u64>,
    /// Number of the update that last wanted it.
    pub(super) wanted: u64,
    pub(super) wanted_at: Instant,
    pub(super) due_s: f64,
    /// Goes as soon as it is not wanted.
    pub(super) discards: bool,
    /// Within the budgets of this update.
    admitted: bool,
}

/// Loads images of sequences ahead of their time and pages them out.
pub struct ImagePager {
    config: ImagePagerConfig,
    threads: Threads,
    pub(super) tracks: Vec<Track>,
    /// By URI.
    pub(super) slots: HashMap<Arc<str>, Slot>,
    /// Of decoded images.
    bytes: u64,
    images: usize,
    /// Of the last images.
    mean_bytes: u64,
    pub(super) updates: u64,
    pub(super) stats: ImagePagerStats,
    errors: Errors,
}

impl Slot {
    /// Of an image that nobody wanted before.
    pub(super) fn new(now: Instant) -> Self {
        Self {
            state: State::Waiting,
            tries: Tries::default(),
            size_bytes: None,
            wanted: 0,
            wanted_at: now,
            due_s: f64::INFINITY,
            discards: true,
            admitted: false,
        }
    }

    /// Nobody wants it in this update, nor will it be kept for later.
    fn is_expired(&self, updates: u64, expiry: Duration, now: Instant) -> bool {
        self.wanted != updates && (self.discards || now.saturating_duration_since(self.wanted_at) > expiry)
    }
}

fn bytes_of(image: &Texture) -> u64 {
    image.mips.iter().map(|m| m.len() as u64).sum()
}

impl ImagePager {
    /// Starts the threads.
    pub fn new(config: ImagePagerConfig) -> Result<Self, PagerError> {
        let threads = Threads::start(&config)?;
        Ok(Self {
            config,
            threads,
            tracks: Vec::new(),
            slots: HashMap::new(),
            bytes: 0,
            images: 0,
            mean_bytes: 0,
            updates: 0,
            stats: ImagePagerStats::default(),
            errors: Errors::default(),
        })
    }

    /// Takes a sequence, until nobody else has it or its texture.
    pub fn add(&mut self, sequence: &ImageSequence) {
        let known = |t: &Track| Arc::ptr_eq(t.sequence.shared_texture(), sequence.shared_texture());
        if !self.tracks.iter().any(known) {
            self.tracks.push(Track::new(sequence.clone()));
        }
    }

    /// Counters up to the last update.
    pub fn stats(&self) -> &ImagePagerStats {
        &self.stats
    }

    /// What failed so far, by URI and reason.
    pub fn errors(&self) -> Vec<ErrorRecord> {
        self.errors.list()
    }

    /// True while another frame would show another image: something plays, or an image of the moment is to come, or failed
    /// and is to be tried again now.
    pub fn needs_frame(&self) -> bool {
        let now = Instant::now();
        let is_due = |s: &Slot| {
            let is_present = s.wanted == self.updates && s.due_s <= 0.0;
            is_present && matches!(s.state, State::Failed { retry_at: Some(at) } if at <= now)
        };
        self.tracks.iter().any(|t| t.sequence.is_used() && (t.is_late || t.is_playing))
            || self.slots.values().any(is_due)
    }

    /// Shows everything again: for contexts that have not got it.
    pub(crate) fn show_again(&mut self) {
        for track in &mut self.tracks {
            track.shown = None;
        }
    }

    /// The pager's turn once a frame: what textures show from this frame on.
    pub(crate) fn update(&mut self, simulation_time_s: f64) -> Vec<ImageChange> {
        self.updates += 1;
        let now = Instant::now();
        self.tracks.retain(|t| !t.sequence.is_forgotten());
        while let Some(loaded) = self.threads.try_loaded() {
            self.arrive(loaded);
        }
        let present = self.want(simulation_time_s, now);
        self.admit();
        self.page_out(now);
        self.request(now);
        while self.config.blocking && present.iter().any(|present| self.is_coming(&present.now)) {
            if let Some(loaded) = self.threads.wait_loaded(Duration::from_millis(20)) {
                self.arrive(loaded);
                // Of another size than was thought: two that do not fit together would take turns for ever.
                self.admit();
                self.page_out(now);
                self.request(now);
            }
        }
        let changes = self.changes(&present, now);
        self.count();
        changes
    }

    /// Chooses among the wanted files those that the budgets have room for, the most urgent first.
    fn admit(&mut self) {
        let mut wanted: Vec<(f64, Arc<str>)> = Vec::new();
        for (uri, slot) in &mut self.slots {
            slot.admitted = false;
            let is_hopeless = matches!(slot.state, State::Failed { retry_at: None });
            if slot.wanted == self.updates && !is_hopeless {
                wanted.push((slot.due_s, uri.clone()));
            }
        }
        wanted.sort_by(|a, b| a.0.total_cmp(&b.0).then_with(|| a.1.cmp(&b.1)));
        let mut bytes = 0;
        for (_, uri) in wanted.iter().take(self.config.max_images.max(1)) {
            let Some(slot) = self.slots.get_mut(uri) else { continue };
            let size = slot.size_bytes.unwrap_or(self.mean_bytes);
            bytes += size;
            if bytes > self.config.max_bytes && bytes > size {
                break;
            }
            slot.admitted = true;
        }
    }

    /// Lets go of what expired, and of what was not wanted for longest while something admitted has no room.
    fn page_out(&mut self, now: Instant) {
        let is_loaded = |s: &Slot| matches!(s.state, State::Loaded(_));
        let updates = self.updates;
        let expiry = self.config.expiry;
        let gone = |s: &Slot| is_loaded(s) && s.is_expired(updates, expiry, now);
        let expired: Vec<Arc<str>> = self.slots.iter().filter(|(_, s)| gone(s)).map(|(uri, _)| uri.clone()).collect();
        for uri in expired {
            self.let_go(&uri);
        }
        let mut spare: Vec<(u64, f64, Arc<str>)> = Vec::new();
        if self.is_beyond() {
            let spared = self.slots.iter().filter(|(_, s)| is_loaded(s) && !s.admitted);
            spare.extend(spared.map(|(uri, s)| (s.wanted, s.due_s, uri.clone())));
            // Wanted longest ago first; of those wanted now, the latest due.
            spare.sort_by(|a, b| a.0.cmp(&b.0).then(b.1.total_cmp(&a.1)).then_with(|| a.2.cmp(&b.2)));
        }
        for (_, _, uri) in spare {
            if !self.is_beyond() {
                break;
            }
            self.let_go(&uri);
        }
        for slot in self.slots.values_mut() {
            if matches!(slot.state, State::Waiting) && slot.wanted != updates && !slot.tries.is_none() {
                slot.state = State::Failed { retry_at: Some(now) };
            }
        }
        let is_kept = |s: &Slot| match s.state {
            State::Loaded(_) | State::Loading => true,
            State::Waiting => s.wanted == updates,
            State::Failed { .. } => true,
        };
        self.slots.retain(|_, s| is_kept(s));
        if self.slots.len() > MOST_FAILURES.saturating_add(self.config.max_images) {
            self.slots.retain(|_, s| s.wanted == updates || !matches!(s.state, State::Failed { .. }));
        }
    }

    /// The budgets have no room for what is there, under way, or admitted.
    fn is_beyond(&self) -> bool {
        let comes = |s: &&Slot| matches!(s.state, State::Loading) || s.admitted && matches!(s.state, State::Waiting);
        let sizes = self.slots.values().filter(comes).map(|s| s.size_bytes.unwrap_or(self.mean_bytes));
        let (images, bytes) = sizes.fold((0, 0), |(images, bytes), size| (images + 1, bytes + size));
        self.images + images > self.config.max_images.max(1) || self.bytes + bytes > self.config.max_bytes
    }

    fn let_go(&mut self, uri: &Arc<str>) {
        let Some(slot) = self.slots.get_mut(uri) else { return };
        if let State::Loaded(image) = std::mem::replace(&mut slot.state, State::Waiting) {
            self.bytes -= bytes_of(&image);
            self.images -= 1;
            self.stats.paged_out += 1;
        }
    }

    /// Writes the request list: what is admitted and not there, as far as there is room.
    fn request(&mut self, now: Instant) {
        let mut waiting = self.threads.lock();
        for uri in waiting.taken.drain(..) {
            // Also where nobody wants it since this update: it is on its way, and is not to be asked for beside that.
            let slot = self.slots.entry(uri).or_insert_with(|| Slot::new(now));
            if !matches!(slot.state, State::Loaded(_)) {
                slot.state = State::Loading;
            }
        }
        let mut wanted: Vec<(f64, &Arc<str>)> = Vec::new();
        let mut loading = 0;
        for (uri, slot) in &mut self.slots {
            // Where nobody wants it, it waits on: its tries are not forgotten.
            if let State::Failed { retry_at: Some(at) } = slot.state
                && at <= now
                && slot.wanted == self.updates
            {
                slot.state = State::Waiting;
            }
            match slot.state {
                State::Waiting if slot.admitted => wanted.push((slot.due_s, uri)),
                State::Loading => loading += 1,
                _ => {}
            }
        }
        // Taken from the end: the most urgent last.
        wanted.sort_by(|a, b| b.0.total_cmp(&a.0).then_with(|| b.1.cmp(a.1)));
        let room = self.config.max_images.max(1).saturating_sub(self.images + loading);
        let first = wanted.len().saturating_sub(room);
        waiting.uris.clear();
        waiting.uris.extend(wanted[first..].iter().map(|(_, uri)| (*uri).clone()));
        let is_empty = waiting.uris.is_empty();
        drop(waiting);
        let slots = &self.slots;
        let is_wanted = |slot: &Slot| !slot.is_expired(self.updates, self.config.expiry, now);
        self.threads.give_up(|uri| !slots.get(uri).is_some_and(is_wanted));
        if !is_empty {
            self.threads.ring();
        }
    }

    fn arrive(&mut self, loaded: Loaded) {
        let Loaded { uri, image, bytes_read } = loaded;
        // What was taken and came since the last look is further already, and may be let go before the next.
        self.threads.lock().taken.retain(|taken| *taken != uri);
        self.stats.bytes_read += bytes_read;
        let Some(image) = image else {
            self.stats.cancelled += 1;
            if let Some(slot) = self.slots.get_mut(&uri).filter(|slot| matches!(slot.state, State::Loading)) {
                slot.state = State::Waiting;
            }
            return;
        };
        let max_bytes = self.config.max_bytes;
        let image = image.and_then(|image| match bytes_of(&image) {
            got if got > max_bytes => {
                Err(IoError::TooLarge { uri: uri.to_string(), what: "image", got, limit: max_bytes })
            }
            _ => Ok(image),
        });
        let Some(slot) = self.slots.get_mut(&uri) else { return };
        match image {
            Ok(image) => {
                let bytes = bytes_of(&image);
                (slot.tries, slot.size_bytes) = (Tries::default(), Some(bytes));
                if matches!(slot.state, State::Loaded(_)) {
                    return;
                }
                slot.state = State::Loaded(image);
                self.stats.loaded += 1;
                self.bytes += bytes;
                self.images += 1;
                self.mean_bytes = if self.mean_bytes == 0 { bytes } else { (7 * self.mean_bytes + bytes) / 8 };
                self.make_room();
                self.stats.images_peak = self.stats.images_peak.max(self.images as u64);
                self.stats.bytes_peak = self.stats.bytes_peak.max(self.bytes);
            }
            Err(error) => {
                self.stats.failed += 1;
                self.errors.add(&error);
                let wait = slot.tries.fail(&error, self.config.retry_after, self.config.max_tries);
                // Beyond what the clock knows it is never.
                slot.state = State::Failed { retry_at: wait.and_then(|wait| Instant::now().checked_add(wait)) };
            }
        }
    }

    /// An image that has come may be larger than was thought: the least urgent go, that one too where it is among them.
    /// In the order of [`Self::admit`]: what goes is not admitted beside what stays, and does not come again.
    fn make_room(&mut self) {
        while self.bytes > self.config.max_bytes || self.images > self.config.max_images.max(1) {
            let loaded = self.slots.iter().filter(|(_, s)| matches!(s.state, State::Loaded(_)));
            let least = loaded.max_by(|(a, s), (b, t)| {
                let unwanted = |s: &Slot| s.wanted < self.updates;
                let by_time = unwanted(s).cmp(&unwanted(t)).then(s.due_s.total_cmp(&t.due_s));
                by_time.then_with(|| a.cmp(b))
            });
            let Some(least) = least.map(|(uri, _)| uri.clone()) else { break };
            self.let_go(&least);
        }
    }

    /// Not there, but asked for and not failed.
    pub(super) fn is_coming(&self, (_, image): &(usize, SequenceImage)) -> bool {
        let SequenceImage::File(uri) = image else { return false };
        self.slots.get(uri).is_some_and(|s| s.admitted && matches!(s.state, State::Waiting | State::Loading))
    }

    fn count(&mut self) {
        let s = &mut self.stats;
        (s.images, s.bytes) = (self.images as u64, self.bytes);
        s.in_flight = self.slots.values().filter(|slot| matches!(slot.state, State::Loading)).count() as u64;
        s.waiting = self.threads.lock().uris.len() as u64;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pager_with(uri: &Arc<str>, state: State, tries: Tries) -> ImagePager {
        let mut pager = ImagePager::new(ImagePagerConfig::default()).unwrap();
        let now = Instant::now();
        let (size_bytes, due_s) = (None, 0.0);
        let slot =
            Slot { state, tries, size_bytes, wanted: 0, wanted_at: now, due_s, discards: false, admitted: false };
        pager.slots.insert(uri.clone(), slot);
        pager
    }

    /// It was asked for a second time, and where that one failed the first one's image was counted for ever.
    #[test]
    fn what_a_thread_takes_while_nobody_wants_it_is_on_its_way() {
        let uri: Arc<str> = "a.png".into();
        let mut failed = Tries::default();
        failed.fail(&IoError::NotFound { uri: uri.to_string() }, Duration::ZERO, None);
        for tries in [Tries::default(), failed] {
            let mut pager = pager_with(&uri, State::Waiting, tries);
            let now = Instant::now();
            pager.updates += 1;
            pager.threads.lock().taken.push(uri.clone());
            pager.page_out(now);
            pager.request(now);
            assert!(matches!(pager.slots[&uri].state, State::Loading));
            let slot = pager.slots.get_mut(&uri).unwrap();
            (slot.wanted, slot.admitted) = (pager.updates, true);
            pager.request(now);
            assert!(pager.threads.lock().uris.is_empty(), "once");
            pager.updates += 1;
            pager.arrive(Loaded { uri: uri.clone(), image: None, bytes_read: 0 });
            pager.page_out(now);
            assert_eq!(pager.slots.is_empty(), tries.is_none(), "given up; its tries are not forgotten");
        }
    }

    #[test]
    fn what_comes_and_goes_between_two_lists_is_asked_for_again() {
        let uri: Arc<str> = "a.png".into();
        let mut pager = pager_with(&uri, State::Waiting, Tries::default());
        pager.threads.lock().taken.push(uri.clone());
        let image = Texture { width: 1, height: 1, mips: vec![vec![1; 4]], wrap: Default::default() };
        pager.arrive(Loaded { uri: uri.clone(), image: Some(Ok(image.into())), bytes_read: 4 });
        pager.let_go(&uri);
        pager.request(Instant::now());
        assert!(matches!(pager.slots[&uri].state, State::Waiting));
    }

    /// They took turns for ever: either was admitted beside the other by the mean size, and let it go when it came.
    #[test]
    fn images_of_unequal_sizes_take_no_turns() {
        let folder = tempfile::tempdir().unwrap();
        let sides = [("small.png", 64), ("wide.png", 104)];
        let files = sides.map(|(name, side)| {
            let file = folder.path().join(name);
            image::RgbImage::new(side, side).save(&file).unwrap();
            file.display().to_string()
        });
        // All levels of both together are 79,488 bytes.
        let config = ImagePagerConfig { max_bytes: 79_000, ..ImagePagerConfig::default() };
        let mut pager = ImagePager::new(config).unwrap();
        let sequence = ImageSequence::from_files("test", files);
        let _used = sequence.texture();
        pager.add(&sequence);
        let until = Instant::now() + Duration::from_secs(60);
        let mut updates_after = 0;
        while updates_after < 100 {
            assert!(Instant::now() < until, "{:?}", pager.stats);
            pager.update(0.0);
            updates_after += u32::from(pager.stats.loaded >= 2);
            std::thread::sleep(Duration::from_millis(1));
        }
        let stats = pager.stats;
        assert_eq!((stats.loaded, stats.images, stats.shown), (2, 1, 1), "{stats:?}");
        assert_eq!(pager.bytes, 21_844, "the one of the moment");
    }

    /// Each of them had all threads but one, so that two had all.
    #[cfg(feature = "http")]
    #[test]
    fn servers_that_hang_hold_up_no_file_and_no_other_server() {
        use std::io::{Read as _, Write as _};
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a.png");
        image::RgbImage::new(8, 8).save(&file).unwrap();
        let image = std::fs::read(&file).unwrap();
        let listen = || std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        // Connections wait to be taken for ever.
        let hung: Vec<_> = (0..5).map(|_| listen()).collect();
        let well = listen();
        let url = |server: &std::net::TcpListener, k: u32| format!("http://{}/{k}.png", server.local_addr().unwrap());
        let long = Duration::from_secs(1000);
        let http = crate::io::HttpConfig { first_byte_timeout: long, total_timeout: long, ..Default::default() };
        let mut pager = ImagePager::new(ImagePagerConfig { http, ..ImagePagerConfig::default() }).unwrap();
        let files = hung.iter().map(|server| (0..9).map(|k| url(server, k)).collect());
        let files: Vec<Vec<String>> = files.chain([vec![file.display().to_string()], vec![url(&well, 0)]]).collect();
        let sequences: Vec<_> = files.into_iter().map(|files| ImageSequence::from_files("test", files)).collect();
        let _used: Vec<_> = sequences.iter().map(ImageSequence::texture).collect();
        sequences[..5].iter().for_each(|sequence| pager.add(sequence));
        let until = Instant::now() + Duration::from_secs(60);
        let update_until = |is_so: &dyn Fn(&ImagePagerStats) -> bool, pager: &mut ImagePager| {
            while !is_so(&pager.stats) {
                assert!(Instant::now() < until, "{:?}", pager.stats);
                pager.update(0.0);
                std::thread::sleep(Duration::from_millis(1));
            }
        };
        update_until(&|stats| stats.in_flight >= 3, &mut pager);
        sequences[5..].iter().for_each(|sequence| pager.add(sequence));
        std::thread::spawn(move || {
            let (mut stream, _) = well.accept().unwrap();
            let _ = stream.read(&mut [0; 4096]).unwrap();
            let head = format!("HTTP/1.1 200 OK\r\nContent-Length: {}\r\n\r\n", image.len());
            stream.write_all(&[head.as_bytes(), &image].concat()).unwrap();
        });
        update_until(&|stats| stats.shown == 2, &mut pager);
        assert_eq!(pager.stats.failed, 0);
    }

    /// Each was let go before it came, and none was shown.
    #[test]
    fn a_sequence_faster_than_its_images_come_shows_some_of_them() {
        let folder = tempfile::tempdir().unwrap();
        let write = |k: u32| {
            let file = folder.path().join(format!("{k}.png"));
            image::RgbImage::from_pixel(8, 8, image::Rgb([k as u8, 0, 0])).save(&file).unwrap();
            file.display().to_string()
        };
        let sequence = ImageSequence::from_files("test", (0..60).map(write));
        sequence.set_mode(crate::pager::SequenceMode::PageAndDiscardUsedImages);
        sequence.set_pre_load_frames(0);
        sequence.set_length(60.0);
        sequence.set_looping_mode(crate::pager::LoopingMode::NoLooping);
        sequence.play();
        let _used = sequence.texture();
        let mut pager = ImagePager::new(ImagePagerConfig::default()).unwrap();
        pager.add(&sequence);
        // An update asks for the image of its moment, and those before it come.
        let update = |pager: &mut ImagePager, time_s: f64| {
            let loaded = pager.stats.loaded;
            let until = Instant::now() + Duration::from_secs(60);
            let changes = pager.update(time_s);
            while pager.stats.loaded == loaded {
                assert!(Instant::now() < until, "{:?}", pager.stats);
                if let Some(loaded) = pager.threads.wait_loaded(Duration::from_millis(20)) {
                    pager.arrive(loaded);
                }
            }
            changes.into_iter().map(|change| change.image.mips[0][0]).collect::<Vec<_>>()
        };
        let shown: Vec<_> = (0..20).map(|k| update(&mut pager, f64::from(k))).collect();
        let order: Vec<_> = shown.concat();
        assert!(order.len() >= 10 && order.is_sorted(), "{shown:?}");
        assert!(shown.iter().all(|shown| shown.len() <= 1), "{shown:?}");
        // Where it stands, the image of the moment is the last.
        sequence.pause();
        let (mut last, until) = (order[order.len() - 1], Instant::now() + Duration::from_secs(60));
        while pager.needs_frame() {
            assert!(Instant::now() < until, "{:?}", pager.stats);
            last = pager.update(20.0).last().map_or(last, |change| change.image.mips[0][0]);
            std::thread::sleep(Duration::from_millis(1));
        }
        assert_eq!(u32::from(last), 19, "{shown:?}");
        assert_eq!(pager.stats.images, 1);
    }

    #[test]
    fn tries_are_not_forgotten_while_nobody_wants_an_image() {
        let uri: Arc<str> = "a.png".into();
        let now = Instant::now();
        let mut tries = Tries::default();
        tries.fail(&IoError::NotFound { uri: uri.to_string() }, Duration::ZERO, None);
        let is_to_be_tried = |pager: &ImagePager| {
            let slot = &pager.slots[&uri];
            slot.tries == tries && matches!(slot.state, State::Failed { retry_at: Some(at) } if at <= now)
        };
        for state in [State::Failed { retry_at: Some(now) }, State::Waiting] {
            let mut pager = pager_with(&uri, state, tries);
            for _ in 0..3 {
                pager.updates += 1;
                pager.page_out(now);
                pager.request(now);
                assert!(is_to_be_tried(&pager));
            }
            pager.slots.get_mut(&uri).unwrap().wanted = pager.updates;
            pager.request(now);
            assert!(matches!(pager.slots[&uri].state, State::Waiting));
        }
    }
}
