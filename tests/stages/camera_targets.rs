//! Targets of cameras in the graph: depth only, one texture for several cameras, and reading back depth and stencil.
//! Needs a GPU; a software adapter suffices.

use std::sync::Arc;

use glam::dcamera::rh::proj::directx as proj;
use image::RgbaImage;
use kit::cameras::{no_errors, picture};
use kit::frames::pixel;
use kit::rig::{Rig, plain, rig, unit_camera};
use kit::shapes::quad;
use terrane::cull::CullCamera;
use terrane::scene::{
    AlphaMode, Attachment, CameraNode, CameraTarget, Drawable, Node, Picture, PictureSink, RenderOrder,
};
use terrane::state::{
    AlphaFunc, Attribute, BinDetails, ColorMask, CompareFunction, Depth, Fog, FogMode, Mode, Program, Sampler,
    SortMode, StateSet, StateValue, Stencil, StencilFace, StencilOperation, TextureBinding, TextureDimension,
    TextureFormat, TextureObject,
};

const SIDE: u32 = 64;
const RED: [u8; 3] = [255, 0, 0];
const GREEN: [u8; 3] = [0, 255, 0];
const BLACK: [u8; 3] = [0, 0, 0];

const VERTEX: &str = "struct V { @builtin(position) position: vec4<f32>, @location(0) uv: vec2<f32> }
    @vertex fn vs_main(vertex: MeshVertex, @builtin(instance_index) i: u32) -> V {
        return V(frame.clip_from_eye * vec4<f32>(point_in_eye(leaves[i], vertex.position), 1.0), vertex.uv);
    }";

fn draw(rig: &mut Rig, nodes: Vec<Node>) -> RgbaImage {
    let picture = picture(rig, Node::group(nodes), &unit_camera(SIDE), &plain());
    no_errors(rig);
    picture
}

fn to(target: CameraTarget, order: i32) -> CameraNode {
    let own = unit_camera(SIDE);
    let any = TextureObject::target("any", [SIDE; 2], TextureFormat::Rgba8Srgb);
    let node = CameraNode::to_texture(any, own.eye_from_world, own.clip_from_eye);
    CameraNode { target: Some(Arc::new(target)), order: RenderOrder::PreRender(order), ..node }
}

/// Returns a square that is green where a depth texture has a value.
fn shown(depth: &Arc<TextureObject>) -> Node {
    let source = format!(
        "@group(2) @binding(3) var shadow: texture_depth_2d;
        @group(2) @binding(4) var shadow_sampler: sampler_comparison;
        {VERTEX}
        @fragment fn fs_main(in: V) -> @location(0) vec4<f32> {{
            return vec4<f32>(0.0, textureSampleCompareLevel(shadow, shadow_sampler, in.uv, 0.005), 0.0, 1.0);
        }}"
    );
    let sampler = Sampler { compare: Some(CompareFunction::Less), ..Sampler::default() };
    let set = StateSet::default()
        .with(Attribute::Program(Program::new("compare", &source)))
        .with(Attribute::Texture(1, TextureBinding { texture: depth.clone(), sampler }));
    Node::geode(vec![quad([0.0; 3], [1.0; 2], [1.0; 4])]).with_state_set(Arc::new(set))
}

