//! Cameras in the graph: into textures and over the view, in their order; targets of every kind;
//! callbacks.

use std::sync::{Arc, Mutex};

use glam::dcamera::rh::proj::directx as proj;
use glam::{DAffine3, DVec4};
use image::RgbaImage;
use kit::frames::{MAGENTA, count, pixel};
use kit::rig::{Rig, plain, rig, unit_camera};
use kit::shapes::quad;
use kit::skip::or_skip;
use terrane::cull::CullCamera;
use terrane::draw::{CameraCallbacks, Renderer};
use terrane::gpu::{AdapterChoice, ContextTraits, GraphicsContext};
use terrane::scene::{
    AlphaMode, Attachment, CameraNode, CameraTarget, ClearNode, Drawable, Node, NodeKind, PictureSink, ReferenceFrame,
    RenderOrder, Scene,
};
use terrane::state::{
    Attribute, BlendFactor, BlendFunc, CompareFunction, Mode, Program, Sampler, StateSet, StateValue, TextureBinding,
    TextureDimension, TextureFormat, TextureObject,
};

const SIDE: u32 = 64;
const RED: [u8; 3] = [255, 0, 0];
const GREEN: [u8; 3] = [0, 255, 0];
const BLUE: [u8; 3] = [0, 0, 255];
const BLACK: [u8; 3] = [0, 0, 0];

fn square(z: f32, color: [u8; 3]) -> Drawable {
    let [r, g, b] = color.map(|c| f32::from(c) / 255.0);
    quad([0.0, 0.0, z], [0.5, 0.5], [r, g, b, 1.0])
}

fn red() -> Node {
    Node::geode(vec![square(0.0, RED)])
}

/// Looks at -1 to 1 from z = 10, as the tests' own camera does.
fn view() -> (DAffine3, glam::DMat4) {
    let camera = unit_camera(SIDE);
    (camera.eye_from_world, camera.clip_from_eye)
}

fn to_texture(texture: &Arc<TextureObject>) -> CameraNode {
    let (view, projection) = view();
    CameraNode::to_texture(texture.clone(), view, projection)
}

fn target(name: &str) -> Arc<TextureObject> {
    TextureObject::target(name, [SIDE, SIDE], TextureFormat::Rgba8Srgb)
}

/// A square that shows a texture.
fn screen(texture: &Arc<TextureObject>) -> Node {
    let set = StateSet::default()
        .with_mode(Mode::Lighting, StateValue::OFF)
        .with(Attribute::Texture(0, TextureBinding::new(texture.clone())));
    Node::geode(vec![square(0.0, [255; 3])]).with_state_set(Arc::new(set))
}

fn draw(rig: &mut Rig, nodes: Vec<Node>) -> RgbaImage {
    let scene = rig.scene(Node::group(nodes));
    let picture = rig.picture(&scene, &unit_camera(SIDE), &plain());
    rig.release(scene);
    picture
}

fn no_errors(rig: &mut Rig) {
    let errors = rig.renderer.take_errors();
    assert!(errors.is_empty(), "{errors:?}");
}

#[test]
fn a_camera_draws_into_a_texture_that_is_seen_in_the_same_frame() {
    let Some(mut rig) = rig("a_camera_draws_into_a_texture_that_is_seen_in_the_same_frame") else { return };
    let rig = &mut *rig;
    let texture = target("mirror");
    let mut camera = to_texture(&texture);
    camera.clear_color = Some([0.0, 0.0, 1.0, 1.0]);
    // The camera hangs behind what shows it: the order of passes decides, not that of nodes.
    let picture = draw(rig, vec![screen(&texture), Node::camera(camera, vec![red()])]);
    // An image of half the size in the middle: red in its middle half, blue around.
    assert_eq!([(32, 32), (20, 32), (32, 45), (4, 4)].map(|(x, y)| pixel(&picture, x, y)), [RED, BLUE, BLUE, MAGENTA]);
    assert_eq!(count(&picture, RED), 16 * 16);
    no_errors(rig);
}

