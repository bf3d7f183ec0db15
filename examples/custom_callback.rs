//! Callbacks of nodes: an update callback turns a windmill's wheel, and an event callback changes its speed with the mouse
//! wheel.
//!
//! ```text
//! cargo run --release --example custom_callback -- [--offscreen] [--frames N] [--screenshot FILE]
//! ```
//! Expected: a white tower with four red sails that turn, faster after each notch away from you; the camera stays.

mod shared;

use std::sync::Arc;
use std::sync::atomic::{AtomicI32, Ordering};

use anyhow::Result;
use glam::{DAffine3, DVec3};
use terrane::math::Aabb;
use terrane::scene::{Drawable, Material, Mesh, Node, Page, Traverse, UpdateCallback};
use terrane::viewer::{EventKind, Viewer, ViewerError, WindowOptions, event_callback};

fn main() -> Result<()> {
    shared::show(&shared::Args::parse()?, WindowOptions { manipulated: false, ..WindowOptions::default() }, build)
}

fn build(viewer: &mut Viewer) -> Result<(), ViewerError> {
    let part = |min: [f64; 3], max: [f64; 3], base_color| {
        let mesh = Mesh::cuboid(&Aabb { min: DVec3::from_array(min), max: DVec3::from_array(max) });
        Drawable::new(mesh.into(), Material { base_color, ..Material::default() })
    };
    let tower = part([-0.5, -0.5, 0.0], [0.5, 0.5, 6.0], [0.9, 0.9, 0.85, 1.0]);
    let sails = (0..4).map(|i| {
        let sail = part([-0.3, -0.1, 0.5], [0.3, 0.0, 4.0], [0.7, 0.1, 0.05, 1.0]);
        Node::transform(
            DAffine3::from_rotation_y(f64::from(i) * 0.5 * std::f64::consts::PI),
            vec![Node::geode(vec![sail])],
        )
    });

    let mut wheel = Node::transform(DAffine3::IDENTITY, sails.collect());
    let notches = Arc::new(AtomicI32::new(4));
    // Called once per frame in the update phase, where the scene may change.
    let (turned, mut angle, mut last_s) = (notches.clone(), 0.3, 0.0);
    wheel.update_callback = Some(UpdateCallback::new(move |scene, node, info| {
        angle += 0.25 * f64::from(turned.load(Ordering::Relaxed)) * (info.simulation_time_s - last_s);
        last_s = info.simulation_time_s;
        let pose = DAffine3::from_translation(DVec3::new(0.0, -0.6, 5.5)) * DAffine3::from_rotation_y(angle);
        scene.set_transform(node, pose).expect("the wheel is a transform");
        Traverse::Below
    }));
    // Called for each event, in the event phase.
    wheel.event_callback = Some(event_callback(move |_, _, event| {
        if let EventKind::Scroll(notch) = event.kind {
            notches.fetch_add(notch.y.signum() as i32, Ordering::Relaxed);
        }
        Traverse::Below
    }));
    viewer.add_root(Page::from_node(Node::group(vec![Node::geode(vec![tower]), wheel])).expect("a shallow graph"))?;
    viewer.view_mut().camera.look_at(DVec3::new(8.0, -16.0, 7.0), DVec3::new(0.0, 0.0, 4.5), DVec3::Z);
    Ok(())
}