/// Alpha tests discard pixels in cameras without color. Regression: they did not.
#[test]
fn cameras_without_colors_discard_like_others() {
    let Some(mut rig) = rig("cameras_without_colors_discard_like_others") else { return };
    let rig = &mut *rig;
    let square = |alpha: AlphaMode| -> Drawable {
        let mut square = quad([0.0; 3], [0.5; 2], [1.0, 1.0, 1.0, 0.2]);
        square.material.alpha = alpha;
        square
    };
    let program = |name: &str, body: &str| {
        let outputs = "struct Out { @location(0) color: vec4<f32>, @builtin(frag_depth) depth: f32 }";
        let source = format!("{VERTEX} {outputs} @fragment fn fs_main(in: V) -> {body}");
        StateSet::default().with(Attribute::Program(Program::new(name, &source)))
    };
    let test = Attribute::AlphaFunc(AlphaFunc { function: CompareFunction::Greater, reference: 0.5 });
    let tested = StateSet::default().with(test).with_mode(Mode::AlphaTest, StateValue::ON);
    let fog = Attribute::Fog(Fog { mode: FogMode::Exp { density_per_m: 1e-6 }, color: [0.0; 3], is_displayed: false });
    let fogged = StateSet::default().with(fog).with_mode(Mode::Fog, StateValue::ON);
    let plain = || Arc::new(StateSet::default());
    let cases = [
        ("opaque", square(AlphaMode::Opaque), plain(), GREEN),
        ("masked", square(AlphaMode::Mask(0.5)), plain(), BLACK),
        ("masked, kept", square(AlphaMode::Mask(0.1)), plain(), GREEN),
        ("masked in fog", square(AlphaMode::Mask(0.5)), Arc::new(fogged), BLACK),
        ("alpha test", square(AlphaMode::Blend), Arc::new(tested), BLACK),
        (
            "discard",
            square(AlphaMode::Opaque),
            Arc::new(program("drops", "@location(0) vec4<f32> { discard; return vec4<f32>(1.0); }")),
            BLACK,
        ),
        (
            "depth of its own",
            square(AlphaMode::Opaque),
            Arc::new(program("deep", "Out { return Out(vec4<f32>(1.0), 0.001); }")),
            BLACK,
        ),
    ];
    for (name, square, set, expected) in cases {
        let depth = TextureObject::target("depth", [SIDE; 2], TextureFormat::Depth32);
        let alone = CameraTarget { depth: Some(Attachment::new(depth.clone())), ..CameraTarget::default() };
        let camera = Node::camera(to(alone, 0), vec![Node::geode(vec![square]).with_state_set(set)]);
        let picture = draw(rig, vec![camera, shown(&depth)]);
        assert_eq!((pixel(&picture, 32, 32), pixel(&picture, 10, 10)), (expected, BLACK), "{name}");
    }
}

/// Regression: each camera had separate samples, and resolved all of them into the texture.
#[test]
fn cameras_with_several_samples_share_a_texture() {
    let Some(mut rig) = rig("cameras_with_several_samples_share_a_texture") else { return };
    let rig = &mut *rig;
    for samples in [1, 4] {
        let texture = TextureObject::target("halves", [SIDE; 2], TextureFormat::Rgba8Srgb);
        let part = |order: i32, x: u32, color: [f32; 4]| {
            let colors = vec![Attachment::new(texture.clone())];
            let target = CameraTarget { colors, samples, ..CameraTarget::default() };
            let viewport_px = Some([x, 0, SIDE / 2, SIDE]);
            Node::camera(CameraNode { viewport_px, clear_color: Some(color), ..to(target, order) }, vec![])
        };
        // One camera clears nothing.
        let colors = vec![Attachment::new(texture.clone())];
        let over =
            CameraNode { clear_color: None, ..to(CameraTarget { colors, samples, ..CameraTarget::default() }, 2) };
        let over = Node::camera(over, vec![Node::geode(vec![quad([0.0; 3], [0.1; 2], [1.0; 4])])]);
        let set = StateSet::default()
            .with_mode(Mode::Lighting, StateValue::OFF)
            .with(Attribute::Texture(0, TextureBinding::new(texture.clone())));
        let screen = Node::geode(vec![quad([0.0; 3], [1.0; 2], [1.0; 4])]).with_state_set(Arc::new(set));
        let halves = [part(0, 0, [1.0, 0.0, 0.0, 1.0]), part(1, SIDE / 2, [0.0, 1.0, 0.0, 1.0])];
        let [left, right] = halves;
        let picture = draw(rig, vec![left, right, over, screen]);
        let at = [16, 48, 32].map(|x| pixel(&picture, x, 32));
        assert_eq!(at, [RED, GREEN, [255; 3]], "{samples} samples");
    }
}

