//! A custom manipulator: a satellite that circles a ball. The arrow keys tilt its orbit, the wheel changes its height.
//!
//! ```text
//! cargo run --release --example custom_manipulator -- [--offscreen] [--frames N] [--screenshot FILE]
//! ```
//! Expected: a blue ball with seven brown blocks on it, seen from an eye that circles it and looks down on it.

mod shared;

use anyhow::Result;
use glam::{DAffine3, DQuat, DVec3};
use terrane::math::Aabb;
use terrane::scene::{Drawable, Material, Mesh, Node, Page};
use terrane::viewer::manipulators::{CameraManipulator, ManipulatorView};
use terrane::viewer::{EventKind, GuiEventAdapter, Key, Usage, Viewer, ViewerError, WindowOptions, world_from_eye};

/// A satellite; angles in radians, the distance in radii of the ball.
struct Satellite {
    angle: f64,
    tilt: f64,
    distance: f64,
}

impl CameraManipulator for Satellite {
    fn handle(&mut self, event: &GuiEventAdapter, _: &ManipulatorView<'_>) -> bool {
        match event.kind {
            EventKind::Scroll(notches) => self.distance = (self.distance * 0.9f64.powf(notches.y)).clamp(1.5, 20.0),
            EventKind::KeyDown { key: Key::Up, .. } => self.tilt += 0.05,
            EventKind::KeyDown { key: Key::Down, .. } => self.tilt -= 0.05,
            _ => return false,
        }
        true
    }

    /// Moves as a function of time, independent of the frame rate; slower at a greater distance, by Kepler's third law.
    fn advance(&mut self, dt_s: f64, view: &ManipulatorView<'_>) -> DAffine3 {
        self.angle += dt_s * 1.5 / self.distance.powf(1.5);
        let around = DQuat::from_rotation_x(self.tilt) * DQuat::from_rotation_z(self.angle);
        let sphere = view.bounds.sphere;
        let out = around * DVec3::X;
        world_from_eye(sphere.center + out * self.distance * sphere.radius_m, -out, around * DVec3::Y)
    }

    /// Ignores the pose, because the orbit determines it; other manipulators would continue from it.
    fn set_pose(&mut self, _: &DAffine3, _: &ManipulatorView<'_>) {}

    fn usage(&self) -> Vec<Usage> {
        vec![Usage { keys: "Up, Down".into(), does: "tilt the orbit" }, Usage { keys: "Wheel".into(), does: "height" }]
    }
}

fn main() -> Result<()> {
    shared::show(&shared::Args::parse()?, WindowOptions::default(), build)
}

fn build(viewer: &mut Viewer) -> Result<(), ViewerError> {
    let colored = |mesh: Mesh, base_color| Drawable::new(mesh.into(), Material { base_color, ..Material::default() });
    let mut parts = vec![Node::geode(vec![colored(Mesh::sphere(DVec3::ZERO, 10.0, 96), [0.05, 0.2, 0.5, 1.0])])];
    for i in 0..7 {
        let block = Aabb { min: DVec3::new(9.5, -1.0, -1.0), max: DVec3::new(11.0, 1.0, 1.0) };
        let turn = DQuat::from_rotation_z(f64::from(i) * 0.9) * DQuat::from_rotation_y(0.5 * f64::from(i % 3 - 1));
        let block = Node::geode(vec![colored(Mesh::cuboid(&block), [0.4, 0.25, 0.1, 1.0])]);
        parts.push(Node::transform(DAffine3::from_quat(turn), vec![block]));
    }
    viewer.add_root(Page::from_node(Node::group(parts)).expect("a shallow graph"))?;
    viewer.set_manipulator(Some(Box::new(Satellite { angle: 0.0, tilt: 0.3, distance: 3.0 })));
    Ok(())
}
