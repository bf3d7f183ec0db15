//! A camera in the graph draws a turning house into a texture; a screen beside the house shows it.
//!
//! ```text
//! cargo run --release --example render_to_texture -- [--offscreen] [--frames N] [--screenshot FILE]
//! ```
//! Expected: a red house with a yellow roof on the left; on the right a screen that shows it from the other side, on blue.

use std::sync::Arc;

use anyhow::Result;
use glam::{DAffine3, DVec3, dcamera::rh::proj::directx::perspective_infinite_reverse};
use terrane::math::Aabb;
use terrane::scene::{CameraNode, Drawable, Material, Mesh, Node, Page};
use terrane::state::{Attribute, Mode, StateSet, StateValue, TextureBinding, TextureFormat, TextureObject};
use terrane::viewer::{Viewer, ViewerConfig, WindowOptions, has_display, run_window, world_from_eye};

fn main() -> Result<()> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let value = |name: &str| args.iter().position(|a| a == name).and_then(|i| args.get(i + 1));
    let frames: u32 = value("--frames").map_or(Ok(60), |n| n.parse())?;
    if has_display() && !args.iter().any(|a| a == "--offscreen") {
        let options = WindowOptions { on_open: Box::new(build), ..WindowOptions::default() };
        return Ok(run_window(ViewerConfig::default(), options).map(drop)?);
    }
    let mut viewer = Viewer::new_offscreen(&ViewerConfig { samples: 4, ..ViewerConfig::default() })?;
    build(&mut viewer)?;
    for frame in 0..frames {
        viewer.frame_at(f64::from(frame) / 60.0)?;
    }
    value("--screenshot").map_or(Ok(()), |file| Ok(viewer.read_back()?.save(file)?))
}

fn build(viewer: &mut Viewer) -> Result<(), terrane::viewer::ViewerError> {
    // The same nodes twice: once to be seen, once below the camera, which looks from behind.
    let picture = TextureObject::target("behind the house", [512, 512], TextureFormat::Rgba8Srgb);
    let eye = world_from_eye(DVec3::new(-9.0, 7.0, 5.0), DVec3::new(9.0, -7.0, -3.5), DVec3::Z);
    let mut camera =
        CameraNode::to_texture(picture.clone(), eye.inverse(), perspective_infinite_reverse(0.7, 1.0, 0.1));
    camera.clear_color = Some([0.1, 0.2, 0.5, 1.0]);
    let behind = Node::camera(camera, vec![house()]);

    let screen = Mesh::rectangle(DVec3::new(1.5, -1.0, 0.0), DVec3::new(6.0, 0.0, 0.0), DVec3::new(0.0, 0.0, 6.0));
    let shows = StateSet::default()
        .with_mode(Mode::Lighting, StateValue::OFF)
        .with(Attribute::Texture(0, TextureBinding::new(picture)));
    let screen = Node::geode(vec![Drawable::new(screen.into(), Material::default())]).with_state_set(Arc::new(shows));
    let seen = Node::transform(DAffine3::from_translation(DVec3::new(-4.0, 0.0, 0.0)), vec![house()]);
    let root = viewer.add_root(Page::from_node(Node::group(vec![behind, screen, seen])).expect("a shallow graph"))?;
    viewer.view_mut().camera.look_at(DVec3::new(0.0, -18.0, 5.0), DVec3::new(0.0, 0.0, 2.5), DVec3::Z);
    let houses: Vec<_> = viewer.scene().nodes_named(root, "house").collect();
    viewer.on_update(Box::new(move |scene, stamp| {
        let turn = DAffine3::from_rotation_z(stamp.simulation_time_s);
        for house in &houses {
            scene.set_transform(*house, turn).expect("a house is a transform");
        }
    }));
    Ok(())
}

fn house() -> Node {
    let part = |half: f64, z: [f64; 2], color: [f32; 3]| {
        let bounds = Aabb { min: DVec3::new(-half, -half, z[0]), max: DVec3::new(half, half, z[1]) };
        let [r, g, b] = color;
        Drawable::new(Mesh::cuboid(&bounds).into(), Material { base_color: [r, g, b, 1.0], ..Material::default() })
    };
    let walls = [part(1.6, [0.0, 2.4], [0.6, 0.1, 0.08]), part(1.9, [2.4, 2.9], [0.8, 0.6, 0.1])];
    let chimney = Node::transform(
        DAffine3::from_translation(DVec3::new(0.9, 0.9, 0.0)),
        vec![Node::geode(vec![part(0.3, [2.9, 4.2], [0.3, 0.3, 0.3])])],
    );
    Node::transform(DAffine3::IDENTITY, vec![Node::geode(walls.to_vec()), chimney]).named("house")
}
