//! Cameras in the graph with a part of their target clear only that part. Needs a GPU; a software adapter suffices.

use std::sync::Arc;

use image::RgbaImage;
use kit::cameras::{no_errors, picture};
use kit::frames::pixel;
use kit::rig::{Rig, plain, rig, unit_camera};
use kit::shapes::quad;
use kit::skip::skipped;
use terrane::scene::{
    Attachment, CameraNode, CameraTarget, ClearNode, Node, NodeKind, PictureSink, ReferenceFrame, RenderOrder,
};
use terrane::state::{
    Attribute, CompareFunction, Mode, StateSet, StateValue, Stencil, StencilFace, StencilOperation, TextureBinding,
    TextureFormat, TextureObject,
};

const SIDE: u32 = 64;
const RED: [u8; 3] = [255, 0, 0];
const GREEN: [u8; 3] = [0, 255, 0];
const BLUE: [u8; 3] = [0, 0, 255];

/// The middle half of the image.
fn square(z: f32, color: [u8; 3]) -> Node {
    let [r, g, b] = color.map(|c| f32::from(c) / 255.0);
    Node::geode(vec![quad([0.0, 0.0, z], [0.5, 0.5], [r, g, b, 1.0])])
}

/// Returns a camera with the view of the main one that clears nothing.
fn over(order: i32) -> CameraNode {
    let own = unit_camera(SIDE);
    CameraNode {
        frame: ReferenceFrame::Absolute,
        view: own.eye_from_world,
        projection: Some(own.clip_from_eye),
        clear_color: None,
        clear_depth: false,
        ..CameraNode::new(RenderOrder::PostRender(order))
    }
}

const LEFT: [u32; 4] = [0, 0, SIDE / 2, SIDE];

fn draw(rig: &mut Rig, nodes: Vec<Node>) -> RgbaImage {
    let picture = picture(rig, Node::group(nodes), &unit_camera(SIDE), &plain());
    no_errors(rig);
    picture
}

#[test]
fn depth_is_cleared_in_the_part_only() {
    let Some(mut rig) = rig("depth_is_cleared_in_the_part_only") else { return };
    let rig = &mut *rig;
    // With and without a colour for the part.
    for (clear_color, beside) in [(None, RED), (Some([0.0, 1.0, 0.0, 1.0]), GREEN)] {
        let clears = CameraNode { viewport_px: Some(LEFT), clear_depth: true, clear_color, ..over(1) };
        // It is behind the red square and narrower, so it is visible only where depth is cleared.
        let behind = Node::geode(vec![quad([0.0, 0.0, -0.5], [0.3, 0.3], [0.0, 0.0, 1.0, 1.0])]);
        let picture =
            draw(rig, vec![square(0.0, RED), Node::camera(clears, vec![]), Node::camera(over(2), vec![behind])]);
        let at = |x| pixel(&picture, x, 32);
        assert_eq!([at(20), at(28), at(36), at(44)], [beside, BLUE, RED, RED], "{clear_color:?}");
    }
}

/// Regression: the depth of the first camera was discarded if nothing followed the image.
#[test]
fn pre_render_cameras_share_the_depth_of_their_target() {
    let Some(mut rig) = rig("pre_render_cameras_share_the_depth_of_their_target") else { return };
    let before = |order| CameraNode { order: RenderOrder::PreRender(order), ..over(0) };
    let first = CameraNode { clear_color: Some([0.0, 0.0, 1.0, 1.0]), clear_depth: true, ..before(0) };
    let behind = Node::geode(vec![quad([0.0, 0.0, -0.5], [0.9, 0.9], [0.0, 1.0, 0.0, 1.0])]);
    let keeps = Node::new(NodeKind::ClearNode(ClearNode { color: None }));
    let nodes = vec![keeps, Node::camera(first, vec![square(0.0, RED)]), Node::camera(before(1), vec![behind])];
    let picture = draw(&mut rig, nodes);
    assert_eq!([1, 8, 32].map(|x| pixel(&picture, x, 32)), [BLUE, GREEN, RED]);
}

#[test]
fn stencil_is_cleared_in_the_part_only() {
    let Some(mut rig) = rig("stencil_is_cleared_in_the_part_only") else { return };
    let rig = &mut *rig;
    if !rig.ctx.device().features().contains(wgpu::Features::DEPTH32FLOAT_STENCIL8) {
        skipped("the adapter has no stencil beside float depth");
        return;
    }
    let stencil = |function, pass| {
        let face = StencilFace { function, pass, ..StencilFace::default() };
        StateSet::default().with(Attribute::Stencil(Stencil::both(face, 1)))
    };
    let writes = square(0.0, RED).with_state_set(Arc::new(stencil(CompareFunction::Always, StencilOperation::Replace)));
    let where_written =
        square(0.5, BLUE).with_state_set(Arc::new(stencil(CompareFunction::Equal, StencilOperation::Keep)));
    let clears = CameraNode { viewport_px: Some(LEFT), clear_depth: true, ..over(1) };
    let picture = draw(rig, vec![writes, Node::camera(clears, vec![]), Node::camera(over(2), vec![where_written])]);
    let at = |x| pixel(&picture, x, 32);
    assert_eq!([at(20), at(28), at(36), at(44)], [RED, RED, BLUE, BLUE]);
}

#[test]
fn all_colours_are_cleared_in_the_part_with_their_alpha() {
    let Some(mut rig) = rig("all_colours_are_cleared_in_the_part_with_their_alpha") else { return };
    let rig = &mut *rig;
    let [a, b] = ["a", "b"].map(|name| TextureObject::target(name, [SIDE, SIDE], TextureFormat::Rgba8Srgb));
    let sink = Arc::new(PictureSink::default());
    let target = Arc::new(CameraTarget {
        colors: vec![Attachment::new(a), Attachment::new(b.clone())],
        samples: 1,
        read_back: Some(sink.clone()),
        ..CameraTarget::default()
    });
    let camera = |order, clear_color, viewport_px| CameraNode {
        order: RenderOrder::PreRender(order),
        target: Some(target.clone()),
        clear_color: Some(clear_color),
        clear_depth: true,
        viewport_px,
        ..over(0)
    };
    let shows = StateSet::default()
        .with_mode(Mode::Lighting, StateValue::OFF)
        .with(Attribute::Texture(0, TextureBinding::new(b)));
    let nodes = vec![
        Node::camera(camera(0, [0.0, 1.0, 0.0, 1.0], None), vec![]),
        Node::camera(camera(1, [0.0, 0.0, 1.0, 0.5], Some(LEFT)), vec![]),
        square(0.0, [255; 3]).with_state_set(Arc::new(shows)),
    ];
    let scene = rig.scene(Node::group(nodes));
    // The image of the second camera is read last.
    let (mut first, mut shown) = (None, None);
    for _ in 0..20 {
        shown = Some(rig.picture(&scene, &unit_camera(SIDE), &plain()));
        first = sink.take().or(first);
    }
    rig.release(scene);
    no_errors(rig);
    let (first, shown) = (first.unwrap(), shown.unwrap());
    let first = RgbaImage::from_raw(SIDE, SIDE, first.texels).unwrap();
    assert_eq!([first.get_pixel(10, 5).0, first.get_pixel(40, 5).0], [[0, 0, 255, 128], [0, 255, 0, 255]]);
    assert_eq!([pixel(&shown, 20, 32), pixel(&shown, 44, 32)], [BLUE, GREEN], "the second attachment");
}
