//! Light beyond white: in the float textures of cameras, under several samples and blending with tone mapping in its own
//! pass, and encoded for targets without an sRGB format.

use std::sync::Arc;

use glam::DVec3;
use image::RgbaImage;
use kit::frames::{count, pixel};
use kit::rig::{Rig, camera, plain, rig_with, traits, unit_camera};
use kit::shapes::{ball, quad};
use terrane::gpu::ContextTraits;
use terrane::scene::{
    AlphaMode, Attachment, CameraNode, CameraTarget, Drawable, Environment, Node, PictureSink, Sky, ToneMapping,
};
use terrane::state::{TextureFormat, TextureObject};

const SIDE: u32 = 64;
/// The light that white surfaces reflect under [`bright`].
const LIGHT: f32 = 8.0;

fn rig_of(samples: u32) -> Option<Rig> {
    rig_with(&ContextTraits { samples, validation: true, ..traits([SIDE; 2]) })
}

/// Returns a black background and a sun that gives surfaces that face +z a light of 8.
fn bright(tone_mapping: ToneMapping) -> Environment {
    Environment {
        sun_direction: DVec3::Z,
        sun_color: [LIGHT; 3],
        ambient_color: [0.0; 3],
        sky: Sky::Background([0; 3]),
        exposure: Some(1.0),
        tone_mapping,
        ..plain()
    }
}

/// Returns a lit square that covers x from an edge to the right.
fn lit(edge: f32, base_color: [f32; 4]) -> Drawable {
    let mut square = quad([edge + 1.0, 0.0, 0.0], [1.0, 1.0], [1.0; 4]);
    square.material.unlit = false;
    square.material.base_color = base_color;
    if base_color[3] < 1.0 {
        square.material.alpha = AlphaMode::Blend;
    }
    square
}

fn picture(rig: &mut Rig, nodes: Vec<Node>, environment: &Environment) -> RgbaImage {
    let scene = rig.scene(Node::group(nodes));
    let picture = rig.picture(&scene, &unit_camera(SIDE), environment);
    rig.release(scene);
    assert!(rig.renderer.take_errors().is_empty());
    picture
}

/// Returns the greatest difference of two pictures in a channel.
fn difference(a: &RgbaImage, b: &RgbaImage) -> u8 {
    a.iter().zip(b.iter()).map(|(a, b)| a.abs_diff(*b)).max().unwrap()
}

/// Half of a pixel is 8, half of it black. Mapped before the mean of the samples is taken, the pixel is half of white; its
/// light is 4, which is nearly white.
#[test]
fn samples_are_averaged_as_light_before_tones_are_mapped() {
    let Some(mut rig) = rig_of(4) else { return };
    // Two of the four samples are on either side of the pixel's middle.
    let edge = 2.0 * (SIDE as f32 / 2.0 + 0.5) / SIDE as f32 - 1.0;
    let [in_shaders, in_own_pass] = [ToneMapping::InShaders, ToneMapping::InOwnPass]
        .map(|tone_mapping| picture(&mut rig, vec![Node::geode(vec![lit(edge, [1.0; 4])])], &bright(tone_mapping)));
    let row = |picture: &RgbaImage| [20, SIDE / 2, 50].map(|x| pixel(picture, x, 32)[0]);
    let ([dark, mean, white], [dark_light, mean_of_light, white_light]) = (row(&in_shaders), row(&in_own_pass));
    assert_eq!((dark, dark_light), (0, 0));
    assert!(white >= 253 && white.abs_diff(white_light) <= 1, "{white} {white_light}");
    assert!((180..196).contains(&mean), "half of white: {mean}");
    assert!(mean_of_light >= 250, "a light of 4: {mean_of_light}");
}

