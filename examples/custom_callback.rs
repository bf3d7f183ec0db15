//! Callbacks of nodes: an update callback turns a windmill's wheel, an event callback changes its speed with the wheel
//! of the mouse.
//!
//! ```text
//! cargo run --release --example custom_callback -- [--offscreen] [--frames N] [--screenshot FILE]
//! ```
//! Expected: a white tower with four red sails that turn, faster after each notch away from you; the camera stays.

use std::sync::Arc;
use std::sync::atomic::{AtomicI32, Ordering};

use anyhow::Result;
use glam::{DAffine3, DVec3};
use terrane::math::Aabb;
use terrane::scene::{Drawable, Material, Mesh, Node, Page, Traverse, UpdateCallback};
use terrane::viewer::{
    EventKind, Viewer, ViewerConfig, ViewerError, WindowOptions, event_callback, has_display, run_window,
};

fn main() -> Result<()> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let value = |name: &str| args.iter().position(|a| a == name).and_then(|i| args.get(i + 1));
    let frames: u32 = value("--frames").map_or(Ok(30), |n| n.parse())?;
    if has_display() && !args.iter().any(|a| a == "--offscreen") {
        let options = WindowOptions { on_open: Box::new(build), manipulated: false, ..WindowOptions::default() };
        return Ok(run_window(ViewerConfig::default(), options).map(drop)?);
    }
    let mut viewer = Viewer::new_offscreen(&ViewerConfig { samples: 4, ..ViewerConfig::default() })?;
    build(&mut viewer)?;
    for frame in 0..frames {
        viewer.frame_at(f64::from(frame) / 60.0)?;
    }
    value("--screenshot").map_or(Ok(()), |file| Ok(viewer.read_back()?.save(file)?))
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
    // Once a frame, in the update phase: the scene may be changed.
    let (turned, mut angle, mut last_s) = (notches.clone(), 0.3, 0.0);
    wheel.update_callback = Some(UpdateCallback::new(move |scene, node, info| {
        angle += 0.25 * f64::from(turned.load(Ordering::Relaxed)) * (info.simulation_time_s - last_s);
        last_s = info.simulation_time_s;
        let place = DAffine3::from_translation(DVec3::new(0.0, -0.6, 5.5)) * DAffine3::from_rotation_y(angle);
        scene.set_transform(node, place).expect("the wheel is a transform");
        Traverse::Below
    }));
    // Once an event, in the event phase.
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
