//! [`NodeTrackerManipulator`]: orbits a moving node.

use std::f64::consts::PI;

use glam::{DAffine3, DMat3, DVec3};

use super::orbit_state::{OrbitState, PointMotion, distance_to_center};
use crate::scene::NodeId;
use crate::viewer::events::{GuiEventAdapter, Usage};
use crate::viewer::manipulators::manipulator::{CameraManipulator, ManipulatorView};

/// The part of the node's motion that the eye follows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TrackerMode {
    /// The eye follows the node's centre.
    #[default]
    NodeCenter,
    /// The eye follows the node's centre and its rotation about the vertical.
    NodeCenterAndAzimuth,
    /// The eye follows the node's centre and its rotation.
    NodeCenterAndRotation,
}

/// Orbits a node and follows it; OSG's `NodeTrackerManipulator`. When the node is removed, the eye stays where it was.
#[derive(Clone, Copy, Debug)]
pub struct NodeTrackerManipulator {
    node: NodeId,
    /// The part of the node's motion that the eye follows.
    pub mode: TrackerMode,
    orbit: OrbitState,
    center: DVec3,
    frame: DMat3,
}

impl NodeTrackerManipulator {
    /// Creates a manipulator that follows a node.
    pub fn new(node: NodeId, mode: TrackerMode) -> Self {
        Self { node, mode, orbit: OrbitState::default(), center: DVec3::ZERO, frame: DMat3::IDENTITY }
    }

    /// Returns the node.
    pub fn node(&self) -> NodeId {
        self.node
    }

    /// Returns the distance from the eye to the node, metres.
    pub fn distance_m(&self) -> f64 {
        self.orbit.distance_m.value
    }

    /// Applies a gesture. Two fingers rotate as one does, because a pan would lose the node.
    fn apply(&mut self, motion: PointMotion) {
        if let PointMotion::Pinch(pinch) = motion {
            self.orbit.stretch_and_twist(&pinch);
            self.orbit.turn(PI * pinch.shift().x, PI * pinch.shift().y);
        }
    }

    /// Takes centre and frame from the node's current pose.
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
                // Orthonormalized, because the node may be scaled.
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
        let motion = self.orbit.handle(event);
        motion.into_iter().for_each(|motion| self.apply(motion));
        motion.is_some()
    }

    fn advance(&mut self, dt_s: f64, view: &ManipulatorView<'_>) -> DAffine3 {
        self.follow(view);
        let motion = self.orbit.advance(dt_s);
        self.apply(motion);
        self.orbit.pose(&self.frame, self.center)
    }

    fn set_pose(&mut self, world_from_eye: &DAffine3, view: &ManipulatorView<'_>) {
        if !world_from_eye.is_finite() {
            return;
        }
        self.follow(view);
        let distance_m = world_from_eye.translation.distance(self.center);
        let is_far = distance_m > 2.0 * view.bounds.sphere.radius_m + distance_to_center(world_from_eye, view);
        self.orbit.distance_m.set(if is_far { distance_to_center(world_from_eye, view) } else { distance_m });
        self.orbit.set_direction(&self.frame, world_from_eye);
    }

    fn home(&mut self, view: &ManipulatorView<'_>) {
        self.follow(view);
        let radius_m = view.scene.node_sphere(self.node).map_or(1.0, |s| s.radius_m.max(1e-3));
        let half = 0.5 * view.camera.fovy(view.size_px);
        let aspect = f64::from(view.size_px[0].max(1)) / f64::from(view.size_px[1].max(1));
        let narrow = half.min((half.tan() * aspect).atan());
        self.orbit.distance_m.set(radius_m / narrow.sin());
        (self.orbit.heading, self.orbit.pitch) = (0.0, -0.4);
        self.orbit.pointer.stop();
    }

    fn usage(&self) -> Vec<Usage> {
        vec![
            Usage::new("Left drag", "turn about what is followed"),
            Usage::new("Right drag, wheel", "zoom"),
            Usage::new("Two fingers", "zoom and turn"),
        ]
    }
}
