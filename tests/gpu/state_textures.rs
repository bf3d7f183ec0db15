//! Textures of state sets: uploaded in slices before the drawables of their page, with levels that the adapter computes, and
//! counted.

use std::sync::Arc;
use std::time::Duration;

use kit::frames::pixel;
use kit::rig::{Rig, plain, rig_with, traits, unit_camera};
use kit::shapes::quad;
use terrane::cull::CullVisitor;
use terrane::gpu::{CompileBudget, CompileOperation, ContextTraits};
use terrane::scene::{Node, Page, Scene};
use terrane::state::{
    Attribute, FilterMode, Mode, Program, Sampler, StateSet, StateValue, TextureBinding, TextureDimension,
    TextureFormat, TextureObject,
};

const SIDE: u32 = 64;

fn rig_of(compile_thread: bool) -> Option<Rig> {
    rig_with(&ContextTraits { compile_thread, validation: true, ..traits([SIDE; 2]) })
}

/// Returns a square over the whole picture that shows a texture.
fn shows(texture: &Arc<TextureObject>) -> Node {
    let set = StateSet::default()
        .with_mode(Mode::Lighting, StateValue::OFF)
        .with(Attribute::Texture(0, TextureBinding::new(texture.clone())));
    Node::geode(vec![quad([0.0; 3], [1.0; 2], [1.0; 4])]).with_state_set(Arc::new(set))
}

/// Uploads a page as the viewer does: its kinds are announced, then its drawables are queued. Returns the scene, the number
/// of calls that it took, and their bytes. No call uploads more than the budget.
fn upload(rig: &mut Rig, root: Node, budget_bytes: u64) -> (Scene, u32, u64) {
    let mut page = Page::from_node(root).unwrap();
    let mut scene = Scene::new();
    let kinds = scene.draw_kinds(None, &page);
    rig.renderer.prewarm(&mut rig.ctx, &kinds);
    rig.ctx.compile(CompileOperation { ticket: 7, drawables: page.take_drawables() });
    let budget = CompileBudget { time: Duration::from_secs(5), bytes: budget_bytes };
    let (mut calls, mut bytes) = (0, 0);
    let start = std::time::Instant::now();
    while rig.ctx.pending_compiles() > 0 {
        let stats = rig.ctx.run_compiles(&budget);
        calls += u32::from(stats.bytes > 0);
        bytes += stats.bytes;
        rig.draw(&scene, &unit_camera(SIDE), &plain());
        assert!(start.elapsed() < Duration::from_secs(100), "{bytes} bytes in {calls} calls");
    }
    let mut compiled = rig.ctx.take_compiled();
    assert_eq!(compiled.len(), 1, "the upload of a texture alone is no operation of the caller");
    let compiled = compiled.remove(0);
    assert!(compiled.ticket == 7 && compiled.errors.is_empty(), "{compiled:?}");
    page.set_draw_slots(0, compiled.slots);
    scene.add_root(page);
    (scene, calls, bytes)
}

fn random(length: usize) -> Vec<u8> {
    let mut seed = 7u32;
    let mut next = || {
        seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (seed >> 24) as u8
    };
    (0..length).map(|_| next()).collect()
}

/// Regression: the first frame that used it uploaded it whole, and nothing counted it.
#[test]
fn texture_is_uploaded_in_slices_before_its_drawables_and_counted() {
    for compile_thread in [false, true] {
        let Some(mut rig) = rig_of(compile_thread) else { return };
        let (scene, ..) = upload(&mut rig, Node::geode(vec![quad([0.0; 3], [1.0; 2], [1.0; 4])]), u64::MAX);
        rig.release(scene);
        rig.draw(&Scene::new(), &unit_camera(SIDE), &plain());
        let before = rig.ctx.bytes_allocated();
        let side = 1024u32;
        let bytes = u64::from(side * side * 4);
        // The last rows differ, so that a missing slice is visible.
        let half = (side * side / 2) as usize;
        let texels = [[255, 0, 0, 255].repeat(half), [0, 0, 255, 255].repeat(half)].concat();
        let texture = TextureObject::image("large", [side; 2], texels);
        let (scene, calls, uploaded) = upload(&mut rig, shows(&texture), 300_000);
        assert!(uploaded >= bytes, "{uploaded} of {bytes}");
        if !compile_thread {
            assert!(u64::from(calls) >= bytes / 300_000, "{calls} calls");
        }
        let allocated = rig.ctx.bytes_allocated() - before;
        assert!(allocated >= bytes && allocated < bytes + 100_000, "{allocated} for {bytes}");
        // Its first frame is complete.
        let picture = rig.picture(&scene, &unit_camera(SIDE), &plain());
        assert_eq!([8, 56].map(|y| pixel(&picture, 32, y)), [[255, 0, 0], [0, 0, 255]]);
        assert!(rig.renderer.take_errors().is_empty());
        rig.release(scene);
        drop(texture);
        // Culls and stages keep the state sets of their last frames.
        for _ in 0..300 {
            rig.draw(&Scene::new(), &unit_camera(SIDE), &plain());
        }
        assert_eq!(rig.ctx.bytes_allocated(), before, "it is freed with the last state set");
    }
}

