//! Contexts with a compile thread upload the same as the draw thread would, under all circumstances. Needs a GPU; a
//! software adapter suffices.

use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};
use terrane::state::DataVariance;

use glam::{DAffine3, DVec3};
use image::RgbaImage;
use kit::process::runs_alone;
use kit::shapes::with_mips;
use kit::skip::or_skip;
use kit::tile_sets::{generate, mountains};
use serde_json::Value;
use terrane::gpu::{CompileBudget, CompileOperation, GraphicsContext};
use terrane::pager::PagerConfig;
use terrane::scene::{DrawSlot, Drawable, Geometry, Material, Mesh, Node, NodeId, Page, Texture};
use terrane::trace::Recording;
use terrane::viewer::{Slave, ThreadingModel, Viewer, ViewerConfig};
use terrane_data_gen::ContentKind;

const SIZE: [u32; 2] = [96, 72];
const PATIENCE: Duration = Duration::from_secs(60);

fn config(threading: ThreadingModel, compile_contexts: bool) -> ViewerConfig {
    ViewerConfig {
        size_px: SIZE,
        threading,
        adapter: kit::adapter(),
        max_sse_px: 4.0,
        pager: PagerConfig::default(),
        compile_contexts,
        max_contexts: 3,
        ..ViewerConfig::default()
    }
}

fn context(compile_thread: bool) -> Option<GraphicsContext> {
    let traits = config(ThreadingModel::SingleThreaded, compile_thread).traits();
    or_skip(GraphicsContext::new_offscreen(&traits))
}

fn small_set(folder: &Path, content: ContentKind) -> String {
    generate(&folder.join("set"), |args| {
        (args.levels, args.seed, args.size, args.content) = (Some(3), 5, 20_000.0, content);
    })
}

fn textured(texture: &Arc<Texture>) -> Drawable {
    let material = Material { texture: Some(texture.clone()), unlit: true, ..Material::default() };
    Drawable::new(Geometry::Mesh(Arc::new(Mesh::sphere(DVec3::ZERO, 1.0, 12))), material)
}

fn until(ctx: &mut GraphicsContext, budget: &CompileBudget) -> u64 {
    let start = Instant::now();
    let mut bytes = 0;
    while ctx.pending_compiles() > 0 {
        bytes += ctx.run_compiles(budget).bytes;
        assert!(start.elapsed() < PATIENCE, "{} operations are stuck", ctx.pending_compiles());
        std::thread::yield_now();
    }
    bytes
}

#[test]
fn uploads_larger_than_the_staging_memory_complete() {
    for budget in [CompileBudget::default(), CompileBudget::UNLIMITED] {
        let Some(mut ctx) = context(true) else { return };
        // The scene has 64 MiB in images and meshes of all sizes, one of them larger than a staging buffer.
        let mut drawables = Vec::new();
        let mut bytes = 0;
        for (place, side) in [2048u32, 1, 3, 513, 1024, 64, 2048, 7, 1000, 256].into_iter().enumerate() {
            let texture = Arc::new(with_mips(side, side, vec![place as u8; (side * side * 4) as usize]));
            bytes += texture.mips.iter().map(|m| m.len() as u64).sum::<u64>();
            drawables.push(textured(&texture));
        }
        for (ticket, drawable) in drawables.into_iter().enumerate() {
            ctx.compile(CompileOperation { ticket: ticket as u64, drawables: vec![drawable] });
        }
        ctx.compile(CompileOperation { ticket: 10, drawables: Vec::new() });
        assert!(until(&mut ctx, &budget) >= bytes);
        let compiled = ctx.take_compiled();
        assert_eq!(compiled.iter().map(|c| c.ticket).collect::<Vec<_>>(), (0..=10).collect::<Vec<_>>());
        assert!(compiled.iter().all(|c| c.errors.is_empty() && c.slots.iter().all(|s| *s != DrawSlot::NONE)));
        let slots: Vec<_> = compiled.into_iter().flat_map(|c| c.slots).collect();
        ctx.release(&slots);
        ctx.flush_released();
        assert!(ctx.bytes_in_use() < 1000, "{} bytes", ctx.bytes_in_use());
        assert!(ctx.take_device_errors().is_empty());
    }
}

#[test]
fn operations_dropped_in_flight_do_not_block_others() {
    let texture = with_mips(1024, 1024, vec![200; 1024 * 1024 * 4]);
    let drawables: Vec<Drawable> = (0..40).map(|_| textured(&Arc::new(texture.clone()))).collect();
    for calls in [0, 1, 3] {
        let Some(mut ctx) = context(true) else { return };
        for (ticket, drawable) in (0..).zip(&drawables) {
            ctx.compile(CompileOperation { ticket, drawables: vec![drawable.clone()] });
        }
        for _ in 0..calls {
            ctx.run_compiles(&CompileBudget { time: Duration::ZERO, bytes: 1 });
        }
        let start = Instant::now();
        drop(ctx);
        assert!(start.elapsed() < Duration::from_secs(5), "{calls}: {:?}", start.elapsed());
    }
}

