//! An occluder node in a wall: balls behind the wall are not drawn, balls behind its window are.
//!
//! ```text
//! cargo run --release --example occluders -- [--no-occluders] [--offscreen] [--frames N] [--screenshot FILE]
//! ```
//! Expected: a grey wall with a window; balls beside it and behind the window. It prints the number of balls that were drawn
//! and the number of nodes and drawables that were found hidden. Without occluders the image is the same, and more balls
//! are drawn.

mod shared;

use anyhow::Result;
use glam::{DAffine3, DVec3};
use terrane::scene::{ConvexPlanarOccluder, CullingMode, Drawable, Material, Mesh, Node, NodeKind, Page};
use terrane::viewer::{Viewer, ViewerConfig, WindowOptions};

fn main() -> Result<()> {
    let args = shared::Args::parse()?;
    let has_occluders = !args.has_flag("--no-occluders");
    let build = move |viewer: &mut Viewer| build(viewer, has_occluders);
    if args.opens_window() {
        return shared::show(&args, WindowOptions::default(), build);
    }
    let mut viewer = Viewer::new_offscreen(&ViewerConfig { samples: 4, ..ViewerConfig::default() })?;
    build(&mut viewer)?;
    shared::draw(&args, &mut viewer)?;
    viewer.finish()?;
    if let Some(last) = viewer.stats().last_drawn() {
        println!("{} of 400 balls and 4 parts of the wall drawn; {} found hidden", last.leaves, last.occluded);
    }
    args.save(&mut viewer)
}

fn build(viewer: &mut Viewer, has_occluders: bool) -> Result<(), terrane::viewer::ViewerError> {
    // A wall from -8 to 8 m and 6 m high, with a window of 3 x 2 m. Its solid parts are four rectangles.
    let part = |x: [f64; 2], z: [f64; 2]| {
        let mesh = Mesh::rectangle(DVec3::new(x[0], 0.0, z[0]), DVec3::X * (x[1] - x[0]), DVec3::Z * (z[1] - z[0]));
        let grey = Material { base_color: [0.35, 0.35, 0.38, 1.0], double_sided: true, ..Material::default() };
        Drawable::new(mesh.into(), grey)
    };
    let wall = Node::geode(vec![
        part([-8.0, -1.5], [0.0, 6.0]),
        part([1.5, 8.0], [0.0, 6.0]),
        part([-1.5, 1.5], [0.0, 2.0]),
        part([-1.5, 1.5], [4.0, 6.0]),
    ]);
    let rectangle = |x: f64, z: [f64; 2]| {
        [(-x, z[0]), (x, z[0]), (x, z[1]), (-x, z[1])].map(|(x, z)| DVec3::new(x, 0.0, z)).to_vec()
    };
    // The occluder itself is invisible; it has the outline of the wall.
    let occluder =
        ConvexPlanarOccluder { corners: rectangle(8.0, [0.0, 6.0]), holes: vec![rectangle(1.5, [2.0, 4.0])] };
    let occluder = Node::new(NodeKind::OccluderNode(Box::new(occluder)));
    let rows = (0..20).map(|row| {
        let balls = (0..20).map(|i| {
            let center = DVec3::new(1.5 * (f64::from(i) - 9.5), 4.0 + 1.5 * f64::from(row), 1.0);
            let red = 0.2 + 0.04 * i as f32;
            let material = Material { base_color: [red, 0.3, 0.05 * row as f32, 1.0], ..Material::default() };
            let ball = Drawable::new(Mesh::sphere(DVec3::ZERO, 0.6, 16).into(), material);
            Node::transform(DAffine3::from_translation(center), vec![Node::geode(vec![ball])])
        });
        Node::group(balls.collect())
    });
    let all = [wall, occluder].into_iter().chain(rows).collect();
    viewer.add_root(Page::from_node(Node::group(all)).expect("a shallow graph"))?;
    if !has_occluders {
        viewer.view_mut().camera.settings.culling = CullingMode::VIEW_FRUSTUM_SIDES;
    }
    viewer.view_mut().camera.look_at(DVec3::new(0.0, -14.0, 4.5), DVec3::new(0.0, 10.0, 1.5), DVec3::Z);
    Ok(())
}
