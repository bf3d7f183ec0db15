//! Values that are written to attachments: masks with alpha, blending and masks of single attachments, constant alpha, samples, and
//! invisible fragments of transparent bins.

use std::sync::Arc;

use kit::frames::pixel;
use kit::rig::{Rig, plain, rig, unit_camera};
use kit::shapes::quad;
use terrane::cull::CullCamera;
use terrane::scene::{Attachment, CameraNode, CameraTarget, Node, PictureSink};
use terrane::state::{
    Attribute, BinDetails, BlendEquation, BlendFactor, BlendFunc, ColorMask, Depth, Program, SampleMask, SortMode,
    StateSet, StateValue, TextureFormat, TextureObject,
};

const SIDE: u32 = 16;
const BEFORE: [f32; 4] = [0.2, 0.4, 0.6, 0.8];
const DRAWN: [f32; 4] = [0.9, 0.7, 0.5, 0.3];

/// A program that writes the same color to all attachments.
fn all_locations() -> Attribute {
    let members: String = (0..8).map(|i| format!("@location({i}) c{i}: vec4<f32>, ")).collect();
    let [r, g, b, a] = DRAWN;
    let values = vec![format!("vec4<f32>({r:?}, {g:?}, {b:?}, {a:?})"); 8].join(", ");
    let wgsl = format!(
        "struct Out {{ {members} }}
        @vertex fn vs_main(vertex: MeshVertex, @builtin(instance_index) i: u32) -> @builtin(position) vec4<f32> {{
            return frame.clip_from_eye * vec4<f32>(point_in_eye(leaves[i], vertex.position), 1.0);
        }}
        @fragment fn fs_main() -> Out {{ return Out({values}); }}"
    );
    Attribute::Program(Program::new("all locations", &wgsl))
}

/// Returns the middle pixel of eight attachments after a square was drawn under a state set, or some draws under several.
fn drawn(rig: &mut Rig, sets: Vec<StateSet>) -> [[f32; 4]; 8] {
    let view = unit_camera(SIDE);
    let textures: Vec<_> =
        (0..8).map(|i| TextureObject::target(&format!("color {i}"), [SIDE; 2], TextureFormat::Rgba8)).collect();
    let sinks: Vec<Arc<PictureSink>> = (0..8).map(|_| Arc::default()).collect();
    let target = CameraTarget {
        colors: textures.iter().map(|texture| Attachment::new(texture.clone())).collect(),
        samples: 1,
        read_back: Some(sinks[0].clone()),
        read_back_of: (1..8).map(|i| (i, sinks[i].clone())).collect(),
        ..CameraTarget::default()
    };
    let mut camera = CameraNode::to_texture(textures[0].clone(), view.eye_from_world, view.clip_from_eye);
    (camera.target, camera.clear_color) = (Some(Arc::new(target)), Some(BEFORE));
    let squares = sets.into_iter().map(|set| {
        Node::geode(vec![quad([0.0; 3], [0.5; 2], [1.0; 4])]).with_state_set(Arc::new(set.with(all_locations())))
    });
    let scene = rig.scene(Node::camera(camera, squares.collect()));
    let mut found = [None; 8];
    for frame in 1..300 {
        rig.draw(&scene, &CullCamera { frame, ..view }, &plain());
        for (found, sink) in found.iter_mut().zip(&sinks) {
            if let Some(picture) = sink.take() {
                let at = 4 * (SIDE / 2 * SIDE + SIDE / 2) as usize;
                *found = Some(std::array::from_fn(|i| f32::from(picture.texels[at + i]) / 255.0));
            }
        }
        if found.iter().all(Option::is_some) {
            break;
        }
    }
    rig.release(scene);
    let errors = rig.renderer.take_errors();
    assert!(errors.is_empty(), "{errors:?}");
    found.map(|found| found.expect("each attachment is read back"))
}

fn assert_near(got: [f32; 4], expected: [f32; 4], what: &str) {
    let is_near = got.iter().zip(expected).all(|(got, expected)| (got - expected).abs() < 0.01);
    assert!(is_near, "{what}: {got:?} instead of {expected:?}");
}

