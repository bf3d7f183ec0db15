//! Pixels of the fixed function: fog, clip planes, alpha test, texture units and their coordinates.

use std::sync::Arc;

use crate::lighting::*;
use glam::{DAffine3, DVec3, DVec4};
use image::RgbaImage;
use kit::frames::{MAGENTA, count, pixel};
use kit::rig::{camera, plain, rig, unit_camera};
use kit::shapes::quad;
use kit::terrain::Terrain;
use terrane::scene::{ClipNode, LightSource, Node, NodeKind, ReferenceFrame, TexGenNode};
use terrane::state::{
    AlphaFunc, Attribute, CompareFunction, FilterMode, Fog, FogMode, Light, Mode, Sampler, StateSet, StateValue,
    SurfaceMaterial, TexGen, TextureBinding, TextureDimension, TextureFormat, TextureObject, WrapMode,
};

#[test]
fn fog_increases_with_distance() {
    let Some(mut rig) = rig("fog_increases_with_distance") else { return };
    let rig = &mut *rig;
    // The square is 10 m in front of the eye.
    let mut with = |mode: FogMode, on: StateValue| {
        let mut set = StateSet::default().with_mode(Mode::Lighting, StateValue::OFF);
        set.set_attribute_and_modes(Attribute::Fog(Fog { mode, color: [0.0, 0.0, 1.0], is_displayed: false }), on);
        middle(rig, vec![node(square([1.0, 0.0, 0.0, 1.0]), set)])
    };
    let on = StateValue::ON;
    let linear = |start_m, end_m| FogMode::Linear { start_m, end_m };
    assert_near(with(linear(5.0, 15.0), on), [0.5, 0.0, 0.5], "half way");
    assert_eq!(with(linear(11.0, 20.0), on), RED);
    assert_eq!(with(linear(1.0, 9.0), on), BLUE);
    let e = (-1.0f32).exp();
    assert_near(with(FogMode::Exp { density_per_m: 0.1 }, on), [e, 0.0, 1.0 - e], "exp");
    let e = (-4.0f32).exp();
    assert_near(with(FogMode::Exp2 { density_per_m: 0.2 }, on), [e, 0.0, 1.0 - e], "exp2");
    assert_eq!(with(linear(1.0, 9.0), StateValue::OFF), RED, "off");
}

/// OpenGL mixes the values of the frame buffer.
#[test]
fn fog_mixes_colours_as_they_are_displayed() {
    let Some(mut rig) = rig("fog_mixes_colours_as_they_are_displayed") else { return };
    let rig = &mut *rig;
    let mode = FogMode::Linear { start_m: 0.0, end_m: 40.0 };
    let mut set = StateSet::default().with_mode(Mode::Lighting, StateValue::OFF);
    let fog = Fog { mode, color: [0.0, 0.0, 1.0], is_displayed: true };
    set.set_attribute_and_modes(Attribute::Fog(fog), StateValue::ON);
    // A quarter of the way, 10 m in front of the eye.
    let [red, green, blue] = middle(rig, vec![node(square([1.0, 0.0, 0.0, 1.0]), set)]);
    assert!(red.abs_diff(191) <= 1 && green == 0 && blue.abs_diff(64) <= 1, "{red} {green} {blue}");
}

#[test]
fn clip_planes_cut_their_children() {
    let Some(mut rig) = rig("clip_planes_cut_their_children") else { return };
    let rig = &mut *rig;
    let clip = |planes: Vec<(u8, DVec4)>, children| Node {
        children,
        ..Node::new(NodeKind::ClipNode(Box::new(ClipNode { planes, frame: ReferenceFrame::Relative })))
    };
    let red = || Node::geode(vec![quad([0.0; 3], [0.5; 2], [1.0, 0.0, 0.0, 1.0])]);
    // The planes are x >= 0 and y <= 0.25.
    let planes = || vec![(0, DVec4::new(1.0, 0.0, 0.0, 0.0)), (3, DVec4::new(0.0, -1.0, 0.0, 0.25))];
    let picture = draw(rig, vec![clip(planes(), vec![red()])]);
    assert_eq!(count(&picture, RED), 16 * 24);
    assert_eq!(
        (picture.get_pixel(40, 32).0[..3].to_vec(), picture.get_pixel(20, 32).0[..3].to_vec()),
        (RED.to_vec(), MAGENTA.to_vec())
    );
    let beside = draw(rig, vec![clip(planes(), vec![]), red()]);
    assert_eq!(count(&beside, RED), 32 * 32, "nodes outside of it are whole");
    let moved = Node::transform(DAffine3::from_translation(DVec3::new(0.25, 0.0, 0.0)), vec![clip(planes(), vec![])]);
    let all = StateSet::default().with_mode(Mode::ClipPlane(0), StateValue::ON);
    let picture = draw(rig, vec![moved, red().with_state_set(Arc::new(all))]);
    assert_eq!(count(&picture, RED), 8 * 32, "enabled by a state set, for a plane elsewhere in the graph");
}