fn settle(viewer: &mut Viewer) {
    let start = Instant::now();
    (0..4).for_each(|_| viewer.frame().unwrap());
    while !viewer.is_settled() {
        viewer.frame().unwrap();
        assert!(start.elapsed() < PATIENCE, "never settled");
    }
    (0..3).for_each(|_| viewer.frame().unwrap());
    viewer.finish().unwrap();
}

fn picture(viewer: &mut Viewer) -> RgbaImage {
    settle(viewer);
    viewer.read_back().unwrap()
}

#[test]
fn all_threading_models_draw_the_same_with_and_without_the_thread() {
    for content in [ContentKind::Height, ContentKind::Mesh] {
        let folder = tempfile::tempdir().unwrap();
        let set = small_set(folder.path(), content);
        let Some(first) = context(false) else { return };
        let mut here = Viewer::new(first, &config(ThreadingModel::SingleThreaded, false)).unwrap();
        here.load(&set).unwrap();
        let expected = picture(&mut here);
        for threading in ThreadingModel::ALL {
            let mut viewer = Viewer::new(context(true).unwrap(), &config(threading, true)).unwrap();
            viewer.load(&set).unwrap();
            assert!(picture(&mut viewer) == expected, "{threading}");
            assert_eq!(viewer.stats().last().unwrap().gpu_bytes, here.stats().last().unwrap().gpu_bytes);
            // All pages are removed and loaded again while frames are drawn. Then the device is lost.
            viewer.clear_pages();
            (0..3).for_each(|_| viewer.frame().unwrap());
            assert!(picture(&mut viewer) == expected, "{threading}: once more");
            let context = viewer.contexts().next().unwrap();
            viewer.clear_pages();
            (0..2).for_each(|_| viewer.frame().unwrap());
            viewer.composite_mut().lose_device(context).unwrap();
            assert!(picture(&mut viewer) == expected, "{threading}: after the device was lost");
            // A context is opened later, with and without a separate device.
            let shared = viewer.composite_mut().open_offscreen_on(context, &config(threading, true).traits()).unwrap();
            let own = viewer.open_context(self::context(true).unwrap()).unwrap();
            for of in [shared, own] {
                viewer.add_slave(Slave::new(of)).unwrap();
            }
            settle(&mut viewer);
            for of in [context, shared, own] {
                assert!(viewer.composite_mut().read_back(of).unwrap() == expected, "{threading}: {of:?}");
            }
        }
    }
}

#[test]
fn blocking_mode_waits_for_the_thread() {
    let folder = tempfile::tempdir().unwrap();
    let set = small_set(folder.path(), ContentKind::Height);
    let mut pictures = Vec::new();
    for compile_contexts in [false, true] {
        let Some(context) = context(compile_contexts) else { return };
        let mut config = config(ThreadingModel::DrawThreadPerContext, compile_contexts);
        config.pager.blocking = true;
        let mut viewer = Viewer::new(context, &config).unwrap();
        viewer.load(&set).unwrap();
        // The first frame shows everything.
        viewer.frame().unwrap();
        pictures.push(viewer.read_back().unwrap());
    }
    assert!(pictures[0] == pictures[1]);
}

#[test]
fn mesh_that_is_replaced_during_its_upload_is_complete() {
    let Some(context) = context(true) else { return };
    let mut viewer = Viewer::new(context, &config(ThreadingModel::SingleThreaded, true)).unwrap();
    let material = |color| Material { base_color: color, unlit: true, ..Material::default() };
    let sphere = |at| Arc::new(Mesh::sphere(at, 1.0, 24));
    let small = Drawable::new(Geometry::Mesh(sphere(DVec3::new(0.0, 0.0, 1e6))), material([1.0, 0.0, 0.0, 1.0]));
    let root = viewer.add_root(Page::from_node(Node::geode(vec![small])).unwrap()).unwrap();
    viewer.view_mut().camera.look_at(DVec3::new(0.0, -6.0, 0.0), DVec3::ZERO, DVec3::Z);
    settle(&mut viewer);
    // Another page has the same mesh, behind 32 MiB of others. The first page takes it before its upload ends.
    let mesh = sphere(DVec3::ZERO);
    let big = (0..2u8).map(|i| textured(&Arc::new(with_mips(2048, 2048, vec![i; 2048 * 2048 * 4]))));
    let far = DAffine3::from_translation(DVec3::new(0.0, 0.0, 1e6));
    let drawables =
        big.chain([Drawable::new(Geometry::Mesh(mesh.clone()), material([0.0, 1.0, 0.0, 1.0]))]).collect::<Vec<_>>();
    viewer.add_root(Page::from_node(Node::transform(far, vec![Node::geode(drawables)])).unwrap()).unwrap();
    viewer.frame().unwrap();
    let geode = NodeId { page: root, index: 0 };
    viewer.scene_mut().set_mesh(geode, 0, mesh, DataVariance::Static).unwrap();
    viewer.frame().unwrap();
    let [red, green, ..] = viewer.read_back().unwrap().get_pixel(48, 36).0;
    assert!(red > 240 && green < 20, "{red} {green}");
}

