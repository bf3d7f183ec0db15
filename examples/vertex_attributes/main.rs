//! Custom vertex attributes, which programs read by name, and primitives other than triangles: rain on hills, and the wind
//! around them.
//!
//! ```text
//! cargo run --release --example vertex_attributes -- [--offscreen] [--frames N] [--screenshot FILE]
//! ```
//! Expected: three hills in a white frame, coloured by rain from sand to deep green, with a line every 100 mm. Bands of wind
//! move from the left in dashes: blue where the wind is slow, before and behind the hills, red where it is fast, between
//! and above them.

mod land;
#[path = "../shared/mod.rs"]
mod shared;
mod wind;

use std::sync::Arc;

use anyhow::Result;
use glam::{DVec2, DVec3};
use terrane::scene::{Drawable, Material, Mesh, Node, Page, PrimitiveMode};
use terrane::state::{Attribute, Program, StateSet};
use terrane::viewer::{Viewer, WindowOptions};

use self::land::{HALF_M, land, vertex};
use self::wind::band;

fn main() -> Result<()> {
    shared::show(&shared::Args::parse()?, WindowOptions::default(), build)
}

fn build(viewer: &mut Viewer) -> Result<(), terrane::viewer::ViewerError> {
    let drawn_by = |program: &str, wgsl: &str, meshes: Vec<Mesh>| {
        let both_sides = Material { double_sided: true, ..Material::default() };
        let drawables = meshes.into_iter().map(|mesh| Drawable::new(mesh.into(), both_sides.clone())).collect();
        let set = StateSet::default().with(Attribute::Program(Program::new(program, wgsl)));
        Node::geode(drawables).with_state_set(Arc::new(set))
    };
    let land = drawn_by("rain", include_str!("rain.wgsl"), vec![land().expect("one value per vertex")]);
    let starts = (0..33).map(|i| DVec2::new(-HALF_M, (f64::from(i) / 16.0 - 1.0) * (HALF_M - 60.0)));
    let bands = starts.map(|start| band(start).expect("one value per vertex")).collect();
    // Without attributes and program the engine shades it.
    let corners = [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)];
    let corners = corners.map(|(x, y)| vertex(DVec3::new(x, y, 0.0) * HALF_M + DVec3::Z, DVec3::Z)).to_vec();
    let white = Material { unlit: true, ..Material::default() };
    let frame = Drawable::new(Mesh::from_arrays(PrimitiveMode::LineLoop, corners).into(), white);
    let all = vec![land, drawn_by("wind", include_str!("wind.wgsl"), bands), Node::geode(vec![frame])];
    viewer.add_root(Page::from_node(Node::group(all)).expect("a shallow graph"))?;
    viewer.view_mut().environment.sun_direction = DVec3::new(-0.6, -0.5, 0.6).normalize();
    viewer.view_mut().camera.look_at(DVec3::new(-700.0, -3600.0, 2300.0), DVec3::new(50.0, -250.0, 0.0), DVec3::Z);
    Ok(())
}
