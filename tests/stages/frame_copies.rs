//! Textures that cameras write: copies of the frame, mip levels and slices of volumes; and when the initial
//! callback of a view's own camera is called.

use std::sync::{Arc, Mutex};

use crate::small_targets::{
    BLUE, GREEN, RED, SIDE, draw, no_errors, read, red, screen, square, target, to_texture, view,
};
use kit::frames::{MAGENTA, pixel};
use kit::rig::{plain, rig, unit_camera};
use kit::shapes::quad;
use terrane::draw::CameraCallbacks;
use terrane::scene::{Attachment, CameraNode, CameraTarget, Node, PictureSink, ReferenceFrame, RenderOrder};
use terrane::state::{Attribute, Program, StateSet, TextureBinding, TextureDimension, TextureFormat, TextureObject};

/// Returns a camera over the frame so far, drawn after it.
fn over(order: i32) -> CameraNode {
    let (view, projection) = view();
    CameraNode {
        frame: ReferenceFrame::Absolute,
        view,
        projection: Some(projection),
        clear_color: None,
        ..CameraNode::new(RenderOrder::PostRender(order))
    }
}

/// Returns a texture that takes size and format of what is copied.
fn copy() -> Arc<TextureObject> {
    TextureObject::target("copy", [1, 1], TextureFormat::Rgba8)
}

/// Returns a green square in the upper left corner.
fn corner() -> Node {
    Node::geode(vec![quad([-0.75, 0.75, 0.5], [0.2; 2], [0.0, 1.0, 0.0, 1.0])])
}

#[test]
fn the_frame_so_far_can_be_sampled() {
    let Some(mut rig) = rig("the_frame_so_far_can_be_sampled") else { return };
    let rig = &mut *rig;
    let frame = copy();
    let copying = CameraNode { copy_to: Some(frame.clone()), ..over(0) };
    let nodes = vec![red(), Node::camera(copying, vec![corner()]), Node::camera(over(1), vec![screen(&frame)])];
    let picture = draw(rig, nodes);
    // The copy covers the middle: the red square appears with half its size, with the background around it.
    assert_eq!([(32, 32), (26, 26), (18, 32)].map(|(x, y)| pixel(&picture, x, y)), [RED, RED, MAGENTA]);
    assert_eq!([(8, 8), (20, 20), (44, 44)].map(|(x, y)| pixel(&picture, x, y)), [GREEN, GREEN, MAGENTA]);
    // A part of the frame: the upper left quarter of the red square.
    let part = CameraNode { copy_to: Some(frame.clone()), viewport_px: Some([8, 8, 16, 16]), ..over(0) };
    let nodes = vec![red(), Node::camera(part, vec![]), Node::camera(over(1), vec![screen(&frame)])];
    let picture = draw(rig, nodes);
    assert_eq!([(20, 20), (28, 40), (40, 40)].map(|(x, y)| pixel(&picture, x, y)), [MAGENTA, MAGENTA, RED]);
    // Nothing of the frame.
    let outside = CameraNode { copy_to: Some(copy()), viewport_px: Some([SIDE, 0, 16, 16]), ..over(0) };
    assert_eq!(pixel(&draw(rig, vec![red(), Node::camera(outside, vec![])]), 32, 32), RED);
    no_errors(rig);
}

#[test]
fn targets_can_be_copied_before_they_change() {
    let Some(mut rig) = rig("targets_can_be_copied_before_they_change") else { return };
    let rig = &mut *rig;
    let (a, kept) = (target("a"), copy());
    let first = CameraNode { copy_to: Some(kept.clone()), ..to_texture(&a) };
    let second =
        CameraNode { clear_color: Some([0.0, 0.0, 1.0, 1.0]), order: RenderOrder::PreRender(1), ..to_texture(&a) };
    let nodes =
        |shown| vec![Node::camera(first.clone(), vec![red()]), Node::camera(second.clone(), vec![]), screen(shown)];
    assert_eq!(pixel(&draw(rig, nodes(&kept)), 32, 32), RED);
    assert_eq!(pixel(&draw(rig, nodes(&a)), 32, 32), BLUE);
    no_errors(rig);
}

/// Returns a square that shows what an expression samples of a texture.
fn sampled(texture: &Arc<TextureObject>, wgsl_type: &str, sample: &str) -> Node {
    let wgsl = format!(
        "@group(2) @binding(1) var whole: {wgsl_type};
         @group(2) @binding(2) var whole_sampler: sampler;
         @vertex fn vs_main(vertex: MeshVertex, @builtin(instance_index) i: u32) -> @builtin(position) vec4<f32> {{
             return frame.clip_from_eye * vec4<f32>(point_in_eye(leaves[i], vertex.position), 1.0);
         }}
         @fragment fn fs_main() -> @location(0) vec4<f32> {{ return {sample}; }}"
    );
    let set = StateSet::default()
        .with(Attribute::Program(Program::new("whole", &wgsl)))
        .with(Attribute::Texture(0, TextureBinding::new(texture.clone())));
    Node::geode(vec![square(0.0, [255; 3])]).with_state_set(Arc::new(set))
}

