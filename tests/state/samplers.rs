//! Sampling of textures in state sets: filters, anisotropy, wrapping along each axis, biases, and the content of images
//! of floats. Needs a GPU; a software adapter suffices.

use std::sync::Arc;

use image::RgbaImage;
use kit::frames::{MAGENTA, pixel, srgb};
use kit::rig::{Rig, plain, rig, unit_camera};
use kit::shapes::quad;
use kit::skip::skipped;
use terrane::scene::Node;
use terrane::state::{
    Attribute, FilterMode, Mode, Program, Sampler, StateSet, StateValue, TexGen, TextureBinding, TextureDimension,
    TextureFormat, TextureObject, WrapMode,
};

const SIDE: u32 = 64;
const RED: [u8; 4] = [255, 0, 0, 255];
const GREEN: [u8; 4] = [0, 255, 0, 255];
const BLUE: [u8; 4] = [0, 0, 255, 255];

const FILTERS: [FilterMode; 2] = [FilterMode::Nearest, FilterMode::Linear];
const NEAREST: Sampler = Sampler {
    min_filter: FilterMode::Nearest,
    mag_filter: FilterMode::Nearest,
    mip_filter: FilterMode::Nearest,
    wrap: [WrapMode::ClampToEdge; 3],
    max_anisotropy: 1,
    mip_bias: 0.0,
    compare: None,
    border_color: [0.0; 4],
};

/// Returns the levels of an image, each with another pattern.
fn levels(size: [u32; 2], texel: impl Fn(u32, u32, u32) -> [u8; 4], levels: u32) -> Arc<TextureObject> {
    let of_level = |level: u32| {
        let [w, h] = size.map(|side| (side >> level).max(1));
        (0..h).flat_map(|y| (0..w).map(move |x| (x, y))).flat_map(|(x, y)| texel(level, x, y)).collect()
    };
    let first = TextureObject::image("levels", size, Vec::new());
    Arc::new(TextureObject { levels, texels: (0..levels).map(of_level).collect(), ..(*first).clone() })
}

fn unlit(texture: &Arc<TextureObject>, sampler: Sampler) -> StateSet {
    StateSet::default()
        .with_mode(Mode::Lighting, StateValue::OFF)
        .with(Attribute::Texture(0, TextureBinding { texture: texture.clone(), sampler }))
}

/// Returns a square over the middle half of the image, covered by a texture.
fn draw(rig: &mut Rig, set: StateSet) -> RgbaImage {
    let square = Node::geode(vec![quad([0.0; 3], [0.5; 2], [1.0; 4])]).with_state_set(Arc::new(set));
    let scene = rig.scene(square);
    let picture = rig.picture(&scene, &unit_camera(SIDE), &plain());
    rig.release(scene);
    let errors = rig.renderer.take_errors();
    assert!(errors.is_empty(), "{errors:?}");
    picture
}

/// Returns true if some of the square is a mixture of red and green.
fn has_mixtures(picture: &RgbaImage) -> bool {
    picture.pixels().any(|p| ![RED, GREEN].contains(&p.0) && p.0[..3] != MAGENTA)
}

#[test]
fn each_filter_smooths_its_kind() {
    let Some(mut rig) = rig("each_filter_smooths_its_kind") else { return };
    let stripes = |_: u32, x: u32, _: u32| if x.is_multiple_of(2) { RED } else { GREEN };
    let (few, many) = (levels([4, 1], stripes, 1), levels([128, 1], stripes, 1));
    // The square's 32 pixels need a level between the first and the second: 0.36.
    let two = levels([41, 41], |level, _, _| if level == 0 { RED } else { GREEN }, 2);
    for (min_filter, mag_filter, mip_filter) in
        FILTERS.into_iter().flat_map(|a| FILTERS.into_iter().flat_map(move |b| FILTERS.map(|c| (a, b, c))))
    {
        let sampler = Sampler { min_filter, mag_filter, mip_filter, ..NEAREST };
        let mut smooths = |texture| has_mixtures(&draw(&mut rig, unlit(texture, sampler)));
        let found = [smooths(&many), smooths(&few), smooths(&two)];
        let wanted = [min_filter, mag_filter, mip_filter].map(|of| of == FilterMode::Linear);
        assert_eq!(found, wanted, "smaller, larger, between levels: {sampler:?}");
    }
}

#[test]
fn anisotropy_keeps_detail_along_the_stretched_axis() {
    let Some(mut rig) = rig("anisotropy_keeps_detail_along_the_stretched_axis") else { return };
    // Each pixel has eight texels along s and one along t: level 3, or level 0 with eight samples.
    let texture = levels([256, 32], |level, _, _| [RED, BLUE, BLUE, GREEN, GREEN, GREEN][level.min(5) as usize], 9);
    let mut middle = |filter, max_anisotropy| {
        let sampler = Sampler {
            min_filter: filter,
            mag_filter: filter,
            mip_filter: filter,
            max_anisotropy,
            ..Sampler::default()
        };
        let [r, g, _] = pixel(&draw(&mut rig, unlit(&texture, sampler)), 32, 32);
        (r > 200, g > 200)
    };
    assert_eq!(middle(FilterMode::Linear, 1), (false, true), "without it");
    assert_eq!(middle(FilterMode::Nearest, 16), (false, true), "only with linear filters");
    assert_eq!(middle(FilterMode::Linear, 0), (false, true), "0 counts as 1");
    let sharp = middle(FilterMode::Linear, 16);
    // An adapter without it takes one sample.
    if sharp == (false, true) && !rig.ctx.adapter_name().contains("llvmpipe") {
        skipped("the adapter has no anisotropic filter");
        return;
    }
    assert_eq!(sharp, (true, false), "16 samples");
}