/// Regression: it started with the old content of its samples, which was that of another camera in the last frame.
#[test]
fn multisampled_camera_continues_from_its_texture() {
    let Some(mut rig) = rig("multisampled_camera_continues_from_its_texture") else { return };
    let rig = &mut *rig;
    for format in [TextureFormat::Rgba8Srgb, TextureFormat::Rgba8, TextureFormat::Rgba16Float] {
        let [texture, second, other] =
            ["kept", "second", "other"].map(|name| TextureObject::target(name, [SIDE; 2], format));
        let target = |texture: &Arc<TextureObject>, samples| CameraTarget {
            colors: vec![Attachment::new(texture.clone()), Attachment::new(second.clone())],
            samples,
            ..CameraTarget::default()
        };
        let shows = |texture: &Arc<TextureObject>| {
            let set = StateSet::default()
                .with_mode(Mode::Lighting, StateValue::OFF)
                .with(Attribute::Texture(0, TextureBinding::new(texture.clone())));
            Node::geode(vec![quad([0.0; 3], [1.0; 2], [1.0; 4])]).with_state_set(Arc::new(set))
        };
        let camera = |target: CameraTarget, order, clear_color, children| {
            Node::camera(CameraNode { clear_color, ..to(target, order) }, children)
        };
        let begins = |samples| camera(target(&texture, samples), 0, Some([0.2, 0.5, 0.7, 1.0]), vec![]);
        // Another camera leaves other content in the samples.
        let blue = |order| {
            let alone =
                CameraTarget { colors: vec![Attachment::new(other.clone())], samples: 4, ..CameraTarget::default() };
            camera(alone, order, Some([0.0, 0.0, 1.0, 1.0]), vec![])
        };
        let mark = |x: f32| Node::geode(vec![quad([x, 0.0, 0.0], [0.2, 0.5], [1.0; 4])]);
        let goes_on = |x| camera(target(&texture, 4), 3, None, vec![mark(x)]);
        // It clears its part of the target.
        let part = || {
            let top = Some([0, 0, SIDE, 8]);
            let node =
                CameraNode { clear_color: Some([1.0, 0.0, 0.0, 1.0]), viewport_px: top, ..to(target(&texture, 4), 3) };
            Node::camera(node, vec![])
        };
        let ground = draw(rig, vec![begins(1), shows(&texture)]);
        let plain = pixel(&ground, 32, 32);
        let at = |picture: &RgbaImage| [12, 32, 52].map(|x| pixel(picture, x, 32));
        // Draws write only the first color.
        for (texture, seen) in [(&texture, [255; 3]), (&second, plain)] {
            // In the next frame, in one frame after a camera without samples, and after one with samples.
            draw(rig, vec![blue(0), begins(4), blue(2), shows(texture)]);
            let next = draw(rig, vec![blue(0), blue(4), goes_on(0.0), shows(texture)]);
            assert_eq!((at(&next), pixel(&next, 2, 2)), ([plain, seen, plain], plain), "{format:?}");
            let in_part = draw(rig, vec![blue(0), part(), shows(texture)]);
            assert_eq!((at(&in_part), pixel(&in_part, 32, 4)), ([plain, seen, plain], RED), "{format:?}");
            for samples in [1, 4] {
                let same = draw(rig, vec![blue(0), begins(samples), goes_on(0.6), shows(texture)]);
                assert_eq!(at(&same), [plain, plain, seen], "{format:?} after {samples} samples");
            }
        }
        // Any number of repetitions gives the same.
        let scene = rig.scene(Node::group(vec![blue(0), goes_on(0.0), shows(&texture)]));
        for _ in 0..40 {
            let picture = rig.picture(&scene, &unit_camera(SIDE), &kit::rig::plain());
            assert_eq!(at(&picture)[..2], [plain, [255; 3]], "{format:?}");
        }
        rig.release(scene);
    }
}

