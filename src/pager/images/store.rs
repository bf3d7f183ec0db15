//! [`ImageStore`]: the images from files, which of them have room, and which are paged out. Update thread.

use std::collections::{HashMap, HashSet};
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::config::{ImagePagerConfig, ImagePagerStats};
use super::job::{ImageJob, ImageReader};
use crate::fetch::IoError;
use crate::pager::loading::request::Request as _;
use crate::pager::loading::ticket::{Ticket, TicketIssuer};
use crate::pager::requests::retry_policy::{RetryPolicy, RetryState, retry_moment};
use crate::pager::residency::budget::moving_mean;
use crate::scene::Texture;

/// Failures that are remembered; beyond that, those of images that are not wanted are forgotten.
const MAX_FAILURES: usize = 4096;

/// How far an image is.
enum State {
    /// In the request list, or not requested yet.
    Waiting,
    /// A thread has it.
    Loading,
    Loaded(Arc<Texture>),
    /// The load failed. Not requested again before this moment; `None` for never.
    Failed {
        retry_at: Option<Instant>,
    },
}

/// An image from a file, for all sequences that name it.
struct Slot {
    state: State,
    job: ImageJob,
    retries: RetryState,
    /// Size of the image when it was last loaded; `None` before.
    size_bytes: Option<u64>,
    /// Number of the update that last wanted it.
    wanted: u64,
    wanted_at: Instant,
    /// Seconds until it is shown; infinite if this update does not want it.
    due_s: f64,
    /// Paged out as soon as it is not wanted.
    discards: bool,
    /// Within the budgets of this update.
    admitted: bool,
}

impl Slot {
    fn new(job: ImageJob, now: Instant) -> Self {
        Self {
            state: State::Waiting,
            job,
            retries: RetryState::default(),
            size_bytes: None,
            wanted: 0,
            wanted_at: now,
            due_s: f64::INFINITY,
            discards: true,
            admitted: false,
        }
    }

    fn is_loaded(&self) -> bool {
        matches!(self.state, State::Loaded(_))
    }
}

/// The budgets of decoded images.
#[derive(Clone, Copy, Debug)]
struct ImageBudget {
    images: usize,
    bytes: u64,
    /// An image that was not wanted for this long is paged out even if there is room.
    expiry: Duration,
}

/// The images from files, by URI. Update thread.
///
/// `bytes` and `images` count the loaded slots.
pub(super) struct ImageStore {
    slots: HashMap<Arc<str>, Slot>,
    tickets: TicketIssuer,
    reader: Arc<ImageReader>,
    budget: ImageBudget,
    retry: RetryPolicy,
    bytes: u64,
    images: usize,
    /// Mean size of recent images; 0 before the first.
    mean_bytes: u64,
    updates: u64,
}

impl ImageStore {
    pub fn new(config: &ImagePagerConfig, reader: ImageReader) -> Self {
        let budget = ImageBudget { images: config.max_images.max(1), bytes: config.max_bytes, expiry: config.expiry };
        Self {
            slots: HashMap::new(),
            tickets: TicketIssuer::new(),
            reader: Arc::new(reader),
            budget,
            retry: RetryPolicy { first_backoff: config.retry_after, max_attempts: config.max_tries },
            bytes: 0,
            images: 0,
            mean_bytes: 0,
            updates: 0,
        }
    }

    /// Begins an update.
    pub fn begin_update(&mut self) {
        self.updates += 1;
    }

    /// Forgets when images are shown, until [`Self::want`] is called for them.
    pub fn forget_wants(&mut self) {
        for slot in self.slots.values_mut() {
            slot.due_s = f64::INFINITY;
        }
    }

    /// Notes that an image is shown in `due_s` seconds; negative if it is overdue. With `discards` it is paged out as soon
    /// as it is no longer wanted.
    pub fn want(&mut self, uri: &Arc<str>, due_s: f64, discards: bool, now: Instant) {
        let slot = match self.slots.get_mut(uri) {
            Some(slot) => slot,
            None => {
                let job = ImageJob::new(self.tickets.issue(), uri.clone(), self.reader.clone());
                self.slots.entry(uri.clone()).or_insert(Slot::new(job, now))
            }
        };
        (slot.wanted, slot.wanted_at) = (self.updates, now);
        slot.due_s = slot.due_s.min(due_s);
        slot.discards = discards;
    }

    /// Returns an image if it is loaded.
    pub fn image(&self, uri: &str) -> Option<&Arc<Texture>> {
        match &self.slots.get(uri)?.state {
            State::Loaded(image) => Some(image),
            _ => None,
        }
    }