#[test]
fn levels_are_the_means_of_what_was_drawn() {
    let Some(mut rig) = rig("levels_are_the_means_of_what_was_drawn") else { return };
    let rig = &mut *rig;
    let onto = |texture: &Arc<TextureObject>, layer, samples| {
        let colors = vec![Attachment { layer, ..Attachment::new(texture.clone()) }.with_mipmaps()];
        let target = CameraTarget { colors, samples, ..CameraTarget::default() };
        CameraNode { target: Some(Arc::new(target)), ..to_texture(texture) }
    };
    for samples in [1, 4] {
        let texture = Arc::new(TextureObject { size: [8, 8, 1], levels: 4, ..(*target("levels")).clone() });
        let mut level = |level: u32| {
            let sample = format!("textureSampleLevel(whole, whole_sampler, vec2(0.5), {level}.0)");
            let nodes = vec![
                Node::camera(onto(&texture, 0, samples), vec![red()]),
                sampled(&texture, "texture_2d<f32>", &sample),
            ];
            pixel(&draw(rig, nodes), 32, 32)
        };
        assert_eq!(level(0), RED);
        // A quarter of the texture is red: 0.25 is 137 of 255 in sRGB.
        let [r, g, b] = level(3);
        assert!(r.abs_diff(137) <= 1 && [g, b] == [0; 2], "{r} {g} {b} with {samples} samples");
    }
    let size = [8, 8, 3];
    let layers = TextureObject { dimension: TextureDimension::D2Array, size, levels: 2, ..(*target("layers")).clone() };
    let layers = Arc::new(layers);
    let sample = "textureSampleLevel(whole, whole_sampler, vec2(0.5), 1, 1.0)";
    let nodes = vec![
        Node::camera(onto(&layers, 1, 1), vec![red()]),
        Node::camera(CameraNode { clear_color: Some([0.0, 1.0, 0.0, 1.0]), ..onto(&layers, 2, 1) }, vec![]),
        sampled(&layers, "texture_2d_array<f32>", sample),
    ];
    assert_eq!(pixel(&draw(rig, nodes), 32, 32), RED, "of the same layer");
    no_errors(rig);
}

#[test]
fn slices_of_volumes_can_be_drawn_to() {
    let Some(mut rig) = rig("slices_of_volumes_can_be_drawn_to") else { return };
    let rig = &mut *rig;
    let volume = Arc::new(TextureObject {
        dimension: TextureDimension::D3,
        size: [SIDE, SIDE, 4],
        ..(*target("volume")).clone()
    });
    let onto = |layer, samples, color: [f64; 3]| {
        let colors = vec![Attachment { layer, ..Attachment::new(volume.clone()) }];
        let target = CameraTarget { colors, samples, ..CameraTarget::default() };
        let [r, g, b] = color.map(|c| c as f32);
        CameraNode { target: Some(Arc::new(target)), clear_color: Some([r, g, b, 1.0]), ..to_texture(&volume) }
    };
    let nodes = [
        Node::camera(onto(0, 1, [1.0, 0.0, 0.0]), vec![]),
        Node::camera(onto(2, 1, [0.0, 1.0, 0.0]), vec![]),
        Node::camera(onto(3, 1, [0.0; 3]), vec![Node::geode(vec![square(0.0, BLUE)])]),
    ];
    let mut slice = |slice: u32| {
        let sample = format!("textureLoad(whole, vec3<u32>(32u, 32u, {slice}u), 0)");
        let shown = sampled(&volume, "texture_3d<f32>", &sample);
        pixel(&draw(rig, nodes.iter().cloned().chain([shown]).collect()), 32, 32)
    };
    // Slice 1 is not drawn to: its texels are whatever the memory had.
    assert_eq!([0, 2, 3].map(&mut slice), [RED, GREEN, BLUE]);
    no_errors(rig);
    let sink = Arc::new(PictureSink::default());
    let picture = read(rig, onto(3, 1, [0.0; 3]), vec![red()], &sink);
    assert_eq!(picture[(32 * SIDE + 32) as usize], [255, 0, 0, 255], "one slice is read back");
    draw(rig, vec![Node::camera(onto(1, 4, [1.0; 3]), vec![])]);
    let errors = rig.renderer.take_errors();
    assert!(matches!(&errors[..], [e] if e.contains("is a volume")), "{errors:?}");
}

#[test]
fn the_main_camera_is_initial_after_the_stages_before_it() {
    let Some(mut rig) = rig("the_main_camera_is_initial_after_the_stages_before_it") else { return };
    let rig = &mut *rig;
    let calls: Arc<Mutex<Vec<String>>> = Arc::default();
    let callbacks = |name: &'static str| {
        let (initial, last) = (calls.clone(), calls.clone());
        CameraCallbacks {
            initial: Some(Box::new(move |_, _| initial.lock().unwrap().push(format!("{name} initial")))),
            final_draw: Some(Box::new(move |_, _| last.lock().unwrap().push(format!("{name} final")))),
            ..CameraCallbacks::default()
        }
        .hook()
    };
    let a = target("a");
    let before = CameraNode { callbacks: Some(callbacks("before")), ..to_texture(&a) };
    let after = CameraNode { callbacks: Some(callbacks("after")), ..over(0) };
    let nodes = vec![Node::camera(before, vec![red()]), Node::camera(after, vec![corner()]), screen(&a)];
    let scene = rig.scene(Node::group(nodes));
    rig.visitor.callbacks = Some(callbacks("main"));
    rig.draw(&scene, &unit_camera(SIDE), &plain());
    rig.visitor.callbacks = None;
    rig.release(scene);
    let expected = ["before initial", "before final", "main initial", "after initial", "after final", "main final"];
    assert_eq!(*calls.lock().unwrap(), expected);
    no_errors(rig);
}
