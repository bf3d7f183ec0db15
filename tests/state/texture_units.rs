//! Texture units of the fixed function in pixels: environments and combinations, matrices, borders.

use std::sync::Arc;

use crate::lighting::*;
use kit::frames::pixel;
use kit::rig::{Rig, plain, rig, unit_camera};
use kit::shapes::quad;
use terrane::state::{
    AlphaFunc, Attribute, CombineFunction, CombineOperand, CombineSource, CompareFunction, FilterMode, Sampler,
    StateSet, TexEnv, TexEnvCombine, TextureBinding, TextureFormat, TextureObject, WrapMode,
};

/// The color of the square, of the texture in unit 0 and of that in unit 1.
const COLOR: [f32; 4] = [0.8, 0.4, 0.2, 0.6];
const FIRST: [u8; 4] = [51, 204, 128, 153];
const SECOND: [u8; 4] = [230, 26, 77, 102];
const CONSTANT: [f32; 4] = [0.1, 0.7, 0.3, 0.5];

/// Returns a texture of one texel of linear values.
fn texel(color: [u8; 4]) -> TextureBinding {
    let image = TextureObject::image("texel", [1, 1], color.to_vec());
    TextureBinding::new(Arc::new(TextureObject { format: TextureFormat::Rgba8, ..(*image).clone() }))
}

/// Returns the pixel of a square under two textures with their environments.
fn shown(rig: &mut Rig, first: TexEnv, second: Option<TexEnv>) -> [u8; 3] {
    let mut set = unlit().with(Attribute::Texture(0, texel(FIRST))).with(Attribute::TexEnv(0, first));
    if let Some(second) = second {
        set = set.with(Attribute::Texture(1, texel(SECOND))).with(Attribute::TexEnv(1, second));
    }
    middle(rig, vec![node(square(COLOR), set)])
}

fn unit(color: [u8; 4]) -> [f32; 4] {
    color.map(|c| f32::from(c) / 255.0)
}

#[test]
fn environments_equal_the_formulas_of_opengl() {
    let Some(mut rig) = rig("environments_equal_the_formulas_of_opengl") else { return };
    let rig = &mut *rig;
    let (c, t) = (COLOR, unit(FIRST));
    let each = |of: &dyn Fn(usize) -> f32| [0, 1, 2].map(|i| of(i).clamp(0.0, 1.0));
    for (env, expected) in [
        (TexEnv::Modulate, each(&|i| c[i] * t[i])),
        (TexEnv::Decal, each(&|i| c[i] * (1.0 - t[3]) + t[i] * t[3])),
        (TexEnv::Blend(CONSTANT), each(&|i| c[i] * (1.0 - t[i]) + CONSTANT[i] * t[i])),
        (TexEnv::Replace, each(&|i| t[i])),
        (TexEnv::Add, each(&|i| c[i] + t[i])),
    ] {
        assert_near(shown(rig, env, None), expected, &format!("{env:?}"));
    }
}