#[test]
fn alpha_tests_discard_pixels() {
    let Some(mut rig) = rig("alpha_tests_discard_pixels") else { return };
    let rig = &mut *rig;
    let mut passes = |function, alpha: f32| {
        let set = StateSet::default()
            .with_mode(Mode::Lighting, StateValue::OFF)
            .with(Attribute::AlphaFunc(AlphaFunc { function, reference: 0.5 }));
        middle(rig, vec![node(square([1.0, 0.0, 0.0, alpha]), set)]) == RED
    };
    use CompareFunction::{Always, Equal, Greater, GreaterOrEqual, Less, LessOrEqual, Never, NotEqual};
    for (function, below, equal, above) in [
        (Never, false, false, false),
        (Less, true, false, false),
        (Equal, false, true, false),
        (LessOrEqual, true, true, false),
        (Greater, false, false, true),
        (NotEqual, true, false, true),
        (GreaterOrEqual, false, true, true),
        (Always, true, true, true),
    ] {
        let got = [0.25, 0.5, 0.75].map(|alpha| passes(function, alpha));
        assert_eq!(got, [below, equal, above], "{function:?}");
    }
}

#[test]
fn texture_units_multiply_all_dimensions_of_textures() {
    let Some(mut rig) = rig("texture_units_multiply_all_dimensions_of_textures") else { return };
    let rig = &mut *rig;
    let white = || square(WHITE);
    let picture = draw(rig, vec![node(white(), unlit().with(Attribute::Texture(0, nearest(quarters()))))]);
    let corners = [(20, 20), (44, 20), (20, 44), (44, 44)].map(|(x, y)| pixel(&picture, x, y));
    assert_eq!(corners, [RED, GREEN, BLUE, [255; 3]]);
    // Two units give yellow times the quarters.
    let yellow = TextureObject::image("yellow", [1, 1], vec![255, 255, 0, 255]);
    let set = unlit().with(Attribute::Texture(0, nearest(quarters()))).with(Attribute::Texture(3, nearest(yellow)));
    let picture = draw(rig, vec![node(white(), set)]);
    assert_eq!([(20, 44), (44, 44)].map(|(x, y)| pixel(&picture, x, y)), [[0; 3], [255, 255, 0]]);
    // A unit that is off.
    let mut off = unlit().with(Attribute::Texture(0, nearest(quarters())));
    off.set_mode(Mode::Texture(0), StateValue::OFF);
    assert_eq!(middle(rig, vec![node(square([0.0, 1.0, 0.0, 1.0]), off)]), GREEN);

    let object = |dimension, size: [u32; 3], texels: Vec<u8>| {
        Arc::new(TextureObject {
            name: format!("{dimension:?}"),
            dimension,
            size,
            format: TextureFormat::Rgba8,
            levels: 1,
            texels: vec![texels],
            is_changing: false,
        })
    };
    let row = object(TextureDimension::D1, [2, 1, 1], [[255, 0, 0, 255], [0, 255, 0, 255]].concat());
    let picture = draw(rig, vec![node(white(), unlit().with(Attribute::Texture(1, nearest(row))))]);
    assert_eq!([(20, 40), (44, 20)].map(|(x, y)| pixel(&picture, x, y)), [RED, GREEN]);
    // A cube sampled by the normal towards +z, which is its fifth face.
    let face = |i: u8| if i == 4 { [0, 255, 0, 255] } else { [255, 0, 0, 255] };
    let cube = object(TextureDimension::Cube, [1, 1, 6], (0..6).flat_map(face).collect());
    let set = unlit().with(Attribute::Texture(0, nearest(cube))).with(Attribute::TexGen(0, TexGen::NormalMap));
    assert_eq!(middle(rig, vec![node(white(), set)]), GREEN);
    // The first slice of a volume, and the first of two layers: generated coordinates have r = 0.
    for dimension in [TextureDimension::D3, TextureDimension::D2Array] {
        let two = object(dimension, [1, 1, 2], [[0, 0, 255, 255], [255, 0, 0, 255]].concat());
        let set = unlit().with(Attribute::Texture(2, nearest(two)));
        assert_eq!(middle(rig, vec![node(white(), set)]), BLUE, "{dimension:?}");
    }
}