/// A target without memory is left out, and the rest of the frame is drawn.
#[test]
fn textures_without_memory_are_reported_and_the_frame_is_drawn() {
    let Some(mut rig) = rig("textures_without_memory_are_reported_and_the_frame_is_drawn") else { return };
    let rig = &mut *rig;
    let limits = rig.ctx.device().limits();
    let side = limits.max_texture_dimension_2d;
    let huge = Arc::new(TextureObject {
        dimension: TextureDimension::D2Array,
        size: [side, side, limits.max_texture_array_layers],
        ..(*TextureObject::target("huge", [side; 2], TextureFormat::Rgba16Float)).clone()
    });
    let set = StateSet::default()
        .with_mode(Mode::Lighting, StateValue::OFF)
        .with(Attribute::Texture(0, TextureBinding::new(huge)));
    let white = Node::geode(vec![quad([-0.5, 0.0, 0.0], [0.4; 2], [1.0; 4])]).with_state_set(Arc::new(set));
    let beside = Node::geode(vec![quad([0.5, 0.0, 0.0], [0.4; 2], [0.0, 1.0, 0.0, 1.0])]);
    let picture = picture(rig, Node::group(vec![white, beside]), &unit_camera(SIDE), &plain());
    assert_eq!([16, 48].map(|x| pixel(&picture, x, 32)), [[255; 3], GREEN]);
    let errors = rig.renderer.take_errors();
    assert!(matches!(&errors[..], [e] if e.contains("texture \"huge\" cannot be made")), "{errors:?}");
}

/// Stencil tests in cameras with a depth texture work or are reported. Regression: they always passed.
#[test]
fn depth_textures_may_have_a_stencil() {
    let Some(mut rig) = rig("depth_textures_may_have_a_stencil") else { return };
    let rig = &mut *rig;
    let has_float = rig.ctx.device().features().contains(wgpu::Features::DEPTH32FLOAT_STENCIL8);
    let face = |function, pass| StencilFace { function, pass, ..StencilFace::default() };
    let in_bin = |number, name: &str, face| {
        let bin = Some(BinDetails::new(number, SortMode::ByState));
        let set = StateSet { bin, name: name.into(), ..StateSet::default() };
        set.with(Attribute::Stencil(Stencil::both(face, 3)))
    };
    // The middle is marked, without colour and depth. Then green is drawn where it is marked.
    let mut mark = in_bin(1, "mark", face(CompareFunction::Always, StencilOperation::Replace))
        .with(Attribute::ColorMask(ColorMask([false; 4])));
    mark.set_attribute(Attribute::Depth(Depth { write: false, ..Depth::default() }), StateValue::ON);
    let test = in_bin(2, "test", face(CompareFunction::Equal, StencilOperation::Keep));
    let node = |half, color, set: &StateSet| {
        Node::geode(vec![quad([0.0; 3], [half; 2], color)]).with_state_set(Arc::new(set.clone()))
    };
    let formats = [TextureFormat::Depth24Stencil8, TextureFormat::Depth32Stencil8, TextureFormat::Depth32];
    for format in formats.into_iter().filter(|f| has_float || *f != TextureFormat::Depth32Stencil8) {
        let color = TextureObject::target("color", [SIDE; 2], TextureFormat::Rgba8Srgb);
        let depth = TextureObject::target("depth", [SIDE; 2], format);
        let target = || CameraTarget {
            colors: vec![Attachment::new(color.clone())],
            depth: Some(Attachment::new(depth.clone())),
            ..CameraTarget::default()
        };
        let camera = |order, clears, children| {
            let node = to(target(), order);
            let node = CameraNode { clear_depth: clears, clear_color: node.clear_color.filter(|_| clears), ..node };
            Node::camera(node, children)
        };
        let green = || node(0.75, [0.0, 1.0, 0.0, 1.0], &test);
        let set = StateSet::default()
            .with_mode(Mode::Lighting, StateValue::OFF)
            .with(Attribute::Texture(0, TextureBinding::new(color.clone())));
        let screen = || node(1.0, [1.0; 4], &set);
        let has_stencil = format != TextureFormat::Depth32;
        let mut said = Vec::new();
        // In one camera, and in a second one that continues with the stencil of the first.
        let one = vec![camera(0, true, vec![node(0.5, [1.0; 4], &mark), green()])];
        let two = vec![camera(0, true, vec![node(0.5, [1.0; 4], &mark)]), camera(1, false, vec![green()])];
        for cameras in [one, two] {
            let nodes = [cameras, vec![screen()]].concat();
            let scene = rig.scene(Node::group(nodes));
            for _ in 0..2 {
                let picture = rig.picture(&scene, &unit_camera(SIDE), &plain());
                let at = [32, 12].map(|x| pixel(&picture, x, 32));
                assert_eq!(at, [GREEN, if has_stencil { BLACK } else { GREEN }], "{format:?}");
                said.extend(rig.renderer.take_errors());
            }
            rig.release(scene);
        }
        let is_of =
            |(error, set): (&String, &&str)| error.starts_with(*set) && error.contains("\"depth\" has no stencil");
        let wanted: &[&str] = if has_stencil { &[] } else { &["mark: ", "test: "] };
        assert!(said.len() == wanted.len() && said.iter().zip(wanted).all(is_of), "{format:?}: {said:?}");
        // The depth can be sampled as before.
        let picture = draw(
            rig,
            vec![camera(0, true, vec![Node::geode(vec![quad([0.0; 3], [0.5; 2], [1.0; 4])])]), shown(&depth)],
        );
        assert_eq!([32, 12].map(|x| pixel(&picture, x, 32)), [GREEN, BLACK], "{format:?}");
    }
}