#[test]
fn eight_attachments_blend_and_mask_each_by_itself() {
    let Some(mut rig) = rig("eight_attachments_blend_and_mask_each_by_itself") else { return };
    use BlendFactor::{One, SrcAlpha, Zero};
    let set = StateSet::default()
        .with(Attribute::BlendFunc(BlendFunc::ALPHA))
        .with(Attribute::BlendFuncOf(1, BlendFunc::new(One, One)))
        .with(Attribute::BlendFuncOf(2, BlendFunc::new(One, Zero)))
        .with(Attribute::BlendEquationOf(3, BlendEquation::Max))
        .with(Attribute::BlendFuncOf(4, BlendFunc::new(SrcAlpha, Zero).with_alpha(Zero, One)))
        .with(Attribute::ColorMaskOf(5, ColorMask([true, false, true, false])))
        .with(Attribute::ColorMaskOf(7, ColorMask([false; 4])));
    let got = drawn(&mut rig, vec![set]);
    let each = |of: &dyn Fn(f32, f32) -> f32| -> [f32; 4] { std::array::from_fn(|i| of(DRAWN[i], BEFORE[i]).min(1.0)) };
    let alpha = DRAWN[3];
    let mixed = each(&|s, d| s * alpha + d * (1.0 - alpha));
    assert_near(got[0], mixed, "the function of all");
    assert_near(got[1], each(&|s, d| s + d), "added");
    assert_near(got[2], DRAWN, "not blended");
    assert_near(got[3], each(&f32::max), "the greater one");
    let [r, g, b, _] = each(&|s, _| s * alpha);
    assert_near(got[4], [r, g, b, BEFORE[3]], "alpha apart");
    assert_near(got[5], [mixed[0], BEFORE[1], mixed[2], BEFORE[3]], "masked");
    assert_near(got[6], mixed, "the function of all");
    assert_near(got[7], BEFORE, "not written");
}

#[test]
fn masks_include_alpha() {
    let Some(mut rig) = rig("masks_include_alpha") else { return };
    let mask = |mask| vec![StateSet::default().with(Attribute::ColorMask(ColorMask(mask)))];
    assert_near(drawn(&mut rig, mask([true, true, true, false]))[0], [0.9, 0.7, 0.5, 0.8], "alpha is kept");
    assert_near(drawn(&mut rig, mask([false, true, false, true]))[3], [0.2, 0.7, 0.6, 0.3], "green and alpha");
}

#[test]
fn constant_alpha_weights_colors() {
    let Some(mut rig) = rig("constant_alpha_weights_colors") else { return };
    use BlendFactor::{ConstantAlpha, ConstantColor, OneMinusConstantAlpha};
    let constant = [0.1, 0.2, 0.3, 0.25];
    let set = |func| vec![StateSet::default().with(Attribute::BlendFunc(func)).with(Attribute::BlendColor(constant))];
    let by_alpha = BlendFunc::new(ConstantAlpha, OneMinusConstantAlpha);
    let expected = std::array::from_fn(|i| 0.25 * DRAWN[i] + 0.75 * BEFORE[i]);
    assert_near(drawn(&mut rig, set(by_alpha))[0], expected, "by the alpha of the constant");
    let by_color = BlendFunc::new(ConstantColor, BlendFactor::Zero).with_alpha(ConstantAlpha, BlendFactor::Zero);
    let expected = std::array::from_fn(|i| constant[i] * DRAWN[i]);
    assert_near(drawn(&mut rig, set(by_color))[0], expected, "alpha by alpha is no conflict");
    // A state that needs both constants is reported.
    let both = set(BlendFunc::new(ConstantColor, ConstantAlpha)).remove(0);
    let scene = rig.scene(Node::geode(vec![quad([0.0; 3], [0.5; 2], DRAWN)]).with_state_set(Arc::new(both)));
    rig.draw(&scene, &unit_camera(SIDE), &plain());
    rig.release(scene);
    let errors = rig.renderer.take_errors();
    assert!(matches!(&errors[..], [e] if e.contains("ConstantAlpha")), "{errors:?}");
}