#[test]
fn samplers_wrap_filter_and_bias() {
    let Some(mut rig) = rig("samplers_wrap_filter_and_bias") else { return };
    let rig = &mut *rig;
    // s and t run over three copies: x + 1.5 with 0.5 m for each.
    let planes = TexGen::planes([2.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.25]);
    let two = TextureObject::image("two", [2, 1], [[255, 0, 0, 255], [0, 255, 0, 255]].concat());
    let mut rows = |wrap| {
        let sampler = Sampler {
            wrap: [wrap; 3],
            min_filter: FilterMode::Nearest,
            mag_filter: FilterMode::Nearest,
            ..Sampler::default()
        };
        let set = unlit()
            .with(Attribute::Texture(0, TextureBinding { texture: two.clone(), sampler }))
            .with(Attribute::TexGen(0, TexGen::ObjectLinear(planes)));
        let picture = draw(rig, vec![node(square(WHITE), set)]);
        // s = -0.75, -0.25, 0.25, 0.75
        [20, 28, 36, 44].map(|x| pixel(&picture, x, 32))
    };
    assert_eq!(rows(WrapMode::ClampToEdge), [RED, RED, RED, GREEN]);
    assert_eq!(rows(WrapMode::Repeat), [RED, GREEN, RED, GREEN]);
    assert_eq!(rows(WrapMode::Mirror), [GREEN, RED, RED, GREEN]);
    // Level 0 is red, level 1 green. The image is magnified, so that a bias of 1 selects level 1.
    let levels = Arc::new(TextureObject {
        levels: 2,
        texels: vec![[255, 0, 0, 255].repeat(64 * 64), [0, 255, 0, 255].repeat(32 * 32)],
        size: [64, 64, 1],
        ..(*two).clone()
    });
    let mut biased = |mip_bias| {
        let sampler = Sampler { mip_bias, mip_filter: FilterMode::Nearest, max_anisotropy: 4, ..Sampler::default() };
        let binding = TextureBinding { texture: levels.clone(), sampler };
        middle(rig, vec![node(square(WHITE), unlit().with(Attribute::Texture(0, binding)))])
    };
    assert_eq!([biased(-2.0), biased(2.0)], [RED, GREEN]);
}

#[test]
fn coordinates_are_generated_by_planes_and_reflections() {
    let Some(mut rig) = rig("coordinates_are_generated_by_planes_and_reflections") else { return };
    let rig = &mut *rig;
    let planes = TexGen::planes([0.5, 0.0, 0.0, 0.5], [0.0, -0.5, 0.0, 0.5]);
    let with = |texgen| unlit().with(Attribute::Texture(1, nearest(quarters()))).with(Attribute::TexGen(1, texgen));
    let aside = |n: Node| Node::transform(DAffine3::from_translation(DVec3::new(0.3, 0.0, 0.0)), vec![n]);
    // In the object's frame the middle of the texture moves along; in the eye's frame it stays.
    let edge = |picture: &RgbaImage| (0..SIDE).find(|x| pixel(picture, *x, 20) == GREEN);
    let object = draw(rig, vec![aside(node(square(WHITE), with(TexGen::ObjectLinear(planes))))]);
    let eye = draw(rig, vec![aside(node(square(WHITE), with(TexGen::EyeLinear(planes))))]);
    assert_eq!(edge(&eye), Some(32));
    assert!(edge(&object).unwrap().abs_diff(32 + 10) <= 1, "{:?}", edge(&object));
    // A TexGenNode fixes the eye's planes to itself.
    let texgen = TexGenNode { unit: 1, texgen: TexGen::EyeLinear(planes) };
    let nodes = vec![
        aside(Node::new(NodeKind::TexGenNode(Box::new(texgen)))),
        node(square(WHITE), with(TexGen::EyeLinear([[0.0; 4]; 4]))),
    ];
    assert!(edge(&draw(rig, nodes)).unwrap().abs_diff(32 + 10) <= 1);
    // A mirror that faces the eye shows the area behind the eye: the middle of a sphere map.
    let dot = |rgb: [u8; 3], x: usize, y: usize| {
        let mut texels = [0u8, 0, 0, 255].repeat(64);
        let at = (y * 8 + x) * 4;
        texels[at..at + 3].copy_from_slice(&rgb);
        TextureObject::image("dot", [8, 8], texels)
    };
    let map =
        unlit().with(Attribute::Texture(0, nearest(dot(RED, 4, 4)))).with(Attribute::TexGen(0, TexGen::SphereMap));
    let picture = draw(rig, vec![node(square(WHITE), map)]);
    assert!(count(&picture, RED) > 0);
    // A mirror that leans back or sideways shows the area above or beside: upper rows, or columns on that side.
    let red_above = [[255, 0, 0, 255], [0, 255, 0, 255]].concat();
    let halves = |size: [u32; 2]| TextureObject::image("halves", size, red_above.clone());
    for (size, turn, seen) in [
        ([1, 2], DAffine3::from_rotation_x(-0.5), RED),
        ([1, 2], DAffine3::from_rotation_x(0.5), GREEN),
        ([2, 1], DAffine3::from_rotation_y(-0.5), RED),
        ([2, 1], DAffine3::from_rotation_y(0.5), GREEN),
    ] {
        let map =
            unlit().with(Attribute::Texture(0, nearest(halves(size)))).with(Attribute::TexGen(0, TexGen::SphereMap));
        assert_eq!(middle(rig, vec![Node::transform(turn, vec![node(square(WHITE), map)])]), seen, "{size:?} {turn}");
    }
    // Straight back, the reflection is +z again, the fifth face of a cube.
    let face = |i: u8| if i == 4 { [0, 255, 0, 255] } else { [255, 0, 0, 255] };
    let cube = Arc::new(TextureObject {
        name: "cube".into(),
        dimension: TextureDimension::Cube,
        size: [1, 1, 6],
        format: TextureFormat::Rgba8,
        levels: 1,
        texels: vec![(0..6).flat_map(face).collect()],
        is_changing: false,
    });
    let set = unlit().with(Attribute::Texture(0, nearest(cube))).with(Attribute::TexGen(0, TexGen::ReflectionMap));
    assert_eq!(middle(rig, vec![node(square(WHITE), set)]), GREEN);
}