/// Textures of all formats and dimensions look the same whether a frame uploads them whole or the queue in slices.
#[test]
fn slices_give_the_same_texture_as_one_upload() {
    let Some(mut rig) = rig_of(false) else { return };
    use TextureDimension as D;
    use TextureFormat as F;
    let half =
        |length: usize| random(length / 2).into_iter().flat_map(|byte| [0, 0x34 + byte % 8]).collect::<Vec<u8>>();
    for (dimension, size, format, levels) in [
        (D::D2, [37, 23, 1], F::Rgba8Srgb, 1),
        (D::D2, [37, 23, 1], F::R8, 3),
        (D::D2, [64, 64, 1], F::Rgba8, 7),
        (D::D2, [19, 40, 1], F::Rgba16Float, 2),
        (D::D1, [300, 1, 1], F::Rgba8Srgb, 1),
        (D::D2Array, [20, 30, 5], F::Rgba8Srgb, 2),
        (D::Cube, [16, 16, 6], F::Rgba8Srgb, 1),
        (D::D3, [9, 17, 11], F::Rgba8Srgb, 2),
    ] {
        let name = format!("{dimension:?} {size:?} {format:?}");
        let mut object = TextureObject {
            dimension,
            size,
            format,
            levels,
            ..(*TextureObject::image(&name, [1, 1], vec![0; 4])).clone()
        };
        let bytes = |level: u32| object.level_size(level).iter().product::<u32>() as usize * format.texel_bytes();
        let texels = |level: u32| if format == F::Rgba16Float { half(bytes(level)) } else { random(bytes(level)) };
        object.texels = (0..levels).map(texels).collect();
        let (sliced, whole) = (Arc::new(object.clone()), Arc::new(object));
        let (scene, ..) = upload(&mut rig, sample(&sliced), 700);
        let in_slices = rig.picture(&scene, &unit_camera(SIDE), &plain());
        rig.release(scene);
        let scene = rig.scene(sample(&whole));
        let at_once = rig.picture(&scene, &unit_camera(SIDE), &plain());
        rig.release(scene);
        let errors = rig.renderer.take_errors();
        assert!(errors.is_empty(), "{errors:?}");
        assert!(in_slices.pixels().collect::<std::collections::HashSet<_>>().len() > 5, "{name}");
        assert!(in_slices == at_once, "{name}");
    }
}

