//! Joins the scenes of a viewer with the pagers that fill them. Main thread, in update.
//!
//! | type | role |
//! |---|---|
//! | [`PagedScene`] | a scene with its loaded root, the application's own pages and the requests of its last culls |
//! | [`LoadedRoot`] | a root tile set that was read, with the pager that loads its tiles, on their way into a scene |
//! | [`PagerGroup`] | one `DatabasePager` with the scenes that share it: its turns in a frame, whether it is at rest |
//! | [`Pagers`] | all groups of a viewer: which scene has which pager, as scenes and devices are added and removed |
//! | [`LookAheads`] | finds the pages that cameras will need soon, for prefetching |
//! | [`EarlyLook`] | requests the contents of new tiles while the main thread waits |
//! | `pager::SceneSet` | the trait through which a pager sees the scenes of its group |

mod blocking;
mod cull_findings;
mod early_look;
mod loaded_root;
mod look_ahead;
mod own_pages;
mod paged_scene;
mod pager_group;
mod pagers;

pub(super) use self::blocking::load_all;
pub(super) use self::early_look::EarlyLook;
pub use self::loaded_root::LoadedRoot;
pub(super) use self::look_ahead::{LookAheads, LookFrom};
pub(super) use self::paged_scene::PagedScene;
pub use self::paged_scene::SceneUpdate;
pub(super) use self::pager_group::PagerGroup;
pub(super) use self::pagers::{MAX_SCENES, Pagers, free_owner};

use super::ids::{KeyedList, SceneId};

/// The scenes of a viewer.
pub(super) type SceneList = KeyedList<SceneId, PagedScene>;
