//! Slave cameras: a wall of three panels, the outer ones turned by 40 degrees, all of them led by one master camera.
//!
//! ```text
//! cargo run --release --example slave_cameras -- [--offscreen] [--frames N] [--screenshot FILE]
//! ```
//! Expected: three upright pictures side by side, black lines between them; columns of all colours stand around the eye
//! and go on from one panel to the next.

use anyhow::Result;
use glam::{DAffine3, DVec3};
use terrane::scene::{Drawable, Material, Mesh, Node, Page};
use terrane::viewer::{
    FieldOfView, Slave, Viewer, ViewerConfig, ViewerError, Viewport, WindowOptions, has_display, run_window,
};

/// What each panel spans.
const PANEL: f64 = 40.0 * std::f64::consts::PI / 180.0;

fn main() -> Result<()> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let value = |name: &str| args.iter().position(|a| a == name).and_then(|i| args.get(i + 1));
    let frames: u32 = value("--frames").map_or(Ok(30), |n| n.parse())?;
    if has_display() && !args.iter().any(|a| a == "--offscreen") {
        let options = WindowOptions { on_open: Box::new(build), ..WindowOptions::default() };
        return Ok(run_window(ViewerConfig::default(), options).map(drop)?);
    }
    let mut viewer = Viewer::new_offscreen(&ViewerConfig { samples: 4, ..ViewerConfig::default() })?;
    build(&mut viewer)?;
    for _ in 0..frames {
        viewer.frame()?;
    }
    value("--screenshot").map_or(Ok(()), |file| Ok(viewer.read_back()?.save(file)?))
}

fn build(viewer: &mut Viewer) -> Result<(), ViewerError> {
    let columns = (0..36).map(|i| {
        let around = f64::from(i) / 36.0 * std::f64::consts::TAU;
        let [r, g, b] = [0.0, 2.1, 4.2].map(|phase: f64| (0.5 + 0.5 * (3.0 * around + phase).cos()) as f32);
        let material = Material { base_color: [r, g, b, 1.0], ..Material::default() };
        let balls = (-3..=3).map(|k| {
            let place = DVec3::new(12.0 * around.sin(), 12.0 * around.cos(), 1.1 * f64::from(k));
            let ball = Drawable::new(Mesh::sphere(DVec3::ZERO, 0.55, 24).into(), material.clone());
            Node::transform(DAffine3::from_translation(place), vec![Node::geode(vec![ball])])
        });
        Node::group(balls.collect())
    });
    viewer.add_root(Page::from_node(Node::group(columns.collect())).expect("a shallow graph"))?;
    viewer.view_mut().camera.look_at(DVec3::ZERO, DVec3::Y, DVec3::Z);

    // The master has the middle of the picture, its slaves what is beside it.
    let panel = |column: u32| Viewport::Shares([f64::from(column) / 3.0 + 0.003, 0.0, 1.0 / 3.0 - 0.006, 1.0]);
    viewer.view_mut().camera.field_of_view = FieldOfView::Horizontal(PANEL);
    viewer.view_mut().set_viewport(panel(1));
    let context = viewer.context();
    for (column, turn) in [(0, -PANEL), (2, PANEL)] {
        let view_offset = DAffine3::from_rotation_y(turn);
        viewer.add_slave(Slave { viewport: panel(column), view_offset, ..Slave::new(context) })?;
    }
    Ok(())
}
