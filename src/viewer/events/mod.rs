//! Input, free of any window library: what happened since the last frame, and who is told. OSG's `osgGA`.
//!
//! A window (or a test, or another toolkit) feeds the [`EventQueue`]; the event phase of each frame takes what is
//! there and hands each [`GuiEventAdapter`] to the [`GuiEventHandler`]s, then to the manipulator. Main thread, but
//! for [`UserEvents`], through which any thread sends events of its own.

mod adapter;
mod fingers;
mod handler;
mod key;
mod queue;

pub use adapter::{
    ButtonMask, EventKind, EventMask, GuiEventAdapter, InputState, Modifiers, MouseButton, TouchPhase, UserEvent,
    YOrientation,
};
pub use handler::{Bindings, GuiEventHandler, Usage};
pub use key::Key;
pub use queue::{EventQueue, UserEvents};
