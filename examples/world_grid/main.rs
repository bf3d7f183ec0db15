//! A grid of world coordinates on whatever is drawn, exact on the globe: a program knows where its pixels are in the world.
//!
//! ```text
//! cargo run --release --example world_grid -- [--offscreen] [--frames N] [--screenshot FILE]
//! ```
//! Expected: a plain with blocks and two domes on the equator, all with thin lines at each metre and thick ones at each
//! 10 m, on the domes as contours. The lines are straight and stay in place while the eye moves.

#[path = "../shared/mod.rs"]
mod shared;

use std::sync::Arc;

use anyhow::Result;
use glam::{DAffine3, DVec3};
use terrane::math::Aabb;
use terrane::scene::{Drawable, Material, Mesh, Node, Page};
use terrane::state::{Attribute, Program, StateSet};
use terrane::viewer::{Viewer, WindowOptions};

/// The point on the ground around which all is built, earth-centred: up is x, east is y and north is z.
const SITE: DVec3 = DVec3::new(6_378_137.25, 0.0, 0.0);

fn main() -> Result<()> {
    shared::show(&shared::Args::parse()?, WindowOptions::default(), build)
}

fn build(viewer: &mut Viewer) -> Result<(), terrane::viewer::ViewerError> {
    let colored = |mesh: Mesh, [r, g, b]: [f32; 3]| {
        Drawable::new(mesh.into(), Material { base_color: [r, g, b, 1.0], ..Material::default() })
    };
    let block = |[y, z]: [f64; 2], half: f64, height: f64, color| {
        let bounds = Aabb { min: DVec3::new(-1.0, y - half, z - half), max: DVec3::new(height, y + half, z + half) };
        colored(Mesh::cuboid(&bounds), color)
    };
    let dome = |[y, z]: [f64; 2], radius: f64, color| colored(Mesh::sphere(DVec3::new(0.0, y, z), radius, 96), color);
    let drawables = vec![
        block([0.0, 0.0], 60.4, 0.0, [0.35, 0.45, 0.25]),
        block([-14.3, 6.4], 5.7, 14.6, [0.7, 0.62, 0.5]),
        block([16.7, 21.2], 4.3, 9.1, [0.6, 0.3, 0.22]),
        dome([9.2, -2.6], 7.4, [0.75, 0.75, 0.7]),
        dome([-8.0, 33.1], 12.7, [0.3, 0.42, 0.6]),
    ];
    let program = StateSet::default().with(Attribute::Program(Program::new("world grid", include_str!("grid.wgsl"))));
    let geode = Node::geode(drawables).with_state_set(Arc::new(program));
    let site = Node::transform(DAffine3::from_translation(SITE), vec![geode]);
    viewer.add_root(Page::from_node(site).expect("a shallow graph"))?;
    viewer.view_mut().environment.sun_direction = DVec3::new(0.7, -0.6, -0.3).normalize();
    viewer.view_mut().camera.look_at(SITE + DVec3::new(17.0, 8.0, -38.0), SITE + DVec3::new(2.0, 0.0, 4.0), DVec3::X);
    Ok(())
}