#[test]
fn planes_of_r_and_q_select_slices_and_project() {
    let Some(mut rig) = rig("planes_of_r_and_q_select_slices_and_project") else { return };
    let rig = &mut *rig;
    let [along_s, along_t] = [[1.0, 0.0, 0.0, 0.5], [0.0, 1.0, 0.0, 0.5]];
    let constant = |value: f32| [0.0, 0.0, 0.0, value];
    let with = |texture: &Arc<TextureObject>, planes| {
        let binding = nearest(texture.clone());
        node(
            square(WHITE),
            unlit().with(Attribute::Texture(1, binding)).with(Attribute::TexGen(1, TexGen::ObjectLinear(planes))),
        )
    };
    // r selects slices and layers from below. q divides all coordinates of a volume, and only s and t of layers.
    for (dimension, q) in [(TextureDimension::D3, 1.0), (TextureDimension::D3, 2.0), (TextureDimension::D2Array, 2.0)] {
        let two = Arc::new(TextureObject {
            dimension,
            size: [1, 1, 2],
            format: TextureFormat::Rgba8,
            texels: vec![[[0, 0, 255, 255], [255, 0, 0, 255]].concat()],
            ..(*quarters()).clone()
        });
        // In a volume, half a slice higher per 0.5 m; in an array, from layer 0 to layer 1 in the middle.
        let r = if dimension == TextureDimension::D3 { [0.0, q, 0.0, 0.5 * q] } else { [0.0, 1.0, 0.0, 0.5] };
        let picture = draw(rig, vec![with(&two, [along_s, along_t, r, constant(q)])]);
        let at = [20, 30, 34, 44].map(|y| pixel(&picture, 32, y));
        assert_eq!(at, [RED, RED, BLUE, BLUE], "{dimension:?} {q}");
    }
    // An image from a projector has s / q = 0.5 where x = y / 2.
    let two = TextureObject::image("two", [2, 1], [[255, 0, 0, 255], [0, 255, 0, 255]].concat());
    let q = [0.0, 1.0, 0.0, 1.0];
    let picture = draw(rig, vec![with(&two, [along_s, constant(0.0), constant(0.0), q])]);
    let edge = |picture: &RgbaImage, y: u32| (16..48).find(|x| pixel(picture, *x, y) == GREEN).unwrap_or(0);
    for y in [18, 25, 32, 39, 46] {
        let y_m = 1.0 - (f64::from(y) + 0.5) / 32.0;
        let expected = 32.0 + 16.0 * y_m;
        assert!((f64::from(edge(&picture, y)) - expected).abs() <= 1.0, "{} instead of {expected}", edge(&picture, y));
    }
    // In the eye's frame, at 10 m, q comes from the depth. The result is the same as without it, in tenths.
    let eye = [[1.0, 0.0, 0.0, 5.0], constant(0.0), constant(0.0), [0.0, 0.0, -1.0, 0.0]];
    let set = unlit().with(Attribute::Texture(0, nearest(two))).with(Attribute::TexGen(0, TexGen::EyeLinear(eye)));
    let picture = draw(rig, vec![node(square(WHITE), set)]);
    assert_eq!(edge(&picture, 32), 32);
}

