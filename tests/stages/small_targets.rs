//! Cameras that draw a square into small textures, and the frames that are read back.

use std::sync::Arc;

use glam::DAffine3;
use image::RgbaImage;
use kit::rig::{Rig, plain, unit_camera};
use kit::shapes::quad;
use terrane::cull::CullCamera;
use terrane::scene::{CameraNode, CameraTarget, Drawable, Node, PictureSink, Scene};
use terrane::state::{Attribute, Mode, StateSet, StateValue, TextureBinding, TextureFormat, TextureObject};

/// The side of all targets in pixels.
pub const SIDE: u32 = 64;
pub const RED: [u8; 3] = [255, 0, 0];
pub const GREEN: [u8; 3] = [0, 255, 0];
pub const BLUE: [u8; 3] = [0, 0, 255];
pub const BLACK: [u8; 3] = [0, 0, 0];

/// Returns a square around the middle of the image with half its side.
pub fn square(z: f32, color: [u8; 3]) -> Drawable {
    let [r, g, b] = color.map(|c| f32::from(c) / 255.0);
    quad([0.0, 0.0, z], [0.5, 0.5], [r, g, b, 1.0])
}

/// Returns a red square at z = 0.
pub fn red() -> Node {
    Node::geode(vec![square(0.0, RED)])
}

/// Returns the pose and projection of [`unit_camera`], whose image spans -1 to 1 of the plane z = 0.
pub fn view() -> (DAffine3, glam::DMat4) {
    let camera = unit_camera(SIDE);
    (camera.eye_from_world, camera.clip_from_eye)
}

/// Returns a camera that draws to a texture.
pub fn to_texture(texture: &Arc<TextureObject>) -> CameraNode {
    let (view, projection) = view();
    CameraNode::to_texture(texture.clone(), view, projection)
}

/// Returns a texture to draw to.
pub fn target(name: &str) -> Arc<TextureObject> {
    TextureObject::target(name, [SIDE, SIDE], TextureFormat::Rgba8Srgb)
}

/// Returns a square that shows a texture.
pub fn screen(texture: &Arc<TextureObject>) -> Node {
    let set = StateSet::default()
        .with_mode(Mode::Lighting, StateValue::OFF)
        .with(Attribute::Texture(0, TextureBinding::new(texture.clone())));
    Node::geode(vec![square(0.0, [255; 3])]).with_state_set(Arc::new(set))
}

/// Draws a frame of the nodes.
pub fn draw(rig: &mut Rig, nodes: Vec<Node>) -> RgbaImage {
    let scene = rig.scene(Node::group(nodes));
    let picture = rig.picture(&scene, &unit_camera(SIDE), &plain());
    rig.release(scene);
    picture
}

/// Panics if the renderer has reported errors.
pub fn no_errors(rig: &mut Rig) {
    let errors = rig.renderer.take_errors();
    assert!(errors.is_empty(), "{errors:?}");
}

/// Returns the pixels that a camera draws of its children, read back without waiting.
pub fn read(rig: &mut Rig, mut camera: CameraNode, children: Vec<Node>, sink: &Arc<PictureSink>) -> Vec<[u8; 4]> {
    let before = camera.target.as_deref().unwrap().clone();
    camera.target = Some(Arc::new(CameraTarget { read_back: Some(sink.clone()), ..before }));
    let scene = rig.scene(Node::camera(camera, children));
    let picture = drawn_until(rig, &scene, sink);
    rig.release(scene);
    picture.chunks_exact(4).map(|p| [p[0], p[1], p[2], p[3]]).collect()
}

/// Draws frames until an image has been read back, at most 200, and returns its texels.
pub fn drawn_until(rig: &mut Rig, scene: &Scene, sink: &Arc<PictureSink>) -> Vec<u8> {
    for frame in 1..200 {
        let camera = CullCamera { frame, ..unit_camera(SIDE) };
        rig.draw(scene, &camera, &plain());
        if let Some(picture) = sink.take() {
            assert!(picture.frame >= 1 && picture.frame <= frame);
            assert_eq!(picture.size_px, [SIDE, SIDE]);
            return picture.texels;
        }
    }
    panic!("no image was read back in 200 frames");
}
