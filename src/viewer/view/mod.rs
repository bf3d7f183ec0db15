//! A view: the master camera with its lens and viewport, the slave cameras beside it, and the extent of the scene that
//! it shows. Main thread.

mod eyes;
mod picking;
mod probe;
pub(super) mod set_bounds;
mod shown_environment;
mod slaves;
#[expect(clippy::module_inception, reason = "the view's own file; the others are its parts")]
mod view;
pub(super) mod viewport;

pub use eyes::Eyes;
pub(super) use probe::Probe;
pub(super) use slaves::CameraSlot;
pub use slaves::Slave;
pub use view::View;

use super::ids::{KeyedList, ViewId};

/// The views of a viewer.
pub(super) type ViewList = KeyedList<ViewId, View>;
