//! The interface for code of the application that runs while a camera is drawn. Callbacks are called on the draw thread
//! and must not keep what they are given.

pub(super) mod attribute_groups;
pub(super) mod attributes;
pub(super) mod camera;
pub(super) mod drawables;
pub(super) mod info;