/// Returns a square that shows all layers and levels of a texture, by a program.
fn sample(texture: &Arc<TextureObject>) -> Node {
    let level = format!("floor(in.uv.y * {}.0)", texture.levels);
    let layers = texture.size[2];
    let (kind, sampled) = match texture.dimension {
        TextureDimension::D1 | TextureDimension::D2 => {
            ("texture_2d<f32>", format!("textureSampleLevel(shown, shown_sampler, in.uv, {level})"))
        }
        TextureDimension::D2Array => (
            "texture_2d_array<f32>",
            format!("textureSampleLevel(shown, shown_sampler, fract(in.uv * 4.0), i32(in.uv.x * {layers}.0), {level})"),
        ),
        TextureDimension::Cube => (
            "texture_cube<f32>",
            format!("textureSampleLevel(shown, shown_sampler, vec3(in.uv * 2.0 - 1.0, sin(in.uv.x * 20.0)), {level})"),
        ),
        TextureDimension::D3 => (
            "texture_3d<f32>",
            format!("textureSampleLevel(shown, shown_sampler, vec3(in.uv, fract(in.uv.x * 3.0)), {level})"),
        ),
    };
    let source = format!(
        "@group(2) @binding(1) var shown: {kind};
        @group(2) @binding(2) var shown_sampler: sampler;
        struct V {{ @builtin(position) position: vec4<f32>, @location(0) uv: vec2<f32> }}
        @vertex fn vs_main(vertex: MeshVertex, @builtin(instance_index) i: u32) -> V {{
            return V(frame.clip_from_eye * vec4<f32>(point_in_eye(leaves[i], vertex.position), 1.0), vertex.uv);
        }}
        @fragment fn fs_main(in: V) -> @location(0) vec4<f32> {{ return vec4({sampled}.rgb, 1.0); }}"
    );
    let sampler = Sampler { min_filter: FilterMode::Nearest, mag_filter: FilterMode::Nearest, ..Sampler::default() };
    let set = StateSet::default()
        .with(Attribute::Program(Program::new("sample", &source)))
        .with(Attribute::Texture(0, TextureBinding { texture: texture.clone(), sampler }));
    Node::geode(vec![quad([0.0; 3], [1.0; 2], [1.0; 4])]).with_state_set(Arc::new(set))
}

#[test]
fn levels_are_computed_by_the_adapter() {
    let Some(mut rig) = rig_of(false) else { return };
    // Every fourth column of 512 is red. A pixel covers eight, and lies between a black one and a red one.
    let side = 512u32;
    let columns = || (0..side * side).flat_map(|i| [if i % 4 == 0 { 255 } else { 0 }, 0, 0, 255]).collect();
    let without = TextureObject::image("columns", [side; 2], columns());
    let with_mips = TextureObject::image_with_mips("columns", [side; 2], columns());
    assert_eq!((with_mips.levels, with_mips.problem()), (10, None));
    for is_announced in [true, false] {
        // Each time another object, since a texture keeps its levels.
        let texture = Arc::new((*with_mips).clone());
        let scene = match is_announced {
            true => upload(&mut rig, shows(&texture), 300_000).0,
            false => rig.scene(shows(&texture)),
        };
        let picture = rig.picture(&scene, &unit_camera(SIDE), &plain());
        // A quarter of red, linear.
        for at in [[8, 8], [32, 32], [50, 20]] {
            let [red, green, blue] = pixel(&picture, at[0], at[1]);
            assert!(red.abs_diff(137) <= 2 && green == 0 && blue == 0, "{red} at {at:?}, announced: {is_announced}");
        }
        rig.release(scene);
    }
    let scene = rig.scene(shows(&without));
    let picture = rig.picture(&scene, &unit_camera(SIDE), &plain());
    assert!(pixel(&picture, 32, 32)[0].abs_diff(188) <= 2, "half of red without levels");
    rig.release(scene);
    assert!(rig.renderer.take_errors().is_empty());
}

/// Regression: every bind group was created again when a texture was removed.
#[test]
fn removed_texture_takes_its_own_bind_groups_only() {
    let Some(mut rig) = rig_of(false) else { return };
    let textures = [[255, 0, 0, 255], [0, 255, 0, 255], [0, 0, 255, 255]]
        .map(|color| TextureObject::image("one colour", [1, 1], color.to_vec()));
    let mut scenes = textures.each_ref().map(|texture| Some(rig.scene(shows(texture))));
    let created = |rig: &mut Rig, scene: &Scene| rig.draw(scene, &unit_camera(SIDE), &plain()).state_groups_created;
    for scene in scenes.iter().flatten() {
        assert_eq!([(); 2].map(|()| created(&mut rig, scene)), [1, 0]);
    }
    // The first texture is dropped with its scene; the second keeps its bind group, the third too.
    let [first, ..] = textures;
    let serial = Arc::downgrade(&first);
    drop(first);
    rig.release(scenes[0].take().unwrap());
    rig.visitor = CullVisitor::new();
    for scene in scenes.iter().flatten().chain(scenes.iter().flatten()) {
        assert_eq!(created(&mut rig, scene), 0);
    }
    assert_eq!(serial.strong_count(), 0, "the texture was removed");
    assert_eq!(pixel(&rig.read_back(), 32, 32), [0, 0, 255]);
    scenes.into_iter().flatten().for_each(|scene| rig.release(scene));
}
