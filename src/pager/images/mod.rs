//! [`ImagePager`]: images of animated textures, loaded ahead of the time they are shown and paged out after it.
//!
//! ```text
//! update    ImageSequence: simulation time -> image now, images ahead -> request list, by the time left to each
//!           results taken; what changed goes to the contexts; what was not wanted for longest goes
//! thread n x  files read, all decoded, the most urgent first
//! HTTP thread servers asked
//! draw      the image is written to the sequence's texture in the compile step, before the frame is drawn
//! ```

mod config;
mod list;
mod sequence;
#[cfg(feature = "http")]
mod servers;
mod store;
mod threads;
mod tracks;

pub use config::{ImagePagerConfig, ImagePagerStats};
pub use sequence::{ImageSequence, LoopingMode, SequenceImage, SequenceMode, StreamStatus};
pub use store::ImagePager;

pub(crate) use tracks::ImageChange;