fn wrapped(mode: WrapMode, texel: i32) -> i32 {
    match mode {
        // Borders are tested with the texture units of the fixed function.
        WrapMode::ClampToEdge | WrapMode::ClampToBorder => texel.clamp(0, 1),
        WrapMode::Repeat => texel.rem_euclid(2),
        WrapMode::Mirror => [0, 1, 1, 0][texel.rem_euclid(4) as usize],
    }
}

/// All axes are tested by a program, because the fixed function has no third coordinate.
#[test]
fn each_axis_has_its_wrap_mode() {
    let Some(mut rig) = rig("each_axis_has_its_wrap_mode") else { return };
    let volume = Arc::new(TextureObject {
        name: "volume".into(),
        dimension: TextureDimension::D3,
        size: [2, 2, 2],
        format: TextureFormat::Rgba8,
        levels: 1,
        // Red, green and blue encode the position of the texel along s, t and r.
        texels: vec![(0..8u8).flat_map(|i| [255 * (i & 1), 255 * (i >> 1 & 1), 255 * (i >> 2), 255]).collect()],
        is_changing: false,
    });
    let wgsl = "
        @group(2) @binding(1) var volume: texture_3d<f32>;
        @group(2) @binding(2) var volume_sampler: sampler;
        struct V { @builtin(position) position: vec4<f32>, @location(0) uv: vec2<f32> }
        @vertex fn vs_main(vertex: MeshVertex, @builtin(instance_index) i: u32) -> V {
            return V(frame.clip_from_eye * vec4<f32>(point_in_eye(leaves[i], vertex.position), 1.0), vertex.uv);
        }
        @fragment fn fs_main(in: V) -> @location(0) vec4<f32> {
            let cell = floor(in.uv * 8.0);
            let texel = vec3<f32>(cell, (cell.x + 3.0 * cell.y) % 8.0) - 3.0;
            return textureSampleLevel(volume, volume_sampler, (texel + 0.5) / 2.0, 0.0);
        }";
    let program = Program::new("volume", wgsl);
    let modes = [WrapMode::ClampToEdge, WrapMode::Repeat, WrapMode::Mirror];
    for wrap in modes.into_iter().flat_map(|s| modes.into_iter().flat_map(move |t| modes.map(|r| [s, t, r]))) {
        let set = unlit(&volume, Sampler { wrap, ..NEAREST }).with(Attribute::Program(program.clone()));
        let picture = draw(&mut rig, set);
        for (x, y) in (0..8).flat_map(|y| (0..8).map(move |x| (x, y))) {
            let texel = [x - 3, y - 3, (x + 3 * y) % 8 - 3];
            let wanted: [u8; 3] = std::array::from_fn(|axis| 255 * wrapped(wrap[axis], texel[axis]) as u8);
            assert_eq!(pixel(&picture, 18 + 4 * x as u32, 18 + 4 * y as u32), wanted, "{wrap:?} at {texel:?}");
        }
    }
}

#[test]
fn planes_wrap_each_axis_in_the_fixed_function() {
    let Some(mut rig) = rig("planes_wrap_each_axis_in_the_fixed_function") else { return };
    let texels = [RED, GREEN, BLUE, [255; 4]].concat();
    let texture = TextureObject::image("quarters", [2, 2], texels.clone());
    // There are three copies in each direction, with the texture itself in the middle of the image.
    let coordinates = TexGen::ObjectLinear(TexGen::planes([3.0, 0.0, 0.0, 0.5], [0.0, -3.0, 0.0, 0.5]));
    let modes = [WrapMode::ClampToEdge, WrapMode::Repeat, WrapMode::Mirror];
    for (s, t) in modes.into_iter().flat_map(|s| modes.map(|t| (s, t))) {
        let set = unlit(&texture, Sampler { wrap: [s, t, WrapMode::Repeat], ..NEAREST });
        let picture = draw(&mut rig, set.with(Attribute::TexGen(0, coordinates)));
        for (x, y) in (0..6).flat_map(|y| (0..6).map(move |x| (x, y))) {
            let [row, column] = [wrapped(t, y - 2), wrapped(s, x - 2)];
            let at = 4 * (2 * row + column) as usize;
            let px = |cell: i32| 16 + (32 * cell as u32 + 16) / 6;
            assert_eq!(pixel(&picture, px(x), px(y)), texels[at..at + 3], "{s:?} {t:?} at {x}, {y}");
        }
    }
}