#[test]
fn invalid_textures_are_white_and_one_error() {
    let Some(mut rig) = rig("invalid_textures_are_white_and_one_error") else { return };
    let rig = &mut *rig;
    let short = TextureObject::image("short", [4, 4], vec![0; 12]);
    let set = StateSet { name: "broken".into(), ..unlit().with(Attribute::Texture(0, nearest(short))) };
    let scene = rig.scene(node(square([0.0, 1.0, 0.0, 1.0]), set));
    for frame in 0..3 {
        let picture = rig.picture(&scene, &unit_camera(SIDE), &plain());
        assert_eq!(pixel(&picture, 32, 32), GREEN);
        let errors = rig.renderer.take_errors();
        assert_eq!(errors.len(), usize::from(frame == 0), "{errors:?}");
        assert!(errors.iter().all(|e| e.contains("broken") && e.contains("\"short\"") && e.contains("12 bytes")));
    }
    rig.release(scene);
}

/// Regression: the second one showed the first.
#[test]
fn one_cube_one_volume_and_one_array_texture_may_be_bound() {
    let Some(mut rig) = rig("one_cube_one_volume_and_one_array_texture_may_be_bound") else { return };
    let rig = &mut *rig;
    let kinds = [(TextureDimension::Cube, 6), (TextureDimension::D3, 2), (TextureDimension::D2Array, 2)];
    for (dimension, layers) in kinds {
        let object = |name: &str, texel: [u8; 4]| {
            nearest(Arc::new(TextureObject {
                name: format!("{name} {dimension:?}"),
                dimension,
                size: [1, 1, layers],
                format: TextureFormat::Rgba8,
                levels: 1,
                texels: vec![texel.repeat(layers as usize)],
                is_changing: false,
            }))
        };
        let (yellow, cyan) = (object("yellow", [255, 255, 0, 255]), object("cyan", [0, 255, 255, 255]));
        let both = unlit().with(Attribute::Texture(0, yellow.clone())).with(Attribute::Texture(2, cyan));
        let scene = rig.scene(node(square(WHITE), StateSet { name: "both".into(), ..both }));
        for frame in 0..3 {
            let picture = rig.picture(&scene, &unit_camera(SIDE), &plain());
            assert_eq!(pixel(&picture, 32, 32), [255, 255, 0], "{dimension:?}");
            let errors = rig.renderer.take_errors();
            assert_eq!(errors.len(), usize::from(frame == 0), "{errors:?}");
            let says = format!("\"cyan {dimension:?}\"");
            assert!(
                errors.iter().all(|e| e.contains("both") && e.contains(&says) && e.contains("unit 2")),
                "{errors:?}"
            );
        }
        rig.release(scene);
        // The same texture twice is no error.
        let twice = unlit().with(Attribute::Texture(0, yellow.clone())).with(Attribute::Texture(2, yellow));
        assert_eq!(middle(rig, vec![node(square(WHITE), twice)]), [255, 255, 0], "{dimension:?}");
    }
}

