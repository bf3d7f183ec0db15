//! Several views in one graphics context: two of one scene from different sides, and one of a second scene.
//!
//! ```text
//! cargo run --release --example multi_view -- [--offscreen] [--frames N] [--screenshot FILE]
//! ```
//! It always draws offscreen. Expected: on the left a ring of balls from above and from the side, each view with its own
//! sky; on the right a single red ball on dark blue.

mod shared;

use anyhow::Result;
use glam::{DAffine3, DVec3};

use terrane::gpu::GraphicsContext;
use terrane::scene::{Drawable, Material, Mesh, Node, Page, Sky};
use terrane::viewer::{CompositeViewer, ViewArea, ViewerConfig};

fn main() -> Result<()> {
    let args = shared::Args::parse()?;
    let config = ViewerConfig { samples: 4, ..ViewerConfig::default() };
    let mut viewer = CompositeViewer::new(&config)?;
    let context = viewer.open_context(GraphicsContext::new_offscreen(&config.traits())?)?;

    let (ring, single) = (viewer.add_scene()?, viewer.add_scene()?);
    let balls = (0..12).map(|i| {
        let around = f64::from(i) / 12.0 * std::f64::consts::TAU;
        ball(DVec3::new(4.0 * around.cos(), 4.0 * around.sin(), 0.0), [1.0, 0.08 * i as f32, 0.2, 1.0])
    });
    viewer.add_root(ring, Page::from_node(Node::group(balls.collect()))?)?;
    viewer.add_root(single, Page::from_node(ball(DVec3::ZERO, [1.0, 0.1, 0.1, 1.0]))?)?;

    let views = [
        (ring, [0.0, 0.0, 0.5, 0.5], DVec3::new(0.0, -0.1, 18.0), [120, 170, 230]),
        (ring, [0.0, 0.5, 0.5, 0.5], DVec3::new(0.0, -14.0, 1.0), [230, 190, 140]),
        (single, [0.5, 0.0, 0.5, 1.0], DVec3::new(0.0, -4.0, 0.0), [10, 15, 60]),
    ];
    for (scene, part, eye, background) in views {
        let id = viewer.add_view(scene, context, ViewArea::Shares(part))?;
        let view = viewer.view_mut(id)?;
        view.camera.look_at(eye, DVec3::ZERO, DVec3::Z);
        view.environment.sky = Sky::Background(background);
        view.environment.fog.enabled = false;
    }
    for _ in 0..args.frames_or(60) {
        viewer.frame()?;
    }
    viewer.finish()?;
    args.save_image(|| Ok(viewer.read_back(context)?))
}

fn ball(center: DVec3, color: [f32; 4]) -> Node {
    let material = Material { base_color: color, ..Material::default() };
    let ball = Drawable::new(Mesh::sphere(DVec3::ZERO, 0.9, 32).into(), material);
    Node::transform(DAffine3::from_translation(center), vec![Node::geode(vec![ball])])
}
