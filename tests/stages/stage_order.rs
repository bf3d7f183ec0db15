//! The order of cameras in the scene graph, the part of the target that they draw to, and their callbacks.

use std::sync::{Arc, Mutex};

use crate::small_targets::{
    BLUE, GREEN, RED, SIDE, draw, drawn_until, no_errors, red, screen, square, target, to_texture, view,
};
use glam::dcamera::rh::proj::directx as proj;
use glam::{DAffine3, DVec4};
use kit::frames::{MAGENTA, count, pixel};
use kit::rig::{plain, rig, rig_with, traits, unit_camera};
use kit::shapes::quad;
use terrane::draw::CameraCallbacks;
use terrane::gpu::ContextTraits;
use terrane::scene::{AlphaMode, CameraNode, ClearNode, Node, NodeKind, PictureSink, ReferenceFrame, RenderOrder};
use terrane::state::{Mode, StateSet, StateValue, TextureObject};

#[test]
fn texture_of_a_camera_is_visible_in_the_same_frame() {
    let Some(mut rig) = rig("texture_of_a_camera_is_visible_in_the_same_frame") else { return };
    let rig = &mut *rig;
    let texture = target("mirror");
    let mut camera = to_texture(&texture);
    camera.clear_color = Some([0.0, 0.0, 1.0, 1.0]);
    // The camera comes after the node that shows its texture: the order of passes decides, not that of nodes.
    let picture = draw(rig, vec![screen(&texture), Node::camera(camera, vec![red()])]);
    // The square in the middle shows the texture: red in its middle half, blue around it.
    assert_eq!([(32, 32), (20, 32), (32, 45), (4, 4)].map(|(x, y)| pixel(&picture, x, y)), [RED, BLUE, BLUE, MAGENTA]);
    assert_eq!(count(&picture, RED), 16 * 16);
    no_errors(rig);
}

#[test]
fn textures_keep_their_image_until_their_owner_is_dropped() {
    let Some(mut rig) = rig("textures_keep_their_image_until_their_owner_is_dropped") else { return };
    let rig = &mut *rig;
    let texture = target("kept");
    draw(rig, vec![Node::camera(to_texture(&texture), vec![red()])]);
    let picture = draw(rig, vec![screen(&texture)]);
    assert_eq!(pixel(&picture, 32, 32), RED, "the image of the previous frame");
    // A camera without a clear draws over the old image.
    let mut over = to_texture(&texture);
    over.clear_color = None;
    let small = Node::geode(vec![quad([0.0; 3], [0.25; 2], [0.0, 1.0, 0.0, 1.0])]);
    let picture = draw(rig, vec![Node::camera(over, vec![small]), screen(&texture)]);
    assert_eq!((pixel(&picture, 32, 32), count(&picture, RED)), (GREEN, 16 * 16 - 8 * 8));
    let held = Arc::downgrade(&texture);
    drop(texture);
    for _ in 0..20 {
        draw(rig, vec![red()]);
    }
    assert!(held.upgrade().is_none());
    no_errors(rig);
}

#[test]
fn post_render_cameras_draw_over_the_image_in_order() {
    let Some(mut rig) = rig("post_render_cameras_draw_over_the_image_in_order") else { return };
    let rig = &mut *rig;
    let hud = |number, x: f32, color: [u8; 3]| {
        let (view, _) = view();
        let camera = CameraNode {
            frame: ReferenceFrame::Absolute,
            view,
            projection: Some(proj::orthographic(-1.0, 1.0, -1.0, 1.0, 100.0, 0.1)),
            clear_color: None,
            ..CameraNode::new(RenderOrder::PostRender(number))
        };
        let [r, g, b] = color.map(|c| f32::from(c) / 255.0);
        // The square lies far behind that of the scene and is drawn over it, because depth is cleared.
        Node::camera(camera, vec![Node::geode(vec![quad([x, 0.0, -50.0], [0.5, 0.25], [r, g, b, 1.0])])])
    };
    let picture = draw(rig, vec![hud(2, -0.25, BLUE), hud(1, 0.25, GREEN), red()]);
    let at = |x| pixel(&picture, x, 32);
    assert_eq!([at(10), at(32), at(44), at(54)], [BLUE, BLUE, GREEN, GREEN]);
    assert_eq!(pixel(&picture, 32, 20), RED, "above the overlays");
    // Without a clear of depth the far square is hidden.
    let (view, projection) = view();
    let camera = CameraNode {
        frame: ReferenceFrame::Absolute,
        view,
        projection: Some(projection),
        clear_color: None,
        clear_depth: false,
        ..CameraNode::new(RenderOrder::PostRender(0))
    };
    let picture = draw(rig, vec![Node::camera(camera, vec![Node::geode(vec![square(-1.0, GREEN)])]), red()]);
    assert_eq!(count(&picture, RED), 32 * 32);
    no_errors(rig);
}

