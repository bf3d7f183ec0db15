//! Input events, independent of any window library; OSG's `osgGA`.
//!
//! A window, a test or another toolkit feeds the [`EventQueue`]. The event phase of each frame takes the queued events and
//! passes each [`GuiEventAdapter`] to the [`GuiEventHandler`](crate::viewer::GuiEventHandler)s, then to the manipulator.
//! Everything runs on the main thread, except [`UserEvents`], through which any thread sends events of the application.

mod button;
mod event;
mod event_mask;
mod fingers;
mod input_state;
mod key;
mod queue;
mod touch;
mod usage;

pub use button::MouseButton;
pub use event::{EventKind, EventSource, GuiEventAdapter, TouchPhase, UserEvent};
pub use event_mask::EventMask;
pub use input_state::{ButtonMask, InputState, Modifiers, YOrientation};
pub use key::Key;
pub use queue::{EventQueue, UserEvents};
pub use usage::{Bindings, Usage};