#[test]
fn combinations_have_any_function_source_and_operand() {
    let Some(mut rig) = rig("combinations_have_any_function_source_and_operand") else { return };
    let rig = &mut *rig;
    use CombineFunction::*;
    use CombineOperand::*;
    use CombineSource::*;
    let (c, t, u) = (COLOR, unit(FIRST), unit(SECOND));
    let previous: [f32; 4] = std::array::from_fn(|i| c[i] * t[i]);
    let value = |(source, operand): (CombineSource, CombineOperand), i: usize| {
        let color = match source {
            Texture | TextureOf(1) => u,
            Constant => CONSTANT,
            PrimaryColor => c,
            Previous => previous,
            TextureOf(0) => t,
            TextureOf(_) => [1.0; 4],
        };
        match operand {
            Color => color[i],
            OneMinusColor => 1.0 - color[i],
            Alpha => color[3],
            OneMinusAlpha => 1.0 - color[3],
        }
    };
    let functions = [Modulate, Replace, Add, AddSigned, Interpolate, Subtract, Dot3Rgb, Dot3Rgba];
    let sources = [Texture, Constant, PrimaryColor, Previous, TextureOf(0), TextureOf(2), TextureOf(9)];
    let operands = [Color, OneMinusColor, Alpha, OneMinusAlpha];
    for n in 0..functions.len() * sources.len() {
        let argument = |k: usize| (sources[(n + 3 * k) % sources.len()], operands[(n / 3 + k) % operands.len()]);
        let color_arguments = [argument(0), argument(1), argument(2)];
        let color_scale = [1.0, 2.0, 0.5][n % 3];
        let function = functions[n % functions.len()];
        let env = TexEnvCombine {
            color: function,
            color_arguments,
            color_scale,
            constant: CONSTANT,
            ..TexEnvCombine::default()
        };
        let [x, y, z] = color_arguments.map(|argument| [0, 1, 2].map(|i| value(argument, i)));
        let dot = 4.0 * (0..3).map(|i| (x[i] - 0.5) * (y[i] - 0.5)).sum::<f32>();
        let expected = [0, 1, 2].map(|i| {
            let result = match function {
                Modulate => x[i] * y[i],
                Replace => x[i],
                Add => x[i] + y[i],
                AddSigned => x[i] + y[i] - 0.5,
                Interpolate => x[i] * z[i] + y[i] * (1.0 - z[i]),
                Subtract => x[i] - y[i],
                Dot3Rgb | Dot3Rgba => dot,
            };
            (color_scale * result).clamp(0.0, 1.0)
        });
        let got = shown(rig, TexEnv::Modulate, Some(TexEnv::Combine(env)));
        assert_near(got, expected, &format!("{env:?}"));
    }
}

#[test]
fn alpha_is_combined_apart_from_color() {
    let Some(mut rig) = rig("alpha_is_combined_apart_from_color") else { return };
    let rig = &mut *rig;
    use CombineOperand::*;
    use CombineSource::*;
    let mut alpha_of = |alpha, alpha_arguments, color| {
        let env = TexEnvCombine { alpha, alpha_arguments, color, constant: CONSTANT, ..TexEnvCombine::default() };
        let mut passes = |reference| {
            let set = unlit()
                .with(Attribute::Texture(0, texel(FIRST)))
                .with(Attribute::TexEnv(0, TexEnv::Combine(env)))
                .with(Attribute::AlphaFunc(AlphaFunc { function: CompareFunction::Greater, reference }));
            middle(rig, vec![node(square(COLOR), set)]) != [255, 0, 255]
        };
        // The alpha lies between the two references.
        (0..20).find(|step| !passes(*step as f32 * 0.05)).map_or(1.0, |step| step as f32 * 0.05 - 0.025)
    };
    let arguments = [(Texture, Alpha), (Previous, OneMinusAlpha), (Constant, Color)];
    let (t, p, c) = (FIRST[3] as f32 / 255.0, 1.0 - COLOR[3], CONSTANT[3]);
    for (function, expected) in [
        (CombineFunction::Replace, t),
        (CombineFunction::Modulate, t * p),
        (CombineFunction::Add, t + p),
        (CombineFunction::Subtract, t - p),
        (CombineFunction::Interpolate, t * c + p * (1.0 - c)),
    ] {
        let got = alpha_of(function, arguments, CombineFunction::Modulate);
        assert!((got - expected.clamp(0.0, 1.0)).abs() <= 0.03, "{function:?}: {got} instead of {expected}");
    }
    let dot = alpha_of(CombineFunction::Replace, arguments, CombineFunction::Dot3Rgba);
    let first = unit(FIRST);
    let expected = 4.0 * (0..3).map(|i| (COLOR[i] - 0.5) * (first[i] - 0.5)).sum::<f32>();
    assert!((dot - expected.clamp(0.0, 1.0)).abs() <= 0.03, "{dot} instead of {expected}");
}