#[test]
fn camera_without_a_target_draws_to_the_target_of_its_parent() {
    let Some(mut rig) = rig("camera_without_a_target_draws_to_the_target_of_its_parent") else { return };
    let rig = &mut *rig;
    let over = |viewport_px| {
        let (view, projection) = view();
        let node = CameraNode {
            frame: ReferenceFrame::Absolute,
            view,
            projection: Some(projection),
            clear_color: None,
            viewport_px,
            ..CameraNode::new(RenderOrder::PostRender(0))
        };
        let small = quad([0.0; 3], [0.25; 2], [0.0, 1.0, 0.0, 1.0]);
        Node::camera(node, vec![Node::geode(vec![small])])
    };
    let (texture, sink) = (target("below"), Arc::new(PictureSink::default()));
    let mut camera = to_texture(&texture);
    let mut into = camera.target.as_deref().unwrap().clone();
    into.read_back = Some(sink.clone());
    camera.target = Some(Arc::new(into));
    let scene = rig.scene(Node::group(vec![Node::camera(camera, vec![red(), over(None)]), screen(&texture)]));
    let read = drawn_until(rig, &scene, &sink);
    let is_green = |p: &&[u8]| p[..3] == GREEN;
    assert_eq!(
        read.chunks_exact(4).filter(is_green).count(),
        16 * 16,
        "the image that was read back includes the overlay"
    );
    let picture = rig.picture(&scene, &unit_camera(SIDE), &plain());
    rig.release(scene);
    assert_eq!(
        (count(&picture, GREEN), count(&picture, RED)),
        (8 * 8, 16 * 16 - 8 * 8),
        "the overlay is in the texture only"
    );
    // With a viewport, an overlay is drawn to that viewport as well, unless it has another one.
    let scene = rig.scene(Node::group(vec![red(), over(None)]));
    rig.visitor.viewport_px = Some([32, 0, 32, 32]);
    let picture = rig.picture(&scene, &unit_camera(SIDE), &plain());
    rig.release(scene);
    assert_eq!(
        (pixel(&picture, 48, 16), count(&picture, GREEN), count(&picture, RED)),
        (GREEN, 8 * 8, 16 * 16 - 8 * 8)
    );
    let scene = rig.scene(Node::group(vec![red(), over(Some([0, 32, 32, 32]))]));
    let picture = rig.picture(&scene, &unit_camera(SIDE), &plain());
    rig.visitor.viewport_px = None;
    rig.release(scene);
    assert_eq!((pixel(&picture, 16, 48), count(&picture, GREEN), count(&picture, RED)), (GREEN, 8 * 8, 16 * 16));
    no_errors(rig);
}

#[test]
fn stages_are_drawn_in_the_order_of_their_numbers() {
    let Some(mut rig) = rig("stages_are_drawn_in_the_order_of_their_numbers") else { return };
    let rig = &mut *rig;
    let (a, b) = (target("a"), target("b"));
    let to = |texture: &Arc<TextureObject>, number| CameraNode {
        order: RenderOrder::PreRender(number),
        ..to_texture(texture)
    };
    // The camera of b shows a, so it must be drawn later, although it comes first in the scene.
    let nodes = || vec![Node::camera(to(&b, 5), vec![screen(&a)]), Node::camera(to(&a, 1), vec![red()]), screen(&b)];
    let picture = draw(rig, nodes());
    assert_eq!((pixel(&picture, 32, 32), count(&picture, RED)), (RED, 8 * 8));
    // A camera inside another camera is drawn before it.
    let inner = Node::camera(to(&a, 9), vec![Node::geode(vec![square(0.0, GREEN)])]);
    let outer = Node::camera(to(&b, 0), vec![inner, screen(&a)]);
    let picture = draw(rig, vec![outer, screen(&b)]);
    assert_eq!((pixel(&picture, 32, 32), count(&picture, GREEN)), (GREEN, 8 * 8));
    no_errors(rig);
}