#[test]
fn light_is_blended_before_tones_are_mapped() {
    let Some(mut rig) = rig_of(1) else { return };
    // A black glass over a light of 8, which lets a quarter through.
    let glass = || {
        let mut glass = lit(-1.0, [0.0, 0.0, 0.0, 0.75]);
        if let terrane::scene::Geometry::Mesh(mesh) = &mut glass.geometry {
            let mut nearer = terrane::scene::Mesh::clone(mesh);
            nearer.vertices.iter_mut().for_each(|vertex| vertex.position[2] = 0.1);
            *mesh = Arc::new(nearer);
        }
        glass
    };
    let [in_shaders, in_own_pass] = [ToneMapping::InShaders, ToneMapping::InOwnPass].map(|tone_mapping| {
        let nodes = vec![Node::geode(vec![lit(-1.0, [1.0; 4]), glass()])];
        pixel(&picture(&mut rig, nodes, &bright(tone_mapping)), 32, 32)[0]
    });
    assert!((130..145).contains(&in_shaders), "a quarter of white: {in_shaders}");
    // A light of 2: 1 - 0.24^2 / (2 - 0.52).
    assert!(in_own_pass.abs_diff(251) <= 2, "{in_own_pass}");
}

/// Both ways show the same where nothing is blended and pixels have one sample.
#[test]
fn own_pass_shows_the_same_as_shaders_without_blending() {
    let Some(mut rig) = rig_of(1) else { return };
    let balls = || {
        let lit_ball = |x: f64, base_color: [f32; 4]| {
            let mut ball = ball(DVec3::new(x, 0.0, 0.0), 0.4, base_color);
            if let terrane::scene::NodeKind::Geode(drawables) = &mut ball.children[0].kind {
                drawables[0].material.unlit = false;
            }
            ball
        };
        let unlit = ball(DVec3::new(0.0, 0.6, 0.0), 0.3, [0.7, 0.2, 0.0, 1.0]);
        vec![lit_ball(-0.5, [1.0, 0.4, 0.1, 1.0]), lit_ball(0.5, [0.2, 0.2, 0.2, 1.0]), unlit]
    };
    for sky in [Sky::Background([200, 90, 10]), Sky::Atmosphere] {
        let environment = |tone_mapping| Environment { sky, tone_mapping, ..Environment::default() };
        let [in_shaders, in_own_pass] = [ToneMapping::InShaders, ToneMapping::InOwnPass]
            .map(|tone_mapping| picture(&mut rig, balls(), &environment(tone_mapping)));
        assert!(in_shaders.pixels().collect::<std::collections::HashSet<_>>().len() > 100);
        let differs = difference(&in_shaders, &in_own_pass);
        assert!(differs <= 2, "{differs} under {sky:?}");
    }
}

#[test]
fn float_textures_of_cameras_get_light_beyond_white() {
    let Some(mut rig) = rig_of(1) else { return };
    for (format, samples) in [(TextureFormat::Rgba16Float, 1), (TextureFormat::Rgba16Float, 4)] {
        let texture = TextureObject::target("light", [SIDE; 2], format);
        let sink: Arc<PictureSink> = Arc::default();
        let colors = vec![Attachment::new(texture.clone())];
        let target = CameraTarget { colors, read_back: Some(sink.clone()), samples, ..CameraTarget::default() };
        let view = unit_camera(SIDE);
        let mut node = CameraNode::to_texture(texture, view.eye_from_world, view.clip_from_eye);
        node.target = Some(Arc::new(target));
        let root = Node::camera(node, vec![Node::geode(vec![lit(0.0, [1.0, 0.5, 0.25, 1.0])])]);
        let scene = rig.scene(root);
        let read = (0..40).find_map(|_| {
            rig.draw(&scene, &view, &bright(ToneMapping::InShaders));
            sink.take()
        });
        let read = read.unwrap();
        assert_eq!(read.format, format);
        let at = 8 * (32 * SIDE as usize + 48);
        let halves: Vec<u16> = read.texels[at..at + 8].chunks(2).map(|h| u16::from_le_bytes([h[0], h[1]])).collect();
        // 8, 4, 2 and 1 in half floats, to the last bits.
        for (half, expected) in halves.iter().zip([0x4800u16, 0x4400, 0x4000, 0x3c00]) {
            assert!(half.abs_diff(expected) <= 4, "{halves:x?} with {samples} samples");
        }
        rig.release(scene);
    }
}

