//! Textures in compressed formats: they look like RGBA8 ones and take a quarter or an eighth of the memory.

use std::sync::Arc;

use basisu::{DecodeFlags, TargetFormat, Transcoder};
use image::RgbaImage;
use kit::compressed::{ETC1S_64, uastc_mosaic};
use kit::rig::{Rig, plain, rig, unit_camera};
use kit::shapes::quad;
use kit::skip::skipped;
use terrane::gpu::{AdapterChoice, CompileBudget, CompileOperation, ContextTraits, GraphicsContext};
use terrane::scene::{AlphaMode, BlockFormats, Drawable, MetallicRoughness, Node, TexelFormat, Texture};

/// The compressed formats, with the transcoder's names.
const FORMATS: [(TexelFormat, TargetFormat); 6] = [
    (TexelFormat::Bc1, TargetFormat::Bc1Rgb),
    (TexelFormat::Bc3, TargetFormat::Bc3Rgba),
    (TexelFormat::Bc7, TargetFormat::Bc7Rgba),
    (TexelFormat::Etc2Rgb, TargetFormat::Etc1Rgb),
    (TexelFormat::Etc2Rgba, TargetFormat::Etc2Rgba),
    (TexelFormat::Astc4x4, TargetFormat::Astc4x4Rgba),
];

/// Returns the formats that the adapter has; each other one is a skip.
fn formats_of(rig: &Rig) -> Vec<(TexelFormat, TargetFormat)> {
    let (has, lacks): (Vec<_>, Vec<_>) =
        FORMATS.into_iter().partition(|(format, _)| rig.ctx.block_formats().contains(BlockFormats::of(*format)));
    lacks.iter().for_each(|(format, _)| skipped(format!("{format:?} textures: {} lacks them", rig.ctx.adapter_name())));
    has
}

fn has_alpha(format: TexelFormat) -> bool {
    !matches!(format, TexelFormat::Bc1 | TexelFormat::Etc2Rgb)
}

fn texture(file: &[u8], format: TexelFormat, target: TargetFormat) -> Arc<Texture> {
    let transcoder = Transcoder::new(file).unwrap();
    let (width, height) = transcoder.base_dimensions();
    let level = |level| transcoder.transcode(level, target, DecodeFlags::NONE).unwrap();
    let mips = (0..transcoder.level_count()).map(level).collect();
    Arc::new(Texture { format, ..Texture::rgba8(width, height, mips) })
}

/// Returns blocks of different colours, another set on each level.
fn mosaic(size: [u32; 2], levels: u32) -> Vec<u8> {
    uastc_mosaic(size, levels, |[level, x, y]| {
        let part = |factor: u32| (40 + (level * 97 + x * 61 + y * 29) * factor % 200) as u8;
        [part(1), part(3), part(7), part(5)]
    })
}

fn square(texture: &Arc<Texture>, half: f32, alpha: AlphaMode) -> Drawable {
    let mut square = quad([0.0; 3], [half, half], [1.0; 4]);
    (square.material.texture, square.material.alpha) = (Some(texture.clone()), alpha);
    square
}

fn picture(rig: &mut Rig, drawable: Drawable) -> RgbaImage {
    let scene = rig.scene(Node::geode(vec![drawable]));
    let picture = rig.picture(&scene, &unit_camera(256), &plain());
    rig.release(scene);
    picture
}

/// Returns the mean and the largest difference of a channel.
fn difference(a: &RgbaImage, b: &RgbaImage) -> (f64, u8) {
    let differences = a.as_raw().iter().zip(b.as_raw()).map(|(a, b)| a.abs_diff(*b));
    let (sum, largest) = differences.fold((0.0, 0), |(sum, largest), d| (sum + f64::from(d), largest.max(d)));
    (sum / a.as_raw().len() as f64, largest)
}

#[test]
fn compressed_textures_look_like_uncompressed_ones() {
    let Some(mut rig) = rig("compressed_textures_look_like_uncompressed_ones") else { return };
    // The levels of the second image end in parts of blocks. The third has one level.
    let images = [("square", mosaic([64, 64], 7)), ("flat", mosaic([24, 12], 5)), ("ETC1S", ETC1S_64.to_vec())];
    for (format, target) in formats_of(&rig) {
        for (name, file) in &images {
            let alpha = if has_alpha(format) { AlphaMode::Blend } else { AlphaMode::Opaque };
            let (compressed, plain) =
                (texture(file, format, target), texture(file, TexelFormat::Rgba8, TargetFormat::Rgba32));
            for half in [0.5, 0.12, 0.03] {
                let [a, b] = [&compressed, &plain].map(|texture| picture(&mut rig, square(texture, half, alpha)));
                let (mean, largest) = difference(&a, &b);
                assert!(mean < 0.5 && largest <= 20, "{format:?} {name} {half}: mean {mean}, largest {largest}");
            }
        }
    }
    // Another image differs by more.
    let [a, b] = [mosaic([64, 64], 7), mosaic([64, 32], 7)].map(|file| {
        picture(&mut rig, square(&texture(&file, TexelFormat::Rgba8, TargetFormat::Rgba32), 0.5, AlphaMode::Opaque))
    });
    assert!(difference(&a, &b).0 > 2.0);
}