    /// Returns true if an image is not loaded, but has room and has not failed.
    pub fn is_coming(&self, uri: &str) -> bool {
        let is_coming = |slot: &Slot| slot.admitted && matches!(slot.state, State::Waiting | State::Loading);
        self.slots.get(uri).is_some_and(is_coming)
    }

    /// Returns true if an image that should be shown now failed, and its back-off is over.
    pub fn has_due_retry(&self, now: Instant) -> bool {
        self.slots.values().any(|slot| {
            let is_shown = slot.wanted == self.updates && slot.due_s <= 0.0;
            is_shown && matches!(slot.state, State::Failed { retry_at: Some(at) } if at <= now)
        })
    }

    /// Admits the wanted images that the budgets have room for, the most urgent first.
    pub fn admit(&mut self) {
        let mut wanted: Vec<(f64, Arc<str>)> = Vec::new();
        for (uri, slot) in &mut self.slots {
            slot.admitted = false;
            let has_failed_for_good = matches!(slot.state, State::Failed { retry_at: None });
            if slot.wanted == self.updates && !has_failed_for_good {
                wanted.push((slot.due_s, uri.clone()));
            }
        }
        wanted.sort_by(|a, b| a.0.total_cmp(&b.0).then_with(|| a.1.cmp(&b.1)));
        let mut bytes = 0;
        for (_, uri) in wanted.iter().take(self.budget.images) {
            let Some(slot) = self.slots.get_mut(uri) else { continue };
            let size = slot.size_bytes.unwrap_or(self.mean_bytes);
            bytes += size;
            if bytes > self.budget.bytes && bytes > size {
                break;
            }
            slot.admitted = true;
        }
    }

    /// Pages out expired images, and those that were not wanted for longest while admitted ones have no room. Forgets what
    /// is neither loaded nor wanted nor has failed.
    pub fn page_out(&mut self, now: Instant, stats: &mut ImagePagerStats) {
        let is_expired = |slot: &Slot| slot.is_loaded() && self.is_expired(slot, now);
        let expired = self.slots.iter().filter(|(_, slot)| is_expired(slot)).map(|(uri, _)| uri.clone());
        for uri in expired.collect::<Vec<_>>() {
            self.unload(&uri, stats);
        }
        if self.is_over_budget() {
            self.make_room_for_admitted(stats);
        }
        let updates = self.updates;
        for slot in self.slots.values_mut() {
            let is_unwanted = matches!(slot.state, State::Waiting) && slot.wanted != updates;
            if is_unwanted && !slot.retries.is_fresh() {
                slot.state = State::Failed { retry_at: Some(now) };
            }
        }
        self.slots.retain(|_, slot| !matches!(slot.state, State::Waiting) || slot.wanted == updates);
        if self.slots.len() > MAX_FAILURES.saturating_add(self.budget.images) {
            self.slots.retain(|_, slot| slot.wanted == updates || !matches!(slot.state, State::Failed { .. }));
        }
    }

    /// Returns true if this update does not want an image and it is not kept for later.
    fn is_expired(&self, slot: &Slot, now: Instant) -> bool {
        let unwanted_for = || now.saturating_duration_since(slot.wanted_at);
        slot.wanted != self.updates && (slot.discards || unwanted_for() > self.budget.expiry)
    }

    fn make_room_for_admitted(&mut self, stats: &mut ImagePagerStats) {
        let spare = self.slots.iter().filter(|(_, slot)| slot.is_loaded() && !slot.admitted);
        let mut spare: Vec<(u64, f64, Arc<str>)> =
            spare.map(|(uri, slot)| (slot.wanted, slot.due_s, uri.clone())).collect();
        // Wanted longest ago first; among those wanted now, the latest due.
        spare.sort_by(|a, b| a.0.cmp(&b.0).then(b.1.total_cmp(&a.1)).then_with(|| a.2.cmp(&b.2)));
        for (_, _, uri) in spare {
            if !self.is_over_budget() {
                break;
            }
            self.unload(&uri, stats);
        }
    }

    /// Returns true if the budgets have no room for the images that are loaded, loading or admitted.
    fn is_over_budget(&self) -> bool {
        let is_coming =
            |s: &&Slot| matches!(s.state, State::Loading) || s.admitted && matches!(s.state, State::Waiting);
        let sizes = self.slots.values().filter(is_coming).map(|s| s.size_bytes.unwrap_or(self.mean_bytes));
        let (images, bytes) = sizes.fold((0, 0), |(images, bytes), size| (images + 1, bytes + size));
        self.images + images > self.budget.images || self.bytes + bytes > self.budget.bytes
    }

