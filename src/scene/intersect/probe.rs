//! Shapes that are intersected with the scene, and the drawables that they may meet.

use glam::{DAffine3, DMat3, DVec3};

use super::window::WindowView;

/// A shape in the world that can be moved into other frames.
pub trait Probe {
    /// The shape in a frame.
    type Local;

    /// The shape as a view has it, in the frame that `world_from_frame` comes from; `None` where that map has no
    /// inverse. View 0 is the one that the shape was made for, others are numbered by [`Self::open_view`].
    fn local(&self, view: u32, world_from_frame: &DAffine3) -> Option<Self::Local>;

    /// The picture that the shape was made for, if it is a place of one.
    fn window(&self) -> Option<WindowView> {
        None
    }

    /// The same place as another view has it; `None` where it is not in that one.
    fn open_view(&mut self, _view: &WindowView) -> Option<u32> {
        None
    }

    /// Where along the shape it enters a sphere; `None` where it misses.
    fn enters_sphere(local: &Self::Local, center: DVec3, radius_m: f64) -> Option<f64>;

    /// Where along the shape it enters a box with unit axes (columns); `None` where it misses.
    fn enters_box(local: &Self::Local, center: DVec3, axes: &DMat3, half: DVec3) -> Option<f64>;
}

/// A drawable whose box is met.
#[derive(Clone, Copy, Debug)]
pub struct Candidate {
    /// Where the shape enters its box.
    pub enters: f64,
    /// Place of its page in the scene's table.
    pub place: u32,
    pub drawable: u32,
    pub world_from_drawable: DAffine3,
    /// Number of the view, as the shape knows it.
    pub view: u32,
    /// Pictures drawn over others come first: 0 is over all.
    pub layer: u32,
}