#[test]
fn height_tiles_have_lights_and_fog() {
    let Some(mut rig) = rig("height_tiles_have_lights_and_fog") else { return };
    let rig = &mut *rig;
    let terrain =
        Terrain { west: 0.13, south: 0.8, width: 0.006, relief_m: 2600.0, root_error_m: 250.0, textured: true };
    let view = camera([256, 256], terrain.world(0.5, 0.1, 9_000.0), terrain.world(0.5, 0.6, 0.0), terrain.up(0.5, 0.5));
    let mut with = |set: StateSet| {
        let scene = rig.scene(Node::group(vec![terrain.tile(0, 0, 0)]).with_state_set(Arc::new(set)));
        let picture = rig.picture(&scene, &view, &plain());
        rig.release(scene);
        assert!(rig.renderer.take_errors().is_empty());
        picture
    };
    let ground = |p: &RgbaImage| p.pixels().filter(|p| p.0[..3] != MAGENTA).count();
    let mean = |p: &RgbaImage, channel: usize| {
        let sum: u64 = p.pixels().filter(|p| p.0[..3] != MAGENTA).map(|p| u64::from(p.0[channel])).sum();
        sum as f64 / ground(p) as f64
    };
    let sunny = with(StateSet::default());
    // The same with the fixed function and white light changes nothing.
    let same = with(StateSet::default().with(Attribute::SurfaceMaterial(SurfaceMaterial::default())));
    assert_eq!(ground(&sunny), ground(&same));
    let differing = sunny.pixels().zip(same.pixels()).filter(|(a, b)| (0..3).any(|c| a.0[c].abs_diff(b.0[c]) > 24));
    assert!(differing.count() * 50 < ground(&sunny), "lit by the pixel instead of the vertex");
    let dark = with(StateSet::default().with_mode(Mode::Light(0), StateValue::OFF));
    assert!(mean(&dark, 1) < 1.0);
    let mode = FogMode::Linear { start_m: 5_000.0, end_m: 30_000.0 };
    let fog = Fog { mode, color: [0.0, 0.0, 1.0], is_displayed: false };
    let foggy = with(StateSet::default().with(Attribute::Fog(fog)));
    assert!(mean(&foggy, 2) > mean(&sunny, 2) + 20.0);
}

/// Regression: such numbers were taken for the last valid ones.
#[test]
fn numbers_out_of_range_are_reported_and_affect_no_others() {
    let Some(mut rig) = rig("numbers_out_of_range_are_reported_and_affect_no_others") else { return };
    let rig = &mut *rig;
    let named = |name: &str, set: StateSet| StateSet { name: name.into(), ..set };
    let color = |texel: [u8; 4]| nearest(TextureObject::image("color", [1, 1], texel.to_vec()));
    let mut last = unlit();
    last.set_attribute(Attribute::Texture(3, color([0, 0, 255, 255])), StateValue::ON);
    let texgen = Attribute::TexGen(4, TexGen::NormalMap);
    let beyond = named("units", last.with(Attribute::Texture(4, color([255, 0, 0, 255]))).with(texgen));
    let clip = |number, plane| {
        let clip = ClipNode { planes: vec![(number, plane)], frame: ReferenceFrame::Relative };
        Node::new(NodeKind::ClipNode(Box::new(clip)))
    };
    let all = DVec4::new(0.0, 0.0, 0.0, -1.0);
    let source = |number| {
        let light = Light { number, position: [0.0, 0.0, 1.0, 0.0], ..Light::default() };
        Node::new(NodeKind::LightSource(Box::new(LightSource { light, frame: ReferenceFrame::Relative })))
    };
    let dark = named(
        "lights",
        StateSet::default().with_mode(Mode::Light(0), StateValue::OFF).with_mode(Mode::Light(8), StateValue::ON),
    );
    // Their modes stay off.
    let off = unlit().with_mode(Mode::Texture(7), StateValue::OFF).with_mode(Mode::Light(200), StateValue::OFF);
    let generator = Node::new(NodeKind::TexGenNode(Box::new(TexGenNode { unit: 4, texgen: TexGen::SphereMap })));
    for (nodes, seen, wanted) in [
        (vec![node(square(WHITE), beyond)], [255; 3], vec!["units: texture unit 4"]),
        (
            vec![clip(5, all), clip(6, all).with_child(node(square(WHITE), unlit()))],
            [255; 3],
            vec!["a ClipNode: clip plane 6"],
        ),
        (
            vec![source(7), source(8), node(square(WHITE), dark)],
            [0; 3],
            vec!["a LightSource: light 8", "lights: light 8"],
        ),
        (vec![generator, node(square(WHITE), off)], [255; 3], vec!["a TexGenNode: texture unit 4"]),
    ] {
        let scene = rig.scene(Node::group(nodes));
        let mut errors = Vec::new();
        for _ in 0..2 {
            assert_eq!(pixel(&rig.picture(&scene, &unit_camera(SIDE), &plain()), 32, 32), seen, "{wanted:?}");
            errors.extend(rig.renderer.take_errors());
        }
        rig.release(scene);
        let is_wanted = |(error, wanted): (&String, &&str)| error.contains(*wanted);
        assert!(errors.len() == wanted.len() && errors.iter().zip(&wanted).all(is_wanted), "{errors:?}");
    }
}