/// Returns the images of a scene in the order of the sinks, and the errors reported meanwhile.
fn read<const N: usize>(
    rig: &mut Rig,
    node: Node,
    sinks: [&Arc<PictureSink>; N],
) -> ([Option<Picture>; N], Vec<String>) {
    let scene = rig.scene(node);
    let mut came = [const { None }; N];
    let mut said = Vec::new();
    for frame in 1..20 {
        rig.draw(&scene, &CullCamera { frame, ..unit_camera(SIDE) }, &plain());
        for (came, sink) in came.iter_mut().zip(sinks) {
            *came = sink.take().or(came.take());
        }
        said.extend(rig.renderer.take_errors());
    }
    rig.release(scene);
    (came, said)
}

#[test]
fn depth_and_stencil_are_read_back() {
    let Some(mut rig) = rig("depth_and_stencil_are_read_back") else { return };
    let rig = &mut *rig;
    let has_float = rig.ctx.device().features().contains(wgpu::Features::DEPTH32FLOAT_STENCIL8);
    let own = unit_camera(SIDE);
    let perspective = proj::perspective(2.0 * 0.1f64.atan(), 1.0, 1000.0, 0.5);
    let parallel = proj::orthographic(-1.0, 1.0, -1.0, 1.0, 1000.0, 0.5);
    // The rows are shorter than the alignment of copies.
    let size = [SIDE - 2, SIDE];
    for (projection, far) in [(own.clip_from_eye, f64::INFINITY), (perspective, 1000.0), (parallel, 1000.0)] {
        let formats = [TextureFormat::Depth32, TextureFormat::Depth32Stencil8, TextureFormat::Depth24Stencil8];
        for (format, samples) in formats.into_iter().flat_map(|format| [(format, 1), (format, 4)]) {
            if format == TextureFormat::Depth32Stencil8 && !has_float {
                continue;
            }
            let [depth_sink, stencil_sink] = [(); 2].map(|()| Arc::new(PictureSink::default()));
            let target = CameraTarget {
                depth: Some(Attachment::new(TextureObject::target("deep", size, format))),
                read_back_depth: Some(depth_sink.clone()),
                read_back_stencil: Some(stencil_sink.clone()),
                samples,
                ..CameraTarget::default()
            };
            let mut camera = to(target, 0);
            camera.projection = Some(projection);
            let face = StencilFace {
                function: CompareFunction::Always,
                pass: StencilOperation::Replace,
                ..StencilFace::default()
            };
            let set = StateSet::default().with(Attribute::Stencil(Stencil::both(face, 77)));
            // The eye is 10 m in front of the origin.
            let square = Node::geode(vec![quad([0.0, 0.0, -2.5], [0.5; 2], [1.0; 4])]).with_state_set(Arc::new(set));
            let ([depth, stencil], said) = read(rig, Node::camera(camera, vec![square]), [&depth_sink, &stencil_sink]);
            let mut wanted = Vec::new();
            if format == TextureFormat::Depth24Stencil8 {
                assert_eq!(depth, None);
                wanted.push("texture \"deep\" holds depth in 24 bits");
            } else {
                let depth = depth.unwrap();
                assert_eq!((depth.size_px, depth.format), (size, TextureFormat::Depth32));
                assert_eq!(depth.clip_from_eye, projection);
                let [middle, corner] = [(31, 32), (0, 0)].map(|(x, y)| depth.distance_m(x, y).unwrap());
                assert!((middle - 12.5).abs() < 1e-2, "{format:?} {far}: {middle}");
                assert!(corner == far || (corner - far).abs() < 1.0, "{format:?} {far}: {corner}");
                assert_eq!(depth.depth(0, 0), Some(0.0));
                let nearer = (0..size[1]).flat_map(|y| (0..size[0]).map(move |x| (x, y)));
                let seen = nearer.filter(|(x, y)| depth.depth(*x, *y).unwrap() > 0.0).count();
                // Perspective makes it smaller: 12.5 m instead of 10.
                let side = if projection == parallel { 31 * 32 } else { 25 * 26 };
                assert!(seen.abs_diff(side) <= 60, "{seen}");
                assert_eq!((depth.depth(size[0], 0), depth.depth(0, size[1])), (None, None));
            }
            if format.has_stencil() {
                let stencil = stencil.unwrap();
                assert_eq!((stencil.size_px, stencil.format), (size, TextureFormat::R8));
                let at = |x: usize, y: usize| stencil.texels[y * size[0] as usize + x];
                assert_eq!((at(31, 32), at(0, 0), stencil.depth(0, 0)), (77, 0, None));
            } else {
                assert_eq!(stencil, None);
                wanted.push("texture \"deep\" has no stencil; the stencil test");
                wanted.push("texture \"deep\" has no stencil, which is to be read");
            }
            let is_of = |(error, wanted): (&String, &&str)| error.contains(*wanted);
            assert!(said.len() == wanted.len() && said.iter().zip(&wanted).all(is_of), "{format:?}: {said:?}");
            // The next target is another texture with the same name.
            rig.renderer = terrane::draw::Renderer::new(&mut rig.ctx);
        }
    }
}

