//! Slave cameras: a wall of three panels. The outer ones are slaves of the middle one, turned by 40 degrees.
//!
//! ```text
//! cargo run --release --example slave_cameras -- [--offscreen] [--frames N] [--screenshot FILE]
//! ```
//! Expected: three upright images side by side with black lines between them. Columns of all colours surround the eye and
//! continue from one panel to the next.

mod shared;

use anyhow::Result;
use glam::{DAffine3, DVec3};
use terrane::scene::{Drawable, Material, Mesh, Node, Page};
use terrane::viewer::{FieldOfView, Slave, ViewArea, Viewer, ViewerError, WindowOptions};

/// The horizontal angle of each panel, radians.
const PANEL: f64 = 40.0 * std::f64::consts::PI / 180.0;

fn main() -> Result<()> {
    shared::show(&shared::Args::parse()?, WindowOptions::default(), build)
}

fn build(viewer: &mut Viewer) -> Result<(), ViewerError> {
    let columns = (0..36).map(|i| {
        let around = f64::from(i) / 36.0 * std::f64::consts::TAU;
        let [r, g, b] = [0.0, 2.1, 4.2].map(|phase: f64| (0.5 + 0.5 * (3.0 * around + phase).cos()) as f32);
        let material = Material { base_color: [r, g, b, 1.0], ..Material::default() };
        let balls = (-3..=3).map(|k| {
            let center = DVec3::new(12.0 * around.sin(), 12.0 * around.cos(), 1.1 * f64::from(k));
            let ball = Drawable::new(Mesh::sphere(DVec3::ZERO, 0.55, 24).into(), material.clone());
            Node::transform(DAffine3::from_translation(center), vec![Node::geode(vec![ball])])
        });
        Node::group(balls.collect())
    });
    viewer.add_root(Page::from_node(Node::group(columns.collect())).expect("a shallow graph"))?;
    viewer.view_mut().camera.look_at(DVec3::ZERO, DVec3::Y, DVec3::Z);

    // The master draws the middle panel, its slaves the outer ones.
    let panel = |column: u32| ViewArea::Shares([f64::from(column) / 3.0 + 0.003, 0.0, 1.0 / 3.0 - 0.006, 1.0]);
    viewer.view_mut().camera.field_of_view = FieldOfView::Horizontal(PANEL);
    viewer.view_mut().set_viewport(panel(1));
    let context = viewer.context();
    for (column, turn) in [(0, -PANEL), (2, PANEL)] {
        let view_offset = DAffine3::from_rotation_y(turn);
        viewer.add_slave(Slave { viewport: panel(column), view_offset, ..Slave::new(context) })?;
    }
    Ok(())
}
