//! [`ImagePager`]: images of animated textures, loaded ahead of the time at which they are shown and paged out after it.
//!
//! ```text
//! update       ImageSequence: simulation time -> image now, images ahead -> request list, by the time left to each
//!              answers accepted; changed images go to the contexts; images over budget are paged out
//! file n x     files read         | -> decode n x, the most urgent first
//! HTTP thread  servers asked      |
//! draw         the image is written to the sequence's texture in the compile step, before the frame is drawn
//! ```
//! It is a second client of the loading threads, the request list, the limits per server and the retry policy of the
//! [`DatabasePager`](super::DatabasePager). Two things differ in kind:
//! - Priority is the time until an image is shown, and what is no longer wanted is dropped at once. So there is no fairness
//!   between scenes, no aging and no prefetch class.
//! - An image is shown as soon as it is decoded, and any image can be paged out. So the store is one list by time with a
//!   budget of images and bytes, without uploads, merges, or parents that must outlive their children.

mod config;
mod image_pager;
mod job;
mod sequence;
mod store;
mod tracks;

pub use config::{ImagePagerConfig, ImagePagerStats};
pub use image_pager::ImagePager;
pub use sequence::{ImageSequence, LoopingMode, SequenceImage, SequenceMode, StreamStatus};

pub(crate) use tracks::ImageChange;