#[test]
fn unreadable_depth_is_reported_once() {
    let Some(mut rig) = rig("unreadable_depth_is_reported_once") else { return };
    let rig = &mut *rig;
    let color = || Attachment::new(TextureObject::target("color", [SIDE; 2], TextureFormat::Rgba8Srgb));
    let [color_sink, depth_sink] = [(); 2].map(|()| Arc::new(PictureSink::default()));
    let without = CameraTarget {
        colors: vec![color()],
        read_back: Some(color_sink.clone()),
        read_back_depth: Some(depth_sink.clone()),
        ..CameraTarget::default()
    };
    let (came, said) = read(rig, Node::camera(to(without, 0), vec![]), [&color_sink, &depth_sink]);
    assert!(matches!(came, [Some(_), None]), "the colour is read back: {came:?}");
    assert!(matches!(&said[..], [error] if error.contains("without a depth texture")), "{said:?}");
}

/// Regression: they could not be stored, and the camera was not drawn.
#[test]
fn depth_of_several_samples_is_that_of_the_first() {
    let Some(mut rig) = rig("depth_of_several_samples_is_that_of_the_first") else { return };
    let rig = &mut *rig;
    let (texture, sink) = (TextureObject::target("deep", [SIDE; 2], TextureFormat::Depth32), Arc::default());
    let camera = |order, viewport_px| {
        let target = CameraTarget {
            depth: Some(Attachment::new(texture.clone())),
            read_back_depth: Some(Arc::clone(&sink)),
            samples: 4,
            ..CameraTarget::default()
        };
        CameraNode { viewport_px, ..to(target, order) }
    };
    // Edges pass through pixels. Each value is that of one square, at 10, 10.5 or 12 m, or of none.
    let squares =
        [(0.0, 0.433), (-0.5, 0.667), (-2.0, 0.933)].map(|(z, half)| quad([0.0, 0.0, z], [half; 2], [1.0; 4]));
    let over = |z: f32| vec![Node::geode(vec![quad([0.0, 0.0, z], [0.9; 2], [1.0; 4])])];
    let all = Node::camera(camera(0, None), vec![Node::geode(squares.to_vec())]);
    let ([depth], said) = read(rig, all, [&sink]);
    assert!(said.is_empty(), "{said:?}");
    let depth = depth.unwrap();
    let mut seen = [0; 4];
    for (x, y) in (0..SIDE).flat_map(|y| (0..SIDE).map(move |x| (x, y))) {
        let distance = depth.distance_m(x, y).unwrap();
        let is_of = |at: &f64| at.is_infinite() && distance.is_infinite() || (distance - at).abs() < 1e-3;
        let which = [10.0, 10.5, 12.0, f64::INFINITY].iter().position(is_of);
        seen[which.unwrap_or_else(|| panic!("({x}, {y}) is {distance} m away"))] += 1;
    }
    assert!(seen.iter().all(|count| *count > 500), "{seen:?}");
    // Later cameras sample the depth.
    let picture = draw(rig, vec![shown(&texture)]);
    assert_eq!((pixel(&picture, 32, 32), pixel(&picture, 1, 1)), (GREEN, BLACK));
    // Cameras with separate parts do not affect each other.
    let (left, right) = ([0, 0, SIDE / 2, SIDE], [SIDE / 2, 0, SIDE / 2, SIDE]);
    let [nearer, farther] = [(0, left, 1.0), (1, right, -5.0)].map(|(order, part, z)| {
        let camera = camera(order, Some(part));
        Node::camera(
            CameraNode { projection: Some(proj::orthographic(-1.0, 1.0, -1.0, 1.0, 1000.0, 0.5)), ..camera },
            over(z),
        )
    });
    let at = |depth: &Picture, x| depth.distance_m(x, SIDE / 2).unwrap();
    let ([depth], _) = read(rig, Node::group(vec![nearer, farther]), [&sink]);
    let depth = depth.unwrap();
    assert!(
        (at(&depth, 16) - 9.0).abs() < 0.01 && (at(&depth, 48) - 15.0).abs() < 0.01,
        "{:?}",
        [16, 48].map(|x| at(&depth, x))
    );
    let again =
        CameraNode { projection: Some(proj::orthographic(-1.0, 1.0, -1.0, 1.0, 1000.0, 0.5)), ..camera(0, Some(left)) };
    let ([depth], _) = read(rig, Node::camera(again, over(3.0)), [&sink]);
    let depth = depth.unwrap();
    assert!(
        (at(&depth, 16) - 7.0).abs() < 0.01 && (at(&depth, 48) - 15.0).abs() < 0.01,
        "{:?}",
        [16, 48].map(|x| at(&depth, x))
    );
}