#[test]
fn matrices_move_coordinates() {
    let Some(mut rig) = rig("matrices_move_coordinates") else { return };
    let rig = &mut *rig;
    let corners =
        |picture: &image::RgbaImage| [(20, 20), (44, 20), (20, 44), (44, 44)].map(|(x, y)| pixel(picture, x, y));
    let quarters = || unlit().with(Attribute::Texture(0, nearest(quarters())));
    let mut moved = |matrix: glam::Mat4| {
        let set = quarters().with(Attribute::TexMat(0, matrix.to_cols_array_2d()));
        corners(&draw(rig, vec![node(square(WHITE), set)]))
    };
    let white = [255; 3];
    assert_eq!(moved(glam::Mat4::IDENTITY), [RED, GREEN, BLUE, white]);
    let half = glam::Mat4::from_translation(glam::Vec3::new(0.5, 0.0, 0.0));
    assert_eq!(moved(half), [GREEN, GREEN, white, white], "half a texture to the right, clamped");
    let swapped = glam::Mat4::from_cols_array_2d(&[
        [0.0, 1.0, 0.0, 0.0],
        [1.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, 1.0, 0.0],
        [0.0, 0.0, 0.0, 1.0],
    ]);
    assert_eq!(moved(swapped), [RED, BLUE, GREEN, white]);
    // The coordinates are divided by q.
    let quotient = glam::Mat4::from_diagonal(glam::Vec4::new(1.0, 1.0, 1.0, 4.0));
    assert_eq!(moved(quotient), [RED; 4]);
}

#[test]
fn borders_have_any_color() {
    let Some(mut rig) = rig("borders_have_any_color") else { return };
    let rig = &mut *rig;
    // The texture covers the middle half of the square along each axis with a border.
    let twice = glam::Mat4::from_translation(glam::Vec3::new(-0.5, -0.5, 0.0))
        * glam::Mat4::from_scale(glam::Vec3::new(2.0, 2.0, 1.0));
    let mut with = |wrap: [WrapMode; 3], border_color: [f32; 4]| {
        let nearest = FilterMode::Nearest;
        let sampler = Sampler {
            min_filter: nearest,
            mag_filter: nearest,
            mip_filter: nearest,
            wrap,
            border_color,
            ..Sampler::default()
        };
        let texture = TextureBinding { sampler, ..texel([0, 255, 0, 255]) };
        let set = unlit().with(Attribute::Texture(0, texture)).with(Attribute::TexMat(0, twice.to_cols_array_2d()));
        let picture = rig_picture(rig, set);
        [(32, 32), (18, 32), (32, 18)].map(|(x, y)| pixel(&picture, x, y))
    };
    let (border, edge) = (WrapMode::ClampToBorder, WrapMode::ClampToEdge);
    let both = [border, border, edge];
    assert_eq!(with(both, [1.0; 4]), [GREEN, [255; 3], [255; 3]], "a color of the adapter");
    assert_eq!(with(both, [1.0, 0.0, 0.0, 1.0]), [GREEN, RED, RED], "any other color");
    assert_eq!(with([border, edge, edge], [0.0, 0.0, 1.0, 1.0]), [GREEN, BLUE, GREEN]);
    assert_eq!(with([edge, border, edge], [0.0, 0.0, 0.0, 1.0]), [GREEN, GREEN, [0; 3]]);
    let errors = rig.renderer.take_errors();
    assert!(errors.is_empty(), "{errors:?}");
}

fn rig_picture(rig: &mut Rig, set: StateSet) -> image::RgbaImage {
    let scene = rig.scene(node(quad([0.0; 3], [0.5; 2], WHITE), set));
    let picture = rig.picture(&scene, &unit_camera(SIDE), &plain());
    rig.release(scene);
    picture
}