    fn unload(&mut self, uri: &Arc<str>, stats: &mut ImagePagerStats) {
        let Some(slot) = self.slots.get_mut(uri) else { return };
        if let State::Loaded(image) = std::mem::replace(&mut slot.state, State::Waiting) {
            slot.job = slot.job.again(self.tickets.issue());
            self.bytes -= image.size_bytes();
            self.images -= 1;
            stats.paged_out += 1;
        }
    }

    /// Marks the images that threads have taken as loading; leaves in `taken` the tickets of those that are forgotten.
    pub fn mark_loading(&mut self, taken: &mut HashSet<Ticket>) {
        if taken.is_empty() {
            return;
        }
        for slot in self.slots.values_mut().filter(|slot| taken.remove(&slot.job.ticket())) {
            slot.state = State::Loading;
        }
    }

    /// Returns the jobs of admitted images that are not loaded, as far as there is room; the most urgent last.
    pub fn jobs(&mut self, now: Instant) -> Vec<ImageJob> {
        let mut wanted: Vec<(f64, &ImageJob)> = Vec::new();
        let mut loading = 0;
        for slot in self.slots.values_mut() {
            // A failure that is not wanted stays one, so that its attempts are remembered.
            if let State::Failed { retry_at: Some(at) } = slot.state
                && at <= now
                && slot.wanted == self.updates
            {
                slot.state = State::Waiting;
                slot.job = slot.job.again(self.tickets.issue());
            }
            match slot.state {
                State::Waiting if slot.admitted => wanted.push((slot.due_s, &slot.job)),
                State::Loading => loading += 1,
                _ => {}
            }
        }
        wanted.sort_by(|a, b| b.0.total_cmp(&a.0).then_with(|| b.1.uri().cmp(a.1.uri())));
        let room = self.budget.images.saturating_sub(self.images + loading);
        let first = wanted.len().saturating_sub(room);
        wanted[first..].iter().map(|(_, job)| (*job).clone()).collect()
    }

