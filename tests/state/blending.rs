//! Every factor and equation of blending, for color and alpha, compared with OpenGL's formulas. Needs a GPU; a software
//! adapter suffices.

use std::sync::Arc;

use kit::rig::{Rig, plain, rig, unit_camera};
use kit::shapes::quad;
use terrane::cull::CullCamera;
use terrane::scene::{Attachment, CameraNode, CameraTarget, Node, PictureSink};
use terrane::state::{
    Attribute, BlendEquation, BlendFactor, BlendFunc, Mode, StateSet, StateValue, TextureFormat, TextureObject,
};

const FACTORS: [BlendFactor; 15] = [
    BlendFactor::Zero,
    BlendFactor::One,
    BlendFactor::SrcColor,
    BlendFactor::OneMinusSrcColor,
    BlendFactor::SrcAlpha,
    BlendFactor::OneMinusSrcAlpha,
    BlendFactor::DstColor,
    BlendFactor::OneMinusDstColor,
    BlendFactor::DstAlpha,
    BlendFactor::OneMinusDstAlpha,
    BlendFactor::SrcAlphaSaturate,
    BlendFactor::ConstantColor,
    BlendFactor::OneMinusConstantColor,
    BlendFactor::ConstantAlpha,
    BlendFactor::OneMinusConstantAlpha,
];
/// The color that is drawn over [`BELOW`], with [`CONSTANT`]. The values of factors differ by at least 0.02 in one
/// component.
const ABOVE: [f32; 4] = [0.9, 0.35, 0.15, 0.7];
const BELOW: [f32; 4] = [0.2, 0.8, 0.4, 0.45];
const CONSTANT: [f32; 4] = [0.6, 0.05, 0.75, 0.22];

const SIDE: u32 = 64;
/// The number of squares along a side of the image, each with a separate function.
const ACROSS: usize = 5;

/// Returns the value of a component; alpha is the last.
fn factor(of: BlendFactor, component: usize) -> f32 {
    let (s, d, c) = (ABOVE[component], BELOW[component], CONSTANT[component]);
    match of {
        BlendFactor::Zero => 0.0,
        BlendFactor::One => 1.0,
        BlendFactor::SrcColor => s,
        BlendFactor::OneMinusSrcColor => 1.0 - s,
        BlendFactor::SrcAlpha => ABOVE[3],
        BlendFactor::OneMinusSrcAlpha => 1.0 - ABOVE[3],
        BlendFactor::DstColor => d,
        BlendFactor::OneMinusDstColor => 1.0 - d,
        BlendFactor::DstAlpha => BELOW[3],
        BlendFactor::OneMinusDstAlpha => 1.0 - BELOW[3],
        BlendFactor::SrcAlphaSaturate if component == 3 => 1.0,
        BlendFactor::SrcAlphaSaturate => ABOVE[3].min(1.0 - BELOW[3]),
        BlendFactor::ConstantColor => c,
        BlendFactor::OneMinusConstantColor => 1.0 - c,
        BlendFactor::ConstantAlpha => CONSTANT[3],
        BlendFactor::OneMinusConstantAlpha => 1.0 - CONSTANT[3],
    }
}

fn blended(func: BlendFunc, equation: BlendEquation) -> [f32; 4] {
    std::array::from_fn(|i| {
        let (of_source, of_destination) =
            if i == 3 { (func.source_alpha, func.destination_alpha) } else { (func.source, func.destination) };
        let (s, d) = (ABOVE[i] * factor(of_source, i), BELOW[i] * factor(of_destination, i));
        let value = match equation {
            BlendEquation::Add => s + d,
            BlendEquation::Subtract => s - d,
            BlendEquation::ReverseSubtract => d - s,
            BlendEquation::Min => ABOVE[i].min(BELOW[i]),
            BlendEquation::Max => ABOVE[i].max(BELOW[i]),
        };
        value.clamp(0.0, 1.0)
    })
}