#[test]
fn clear_nodes_set_the_background() {
    let Some(mut rig) = rig("clear_nodes_set_the_background") else { return };
    let rig = &mut *rig;
    let clear = |color| Node::new(NodeKind::ClearNode(ClearNode { color }));
    let picture = draw(rig, vec![clear(Some([0.0, 0.0, 1.0, 1.0])), red()]);
    assert_eq!((count(&picture, BLUE), count(&picture, MAGENTA)), (3 * 32 * 32, 0));
    let small = Node::geode(vec![quad([0.0; 3], [0.25; 2], [0.0, 1.0, 0.0, 1.0])]);
    let picture = draw(rig, vec![clear(None), small]);
    assert_eq!(
        (count(&picture, BLUE), count(&picture, GREEN)),
        (3 * 32 * 32, 16 * 16),
        "drawn over the previous frame"
    );
}

#[test]
fn nested_cameras_draw_to_their_viewport() {
    let Some(mut rig) = rig("nested_cameras_draw_to_their_viewport") else { return };
    let rig = &mut *rig;
    let (view, projection) = view();
    let nested = CameraNode {
        frame: ReferenceFrame::Absolute,
        view,
        projection: Some(projection),
        viewport_px: Some([0, 32, 32, 32]),
        ..CameraNode::new(RenderOrder::Nested)
    };
    let green = Node::geode(vec![square(0.5, GREEN)]);
    let picture = draw(rig, vec![Node::camera(nested, vec![green]), red()]);
    assert_eq!([(16, 48), (32, 32), (2, 34), (40, 40)].map(|(x, y)| pixel(&picture, x, y)), [GREEN, RED, MAGENTA, RED]);
    // A projection for some nodes of the same image: with half the angle, they appear twice as large.
    let mut wide = Node::new(NodeKind::Projection(proj::perspective_infinite_reverse(2.0 * (0.2f64).atan(), 1.0, 0.1)));
    wide.children = vec![Node::geode(vec![square(0.5, GREEN)])];
    let picture = draw(rig, vec![wide, red()]);
    assert!(count(&picture, GREEN).abs_diff(17 * 17) <= 60, "{}", count(&picture, GREEN));
    no_errors(rig);
}

#[test]
fn callbacks_are_called_before_and_after_each_stage() {
    let Some(mut rig) = rig("callbacks_are_called_before_and_after_each_stage") else { return };
    let rig = &mut *rig;
    let calls: Arc<Mutex<Vec<String>>> = Arc::default();
    let callbacks = |name: &'static str| {
        let log = |moment: &'static str| {
            let calls = calls.clone();
            move |leaves: usize| calls.lock().unwrap().push(format!("{name} {moment} {leaves}"))
        };
        let (initial, pre, post, last) = (log("initial"), log("pre"), log("post"), log("final"));
        CameraCallbacks {
            initial: Some(Box::new(move |info, _| initial(info.stage.leaf_count()))),
            pre_draw: Some(Box::new(move |info, pass| {
                // Callbacks need not restore the state of the pass.
                pass.set_viewport(0.0, 0.0, 1.0, 1.0, 0.0, 0.1);
                pass.set_scissor_rect(0, 0, 1, 1);
                pre(info.stage.leaf_count());
            })),
            post_draw: Some(Box::new(move |info, _| post(info.stage.leaf_count()))),
            final_draw: Some(Box::new(move |info, _| last(info.stage.leaf_count()))),
            ..CameraCallbacks::default()
        }
        .hook()
    };
    let (a, b) = (target("a"), target("b"));
    let inner = CameraNode { callbacks: Some(callbacks("inner")), ..to_texture(&a) };
    let outer = CameraNode { callbacks: Some(callbacks("outer")), ..to_texture(&b) };
    let both = Node::group(vec![red(), red()]);
    let outer = Node::camera(outer, vec![Node::camera(inner, vec![red()]), both, screen(&a)]);
    let picture = draw(rig, vec![outer, screen(&b)]);
    assert_eq!(pixel(&picture, 32, 32), RED);
    let expected = [
        "outer initial 3",
        "inner initial 1",
        "inner pre 1",
        "inner post 1",
        "inner final 1",
        "outer pre 3",
        "outer post 3",
        "outer final 3",
    ];
    assert_eq!(*calls.lock().unwrap(), expected);
    no_errors(rig);
}