/// Regression: colours were written without encoding, so that everything was too dark.
#[test]
fn targets_without_srgb_get_the_same_bytes() {
    for samples in [1, 4] {
        let Some(mut rig) = rig_of(samples) else { return };
        let nodes = || {
            let glass = lit(0.2, [0.1, 0.3, 0.9, 0.5]);
            let balls = [0.9, 0.3, 0.02].into_iter().enumerate();
            let balls = balls.map(|(i, c)| ball(DVec3::new(i as f64 * 0.6 - 0.6, -0.4, 0.2), 0.25, [c, c * c, c, 1.0]));
            balls.chain([Node::geode(vec![glass])]).collect::<Vec<_>>()
        };
        for tone_mapping in [ToneMapping::InShaders, ToneMapping::InOwnPass] {
            let environment = Environment { tone_mapping, ..Environment::default() };
            rig.ctx.pretend_format(wgpu::TextureFormat::Rgba8UnormSrgb);
            let encoded_by_adapter = picture(&mut rig, nodes(), &environment);
            for format in [wgpu::TextureFormat::Rgba8Unorm, wgpu::TextureFormat::Bgra8Unorm] {
                rig.ctx.pretend_format(format);
                let encoded_by_shader = picture(&mut rig, nodes(), &environment);
                let differs = difference(&encoded_by_adapter, &encoded_by_shader);
                assert!(differs <= 1, "{differs} in {format:?} with {samples} samples, {tone_mapping:?}");
            }
            assert!(count(&encoded_by_adapter, [0; 3]) < 1000, "a sky and balls");
        }
    }
}

/// Two views with different exposures side by side, the second of which is drawn over the first one's image.
#[test]
fn each_view_has_its_own_tones() {
    let Some(mut rig) = rig_of(4) else { return };
    let scene = rig.scene(Node::geode(vec![lit(-1.0, [0.05, 0.05, 0.05, 1.0])]));
    let view = terrane::cull::CullCamera { viewport_px: [SIDE / 2, SIDE], ..unit_camera(SIDE) };
    let mut shown = Vec::new();
    for tone_mapping in [ToneMapping::InShaders, ToneMapping::InOwnPass] {
        let environments = [1.0, 0.25].map(|exposure| Environment { exposure: Some(exposure), ..bright(tone_mapping) });
        let stages = [0, SIDE / 2].map(|left| {
            let mut stage = terrane::cull::RenderStage::new();
            rig.visitor.environment = None;
            rig.visitor.cull(&scene, &view, &mut stage);
            stage.target.viewport_px = Some([left, 0, SIDE / 2, SIDE]);
            stage
        });
        let views = stages.iter().zip(&environments);
        let views = views.map(|(stage, environment)| terrane::draw::CameraView { stage, environment });
        rig.renderer.draw_views(&mut rig.ctx, views).unwrap();
        let picture = rig.read_back();
        shown.push([16, 48].map(|x| pixel(&picture, x, 32)[0]));
    }
    // 0.4 and 0.1 of white.
    assert!(shown[0][0].abs_diff(168) <= 2 && shown[0][1].abs_diff(89) <= 2, "{shown:?}");
    assert!(shown[0].iter().zip(&shown[1]).all(|(a, b)| a.abs_diff(*b) <= 1), "{shown:?}");
    rig.release(scene);
}

#[test]
#[ignore = "measures: cargo test --workspace --test draw tone_mapping_cost -- --ignored --nocapture"]
fn tone_mapping_cost() {
    for samples in [1, 4] {
        let Some(mut rig) = rig_of(samples) else { return };
        let scene = rig.scene(Node::group((0..30).map(|i| ball(DVec3::X * f64::from(i), 0.7, [0.5; 4])).collect()));
        let seen = camera([1280, 720], DVec3::new(5.0, -20.0, 6.0), DVec3::new(10.0, 0.0, 0.0), DVec3::Z);
        let mut times = [Vec::new(), Vec::new()];
        for _ in 0..30 {
            for (times, tone_mapping) in times.iter_mut().zip([ToneMapping::InShaders, ToneMapping::InOwnPass]) {
                let start = std::time::Instant::now();
                rig.picture(&scene, &seen, &Environment { tone_mapping, ..Environment::default() });
                times.push(start.elapsed());
            }
        }
        let [in_shaders, in_own_pass] = times.map(|mut times| {
            times.sort();
            times[times.len() / 2]
        });
        println!("{samples} samples, 1280 x 720: {in_shaders:?} in shaders, {in_own_pass:?} in its own pass");
    }
}
