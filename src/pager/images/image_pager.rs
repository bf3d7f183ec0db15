//! [`ImagePager`]: its parts, and its turn in a frame. Update thread.

use std::collections::HashSet;
use std::time::{Duration, Instant};

use super::config::{ImagePagerConfig, ImagePagerStats};
use super::job::{ImageJob, ImageReader};
use super::sequence::ImageSequence;
use super::store::ImageStore;
use super::tracks::{ImageChange, Tracks};
use crate::pager::config::PagerError;
use crate::pager::loading::config::{LimitRange, LoadConfig};
use crate::pager::loading::job::Answer;
use crate::pager::loading::request::Request as _;
use crate::pager::loading::request_list::Limits;
use crate::pager::loading::threads::LoadThreads;
use crate::pager::loading::ticket::Ticket;
use crate::pager::stats::{ErrorRecord, Errors};

/// How long the blocking mode waits for an answer before it looks again.
const BLOCKING_POLL: Duration = Duration::from_millis(20);

/// Loads the images of sequences ahead of the time at which they are shown, and pages them out.
pub struct ImagePager {
    is_blocking: bool,
    threads: LoadThreads<ImageJob>,
    tracks: Tracks,
    store: ImageStore,
    stats: ImagePagerStats,
    errors: Errors,
}

impl ImagePager {
    /// Starts the threads.
    ///
    /// # Errors
    /// [`PagerError`] if a thread or the HTTP client cannot be started.
    pub fn new(config: ImagePagerConfig) -> Result<Self, PagerError> {
        let count = config.threads.max(1);
        let reader = ImageReader {
            limits: config.limits,
            #[cfg(feature = "http")]
            client: crate::fetch::HttpClient::new(&config.http).map_err(PagerError::Http)?,
        };
        let threads = LoadThreads::start(&LoadConfig {
            readers: count,
            decoders: count,
            // Few, so that a sequence that is faster than its images load does not wait for images it has passed.
            max_files: 2 * count,
            per_server: LimitRange::new(count, 0),
            max_bytes: config.max_bytes_loading,
            waits_for_contents: true,
            limits: config.limits,
        })?;
        #[cfg(feature = "http")]
        if let Some(http) = threads.http() {
            http.add_client(reader.client.clone());
        }
        Ok(Self {
            is_blocking: config.blocking,
            threads,
            tracks: Tracks::default(),
            store: ImageStore::new(&config, reader),
            stats: ImagePagerStats::default(),
            errors: Errors::default(),
        })
    }

    /// Adds a sequence. It is removed once nothing else refers to it or to its texture.
    pub fn add(&mut self, sequence: &ImageSequence) {
        self.tracks.add(sequence);
    }

    /// Pins the loading threads to a core; see
    /// [`DatabasePager::set_processor_affinity`](crate::pager::DatabasePager::set_processor_affinity).
    pub fn set_processor_affinity(&mut self, core: usize) {
        self.threads.set_core(core);
    }

    /// Returns the counters as of the last update.
    pub fn stats(&self) -> &ImagePagerStats {
        &self.stats
    }

    /// Returns all failures so far, by URI and reason.
    pub fn errors(&self) -> Vec<ErrorRecord> {
        self.errors.list()
    }

    /// Returns true while another frame would show another image: something plays, an image of the moment is loading, or
    /// one failed and is due for a retry.
    pub fn needs_frame(&self) -> bool {
        self.tracks.is_active() || self.store.has_due_retry(Instant::now())
    }

    /// Shows every image again, for contexts that were added.
    pub(crate) fn show_again(&mut self) {
        self.tracks.show_again();
    }

    /// Runs the pager's turn, once a frame; returns what textures show from this frame on.
    pub(crate) fn update(&mut self, simulation_time_s: f64) -> Vec<ImageChange> {
        let now = Instant::now();
        self.tracks.remove_forgotten();
        self.store.begin_update();
        while let Some(answer) = self.threads.try_answer() {
            self.accept(answer);
        }
        self.store.forget_wants();
        let candidates = self.tracks.advance(&mut self.store, simulation_time_s, now);
        self.request(now);
        while self.is_blocking && candidates.iter().any(|c| c.is_loading(&self.store)) {
            if let Some(answer) = self.threads.wait_answer(BLOCKING_POLL) {
                self.accept(answer);
                // The size may differ from the expected one: without this, two images that do not fit together would
                // replace each other forever.
                self.request(now);
            }
        }
        let (changes, late) = self.tracks.changes(&candidates, &self.store, now);
        self.stats.shown += changes.len() as u64;
        self.stats.late += late;
        self.store.count(&mut self.stats);
        self.stats.waiting = self.threads.list().lock().waiting() as u64;
        changes
    }

    /// Pages out what has no room and writes the request list. The list is locked meanwhile, so that no job is taken twice.
    fn request(&mut self, now: Instant) {
        let list = self.threads.list();
        let mut state = list.lock();
        let mut forgotten: HashSet<Ticket> = state.drain_taken(usize::MAX).map(|job| job.ticket()).collect();
        self.store.mark_loading(&mut forgotten);
        self.store.admit();
        self.store.page_out(now, &mut self.stats);
        state.set_jobs(self.store.jobs(now));
        if cfg!(feature = "http") {
            forgotten.into_iter().chain(self.store.unwanted_loads(now)).for_each(|ticket| state.abort(ticket));
        }
        let load_room = self.threads.budgets().bodies.room();
        let outstanding = list.capacity().min(state.outstanding().saturating_add(load_room.loads));
        state.set_limits(Limits { outstanding, prefetch_room: 0, prefetch_beside_others: 0, aged_before: 0 });
        list.ring(state);
    }

