//! Shapes that are intersected with the scene, and the drawables that they may meet.

use glam::{DAffine3, DMat3, DVec3};

use super::window::WindowView;

/// A shape in the world that can be transformed to other frames.
pub trait Probe {
    /// The shape in a frame.
    type Local;

    /// Returns the shape of a view in the frame from which `world_from_frame` maps; `None` if that map has no inverse. View 0
    /// is the view that the shape was created for, others are numbered by [`Self::open_view`].
    fn local(&self, view: u32, world_from_frame: &DAffine3) -> Option<Self::Local>;

    /// Returns the view that the shape was created for, if it is a position in an image.
    fn window(&self) -> Option<WindowView> {
        None
    }

    /// Adds another view of the same image position and returns its number; `None` if the position is outside that view.
    fn open_view(&mut self, _view: &WindowView) -> Option<u32> {
        None
    }

    /// Returns the position along the shape at which it enters a sphere; `None` if it misses.
    fn enters_sphere(local: &Self::Local, center: DVec3, radius_m: f64) -> Option<f64>;

    /// Returns the position along the shape at which it enters a box with unit axes (columns); `None` if it misses.
    fn enters_box(local: &Self::Local, center: DVec3, axes: &DMat3, half: DVec3) -> Option<f64>;
}

/// A drawable whose box the shape enters.
#[derive(Clone, Copy, Debug)]
pub struct Candidate {
    /// The position along the shape at which it enters the box.
    pub enters: f64,
    /// The position of its page in the scene's page table.
    pub place: u32,
    pub drawable: u32,
    pub world_from_drawable: DAffine3,
    /// The shape's number of the view.
    pub view: u32,
    /// The layer of the image: 0 is drawn over all others.
    pub layer: u32,
}