/// A normal map is linear: compressed numbers are not decoded as sRGB.
#[test]
fn compressed_maps_are_linear() {
    let Some(mut rig) = rig("compressed_maps_are_linear") else { return };
    let environment = terrane::scene::Environment { sun_color: [0.8; 3], ambient_color: [0.1; 3], ..plain() };
    let slanted = uastc_mosaic([16, 16], 5, |_| [208, 128, 225, 255]);
    for (format, target) in formats_of(&rig) {
        let pictures = [(format, target), (TexelFormat::Rgba8, TargetFormat::Rgba32)].map(|(format, target)| {
            let mut drawable = quad([0.0; 3], [0.5; 2], [0.5, 0.5, 0.5, 1.0]);
            let normal_map = Some(texture(&slanted, format, target));
            drawable.material.unlit = false;
            drawable.material.metallic_roughness =
                Some(MetallicRoughness { normal_map, ..MetallicRoughness::default() });
            let scene = rig.scene(Node::geode(vec![drawable]));
            let picture = rig.picture(&scene, &unit_camera(64), &environment);
            rig.release(scene);
            picture
        });
        let (_, largest) = difference(&pictures[0], &pictures[1]);
        assert!(largest <= 8, "{format:?}: {largest}");
    }
}

/// Uploads every format to wgpu's backend that executes nothing: sizes and copies are checked as for all adapters.
#[test]
fn uploads_of_every_format_are_valid() {
    let traits = ContextTraits { adapter: AdapterChoice::Noop, validation: true, ..ContextTraits::default() };
    let mut context = GraphicsContext::new_offscreen(&traits).unwrap();
    let all = BlockFormats { bc: true, etc2: true, astc: true };
    assert_eq!(context.block_formats(), all);
    for (format, target) in FORMATS {
        for (name, file) in [("square", mosaic([64, 64], 7)), ("flat", mosaic([24, 12], 5))] {
            for is_slow in [false, true] {
                let texture = texture(&file, format, target);
                let drawables = vec![square(&texture, 0.5, AlphaMode::Opaque)];
                context.compile(CompileOperation { ticket: 1, drawables });
                let budget = CompileBudget { bytes: if is_slow { 100 } else { u64::MAX }, ..CompileBudget::UNLIMITED };
                while context.pending_compiles() > 0 {
                    context.run_compiles(&budget);
                }
                let compiled = context.take_compiled().remove(0);
                assert!(compiled.errors.is_empty() && compiled.bytes >= texture.size_bytes(), "{format:?} {name}");
                let errors = context.take_device_errors();
                assert!(errors.is_empty(), "{format:?} {name}: {errors:?}");
                context.release(&compiled.slots);
                context.flush_released();
            }
        }
    }
}

#[test]
fn compressed_textures_count_a_quarter_or_an_eighth() {
    let Some(mut rig) = rig("compressed_textures_count_a_quarter_or_an_eighth") else { return };
    let file = mosaic([256, 256], 9);
    let mut used = |format, target| {
        let before = rig.ctx.bytes_in_use();
        let texture = texture(&file, format, target);
        let scene = rig.scene(Node::geode(vec![square(&texture, 0.5, AlphaMode::Opaque)]));
        let used = rig.ctx.bytes_in_use() - before;
        rig.release(scene);
        assert_eq!(rig.ctx.bytes_in_use(), before);
        // The mesh takes some too.
        assert!((texture.size_bytes()..texture.size_bytes() + 4096).contains(&used), "{format:?}: {used}");
        used as f64
    };
    let plain = used(TexelFormat::Rgba8, TargetFormat::Rgba32);
    for (format, target) in
        FORMATS.into_iter().filter(|(format, _)| matches!(format, TexelFormat::Bc1 | TexelFormat::Bc7))
    {
        let part = if format == TexelFormat::Bc1 { 8.0 } else { 4.0 };
        let ratio = plain / used(format, target);
        assert!((part - 0.8..=part).contains(&ratio), "{format:?}: {ratio}");
    }
}

#[test]
fn textures_that_the_adapter_cannot_sample_are_refused() {
    let Some(mut rig) = rig("textures_that_the_adapter_cannot_sample_are_refused") else { return };
    let before = rig.ctx.bytes_in_use();
    let good = texture(&mosaic([16, 16], 5), TexelFormat::Bc7, TargetFormat::Bc7Rgba);
    let changed = |change: fn(&mut Texture)| {
        let mut texture = Texture::clone(&good);
        change(&mut texture);
        Arc::new(texture)
    };
    let mut wrong = vec![
        (changed(|t| t.mips[1].truncate(48)), "level 1"),
        (changed(|t| t.mips[4].push(0)), "level 4"),
        (changed(|t| t.format = TexelFormat::Bc1), "level 0"),
        (changed(|t| t.format = TexelFormat::Rgba8), "level 0"),
        (changed(|t| t.width = 14), "4x4"),
        (changed(|t| t.mips.push(vec![0; 16])), "levels"),
    ];
    if rig.ctx.block_formats().astc {
        skipped("a format that the adapter lacks: it has all");
    } else {
        wrong.push((changed(|t| t.format = TexelFormat::Astc4x4), "cannot sample"));
    }
    for (texture, why) in wrong {
        let compiled = rig.compile(vec![square(&texture, 0.5, AlphaMode::Opaque)]);
        assert_eq!(compiled.errors.len(), 1, "{texture:?}");
        assert!(compiled.errors[0].contains(why), "{:?}", compiled.errors);
        rig.ctx.release(&compiled.slots);
        rig.ctx.flush_released();
    }
    assert_eq!(rig.ctx.bytes_in_use(), before);
}
