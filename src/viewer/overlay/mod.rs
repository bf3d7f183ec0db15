//! The overlay of a view, drawn with egui: pages of event handlers, and notices.
//!
//! Each view has an [`Overlay`] over its master camera's part of the window. [`Overlay::lay_out`] runs on the main thread
//! after the event phase. The resulting [`OverlayPaint`], a list of triangles, travels with the frame to the draw thread,
//! where an [`OverlayPainter`] draws it.

mod layout;
mod paint;
mod painter;

pub use layout::Overlay;
pub(super) use layout::notice;
pub use paint::OverlayPaint;
pub use painter::OverlayPainter;
