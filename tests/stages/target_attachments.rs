//! Attachments of camera targets: layers, faces, levels, several colors, samples, read-back and errors.

use std::sync::Arc;

use crate::small_targets::{
    BLACK, BLUE, GREEN, RED, SIDE, draw, no_errors, read, red, screen, square, target, to_texture, view,
};
use glam::DAffine3;
use kit::frames::{count, pixel};
use kit::rig::{plain, rig, unit_camera};
use kit::shapes::quad;
use terrane::cull::CullCamera;
use terrane::scene::{Attachment, CameraNode, CameraTarget, Node, PictureSink, RenderOrder};
use terrane::state::{
    Attribute, BlendFactor, BlendFunc, CompareFunction, Mode, Program, Sampler, StateSet, StateValue, TextureBinding,
    TextureDimension, TextureFormat, TextureObject,
};

#[test]
fn layers_faces_and_levels_can_be_drawn_to() {
    let Some(mut rig) = rig("layers_faces_and_levels_can_be_drawn_to") else { return };
    let rig = &mut *rig;
    let object = |dimension, size: [u32; 3], levels| {
        Arc::new(TextureObject { dimension, size, levels, ..(*target("parts")).clone() })
    };
    let onto = |texture: &Arc<TextureObject>, level, layer, color: [u8; 3]| {
        let colors = vec![Attachment { level, layer, ..Attachment::new(texture.clone()) }];
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
    // The square at 10 m has the reversed depth 0.01 with a near plane of 0.1 m. It is compared with 0.005.
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

#[test]
fn alpha_is_blended_separately_from_color() {
    use BlendFactor::{DstAlpha, One, OneMinusSrcAlpha, SrcAlpha, Zero};
    let Some(mut rig) = rig("alpha_is_blended_separately_from_color") else { return };
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
    // Alpha 0.25 is drawn over alpha 0.5.
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
fn invalid_target_is_reported_once_and_the_rest_is_drawn() {
    let Some(mut rig) = rig("invalid_target_is_reported_once_and_the_rest_is_drawn") else { return };
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
        colors: vec![Attachment { level: 3, ..Attachment::new(fine.clone()) }],
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
    // A stage that reads the texture it draws to.
    let camera = to_texture(&fine);
    let picture = draw(rig, vec![Node::camera(camera, vec![screen(&fine)]), red()]);
    assert_eq!(count(&picture, RED), 32 * 32);
    let errors = rig.renderer.take_errors();
    assert!(matches!(&errors[..], [e] if e.contains("read while it is drawn into")), "{errors:?}");
}

#[test]
fn images_are_read_back_without_waiting() {
    let Some(mut rig) = rig("images_are_read_back_without_waiting") else { return };
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
fn several_attachments_and_formats_are_read_back() {
    let Some(mut rig) = rig("several_attachments_and_formats_are_read_back") else { return };
    let rig = &mut *rig;
    // The rows are shorter than the alignment of copies.
    let size = [40, 24];
    let formats = [TextureFormat::Rgba8, TextureFormat::Rgba16Float, TextureFormat::R32Float];
    let colors = formats.map(|format| Attachment::new(TextureObject::target("part", size, format)));
    let sinks = formats.map(|_| Arc::new(PictureSink::default()));
    let [first, second, third] = &sinks;
    // The third attachment is read twice, and one that does not exist.
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
    let mut found = [const { None }; 4];
    for frame in 1..50 {
        rig.draw(&scene, &CullCamera { frame, ..unit_camera(SIDE) }, &plain());
        for (found, sink) in found.iter_mut().zip([first, second, third, &again]) {
            *found = sink.take().or(found.take());
        }
    }
    rig.release(scene);
    let [first, second, third, again] = found.map(|picture| picture.expect("an image"));
    for (picture, format) in [(&first, formats[0]), (&second, formats[1]), (&third, formats[2]), (&again, formats[2])] {
        assert_eq!((picture.size_px, picture.format), (size, format));
        assert_eq!(picture.texels.len(), (size[0] * size[1]) as usize * format.texel_bytes());
    }
    assert!(first.texels.chunks_exact(4).all(|p| p == [255, 0, 0, 255]));
    // 0.5, -2, 1024 and 1 as 16-bit floats.
    let halves = [0x3800u16, 0xc000, 0x6400, 0x3c00].map(u16::to_le_bytes).concat();
    assert!(second.texels.chunks_exact(8).all(|p| p == halves));
    let numbers: Vec<f32> = third.texels.chunks_exact(4).map(|b| f32::from_le_bytes(b.try_into().unwrap())).collect();
    let expected: Vec<f32> = (0..size[1]).flat_map(|y| (0..size[0]).map(move |x| (x + 1000 * y) as f32)).collect();
    assert_eq!(numbers, expected);
    assert!(missing.take().is_none());
    let errors = rig.renderer.take_errors();
    assert!(matches!(&errors[..], [e] if e.contains("colour 3")), "{errors:?}");
}
