//! Cameras in the scene graph that draw to a texture, and the images that are read back from them.

use std::sync::Arc;

use image::RgbaImage;
use terrane::cull::CullCamera;
use terrane::draw::DrawStats;
use terrane::scene::{CameraNode, CameraTarget, Environment, Node, PictureSink};
use terrane::state::{TextureFormat, TextureObject};

use crate::rig::Rig;

/// Returns a camera node with the pose, projection and size of `camera` that draws to a texture.
pub fn like(camera: &CullCamera) -> CameraNode {
    let texture = TextureObject::target("image", camera.viewport_px, TextureFormat::Rgba8Srgb);
    CameraNode::to_texture(texture, camera.eye_from_world, camera.clip_from_eye)
}

/// Returns the image that a camera node draws of its children, and the counts of that frame.
///
/// The main camera looks from `elsewhere` in the environment `main`; its image is not read. Panics after 200 frames
/// without an image.
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
    panic!("no image was read back in 200 frames");
}

/// Returns the image that the main camera draws of a node.
pub fn picture(rig: &mut Rig, node: Node, camera: &CullCamera, environment: &Environment) -> RgbaImage {
    let scene = rig.scene(node);
    let picture = rig.picture(&scene, camera, environment);
    rig.release(scene);
    picture
}

/// Panics if the renderer has reported errors.
pub fn no_errors(rig: &mut Rig) {
    let errors = rig.renderer.take_errors();
    assert!(errors.is_empty(), "{errors:?}");
}
