//! Cameras in the scene graph that draw to a texture, and the frames that are read back from them.

use std::sync::Arc;

use image::RgbaImage;
use terrane::cull::CullCamera;
use terrane::draw::{DrawStats, Environment};
use terrane::scene::{CameraNode, CameraTarget, Node, PictureSink};
use terrane::state::{TextureFormat, TextureObject};

use crate::rig::Rig;

/// A camera to a texture that sees what another one does.
pub fn like(camera: &CullCamera) -> CameraNode {
    let texture = TextureObject::target("picture", camera.viewport_px, TextureFormat::Rgba8Srgb);
    CameraNode::to_texture(texture, camera.eye_from_world, camera.clip_from_eye)
}

/// What a camera to a texture draws while the main one, which is not looked at, is elsewhere.
pub fn drawn(
    rig: &mut Rig,
    mut node: CameraNode,
    children: Vec<Node>,
    elsewhere: &CullCamera,
    main: &Environment,
) -> (RgbaImage, DrawStats) {
    let sink = Arc::new(PictureSink::default());
    let before = node.target.as_deref().unwrap().clone();
    node.target = Some(Arc::new(CameraTarget { read_back: Some(sink.clone()), ..before }));
    let scene = rig.scene(Node::camera(node, children));
    for frame in 1..200 {
        let stats = rig.draw(&scene, &CullCamera { frame, ..*elsewhere }, main);
        if let Some(picture) = sink.take() {
            rig.release(scene);
            let [width, height] = picture.size_px;
            return (RgbaImage::from_raw(width, height, picture.texels).unwrap(), stats);
        }
    }
    panic!("no picture came");
}

/// The main picture of something from a camera.
pub fn picture(rig: &mut Rig, node: Node, camera: &CullCamera, environment: &Environment) -> RgbaImage {
    let scene = rig.scene(node);
    let picture = rig.picture(&scene, camera, environment);
    rig.release(scene);
    picture
}

pub fn no_errors(rig: &mut Rig) {
    let errors = rig.renderer.take_errors();
    assert!(errors.is_empty(), "{errors:?}");
}