#[test]
fn textures_keep_their_image_and_are_freed_with_their_owner() {
    let Some(mut rig) = rig("textures_keep_their_image_and_are_freed_with_their_owner") else { return };
    let rig = &mut *rig;
    let texture = target("kept");
    draw(rig, vec![Node::camera(to_texture(&texture), vec![red()])]);
    let picture = draw(rig, vec![screen(&texture)]);
    assert_eq!(pixel(&picture, 32, 32), RED, "from the frame before");
    // Drawn over without a clear.
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
fn cameras_after_draw_over_the_picture_in_their_order() {
    let Some(mut rig) = rig("cameras_after_draw_over_the_picture_in_their_order") else { return };
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
        // Far behind the scene's square, and yet over it: depth is cleared.
        Node::camera(camera, vec![Node::geode(vec![quad([x, 0.0, -50.0], [0.5, 0.25], [r, g, b, 1.0])])])
    };
    let picture = draw(rig, vec![hud(2, -0.25, BLUE), hud(1, 0.25, GREEN), red()]);
    let at = |x| pixel(&picture, x, 32);
    assert_eq!([at(10), at(32), at(44), at(54)], [BLUE, BLUE, GREEN, GREEN]);
    assert_eq!(pixel(&picture, 32, 20), RED, "above them");
    // Without a clear of depth the far one is hidden.
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
fn without_a_target_a_camera_draws_where_the_one_around_it_does() {
    let Some(mut rig) = rig("without_a_target_a_camera_draws_where_the_one_around_it_does") else { return };
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
    assert_eq!(read.chunks_exact(4).filter(is_green).count(), 16 * 16, "what was read back is the whole picture");
    let picture = rig.picture(&scene, &unit_camera(SIDE), &plain());
    rig.release(scene);
    assert_eq!((count(&picture, GREEN), count(&picture, RED)), (8 * 8, 16 * 16 - 8 * 8), "in the texture alone");
    // In a part of the window, what is drawn over the image is in that part too, unless it says another.
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
fn stages_come_in_the_order_of_their_numbers() {
    let Some(mut rig) = rig("stages_come_in_the_order_of_their_numbers") else { return };
    let rig = &mut *rig;
    let (a, b) = (target("a"), target("b"));
    let to = |texture: &Arc<TextureObject>, number| CameraNode {
        order: RenderOrder::PreRender(number),
        ..to_texture(texture)
    };
    // b shows a: it must come after it, though it is met before.
    let nodes = || vec![Node::camera(to(&b, 5), vec![screen(&a)]), Node::camera(to(&a, 1), vec![red()]), screen(&b)];
    let picture = draw(rig, nodes());
    assert_eq!((pixel(&picture, 32, 32), count(&picture, RED)), (RED, 8 * 8));
    // A camera inside a camera comes before it.
    let inner = Node::camera(to(&a, 9), vec![Node::geode(vec![square(0.0, GREEN)])]);
    let outer = Node::camera(to(&b, 0), vec![inner, screen(&a)]);
    let picture = draw(rig, vec![outer, screen(&b)]);
    assert_eq!((pixel(&picture, 32, 32), count(&picture, GREEN)), (GREEN, 8 * 8));
    no_errors(rig);
}

#[test]
fn layers_faces_and_levels_are_targets() {
    let Some(mut rig) = rig("layers_faces_and_levels_are_targets") else { return };
    let rig = &mut *rig;
    let object = |dimension, size: [u32; 3], levels| {
        Arc::new(TextureObject { dimension, size, levels, ..(*target("parts")).clone() })
    };
    let onto = |texture: &Arc<TextureObject>, level, layer, color: [u8; 3]| {
        let colors = vec![Attachment { texture: texture.clone(), level, layer }];
        let target = CameraTarget { colors, samples: 1, ..CameraTarget::default() };
        let [r, g, b] = color.map(|c| f32::from(c) / 255.0);
        let camera = CameraNode {
            target: Some(Arc::new(target)),
            clear_color: Some([r, g, b, 1.0]),
            ..CameraNode::new(RenderOrder::PreRender(0))
        };
        Node::camera(camera, vec![])
    };
    let show = |texture: &Arc<TextureObject>, wgsl_type: &str, sample: &str| {
        let wgsl = format!(
            "@group(2) @binding(1) var parts: {wgsl_type};
             @group(2) @binding(2) var parts_sampler: sampler;
             struct Out {{ @builtin(position) position: vec4<f32> }}
             @vertex fn vs_main(vertex: MeshVertex, @builtin(instance_index) i: u32) -> Out {{
                 return Out(frame.clip_from_eye * vec4<f32>(point_in_eye(leaves[i], vertex.position), 1.0));
             }}
             @fragment fn fs_main() -> @location(0) vec4<f32> {{ return {sample}; }}"
        );
        let set = StateSet::default()
            .with(Attribute::Program(Program::new("parts", &wgsl)))
            .with(Attribute::Texture(0, TextureBinding::new(texture.clone())));
        Node::geode(vec![square(0.0, [255; 3])]).with_state_set(Arc::new(set))
    };
    let layers = object(TextureDimension::D2Array, [8, 8, 3], 1);
    let nodes = vec![
        onto(&layers, 0, 0, RED),
        onto(&layers, 0, 2, GREEN),
        onto(&layers, 0, 1, BLUE),
        show(&layers, "texture_2d_array<f32>", "textureSampleLevel(parts, parts_sampler, vec2(0.5), 2, 0.0)"),
    ];
    assert_eq!(pixel(&draw(rig, nodes), 32, 32), GREEN);
    let cube = object(TextureDimension::Cube, [8, 8, 6], 1);
    let mut nodes: Vec<Node> = (0..6).map(|face| onto(&cube, 0, face, if face == 3 { GREEN } else { RED })).collect();
    nodes.push(show(&cube, "texture_cube<f32>", "textureSampleLevel(parts, parts_sampler, vec3(0.0, -1.0, 0.0), 0.0)"));
    assert_eq!(pixel(&draw(rig, nodes), 32, 32), GREEN, "-y is the fourth face");
    let levels = object(TextureDimension::D2, [8, 8, 1], 4);
    let nodes = vec![
        onto(&levels, 0, 0, RED),
        onto(&levels, 1, 0, BLUE),
        onto(&levels, 2, 0, GREEN),
        onto(&levels, 3, 0, RED),
        show(&levels, "texture_2d<f32>", "textureSampleLevel(parts, parts_sampler, vec2(0.5), 2.0)"),
    ];
    assert_eq!(pixel(&draw(rig, nodes), 32, 32), GREEN);
    no_errors(rig);
}

#[test]
fn programs_write_several_attachments_and_read_depth() {
    let Some(mut rig) = rig("programs_write_several_attachments_and_read_depth") else { return };
    let rig = &mut *rig;
    let (first, second) = (target("first"), TextureObject::target("second", [SIDE; 2], TextureFormat::Rgba16Float));
    let depth = TextureObject::target("depth", [SIDE; 2], TextureFormat::Depth32);
    let colors = vec![Attachment::new(first.clone()), Attachment::new(second.clone())];
    let of = CameraTarget { colors, depth: Some(Attachment::new(depth.clone())), ..CameraTarget::default() };
    let (eye_from_world, projection) = view();
    let camera =
        CameraNode { target: Some(Arc::new(of)), ..CameraNode::to_texture(first.clone(), eye_from_world, projection) };
    let vertex = "struct V { @builtin(position) position: vec4<f32>, @location(0) uv: vec2<f32> }
        @vertex fn vs_main(vertex: MeshVertex, @builtin(instance_index) i: u32) -> V {
            return V(frame.clip_from_eye * vec4<f32>(point_in_eye(leaves[i], vertex.position), 1.0), vertex.uv);
        }";
    let both = Program::new(
        "both",
        &format!(
            "{vertex}
            struct Out {{ @location(0) a: vec4<f32>, @location(1) b: vec4<f32> }}
            @fragment fn fs_main(in: V) -> Out {{ return Out(vec4(1.0, 0.0, 0.0, 1.0), vec4(0.0, 0.0, 1.0, 1.0)); }}"
        ),
    );
    let source = StateSet::default().with(Attribute::Program(both));
    let drawn = Node::geode(vec![square(0.0, GREEN)]).with_state_set(Arc::new(source));
    let root = || Node::camera(camera.clone(), vec![drawn.clone()]);
    let picture = draw(rig, vec![root(), screen(&first)]);
    assert_eq!((pixel(&picture, 32, 32), pixel(&picture, 20, 20)), (RED, BLACK));
    assert_eq!(pixel(&draw(rig, vec![root(), screen(&second)]), 32, 32), BLUE);
    // The depth of the square at 10 m with a near plane of 0.1 m, reversed: 0.01; compared with 0.005.
    let compare = Program::new(
        "compare",
        &format!(
            "@group(2) @binding(3) var shadow: texture_depth_2d;
            @group(2) @binding(4) var shadow_sampler: sampler_comparison;
            {vertex}
            @fragment fn fs_main(in: V) -> @location(0) vec4<f32> {{
                return vec4<f32>(0.0, textureSampleCompareLevel(shadow, shadow_sampler, in.uv, 0.005), 0.0, 1.0);
            }}"
        ),
    );
    let sampler = Sampler { compare: Some(CompareFunction::Less), ..Sampler::default() };
    let set = StateSet::default()
        .with(Attribute::Program(compare))
        .with(Attribute::Texture(1, TextureBinding { texture: depth, sampler }));
    let shown = Node::geode(vec![square(0.0, [255; 3])]).with_state_set(Arc::new(set));
    let picture = draw(rig, vec![root(), shown]);
    assert_eq!((pixel(&picture, 32, 32), pixel(&picture, 20, 20)), (GREEN, BLACK));
    no_errors(rig);
}

#[test]
fn several_samples_smooth_edges() {
    let Some(mut rig) = rig("several_samples_smooth_edges") else { return };
    let rig = &mut *rig;
    let slanted = || Node::transform(DAffine3::from_rotation_z(0.3), vec![Node::geode(vec![square(0.0, [255; 3])])]);
    let mut shades = |samples| {
        let texture = target("smooth");
        let mut camera = to_texture(&texture);
        let colors = vec![Attachment::new(texture.clone())];
        camera.target = Some(Arc::new(CameraTarget { colors, samples, ..CameraTarget::default() }));
        let sink = Arc::new(PictureSink::default());
        let picture = read(rig, camera, vec![slanted()], &sink);
        let grey = picture.iter().filter(|p| p[0] != 0 && p[0] != 255).count();
        no_errors(rig);
        grey
    };
    assert_eq!(shades(1), 0);
    assert!(shades(4) > 60);
}

/// A camera's image is read back without waiting.
fn read(rig: &mut Rig, mut camera: CameraNode, children: Vec<Node>, sink: &Arc<PictureSink>) -> Vec<[u8; 4]> {
    let before = camera.target.as_deref().unwrap().clone();
    camera.target = Some(Arc::new(CameraTarget { read_back: Some(sink.clone()), ..before }));
    let scene = rig.scene(Node::camera(camera, children));
    let picture = drawn_until(rig, &scene, sink);
    rig.release(scene);
    picture.chunks_exact(4).map(|p| [p[0], p[1], p[2], p[3]]).collect()
}

fn drawn_until(rig: &mut Rig, scene: &Scene, sink: &Arc<PictureSink>) -> Vec<u8> {
    for frame in 1..200 {
        let camera = CullCamera { frame, ..unit_camera(SIDE) };
        rig.draw(scene, &camera, &plain());
        if let Some(picture) = sink.take() {
            assert!(picture.frame >= 1 && picture.frame <= frame);
            assert_eq!(picture.size_px, [SIDE, SIDE]);
            return picture.texels;
        }
    }
    panic!("no picture came");
}

#[test]
fn pictures_come_back_without_waiting() {
    let Some(mut rig) = rig("pictures_come_back_without_waiting") else { return };
    let rig = &mut *rig;
    let sink = Arc::new(PictureSink::default());
    let mut camera = to_texture(&target("read"));
    camera.clear_color = Some([0.0, 0.0, 1.0, 0.5]);
    let pixels = read(rig, camera, vec![red()], &sink);
    assert_eq!(pixels.len(), (SIDE * SIDE) as usize);
    assert_eq!(pixels.iter().filter(|p| **p == [255, 0, 0, 255]).count(), 32 * 32);
    assert_eq!(pixels[0], [0, 0, 255, 128], "textures keep alpha");
    no_errors(rig);
}

#[test]
fn pictures_of_several_attachments_and_of_numbers_come_back() {
    let Some(mut rig) = rig("pictures_of_several_attachments_and_of_numbers_come_back") else { return };
    let rig = &mut *rig;
    // Rows that do not fill what copies are aligned to.
    let size = [40, 24];
    let formats = [TextureFormat::Rgba8, TextureFormat::Rgba16Float, TextureFormat::R32Float];
    let colors = formats.map(|format| Attachment::new(TextureObject::target("part", size, format)));
    let sinks = formats.map(|_| Arc::new(PictureSink::default()));
    let [first, second, third] = &sinks;
    // The third twice, and one that is not there.
    let (again, missing) = (Arc::new(PictureSink::default()), Arc::new(PictureSink::default()));
    let target = CameraTarget {
        colors: colors.to_vec(),
        read_back: Some(first.clone()),
        read_back_of: vec![(2, third.clone()), (1, second.clone()), (2, again.clone()), (3, missing.clone())],
        ..CameraTarget::default()
    };
    let program = Program::new(
        "numbers",
        "struct Out { @location(0) a: vec4<f32>, @location(1) b: vec4<f32>, @location(2) c: f32 }
        @vertex fn vs_main(vertex: MeshVertex, @builtin(instance_index) i: u32) -> @builtin(position) vec4<f32> {
            return frame.clip_from_eye * vec4<f32>(point_in_eye(leaves[i], vertex.position), 1.0);
        }
        @fragment fn fs_main(@builtin(position) at: vec4<f32>) -> Out {
            return Out(vec4(1.0, 0.0, 0.0, 1.0), vec4(0.5, -2.0, 1024.0, 1.0), floor(at.x) + 1000.0 * floor(at.y));
        }",
    );
    let set = StateSet::default().with(Attribute::Program(program));
    let drawn = Node::geode(vec![quad([0.0; 3], [2.0; 2], [1.0; 4])]).with_state_set(Arc::new(set));
    let (view, projection) = view();
    let camera = CameraNode {
        target: Some(Arc::new(target)),
        ..CameraNode::to_texture(colors[0].texture.clone(), view, projection)
    };
    let scene = rig.scene(Node::camera(camera, vec![drawn]));
    let mut came = [const { None }; 4];
    for frame in 1..50 {
        rig.draw(&scene, &CullCamera { frame, ..unit_camera(SIDE) }, &plain());
        for (came, sink) in came.iter_mut().zip([first, second, third, &again]) {
            *came = sink.take().or(came.take());
        }
    }
    rig.release(scene);
    let [first, second, third, again] = came.map(|picture| picture.expect("a picture"));
    for (picture, format) in [(&first, formats[0]), (&second, formats[1]), (&third, formats[2]), (&again, formats[2])] {
        assert_eq!((picture.size_px, picture.format), (size, format));
        assert_eq!(picture.texels.len(), (size[0] * size[1]) as usize * format.texel_bytes());
    }
    assert!(first.texels.chunks_exact(4).all(|p| p == [255, 0, 0, 255]));
    // 0.5, -2, 1024 and 1 in halves.
    let halves = [0x3800u16, 0xc000, 0x6400, 0x3c00].map(u16::to_le_bytes).concat();
    assert!(second.texels.chunks_exact(8).all(|p| p == halves));
    let numbers: Vec<f32> = third.texels.chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect();
    let expected: Vec<f32> = (0..size[1]).flat_map(|y| (0..size[0]).map(move |x| (x + 1000 * y) as f32)).collect();
    assert_eq!(numbers, expected);
    assert!(missing.take().is_none());
    let errors = rig.renderer.take_errors();
    assert!(matches!(&errors[..], [e] if e.contains("colour 3")), "{errors:?}");
}

#[test]
fn alpha_is_weighed_apart_from_colour() {
    use BlendFactor::{DstAlpha, One, OneMinusSrcAlpha, SrcAlpha, Zero};
    let Some(mut rig) = rig("alpha_is_weighed_apart_from_colour") else { return };
    let rig = &mut *rig;
    let mut drawn = |func: BlendFunc| {
        let sink = Arc::new(PictureSink::default());
        let mut camera = to_texture(&target("alpha"));
        camera.clear_color = Some([0.0, 0.0, 1.0, 0.5]);
        let mut glass = square(0.0, RED);
        glass.material.base_color[3] = 0.25;
        let set = StateSet::default().with(Attribute::BlendFunc(func)).with_mode(Mode::Blend, StateValue::ON);
        let glass = Node::geode(vec![glass]).with_state_set(Arc::new(set));
        let pixels = read(rig, camera, vec![glass], &sink);
        no_errors(rig);
        pixels[(SIDE * SIDE / 2 + SIDE / 2) as usize]
    };
    // Both have what they weigh: 0.25 drawn over 0.5.
    let cases = [
        (BlendFunc::new(SrcAlpha, OneMinusSrcAlpha), 0.25 * 0.25 + 0.5 * 0.75),
        (BlendFunc::ALPHA.with_alpha(One, OneMinusSrcAlpha), 0.25 + 0.5 * 0.75),
        (BlendFunc::ALPHA.with_alpha(Zero, One), 0.5),
        (BlendFunc::ALPHA.with_alpha(DstAlpha, Zero), 0.25 * 0.5),
    ];
    let pixels = cases.map(|(func, _)| drawn(func));
    for ((func, wanted), pixel) in cases.into_iter().zip(pixels) {
        assert!((f64::from(pixel[3]) - 255.0 * wanted).abs() < 1.5, "{func:?}: {pixel:?}");
    }
    let colors = pixels.map(|[r, g, b, _]| [r, g, b]);
    assert!(colors.iter().all(|c| *c == colors[0]), "colour does not change: {colors:?}");
}

#[test]
fn wrong_targets_are_one_error_and_the_rest_is_drawn() {
    let Some(mut rig) = rig("wrong_targets_are_one_error_and_the_rest_is_drawn") else { return };
    let rig = &mut *rig;
    let depth = TextureObject::target("depths", [SIDE; 2], TextureFormat::Depth32);
    let image = TextureObject::image("image", [1, 1], vec![255; 4]);
    let small = TextureObject::target("small", [8; 2], TextureFormat::Rgba8Srgb);
    let attached = |colors: &[&Arc<TextureObject>], depth: Option<&Arc<TextureObject>>| CameraTarget {
        colors: colors.iter().map(|t| Attachment::new((*t).clone())).collect(),
        depth: depth.map(|t| Attachment::new(t.clone())),
        samples: 1,
        ..CameraTarget::default()
    };
    let fine = target("fine");
    let missing = CameraTarget {
        colors: vec![Attachment { texture: fine.clone(), level: 3, layer: 0 }],
        samples: 1,
        ..CameraTarget::default()
    };
    let numbers = TextureObject::target("numbers", [SIDE; 2], TextureFormat::R32Float);
    let mut huge = (*target("huge")).clone();
    huge.size = [1 << 20, 4, 1];
    for (target, says) in [
        (attached(&[&depth], None), "\"depths\" holds depth"),
        (attached(&[&image], None), "\"image\" has contents"),
        (attached(&[&fine, &small], None), "\"small\" has another size"),
        (attached(&[&fine], Some(&fine)), "\"fine\" holds colour"),
        (attached(&[&fine, &fine], None), "\"fine\" is attached twice: level 0 of layer 0"),
        (attached(&[&Arc::new(huge)], None), "\"huge\""),
        (missing, "\"fine\" has no level 3"),
        (CameraTarget { samples: 4, ..attached(&[&numbers], None) }, "\"numbers\" holds 32-bit floats"),
    ] {
        let camera = CameraNode { target: Some(Arc::new(target)), ..CameraNode::new(RenderOrder::PreRender(0)) };
        let scene = rig.scene(Node::group(vec![Node::camera(camera, vec![red()]), red()]));
        for frame in 0..3 {
            let picture = rig.picture(&scene, &unit_camera(SIDE), &plain());
            assert_eq!(count(&picture, RED), 32 * 32);
            let errors = rig.renderer.take_errors();
            assert_eq!(errors.len(), usize::from(frame == 0), "{errors:?}");
            assert!(errors.iter().all(|e| e.contains(says)), "{errors:?} instead of {says}");
        }
        rig.release(scene);
    }
    // A stage that reads what it draws into.
    let camera = to_texture(&fine);
    let picture = draw(rig, vec![Node::camera(camera, vec![screen(&fine)]), red()]);
    assert_eq!(count(&picture, RED), 32 * 32);
    let errors = rig.renderer.take_errors();
    assert!(matches!(&errors[..], [e] if e.contains("read while it is drawn into")), "{errors:?}");
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
    assert_eq!((count(&picture, BLUE), count(&picture, GREEN)), (3 * 32 * 32, 16 * 16), "over the frame before");
}

#[test]
fn nested_cameras_draw_into_their_part() {
    let Some(mut rig) = rig("nested_cameras_draw_into_their_part") else { return };
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
    // Another projection for some nodes of the same image: half as wide an angle, twice as large.
    let mut wide = Node::new(NodeKind::Projection(proj::perspective_infinite_reverse(2.0 * (0.2f64).atan(), 1.0, 0.1)));
    wide.children = vec![Node::geode(vec![square(0.5, GREEN)])];
    let picture = draw(rig, vec![wide, red()]);
    assert!(count(&picture, GREEN).abs_diff(17 * 17) <= 60, "{}", count(&picture, GREEN));
    no_errors(rig);
}

#[test]
fn callbacks_come_at_their_moments() {
    let Some(mut rig) = rig("callbacks_come_at_their_moments") else { return };
    let rig = &mut *rig;
    let said: Arc<Mutex<Vec<String>>> = Arc::default();
    let callbacks = |name: &'static str| {
        let log = |moment: &'static str| {
            let said = said.clone();
            move |leaves: usize| said.lock().unwrap().push(format!("{name} {moment} {leaves}"))
        };
        let (initial, pre, post, last) = (log("initial"), log("pre"), log("post"), log("final"));
        CameraCallbacks {
            initial: Some(Box::new(move |info, _| initial(info.stage.leaf_count()))),
            pre_draw: Some(Box::new(move |info, pass| {
                // May leave the pass's state as it likes.
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
    assert_eq!(*said.lock().unwrap(), expected);
    no_errors(rig);
}

#[test]
fn a_context_has_several_samples() {
    let traits =
        ContextTraits { size_px: [64, 64], adapter: AdapterChoice::Software, samples: 4, ..ContextTraits::default() };
    let Some(mut ctx) = or_skip(GraphicsContext::new_offscreen(&traits)) else { return };
    let renderer = Renderer::new(&mut ctx);
    let mut rig = Rig::new(ctx, renderer);
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
    // Alpha 0.5 covers half of the samples: half of the background shows.
    let half = Arc::new(StateSet::default().with_mode(Mode::AlphaToCoverage, StateValue::ON));
    let covered =
        Node::geode(vec![quad([0.0, -0.8, 0.0], [0.1; 2], [0.0, 1.0, 0.0, 0.5])]).with_state_set(half.clone());
    let mut masked = quad([0.8, 0.0, 0.0], [0.1; 2], [0.0, 1.0, 0.0, 0.5]);
    masked.material.alpha = AlphaMode::Mask(0.25);
    let masked = Node::geode(vec![masked]).with_state_set(half.clone());
    let picture = draw(&mut rig, vec![slanted, Node::camera(hud, vec![small]), covered, masked]);
    let is_mixed = |p: &&image::Rgba<u8>| p.0[1] != 0 && p.0[1] != 255;
    assert!(picture.pixels().filter(is_mixed).count() > 60, "smooth edges");
    assert_eq!(pixel(&picture, 32, 32), GREEN, "over the resolved picture");
    for [x, y] in [[32, 57], [57, 32]] {
        let [r, g, b] = pixel(&picture, x, y);
        assert!((170..210).contains(&g) && r == b && (170..210).contains(&r), "{r} {g} {b}");
    }
    let errors = rig.renderer.take_errors();
    assert!(errors.is_empty(), "{errors:?}");
}

/// Projections beyond 63 are used; they were once replaced by the stage's own.
#[test]
fn each_of_many_projections_is_its_own() {
    let Some(mut rig) = rig("each_of_many_projections_is_its_own") else { return };
    let rig = &mut *rig;
    // Each puts its square of 2 m into another cell of 4 x 4 pixels.
    let cell = |i: u32, child: Node| {
        let at = |place: u32| (f64::from(place) + 0.5) / 8.0 - 1.0;
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
    // Fewer in the next frame.
    assert_eq!(count(&draw(rig, nodes[..100].to_vec()), MAGENTA), (256 - 100) * 16);
    no_errors(rig);
}