/// A camera that does not clear the depth compares with it in the same frame.
#[test]
fn cameras_with_several_samples_share_a_depth_texture() {
    let Some(mut rig) = rig("cameras_with_several_samples_share_a_depth_texture") else { return };
    let rig = &mut *rig;
    let (texture, sink) = (TextureObject::target("deep", [SIDE; 2], TextureFormat::Depth32), Arc::default());
    let camera = |order, z: f32, half: f32| {
        let target = CameraTarget {
            depth: Some(Attachment::new(texture.clone())),
            read_back_depth: (order == 1).then(|| Arc::clone(&sink)),
            samples: 4,
            ..CameraTarget::default()
        };
        let camera = CameraNode { clear_depth: order == 0, ..to(target, order) };
        Node::camera(camera, vec![Node::geode(vec![quad([0.0, 0.0, z], [half; 2], [1.0; 4])])])
    };
    let both = Node::group(vec![camera(0, 0.0, 0.4), camera(1, -1.0, 0.9)]);
    let ([depth], said) = read(rig, both, [&sink]);
    assert!(said.is_empty(), "{said:?}");
    let depth = depth.unwrap();
    let at = |x, y| depth.distance_m(x, y).unwrap();
    assert!((at(32, 32) - 10.0).abs() < 1e-3 && (at(12, 32) - 11.0).abs() < 1e-3, "{} {}", at(32, 32), at(12, 32));
    // Without the first camera it finds no depth.
    let ([depth], _) = read(rig, camera(1, -1.0, 0.9), [&sink]);
    assert!((depth.unwrap().distance_m(32, 32).unwrap() - 11.0).abs() < 1e-3);
}