#[test]
fn sample_masks_leave_a_share_of_the_background() {
    let Some(mut rig) = rig("sample_masks_leave_a_share_of_the_background") else { return };
    let mut with = |mask, samples, on| {
        let view = unit_camera(SIDE);
        let texture = TextureObject::target("samples", [SIDE; 2], TextureFormat::Rgba8);
        let sink = Arc::new(PictureSink::default());
        let mut camera = CameraNode::to_texture(texture.clone(), view.eye_from_world, view.clip_from_eye);
        let colors = vec![Attachment::new(texture)];
        let target = CameraTarget { colors, samples, read_back: Some(sink.clone()), ..CameraTarget::default() };
        (camera.target, camera.clear_color) = (Some(Arc::new(target)), Some([0.0, 0.0, 0.0, 1.0]));
        let mut set = StateSet::default();
        set.set_attribute_and_modes(Attribute::SampleMask(mask), on);
        let square = Node::geode(vec![quad([0.0; 3], [0.5; 2], [1.0; 4])]).with_state_set(Arc::new(set));
        let scene = rig.scene(Node::camera(camera, vec![square]));
        let picture = (1..200).find_map(|frame| {
            rig.draw(&scene, &CullCamera { frame, ..view }, &plain());
            sink.take()
        });
        rig.release(scene);
        let at = 4 * (SIDE / 2 * SIDE + SIDE / 2) as usize;
        (f32::from(picture.unwrap().texels[at]) / 255.0 * 4.0).round()
    };
    let on = StateValue::ON;
    assert_eq!(with(SampleMask::Bits(0b0001), 4, on), 1.0);
    assert_eq!(with(SampleMask::Bits(0b1011), 4, on), 3.0);
    assert_eq!(with(SampleMask::Bits(0b0001), 4, StateValue::OFF), 4.0);
    let share = |share, is_inverted| SampleMask::Coverage { share, is_inverted };
    assert_eq!(with(share(0.5, false), 4, on), 2.0);
    assert_eq!(with(share(0.25, true), 4, on), 3.0);
    assert_eq!(with(SampleMask::Bits(0), 1, on), 4.0, "without effect on one sample");
    let errors = rig.renderer.take_errors();
    assert!(errors.is_empty(), "{errors:?}");
}

#[test]
fn invisible_fragments_of_transparent_bins_hide_nothing() {
    let Some(mut rig) = rig("invisible_fragments_of_transparent_bins_hide_nothing") else { return };
    let rig = &mut *rig;
    let green = |number| {
        let bin = Some(BinDetails::new(number, SortMode::ByState));
        let set = StateSet { bin, ..StateSet::default() };
        Node::geode(vec![quad([0.0; 3], [0.5; 2], [0.0, 1.0, 0.0, 1.0])]).with_state_set(Arc::new(set))
    };
    let mut behind = |sort, alpha| {
        let bin = Some(BinDetails::new(10, sort));
        let set = StateSet { bin, ..StateSet::default() }
            .with(Attribute::BlendFunc(BlendFunc::ALPHA))
            .with(Attribute::Depth(Depth::default()));
        let pane = Node::geode(vec![quad([0.0, 0.0, 1.0], [0.5; 2], [1.0, 0.0, 0.0, alpha])]);
        let scene = rig.scene(Node::group(vec![pane.with_state_set(Arc::new(set)), green(11)]));
        let picture = rig.picture(&scene, &unit_camera(SIDE), &plain());
        rig.release(scene);
        pixel(&picture, SIDE / 2, SIDE / 2)
    };
    let (green, background) = ([0, 255, 0], [255, 0, 255]);
    assert_eq!(behind(SortMode::BackToFront, 0.0), green, "no depth was written");
    assert_eq!(behind(SortMode::BackToFront, 1.0), [255, 0, 0]);
    assert_eq!(behind(SortMode::TraversalOrder, 0.0), background, "other bins test nothing");
}
