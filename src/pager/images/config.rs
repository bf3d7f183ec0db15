//! Configuration and counters of an [`ImagePager`](super::ImagePager).

use std::time::Duration;

use crate::fetch::Limits;

/// Configuration of an [`ImagePager`](super::ImagePager): threads, budgets and timeouts.
#[derive(Clone, Debug)]
pub struct ImagePagerConfig {
    /// Threads that read files, and as many that decode; each server may have as many requests in flight.
    pub threads: usize,
    /// Maximum number of images from files that are decoded or loading.
    pub max_images: usize,
    /// Maximum CPU bytes of decoded images.
    pub max_bytes: u64,
    /// Maximum CPU bytes of images that are on their way; see
    /// [`PagerConfig::max_bytes_loading`](crate::pager::PagerConfig::max_bytes_loading).
    pub max_bytes_loading: u64,
    /// An image that was not wanted for this long is paged out even if there is room.
    pub expiry: Duration,
    /// Back-off before a failed load is retried while it is wanted; doubled each time, up to five minutes.
    pub retry_after: Duration,
    /// Maximum attempts to load a URI; `None` for no limit, so that loads resume after a long network outage. Errors that
    /// rarely pass ([`IoError::is_doubtful`](crate::fetch::IoError::is_doubtful)) are tried five times.
    pub max_tries: Option<u32>,
    /// Bounds on data from outside.
    pub limits: Limits,
    /// Timeouts, certificates, credentials and cache of the HTTP client.
    #[cfg(feature = "http")]
    pub http: crate::fetch::HttpConfig,
    /// Each update waits for the images of its moment, so that equal times give equal frames. OSG's
    /// `LOAD_AND_RETAIN_IN_UPDATE_TRAVERSAL`.
    pub blocking: bool,
}

impl Default for ImagePagerConfig {
    fn default() -> Self {
        Self {
            threads: 3,
            max_images: 256,
            max_bytes: 128 << 20,
            max_bytes_loading: 64 << 20,
            expiry: Duration::from_secs(10),
            retry_after: Duration::from_secs(5),
            max_tries: None,
            limits: Limits::default(),
            #[cfg(feature = "http")]
            http: crate::fetch::HttpConfig::default(),
            blocking: false,
        }
    }
}

/// Counters of an [`ImagePager`](super::ImagePager) since it started; update thread.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ImagePagerStats {
    /// Images read and decoded.
    pub loaded: u64,
    /// Loads that failed.
    pub failed: u64,
    /// Loads aborted because the image was no longer wanted.
    pub cancelled: u64,
    /// Images paged out.
    pub paged_out: u64,
    /// Times that a texture began to show another image.
    pub shown: u64,
    /// Times that a sequence still showed an earlier image because the one of the moment was not loaded.
    pub late: u64,
    /// Bytes read from files and servers.
    pub bytes_read: u64,
    /// Decoded images in memory now.
    pub images: u64,
    /// Maximum of `images`.
    pub images_peak: u64,
    /// CPU bytes of decoded images now.
    pub bytes: u64,
    /// Maximum of `bytes`.
    pub bytes_peak: u64,
    /// Images waiting for a thread.
    pub waiting: u64,
    /// Images being read or decoded.
    pub in_flight: u64,
}
