//! A camera in the graph draws a turning house into a texture; a screen beside the house shows it.
//!
//! ```text
//! cargo run --release --example render_to_texture -- [--offscreen] [--frames N] [--screenshot FILE]
//! ```
//! Expected: a red house with a yellow roof on the left; on the right a screen that shows its other side on blue.

mod shared;

use std::sync::Arc;

use anyhow::Result;
use glam::{DAffine3, DVec3, dcamera::rh::proj::directx::perspective_infinite_reverse};
use terrane::math::Aabb;
use terrane::scene::{CameraNode, Drawable, Material, Mesh, Node, Page};
use terrane::state::{Attribute, Mode, StateSet, StateValue, TextureBinding, TextureFormat, TextureObject};
use terrane::viewer::{Viewer, WindowOptions, world_from_eye};

fn main() -> Result<()> {
    shared::show(&shared::Args::parse()?, WindowOptions::default(), build)
}

fn build(viewer: &mut Viewer) -> Result<(), terrane::viewer::ViewerError> {
    // The house is in the scene twice: once visible, and once below the camera, which looks from behind.
    let texture = TextureObject::target("behind the house", [512, 512], TextureFormat::Rgba8Srgb);
    let eye = world_from_eye(DVec3::new(-9.0, 7.0, 5.0), DVec3::new(9.0, -7.0, -3.5), DVec3::Z);
    let mut camera =
        CameraNode::to_texture(texture.clone(), eye.inverse(), perspective_infinite_reverse(0.7, 1.0, 0.1));
    camera.clear_color = Some([0.1, 0.2, 0.5, 1.0]);
    let behind = Node::camera(camera, vec![house()]);

    let screen = Mesh::rectangle(DVec3::new(1.5, -1.0, 0.0), DVec3::new(6.0, 0.0, 0.0), DVec3::new(0.0, 0.0, 6.0));
    let material = StateSet::default()
        .with_mode(Mode::Lighting, StateValue::OFF)
        .with(Attribute::Texture(0, TextureBinding::new(texture)));
    let screen =
        Node::geode(vec![Drawable::new(screen.into(), Material::default())]).with_state_set(Arc::new(material));
    let visible = Node::transform(DAffine3::from_translation(DVec3::new(-4.0, 0.0, 0.0)), vec![house()]);
    let root =
        viewer.add_root(Page::from_node(Node::group(vec![behind, screen, visible])).expect("a shallow graph"))?;
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