    /// Returns the tickets of images that are loading and no longer wanted.
    pub fn unwanted_loads(&self, now: Instant) -> impl Iterator<Item = Ticket> + '_ {
        let loading = self.slots.values().filter(|slot| matches!(slot.state, State::Loading));
        loading.filter(move |slot| self.is_expired(slot, now)).map(|slot| slot.job.ticket())
    }

    /// Accepts the answer to a job; `None` if it was aborted. Returns the error if it failed.
    pub fn arrive(
        &mut self,
        job: &ImageJob,
        image: Option<Result<Arc<Texture>, IoError>>,
        stats: &mut ImagePagerStats,
    ) -> Option<IoError> {
        let slot = self.slots.get_mut(job.uri()).filter(|slot| slot.job.ticket() == job.ticket());
        let Some(image) = image else {
            stats.cancelled += 1;
            if let Some(slot) = slot {
                slot.state = State::Waiting;
                slot.job = slot.job.again(self.tickets.issue());
            }
            return None;
        };
        let limit = self.budget.bytes;
        let image = image.and_then(|image| match image.size_bytes() {
            got if got > limit => Err(IoError::TooLarge { uri: job.uri().to_owned(), what: "image", got, limit }),
            _ => Ok(image),
        });
        let slot = slot?;
        match image {
            Ok(image) => {
                let bytes = image.size_bytes();
                (slot.retries, slot.size_bytes) = (RetryState::default(), Some(bytes));
                slot.state = State::Loaded(image);
                stats.loaded += 1;
                self.bytes += bytes;
                self.images += 1;
                self.mean_bytes = moving_mean(self.mean_bytes, bytes);
                self.make_room_for_loaded(stats);
                stats.images_peak = stats.images_peak.max(self.images as u64);
                stats.bytes_peak = stats.bytes_peak.max(self.bytes);
                None
            }
            Err(error) => {
                stats.failed += 1;
                slot.state = State::Failed { retry_at: retry_moment(slot.retries.fail(&error, self.retry)) };
                Some(error)
            }
        }
    }

    /// Pages out the least urgent images until the budgets hold: an image may be larger than expected. The order is that of
    /// [`Self::admit`]; an image paged out here is not admitted beside those that stay, and so not loaded again.
    fn make_room_for_loaded(&mut self, stats: &mut ImagePagerStats) {
        while self.bytes > self.budget.bytes || self.images > self.budget.images {
            let loaded = self.slots.iter().filter(|(_, slot)| slot.is_loaded());
            let least = loaded.max_by(|(a, s), (b, t)| {
                let is_unwanted = |s: &Slot| s.wanted < self.updates;
                let by_time = is_unwanted(s).cmp(&is_unwanted(t)).then(s.due_s.total_cmp(&t.due_s));
                by_time.then_with(|| a.cmp(b))
            });
            let Some(least) = least.map(|(uri, _)| uri.clone()) else { break };
            self.unload(&least, stats);
        }
    }

    /// Updates the counters that are states and not events.
    pub fn count(&self, stats: &mut ImagePagerStats) {
        (stats.images, stats.bytes) = (self.images as u64, self.bytes);
        stats.in_flight = self.slots.values().filter(|slot| matches!(slot.state, State::Loading)).count() as u64;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn store() -> ImageStore {
        let config = ImagePagerConfig { retry_after: Duration::ZERO, ..ImagePagerConfig::default() };
        let reader = ImageReader {
            limits: config.limits,
            #[cfg(feature = "http")]
            client: crate::fetch::HttpClient::new(&config.http).unwrap(),
        };
        ImageStore::new(&config, reader)
    }

    /// Runs an update that wants this image, or none; returns its requests.
    fn update(store: &mut ImageStore, uri: Option<&Arc<str>>, taken: &[Ticket]) -> Vec<ImageJob> {
        let (now, mut stats) = (Instant::now(), ImagePagerStats::default());
        store.begin_update();
        store.forget_wants();
        if let Some(uri) = uri {
            store.want(uri, 0.0, false, now);
        }
        store.admit();
        store.mark_loading(&mut taken.iter().copied().collect());
        store.page_out(now, &mut stats);
        store.jobs(now)
    }

    fn arrive(store: &mut ImageStore, job: &ImageJob, image: Option<Result<Arc<Texture>, IoError>>) {
        store.arrive(job, image, &mut ImagePagerStats::default());
    }

    fn not_found(uri: &Arc<str>) -> Option<Result<Arc<Texture>, IoError>> {
        Some(Err(IoError::Status { uri: uri.to_string(), status: 503, retry_after: None }))
    }

    fn image() -> Option<Result<Arc<Texture>, IoError>> {
        Some(Ok(Texture::rgba8(1, 1, vec![vec![1; 4]]).into()))
    }

    /// Regression: such an image was requested a second time; if that load failed, the first image was counted forever.
    #[test]
    fn image_taken_while_it_is_not_wanted_is_loading() {
        let uri: Arc<str> = "a.png".into();
        for fails_before in [false, true] {
            let mut store = store();
            let mut job = update(&mut store, Some(&uri), &[]).remove(0);
            if fails_before {
                update(&mut store, Some(&uri), &[job.ticket()]);
                arrive(&mut store, &job, not_found(&uri));
                job = update(&mut store, Some(&uri), &[]).remove(0);
            }
            assert!(update(&mut store, None, &[job.ticket()]).is_empty());
            assert!(matches!(store.slots[&uri].state, State::Loading));
            assert!(update(&mut store, Some(&uri), &[]).is_empty(), "requested once");
            arrive(&mut store, &job, None);
            update(&mut store, None, &[]);
            assert_eq!(store.slots.is_empty(), !fails_before, "forgotten, except its failures");
        }
    }

    #[test]
    fn image_loaded_and_paged_out_between_two_lists_is_requested_again() {
        let uri: Arc<str> = "a.png".into();
        let mut store = store();
        let job = update(&mut store, Some(&uri), &[]).remove(0);
        arrive(&mut store, &job, image());
        store.unload(&uri, &mut ImagePagerStats::default());
        assert_eq!(update(&mut store, Some(&uri), &[job.ticket()]).len(), 1, "the ticket is of the earlier attempt");
        assert!(matches!(store.slots[&uri].state, State::Waiting));
    }

    #[test]
    fn failures_are_remembered_while_an_image_is_not_wanted() {
        let uri: Arc<str> = "a.png".into();
        let mut store = store();
        let job = update(&mut store, Some(&uri), &[]).remove(0);
        update(&mut store, Some(&uri), &[job.ticket()]);
        arrive(&mut store, &job, not_found(&uri));
        let retries = store.slots[&uri].retries;
        assert!(!retries.is_fresh());
        let is_remembered = |store: &ImageStore| {
            let slot = &store.slots[&uri];
            slot.retries == retries && matches!(slot.state, State::Failed { retry_at: Some(_) })
        };
        for _ in 0..3 {
            assert!(update(&mut store, None, &[]).is_empty() && is_remembered(&store));
        }
        assert_eq!(update(&mut store, Some(&uri), &[]).len(), 1);
        // Requested, and no longer wanted before a thread has taken it.
        assert!(update(&mut store, None, &[]).is_empty() && is_remembered(&store));
    }
}