#[test]
fn biases_apply_to_the_fixed_function_and_programs_add_their_own() {
    let Some(mut rig) = rig("biases_apply_to_the_fixed_function_and_programs_add_their_own") else { return };
    let texture = levels([32, 32], |level, _, _| [RED, GREEN, BLUE][level as usize], 3);
    let by_program = |sample: &str| {
        let wgsl = format!(
            "@group(2) @binding(1) var levels: texture_2d<f32>;
            @group(2) @binding(2) var levels_sampler: sampler;
            struct V {{ @builtin(position) position: vec4<f32>, @location(0) uv: vec2<f32> }}
            @vertex fn vs_main(vertex: MeshVertex, @builtin(instance_index) i: u32) -> V {{
                return V(frame.clip_from_eye * vec4<f32>(point_in_eye(leaves[i], vertex.position), 1.0), vertex.uv);
            }}
            @fragment fn fs_main(in: V) -> @location(0) vec4<f32> {{ return {sample}; }}"
        );
        Attribute::Program(Program::new("levels", &wgsl))
    };
    let plain = by_program("textureSample(levels, levels_sampler, in.uv)");
    let biased = by_program("textureSampleBias(levels, levels_sampler, in.uv, 1.0)");
    for (mip_bias, seen) in [(0.0, RED), (1.0, GREEN), (2.0, BLUE)] {
        let set = || unlit(&texture, Sampler { mip_bias, ..NEAREST });
        let mut middle = |set| pixel(&draw(&mut rig, set), 32, 32);
        assert_eq!(middle(set()), seen[..3], "{mip_bias}");
        assert_eq!(middle(set().with(plain.clone())), RED[..3], "{mip_bias}: programs ignore it");
        assert_eq!(middle(set().with(biased.clone())), GREEN[..3], "{mip_bias}: programs add their own bias");
    }
}

/// Returns the sRGB value of a linear one.
#[test]
fn images_of_floats_keep_their_values() {
    let Some(mut rig) = rig("images_of_floats_keep_their_values") else { return };
    let object = |format, texels: Vec<u8>| {
        let image = TextureObject::image("floats", [2, 1], Vec::new());
        Arc::new(TextureObject { format, texels: vec![texels], ..(*image).clone() })
    };
    // 16-bit floats: 0.25, 0.5, 1 and 1; then 4, -2, 0.125 and 1.
    let halves: [u16; 8] = [0x3400, 0x3800, 0x3c00, 0x3c00, 0x4400, 0xc000, 0x3000, 0x3c00];
    let halves = object(TextureFormat::Rgba16Float, halves.iter().flat_map(|h| h.to_le_bytes()).collect());
    let singles = object(TextureFormat::R32Float, [0.3f32, -5.0e6].iter().flat_map(|f| f.to_le_bytes()).collect());
    let of_texels = "
        @group(2) @binding(1) var floats: texture_2d<f32>;
        @vertex fn vs_main(vertex: MeshVertex, @builtin(instance_index) i: u32) -> @builtin(position) vec4<f32> {
            return frame.clip_from_eye * vec4<f32>(point_in_eye(leaves[i], vertex.position), 1.0);
        }
        @fragment fn fs_main() -> @location(0) vec4<f32> {
            let texel = textureLoad(floats, vec2<i32>(1, 0), 0);
            return vec4<f32>(select(0.0, 1.0, all(texel == WANTED)), 0.0, 0.0, 1.0);
        }";
    let can_filter = rig.ctx.device().features().contains(wgpu::Features::FLOAT32_FILTERABLE);
    for (texture, seen, second) in [
        (&halves, [0.25, 0.5, 1.0], "vec4<f32>(4.0, -2.0, 0.125, 1.0)"),
        (&singles, [0.3, 0.0, 0.0], "vec4<f32>(-5.0e6, 0.0, 0.0, 1.0)"),
    ] {
        if texture.format == TextureFormat::R32Float && !can_filter {
            skipped("the adapter does not filter single floats");
            continue;
        }
        let picture = draw(&mut rig, unlit(texture, NEAREST));
        let wanted = seen.map(srgb);
        let got = pixel(&picture, 20, 32);
        assert!(got.iter().zip(wanted).all(|(g, w)| g.abs_diff(w) <= 1), "{:?}: {got:?}, {wanted:?}", texture.format);
        let program = Program::new("texels", &of_texels.replace("WANTED", second));
        let picture = draw(&mut rig, unlit(texture, NEAREST).with(Attribute::Program(program)));
        assert_eq!(pixel(&picture, 32, 32), RED[..3], "{:?}", texture.format);
    }
    // The sample is between two texels of 0 and 1.
    let ramp = object(TextureFormat::R32Float, [0.0f32, 1.0].iter().flat_map(|f| f.to_le_bytes()).collect());
    if can_filter {
        let picture = draw(&mut rig, unlit(&ramp, Sampler::default()));
        let [left, right] = [31, 32].map(|x| f32::from(pixel(&picture, x, 32)[0]));
        assert!(left < right && (left..=right).contains(&f32::from(srgb(0.5))), "{left} {right}");
    }
}