/// The timeline shows which thread fills the staging buffers.
#[test]
fn compile_thread_fills_staging_buffers_if_it_is_asked_for() {
    if runs_alone(module_path!(), "compile_thread_fills_staging_buffers_if_it_is_asked_for") {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let set = small_set(folder.path(), ContentKind::default());
    let file = folder.path().join("trace.json");
    for compile_contexts in [false, true] {
        let recording = Recording::start().unwrap();
        let Some(context) = context(compile_contexts) else { return };
        let config = config(ThreadingModel::DrawThreadPerContext, compile_contexts);
        let mut viewer = Viewer::new(context, &ViewerConfig { max_sse_px: 0.05, ..config }).unwrap();
        viewer.load(&set).unwrap();
        settle(&mut viewer);
        let uploaded = viewer.pager().unwrap().stats().merged;
        drop(viewer);
        recording.write(&file).unwrap();
        let json: Value = serde_json::from_slice(&std::fs::read(&file).unwrap()).unwrap();
        let events = json["traceEvents"].as_array().unwrap();
        let thread = events.iter().find(|e| e["name"] == "thread_name" && e["args"]["name"] == "compile");
        let uploads = thread.map_or(0, |thread| {
            let on_thread = |e: &&Value| e["ph"] == "X" && e["name"] == "upload" && e["tid"] == thread["tid"];
            events.iter().filter(on_thread).count() as u64
        });
        assert!(uploaded > 0, "nothing was loaded");
        assert!(if compile_contexts { uploads >= uploaded } else { uploads == 0 }, "{compile_contexts}: {uploads}");
    }
}

/// Measures the cost of uploads on the draw thread and the time to load a set: `-- --ignored --nocapture`.
#[test]
#[ignore = "a measurement"]
fn upload_cost() {
    let folder = tempfile::tempdir().unwrap();
    let set = mountains(folder.path(), 6);
    for round in 0..4 {
        let compile_contexts = round % 2 == 1;
        let Some(context) = context(compile_contexts) else { return };
        let config = ViewerConfig {
            validation: false,
            max_sse_px: 0.25,
            ..config(ThreadingModel::DrawThreadPerContext, compile_contexts)
        };
        let mut viewer = Viewer::new(context, &config).unwrap();
        viewer.load(&set).unwrap();
        settle(&mut viewer);
        let mut settled_ms = Vec::new();
        let first = viewer.frame_stamp().frame;
        for _ in 0..10 {
            viewer.clear_pages();
            let start = Instant::now();
            viewer.frame().unwrap();
            while !viewer.is_settled() {
                viewer.frame().unwrap();
            }
            settled_ms.push(start.elapsed().as_secs_f64() * 1e3);
        }
        viewer.finish().unwrap();
        let frames = viewer.stats().iter().filter(|f| f.frame > first);
        let of = |value: fn(&terrane::viewer::FrameStats) -> f64| {
            let samples = terrane::viewer::Samples::new(frames.clone().map(value));
            format!("{:.3} / {:.3} / {:.3}", samples.median(), samples.percentile(0.99), samples.max())
        };
        println!(
            "compile thread {compile_contexts}: {} frames; ms median / p99 / max: compile {}; draw {}; frame {}; settled {}",
            frames.clone().count(),
            of(|f| f.compile_ms),
            of(|f| f.draw_ms),
            of(|f| f.frame_ms),
            terrane::viewer::Samples::new(settled_ms).median(),
        );
    }
}

/// Regression: the update waited forever for uploads that could not continue.
#[test]
fn blocking_mode_does_not_wait_for_uploads_that_cannot_complete() {
    let folder = tempfile::tempdir().unwrap();
    let set = small_set(folder.path(), ContentKind::Mesh);
    for threading in [ThreadingModel::SingleThreaded, ThreadingModel::DrawThreadPerContext] {
        for compile_contexts in [false, true] {
            let mut config = config(threading, compile_contexts);
            config.pager.blocking = true;
            let Some(dry) = context(compile_contexts) else { return };
            dry.pretend_frame_memory(Some(0));
            let mut viewer = Viewer::new(dry, &config).unwrap();
            viewer.load(&set).unwrap();
            // A frame without memory for its target may be an error.
            let _ = viewer.frame();
            assert_eq!(viewer.pager().unwrap().stats().merged, 0, "{threading} {compile_contexts}");

            let mut viewer = Viewer::new(context(compile_contexts).unwrap(), &config).unwrap();
            viewer.load(&set).unwrap();
            let expected = picture(&mut viewer);
            let context = viewer.contexts().next().unwrap();
            viewer.clear_pages();
            viewer.composite_mut().lose_device(context).unwrap();
            viewer.frame().unwrap();
            assert!(picture(&mut viewer) == expected, "{threading} {compile_contexts}: after the device was lost");
        }
    }
}
