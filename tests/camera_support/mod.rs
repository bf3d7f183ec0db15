//! What the tests of cameras in the graph share: a camera to a texture, its picture, and how pictures compare.
#![allow(clippy::unwrap_used, dead_code, reason = "shared by tests, which use parts of it")]

use std::path::Path;
use std::sync::Arc;

use image::RgbaImage;
use terrane::cull::CullCamera;
use terrane::draw::{DrawStats, Environment};
use terrane::scene::{CameraNode, CameraTarget, Node, PictureSink};
use terrane::state::{TextureFormat, TextureObject};

use crate::gpu_support::Rig;

/// `KEEP_IMAGES=DIR` keeps the pictures to look at.
pub fn keep(name: &str, picture: &RgbaImage) {
    if let Some(folder) = std::env::var_os("KEEP_IMAGES") {
        picture.save(Path::new(&folder).join(format!("{name}.png"))).unwrap();
    }
}

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

/// Pixels that differ by more than that.
pub fn differ(a: &RgbaImage, b: &RgbaImage, by: u8) -> usize {
    assert_eq!(a.dimensions(), b.dimensions());
    let far = |a: &[u8], b: &[u8]| a.iter().zip(b).take(3).any(|(a, b)| a.abs_diff(*b) > by);
    a.pixels().zip(b.pixels()).filter(|(a, b)| far(&a.0, &b.0)).count()
}

pub fn no_errors(rig: &mut Rig) {
    let errors = rig.renderer.take_errors();
    assert!(errors.is_empty(), "{errors:?}");
}
