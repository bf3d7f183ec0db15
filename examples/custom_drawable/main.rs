//! A custom drawable: waving grass whose blades are made in the vertex shader, lit by the engine's sun and shadows.
//!
//! ```text
//! cargo run --release --example custom_drawable -- [--offscreen] [--frames N] [--screenshot FILE]
//! ```
//! Expected: a round meadow on brown ground, with waves of wind; a white ball stands in it and casts a shadow.

mod compiled_grass;
mod grass;
#[path = "../shared/mod.rs"]
mod shared;

use anyhow::Result;
use glam::DVec3;

use terrane::draw::custom_geometry;
use terrane::scene::{Drawable, Environment, Material, Mesh, Node, Page, SunShadows};
use terrane::viewer::{Viewer, WindowOptions};

use self::grass::Grass;

fn main() -> Result<()> {
    shared::show(&shared::Args::parse()?, WindowOptions::default(), build)
}

fn build(viewer: &mut Viewer) -> Result<(), terrane::viewer::ViewerError> {
    let brown = Material { base_color: [0.10, 0.07, 0.04, 1.0], double_sided: true, ..Material::default() };
    let ground = Mesh::rectangle(DVec3::new(-40.0, -40.0, 0.0), DVec3::X * 80.0, DVec3::Y * 80.0);
    let ball = Mesh::sphere(DVec3::new(0.0, 2.0, 1.6), 1.6, 64);
    let drawables = vec![
        Drawable::new(ground.into(), brown),
        Drawable::new(ball.into(), Material::default()),
        Drawable::new(custom_geometry(Grass), Material::default()),
    ];
    viewer.add_root(Page::from_node(Node::group(vec![Node::geode(drawables)])).expect("a shallow graph"))?;
    viewer.view_mut().environment = Environment {
        sun_direction: DVec3::new(-0.8, 0.3, 0.5).normalize(),
        shadows: Some(SunShadows::default()),
        ..viewer.view().environment
    };
    viewer.view_mut().camera.look_at(DVec3::new(2.0, -15.0, 5.0), DVec3::new(0.0, 0.0, 0.5), DVec3::Z);
    Ok(())
}
