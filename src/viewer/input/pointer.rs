//! The pointer of a view in its windows. Positions in the window of any camera become positions in the image of the master
//! camera. The application sets the pointer's shape and moves it. Main thread.
//!
//! OSG calls the camera under the pointer the one with focus, and converts its coordinates to the master camera's.

use glam::{DMat3, DMat4, DVec2};

use super::state::{MouseCursor, WindowCommand};
use super::window_matrix::WindowMatrix;
use crate::viewer::events::EventSource;
use crate::viewer::ids::{ContextId, SlaveId};
use crate::viewer::view::View;

/// A camera in a window.
struct CameraWindow {
    /// The number of the camera; cameras of a window are drawn in the order of their numbers.
    number: u32,
    slave: Option<SlaveId>,
    /// Its viewport, and the projection from the eye space of the master camera, without an offset of the eye.
    matrix: WindowMatrix,
}

impl View {
    /// Returns the image of the master camera as a window; `None` once its context was closed.
    fn master_window(&self) -> Option<CameraWindow> {
        let slot = self.master?;
        Some(CameraWindow { number: slot.camera, slave: None, matrix: self.master_image() })
    }

    /// Returns the projection into the image of the master camera. Without its context, the image keeps its last size.
    fn master_image(&self) -> WindowMatrix {
        let WindowMatrix { origin_px, size_px, .. } = self.window_matrix();
        let clip_from_world = self.camera.clip_from_eye(self.size_px(), self.camera.min_near_m);
        WindowMatrix { clip_from_world, origin_px, size_px }
    }

    fn slave_window(&self, slave: SlaveId) -> Option<CameraWindow> {
        let (part_px, clip_from_eye, view_offset) = self.slave_lens(slave)?;
        let [x, y, width, height] = part_px.map(f64::from);
        let turn = if view_offset.is_finite() { view_offset.matrix3 } else { DMat3::IDENTITY };
        let matrix = WindowMatrix {
            clip_from_world: clip_from_eye * DMat4::from_mat3(turn),
            origin_px: DVec2::new(x, y),
            size_px: DVec2::new(width.max(1.0), height.max(1.0)),
        };
        Some(CameraWindow { number: slave.0, slave: Some(slave), matrix })
    }

    /// Returns the cameras in a context, in the order drawn.
    fn camera_windows(&self, context: ContextId) -> impl Iterator<Item = CameraWindow> {
        let master = self.master_window().filter(|_| self.context() == Some(context));
        let slaves = self.slaves().filter(move |(_, slave)| slave.context == context);
        master.into_iter().chain(slaves.filter_map(|(id, _)| self.slave_window(id)))
    }

    /// Returns the view's camera at a position of a context, of those that overlap the one drawn last, with its number.
    pub(in crate::viewer) fn camera_at(&self, context: ContextId, position_px: DVec2) -> Option<(u32, EventSource)> {
        let here = self.camera_windows(context).filter(|camera| camera.matrix.contains(position_px)).last()?;
        Some((here.number, EventSource { context: Some(context), slave: here.slave }))
    }

    /// Converts a position in the window of a camera to the position in the image of the master camera that shows the same
    /// direction. Both are in pixels from the upper left corner. The result may be outside of the image. A direction behind the
    /// master camera becomes the nearest position on the image's edge.
    pub fn in_master(&self, source: EventSource, position_px: DVec2) -> DVec2 {
        let master = self.master_image();
        let Some(slave) = source.slave.and_then(|slave| self.slave_window(slave)) else {
            return position_px - master.origin_px;
        };
        if let Some(at) = slave.matrix.to_other(position_px, &master) {
            return at - master.origin_px;
        }
        let behind = slave.matrix.world_from_window(position_px.extend(0.5));
        let aside = behind.map_or(DVec2::X, |point| DVec2::new(point.x, -point.y)).normalize_or(DVec2::X);
        // From the middle of the image to its edge.
        let half = 0.5 * master.size_px;
        half + aside * (half / aside.abs()).min_element()
    }

    /// Converts the pointer's position in a window to the image of the master camera as [`Self::in_master`] does, and sets the
    /// window and the camera of the events that are queued next. While a button or a finger is down, the camera stays the
    /// one in which it went down.
    ///
    /// For code that runs a window: queue the motion at the returned position.
    pub fn focus_camera(&mut self, context: ContextId, position_px: DVec2) -> DVec2 {
        let queue = &self.input.queue;
        let is_grabbed = queue.is_pressed() && queue.source().context == Some(context);
        let source = if is_grabbed {
            queue.source()
        } else {
            let outside = EventSource { context: Some(context), slave: self.first_slave_in(context) };
            self.camera_at(context, position_px).map_or(outside, |(_, source)| source)
        };
        self.input.queue.set_source(source);
        self.in_master(source, position_px)
    }

    /// Sets the window of the events that are queued next, for events without a position. While a button or a finger is down,
    /// it stays the one in which it went down.
    pub fn focus_window(&mut self, context: ContextId) {
        let queue = &self.input.queue;
        if queue.source().context != Some(context) && !queue.is_pressed() {
            let slave = self.first_slave_in(context);
            self.input.queue.set_source(EventSource { context: Some(context), slave });
        }
    }

    /// Returns the first slave in a window without the master camera.
    fn first_slave_in(&self, context: ContextId) -> Option<SlaveId> {
        self.camera_windows(context).next().and_then(|camera| camera.slave)
    }

    /// Has the window of the master camera show a shape of the pointer.
    pub fn set_cursor(&mut self, cursor: MouseCursor) {
        self.request_window(WindowCommand::SetCursor(cursor));
    }

    /// Moves the pointer to a position in the master camera's image, in pixels from its upper left corner; OSG's
    /// `requestWarpPointer`. The event queue has the new position at once, without an event. Not all window systems let
    /// applications move the pointer.
    pub fn warp_pointer(&mut self, position_px: DVec2) {
        if position_px.is_finite() {
            self.input.queue.mouse_warped(position_px);
            self.request_window(WindowCommand::WarpPointer(position_px + self.window_matrix().origin_px));
        }
    }
}
