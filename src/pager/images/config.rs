//! Sizes and counters of an [`ImagePager`](super::ImagePager).

use std::time::Duration;

use crate::io::Limits;

/// Sizes and patience of an [`ImagePager`](super::ImagePager).
#[derive(Clone, Debug)]
pub struct ImagePagerConfig {
    /// Threads that read files and decode; each server may have as many requests.
    pub threads: usize,
    /// Images from files that may be decoded or under way at once.
    pub max_images: usize,
    /// CPU bytes of decoded images.
    pub max_bytes: u64,
    /// An image that was not wanted for so long goes, though there may be room.
    pub expiry: Duration,
    /// Wait before a failure that may pass is tried again, while somebody looks; doubled each time, up to five minutes.
    pub retry_after: Duration,
    /// Tries of a URI in all; `None` for no end of them: a network that was away for long is found when it comes back. Of
    /// those that fail with what mostly stays ([`IoError::is_doubtful`](crate::io::IoError::is_doubtful)) there are five.
    pub max_tries: Option<u32>,
    /// How much is accepted from outside.
    pub limits: Limits,
    /// How servers are talked to, and the cache on disk.
    #[cfg(feature = "http")]
    pub http: crate::io::HttpConfig,
    /// Each update waits for the images of its moment: equal times give equal pictures. OSG's
    /// `LOAD_AND_RETAIN_IN_UPDATE_TRAVERSAL`.
    pub blocking: bool,
}

impl Default for ImagePagerConfig {
    fn default() -> Self {
        Self {
            threads: 3,
            max_images: 256,
            max_bytes: 128 << 20,
            expiry: Duration::from_secs(10),
            retry_after: Duration::from_secs(5),
            max_tries: None,
            limits: Limits::default(),
            #[cfg(feature = "http")]
            http: crate::io::HttpConfig::default(),
            blocking: false,
        }
    }
}

/// What an [`ImagePager`](super::ImagePager) did since it started; update thread.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ImagePagerStats {
    /// Images read and decoded.
    pub loaded: u64,
    /// Reads that failed.
    pub failed: u64,
    /// Reads that were given up, because nobody wanted the image any more.
    pub cancelled: u64,
    /// Images paged out.
    pub paged_out: u64,
    /// Images that began to be shown.
    pub shown: u64,
    /// Times that a sequence went on showing an earlier image, because the one of the moment was not there.
    pub late: u64,
    /// Bytes read from files and servers.
    pub bytes_read: u64,
    /// Decoded images now.
    pub images: u64,
    /// Most that `images` was.
    pub images_peak: u64,
    /// CPU bytes of decoded images now.
    pub bytes: u64,
    /// Most that `bytes` was.
    pub bytes_peak: u64,
    /// Images waiting for a thread.
    pub waiting: u64,
    /// Images being read or decoded.
    pub in_flight: u64,
}
