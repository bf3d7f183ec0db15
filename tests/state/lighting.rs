//! Shared parts of the lighting tests: a lit square in front of the eye, a light, colours and textures.

use std::sync::Arc;

use image::RgbaImage;
use terrane::scene::{Drawable, LightSource, Node, NodeKind, ReferenceFrame};
use terrane::state::{FilterMode, Light, Mode, Sampler, StateSet, StateValue, TextureBinding, TextureObject};

use kit::frames::srgb;
use kit::rig::{Rig, plain, unit_camera};
use kit::shapes::quad;

pub const SIDE: u32 = 64;
pub const RED: [u8; 3] = [255, 0, 0];
pub const GREEN: [u8; 3] = [0, 255, 0];
pub const BLUE: [u8; 3] = [0, 0, 255];

/// Returns a lit square over the middle half of the image that faces the eye.
pub fn square(color: [f32; 4]) -> Drawable {
    let mut drawable = quad([0.0, 0.0, 0.0], [0.5, 0.5], color);
    drawable.material.unlit = false;
    drawable
}

pub fn node(drawable: Drawable, set: StateSet) -> Node {
    Node::geode(vec![drawable]).with_state_set(Arc::new(set))
}

pub fn draw(rig: &mut Rig, nodes: Vec<Node>) -> RgbaImage {
    let scene = rig.scene(Node::group(nodes));
    let picture = rig.picture(&scene, &unit_camera(SIDE), &plain());
    rig.release(scene);
    let errors = rig.renderer.take_errors();
    assert!(errors.is_empty(), "{errors:?}");
    picture
}

pub fn middle(rig: &mut Rig, nodes: Vec<Node>) -> [u8; 3] {
    let [r, g, b, _] = draw(rig, nodes).get_pixel(SIDE / 2, SIDE / 2).0;
    [r, g, b]
}

pub fn assert_near(got: [u8; 3], linear: [f32; 3], what: &str) {
    let want = linear.map(|value| srgb(value.into()));
    assert!(got.iter().zip(want).all(|(g, w)| g.abs_diff(w) <= 2), "{what}: {got:?} instead of {want:?}");
}

/// Returns an environment without the sun, in which only light 1 and those of the test shine.
pub fn only_light_1() -> StateSet {
    StateSet::default().with_mode(Mode::Light(0), StateValue::OFF).with_mode(Mode::Light(1), StateValue::ON)
}

pub fn light(light: Light) -> Node {
    let light = Light { number: 1, ..light };
    Node::new(NodeKind::LightSource(Box::new(LightSource { light, frame: ReferenceFrame::Relative })))
}

pub const WHITE: [f32; 4] = [1.0; 4];

/// Returns texels in four quarters: red, green, blue, white; rows from the top.
pub fn quarters() -> Arc<TextureObject> {
    let texels = [[255, 0, 0, 255], [0, 255, 0, 255], [0, 0, 255, 255], [255; 4]].concat();
    TextureObject::image("quarters", [2, 2], texels)
}

pub fn nearest(texture: Arc<TextureObject>) -> TextureBinding {
    let sampler = Sampler { min_filter: FilterMode::Nearest, mag_filter: FilterMode::Nearest, ..Sampler::default() };
    TextureBinding { texture, sampler }
}

pub fn unlit() -> StateSet {
    StateSet::default().with_mode(Mode::Lighting, StateValue::OFF)
}
