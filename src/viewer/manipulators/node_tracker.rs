//! Around a node that moves.

use std::f64::consts::PI;

use glam::{DAffine3, DMat3, DVec3};

use super::orbit::{Around, Shift, distance_to_middle};
use super::{CameraManipulator, ManipulatorView, usage};
use crate::scene::NodeId;
use crate::viewer::events::{GuiEventAdapter, Usage};

/// What of the node's motion the eye takes part in.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TrackerMode {
    /// Its place.
    #[default]
    NodeCenter,
    /// Its place, and its turn about the vertical.
    NodeCenterAndAzimuth,
    /// Its place and its rotation.
    NodeCenterAndRotation,
}

/// Looks at a node from around it, wherever it goes; OSG's `NodeTrackerManipulator`. When the node is gone it stays
/// where it was.
#[derive(Clone, Copy, Debug)]
pub struct NodeTrackerManipulator {
    node: NodeId,
    /// What of the node's motion the eye takes part in.
    pub mode: TrackerMode,
    around: Around,
    center: DVec3,
    frame: DMat3,
}

impl NodeTrackerManipulator {
    /// Follows a node.
    pub fn new(node: NodeId, mode: TrackerMode) -> Self {
        Self { node, mode, around: Around::default(), center: DVec3::ZERO, frame: DMat3::IDENTITY }
    }

    /// The node.
    pub fn node(&self) -> NodeId {
        self.node
    }

    /// Metres from the eye to the node.
    pub fn distance_m(&self) -> f64 {
        self.around.distance_m.value
    }

    /// A pan would lose the node: two fingers turn about it as one does.
    fn shift(&mut self, shift: Shift) {
        if let Shift::Pinch(pinch) = shift {
            self.around.stretch_and_twist(&pinch);
            self.around.turn(PI * pinch.shift().x, PI * pinch.shift().y);
        }
    }

    fn follow(&mut self, view: &ManipulatorView<'_>) {
        let Some(world_from_node) = view.scene.world_from_node(self.node).filter(DAffine3::is_finite) else { return };
        let sphere = view.scene.node_sphere(self.node);
        self.center = sphere.map_or(world_from_node.translation, |s| s.center);
        let upright = view.frame_at(self.center).world_from_local.matrix3;
        self.frame = match self.mode {
            TrackerMode::NodeCenter => upright,
            TrackerMode::NodeCenterAndAzimuth => {
                let ahead = upright.transpose() * (world_from_node.matrix3 * DVec3::Y);
                let heading = if ahead.truncate().length() > 1e-9 { ahead.x.atan2(ahead.y) } else { 0.0 };
                upright * DMat3::from_rotation_z(-heading)
            }
            TrackerMode::NodeCenterAndRotation => {
                // Without the node's scale.
                let m = world_from_node.matrix3;
                let x = m.x_axis.normalize_or(upright.x_axis);
                let z = x.cross(m.y_axis).normalize_or(upright.z_axis);
                DMat3::from_cols(x, z.cross(x), z)
            }
        };
    }
}

impl CameraManipulator for NodeTrackerManipulator {
    fn handle(&mut self, event: &GuiEventAdapter, _: &ManipulatorView<'_>) -> bool {
        let shift = self.around.handle(event);
        shift.into_iter().for_each(|shift| self.shift(shift));
        shift.is_some()
    }

    fn advance(&mut self, dt_s: f64, view: &ManipulatorView<'_>) -> DAffine3 {
        self.follow(view);
        let shift = self.around.advance(dt_s);
        self.shift(shift);
        self.around.pose(&self.frame, self.center)
    }

    fn set_pose(&mut self, world_from_eye: &DAffine3, view: &ManipulatorView<'_>) {
        if !world_from_eye.is_finite() {
            return;
        }
        self.follow(view);
        let distance_m = world_from_eye.translation.distance(self.center);
        let is_far = distance_m > 2.0 * view.bounds.sphere.radius_m + distance_to_middle(world_from_eye, view);
        self.around.distance_m.set(if is_far { distance_to_middle(world_from_eye, view) } else { distance_m });
        self.around.set_direction(&self.frame, world_from_eye);
    }

    fn home(&mut self, view: &ManipulatorView<'_>) {
        self.follow(view);
        let radius_m = view.scene.node_sphere(self.node).map_or(1.0, |s| s.radius_m.max(1e-3));
        let half = 0.5 * view.camera.fovy(view.size_px);
        let aspect = f64::from(view.size_px[0].max(1)) / f64::from(view.size_px[1].max(1));
        let narrow = half.min((half.tan() * aspect).atan());
        self.around.distance_m.set(radius_m / narrow.sin());
        (self.around.heading, self.around.pitch) = (0.0, -0.4);
        self.around.pointer.stop();
    }

    fn usage(&self) -> Vec<Usage> {
        vec![
            usage("Left drag", "turn about what is followed"),
            usage("Right drag, wheel", "zoom"),
            usage("Two fingers", "zoom and turn"),
        ]
    }
}