/// Returns an image in which each square is blended by one of the cases, read with its alpha.
fn drawn(rig: &mut Rig, cases: &[(BlendFunc, BlendEquation)]) -> Vec<[u8; 4]> {
    let texture = TextureObject::target("blended", [SIDE; 2], TextureFormat::Rgba8);
    let sink = Arc::new(PictureSink::default());
    let view = unit_camera(SIDE);
    let mut camera = CameraNode::to_texture(texture.clone(), view.eye_from_world, view.clip_from_eye);
    camera.clear_color = Some(BELOW);
    let colors = vec![Attachment::new(texture)];
    let target = CameraTarget { colors, samples: 1, read_back: Some(sink.clone()), ..CameraTarget::default() };
    camera.target = Some(Arc::new(target));
    let center = |place: usize| (2.0 * place as f32 + 1.0) / ACROSS as f32 - 1.0;
    let squares = cases.iter().enumerate().map(|(at, (func, equation))| {
        let set = StateSet::default()
            .with(Attribute::BlendFunc(*func))
            .with(Attribute::BlendEquation(*equation))
            .with(Attribute::BlendColor(CONSTANT))
            .with_mode(Mode::Blend, StateValue::ON);
        let half = 0.5 / ACROSS as f32;
        let square = quad([center(at % ACROSS), center(at / ACROSS), 0.0], [half; 2], ABOVE);
        Node::geode(vec![square]).with_state_set(Arc::new(set))
    });
    let scene = rig.scene(Node::camera(camera, squares.collect()));
    let picture = (1..200).find_map(|frame| {
        rig.draw(&scene, &CullCamera { frame, ..unit_camera(SIDE) }, &plain());
        sink.take()
    });
    rig.release(scene);
    let errors = rig.renderer.take_errors();
    assert!(errors.is_empty(), "{errors:?}");
    let picture = picture.expect("an image is read back").texels;
    let px = |place: f32| (0.5 * (place + 1.0) * SIDE as f32) as usize;
    let at = |at: usize| (px(-center(at / ACROSS)) * SIDE as usize + px(center(at % ACROSS))) * 4;
    (0..cases.len()).map(|case| std::array::from_fn(|i| picture[at(case) + i])).collect()
}

#[test]
fn all_factors_and_equations_equal_opengl() {
    let Some(mut rig) = rig("all_factors_and_equations_equal_opengl") else { return };
    let of = |i: usize| FACTORS[i % FACTORS.len()];
    let shifts = [
        (BlendEquation::Add, 0),
        (BlendEquation::Add, 1),
        (BlendEquation::Add, 6),
        (BlendEquation::Subtract, 2),
        (BlendEquation::ReverseSubtract, 5),
        (BlendEquation::Min, 8),
        (BlendEquation::Max, 11),
    ];
    let cases = shifts.into_iter().flat_map(|(equation, shift)| {
        (0..FACTORS.len()).map(move |s| (BlendFunc::new(of(s), of(s + shift)), s, equation))
    });
    let cases = cases.map(|(func, s, equation)| (func.with_alpha(of(s + 5), of(2 * s + 8)), equation));
    // Colours are weighted with the constant's colour or with its alpha.
    let colors = [BlendFactor::ConstantColor, BlendFactor::OneMinusConstantColor];
    let alphas = [BlendFactor::ConstantAlpha, BlendFactor::OneMinusConstantAlpha];
    let has = |func: &BlendFunc, of: [BlendFactor; 2]| of.contains(&func.source) || of.contains(&func.destination);
    let cases: Vec<_> = cases.filter(|(func, _)| !(has(func, colors) && has(func, alphas))).collect();
    for cases in cases.chunks(ACROSS * ACROSS) {
        for ((func, equation), got) in cases.iter().zip(drawn(&mut rig, cases)) {
            let wanted = blended(*func, *equation).map(|v| 255.0 * v);
            let is_near = got.iter().zip(wanted).all(|(got, wanted)| (f32::from(*got) - wanted).abs() < 2.0);
            assert!(is_near, "{equation:?} of {func:?}: {got:?} instead of {wanted:?}");
        }
    }
}
