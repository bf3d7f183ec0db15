//! The DatabasePager: from the requests of cull to merged pages, and out of memory again.
//!
//! ```text
//! main     update_scene_graph: accept requests -> answers -> uploads -> merge -> expire -> request list
//! file n x read local files          |
//! http 1 x one async runtime, many   | -> decode n x -> answers (back to main)
//!          requests in flight        |
//! reaper   drops expired pages
//! ```
//! Cull takes no lock: its requests are data. The threads share one request list behind one mutex, which update rewrites
//! once a frame. The other hand-overs are channels. Those of jobs and answers are bounded by the number of jobs that may be
//! outstanding (`loading/request_list.rs`), so that no answer waits. The reaper's is unbounded, because thousands of pages
//! may leave in one frame and update must not wait; they count in no budget. The channels of the contexts' compile queues,
//! in `gpu` and in the viewer, are unbounded too; they hold only pages that have arrived, which the budgets bound.
//!
//! # Parts
//! | folder | responsibility |
//! |---|---|
//! | `database_pager` | [`DatabasePager`]: owns the parts and calls them in the order of a frame |
//! | `requests` | table of requests, order of loading, fairness, retries |
//! | `loading` | request list, file, HTTP and decode threads, limits per server, reaper; generic over the job |
//! | `residency` | merged pages, memory budgets, expiry, reference counts of shared contents |
//! | `upload` | arrived pages on their way through the contexts' compile queues to their merge |
//! | `prefetch` | what coming frames will lack, from announced paths and from the eye's motion |
//! | `scenes` | the scenes that a pager serves and what each may read |
//! | `images` | [`ImagePager`]: images of sequences, a second client of `loading` and of the retry policy |
//!
//! # Roles around a scene
//! | type | role |
//! |---|---|
//! | [`SceneSet`] | all scenes of a pager, as each call borrows them from their owner |
//! | `SceneRegistry` | which scenes a pager serves; it knows their numbers and holds no scene |
//! | `SceneState` | what the registry knows of one scene: its read scope and the ancestors of its roots |
//! | `ReadScope` | what the contents of a scene may read, and the HTTP client they are requested with |

mod config;
mod database_pager;
mod frame_times;
mod images;
mod loading;
mod prefetch;
mod requests;
mod residency;
mod scenes;
mod stats;
mod time_budget;
mod upload;

pub use config::{PagerConfig, PagerError};
pub use database_pager::DatabasePager;
pub use images::{
    ImagePager, ImagePagerConfig, ImagePagerStats, ImageSequence, LoopingMode, SequenceImage, SequenceMode,
    StreamStatus,
};
pub(crate) use prefetch::turn_between;
pub use prefetch::{EyeMotion, MotionLooks, PathLooks, frames_until};
pub use requests::state::RequestState;
pub use scenes::scene_set::SceneSet;
pub use stats::{ErrorRecord, PagerStats};
pub use upload::context::CompileContext;

pub(crate) use images::ImageChange;