#[test]
fn contexts_can_have_several_samples() {
    let Some(mut rig) = rig_with(&ContextTraits { samples: 4, ..traits([64, 64]) }) else { return };
    let slanted = Node::transform(DAffine3::from_rotation_z(0.3), vec![Node::geode(vec![square(0.0, [255; 3])])]);
    let (view, projection) = view();
    let hud = CameraNode {
        frame: ReferenceFrame::Absolute,
        view,
        projection: Some(projection),
        clear_color: None,
        ..CameraNode::new(RenderOrder::PostRender(0))
    };
    let small = Node::geode(vec![quad([0.0; 3], [0.25; 2], [0.0, 1.0, 0.0, 1.0])]);
    // Alpha 0.5 covers half of the samples, so half of the background is visible.
    let half = Arc::new(StateSet::default().with_mode(Mode::AlphaToCoverage, StateValue::ON));
    let covered =
        Node::geode(vec![quad([0.0, -0.8, 0.0], [0.1; 2], [0.0, 1.0, 0.0, 0.5])]).with_state_set(half.clone());
    let mut masked = quad([0.8, 0.0, 0.0], [0.1; 2], [0.0, 1.0, 0.0, 0.5]);
    masked.material.alpha = AlphaMode::Mask(0.25);
    let masked = Node::geode(vec![masked]).with_state_set(half.clone());
    let picture = draw(&mut rig, vec![slanted, Node::camera(hud, vec![small]), covered, masked]);
    let is_mixed = |p: &&image::Rgba<u8>| p.0[1] != 0 && p.0[1] != 255;
    assert!(picture.pixels().filter(is_mixed).count() > 60, "smooth edges");
    assert_eq!(pixel(&picture, 32, 32), GREEN, "drawn over the resolved image");
    for [x, y] in [[32, 57], [57, 32]] {
        let [r, g, b] = pixel(&picture, x, y);
        assert!((170..210).contains(&g) && r == b && (170..210).contains(&r), "{r} {g} {b}");
    }
    let errors = rig.renderer.take_errors();
    assert!(errors.is_empty(), "{errors:?}");
}

/// Regression: projections beyond the 63rd were replaced by that of the stage.
#[test]
fn many_projections_stay_separate() {
    let Some(mut rig) = rig("many_projections_stay_separate") else { return };
    let rig = &mut *rig;
    // Each projection maps its square of 2 m to another cell of 4 x 4 pixels.
    let cell = |i: u32, child: Node| {
        let at = |index: u32| (f64::from(index) + 0.5) / 8.0 - 1.0;
        let projection = glam::DMat4 {
            x_axis: DVec4::X / 16.0,
            y_axis: DVec4::Y / 16.0,
            z_axis: DVec4::Z / 20.0,
            w_axis: DVec4::new(at(i % 16), at(i / 16), 1.0, 1.0),
        };
        Node::new(NodeKind::Projection(projection)).with_child(child)
    };
    let full = |[r, g, b]: [u8; 3]| quad([0.0; 3], [1.0; 2], [r, g, b, 255].map(|c| f32::from(c) / 255.0));
    let colors = [RED, GREEN, BLUE];
    let nodes: Vec<Node> = (0..150u32).map(|i| cell(i, Node::geode(vec![full(colors[i as usize % 3])]))).collect();
    for _ in 0..2 {
        let picture = draw(rig, nodes.clone());
        assert_eq!(colors.map(|c| count(&picture, c)), [50 * 16; 3]);
    }
    // The next frame has fewer projections.
    assert_eq!(count(&draw(rig, nodes[..100].to_vec()), MAGENTA), (256 - 100) * 16);
    no_errors(rig);
}