    fn accept(&mut self, answer: Answer<ImageJob>) {
        let Answer { job, content, bytes_read, .. } = answer;
        self.threads.list().lock().answered(&job, matches!(content, Some(Ok(_))));
        self.stats.bytes_read += bytes_read;
        if let Some(error) = self.store.arrive(&job, content, &mut self.stats) {
            self.errors.add(&error);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pager::{LoopingMode, SequenceMode};

    /// Regression: each was admitted beside the other by the mean size and paged it out when it was loaded, forever.
    #[test]
    fn images_of_unequal_sizes_do_not_replace_each_other() {
        let folder = tempfile::tempdir().unwrap();
        let sides = [("small.png", 64), ("wide.png", 104)];
        let files = sides.map(|(name, side)| {
            let file = folder.path().join(name);
            image::RgbImage::new(side, side).save(&file).unwrap();
            file.display().to_string()
        });
        // All mip levels of both images are 79,488 bytes.
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
        assert_eq!(stats.bytes, 21_844, "the image of the moment");
    }

    /// Regression: each server that hangs had all threads but one, so that two had all.
    #[cfg(feature = "http")]
    #[test]
    fn servers_that_hang_delay_no_file_and_no_other_server() {
        use std::io::{Read as _, Write as _};
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a.png");
        image::RgbImage::new(8, 8).save(&file).unwrap();
        let image = std::fs::read(&file).unwrap();
        let listen = || std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        // Connections wait forever to be accepted.
        let hung: Vec<_> = (0..5).map(|_| listen()).collect();
        let well = listen();
        let url = |server: &std::net::TcpListener, k: u32| format!("http://{}/{k}.png", server.local_addr().unwrap());
        let long = Duration::from_secs(1000);
        let http = crate::fetch::HttpConfig { first_byte_timeout: long, total_timeout: long, ..Default::default() };
        let mut pager = ImagePager::new(ImagePagerConfig { http, ..ImagePagerConfig::default() }).unwrap();
        let files = hung.iter().map(|server| (0..9).map(|k| url(server, k)).collect());
        let files: Vec<Vec<String>> = files.chain([vec![file.display().to_string()], vec![url(&well, 0)]]).collect();
        let sequences: Vec<_> = files.into_iter().map(|files| ImageSequence::from_files("test", files)).collect();
        let _used: Vec<_> = sequences.iter().map(ImageSequence::texture).collect();
        sequences[..5].iter().for_each(|sequence| pager.add(sequence));
        let until = Instant::now() + Duration::from_secs(60);
        let update_until = |condition: &dyn Fn(&ImagePagerStats) -> bool, pager: &mut ImagePager| {
            while !condition(&pager.stats) {
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

    /// Regression: each image was paged out before it was loaded, and none was shown.
    #[test]
    fn sequence_faster_than_its_images_load_shows_some_of_them() {
        let folder = tempfile::tempdir().unwrap();
        let write = |k: u32| {
            let file = folder.path().join(format!("{k}.png"));
            image::RgbImage::from_pixel(8, 8, image::Rgb([k as u8, 0, 0])).save(&file).unwrap();
            file.display().to_string()
        };
        let sequence = ImageSequence::from_files("test", (0..60).map(write));
        sequence.set_mode(SequenceMode::PageAndDiscardUsedImages);
        sequence.set_pre_load_frames(0);
        sequence.set_length(60.0);
        sequence.set_looping_mode(LoopingMode::NoLooping);
        sequence.play();
        let _used = sequence.texture();
        let mut pager = ImagePager::new(ImagePagerConfig::default()).unwrap();
        pager.add(&sequence);
        // Each update requests the image of its moment, and earlier images arrive.
        let update = |pager: &mut ImagePager, time_s: f64| {
            let loaded = pager.stats.loaded;
            let until = Instant::now() + Duration::from_secs(60);
            let changes = pager.update(time_s);
            while pager.stats.loaded == loaded {
                assert!(Instant::now() < until, "{:?}", pager.stats);
                if let Some(answer) = pager.threads.wait_answer(BLOCKING_POLL) {
                    pager.accept(answer);
                }
            }
            changes.into_iter().map(|change| change.image.mips[0][0]).collect::<Vec<_>>()
        };
        let shown: Vec<_> = (0..20).map(|k| update(&mut pager, f64::from(k))).collect();
        let order: Vec<_> = shown.concat();
        assert!(order.len() >= 10 && order.is_sorted(), "{shown:?}");
        assert!(shown.iter().all(|shown| shown.len() <= 1), "{shown:?}");
        // When it is paused, the image of the moment is shown last.
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

    /// Regression: a codec's panic ended the thread, and its image was loading forever.
    #[test]
    fn panic_while_reading_is_an_error_of_that_image() {
        let mut pager = ImagePager::new(ImagePagerConfig { threads: 1, ..ImagePagerConfig::default() }).unwrap();
        let sequence = ImageSequence::from_files("test", (0..2).map(|k| format!("/{k}/{}", crate::fetch::PANICS)));
        let _used = sequence.texture();
        pager.add(&sequence);
        let until = Instant::now() + Duration::from_secs(60);
        while pager.stats.failed < 2 {
            assert!(Instant::now() < until, "the thread continues: {:?}", pager.stats);
            pager.update(0.0);
            std::thread::sleep(Duration::from_millis(1));
        }
        let errors = pager.errors();
        assert!(errors.iter().all(|error| &*error.reason == crate::fetch::DECODER_PANICKED), "{errors:?}");
    }
}
