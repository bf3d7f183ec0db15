//! Frames whose resources do not fit into memory: one error is reported, and the rest is drawn. Needs a GPU; a software
//! adapter suffices.

use std::sync::Arc;
use std::time::{Duration, Instant};

use kit::frames::{MAGENTA, count, pixel};
use kit::rig::{new_rig, plain, unit_camera};
use kit::shapes::{quad, with_mips};

use terrane::gpu::{AdapterChoice, CompileBudget, CompileOperation, ContextTraits, GraphicsContext};
use terrane::scene::{CameraNode, Drawable, Environment, Material, Node, Sky};
use terrane::state::{Attribute, Mode, StateSet, StateValue, TextureBinding, TextureFormat, TextureObject};

const SIDE: u32 = 64;
const RED: [u8; 3] = [255, 0, 0];

fn square(color: [f32; 4]) -> Node {
    Node::geode(vec![quad([0.0; 3], [0.5; 2], color)])
}

/// Regression: only the device's error handler received the error and its consequences, and the frame was lost
/// silently.
#[test]
fn frame_without_memory_for_its_target_is_left_out_and_reported() {
    let Some(mut rig) = new_rig([SIDE; 2]) else { return };
    let scene = rig.scene(square([1.0, 0.0, 0.0, 1.0]));
    let camera = unit_camera(SIDE);
    // All other resources exist already, from a smaller frame.
    rig.draw(&scene, &unit_camera(SIDE / 2), &plain());
    rig.ctx.pretend_frame_memory(Some(0));
    for _ in 0..3 {
        let stats = rig.draw(&scene, &camera, &plain());
        assert_eq!((stats.stages_refused, stats.passes), (1, 0));
    }
    let errors = rig.renderer.take_errors();
    let what = "out of graphics memory: depth and samples of a target of ";
    assert!(matches!(&errors[..], [error] if error.starts_with(what)), "{errors:?}");
    // With memory the frame is drawn again, and no further allocation is needed.
    rig.ctx.pretend_frame_memory(None);
    assert_eq!(pixel(&rig.picture(&scene, &camera, &plain()), 32, 32), RED);
    rig.ctx.pretend_frame_memory(Some(0));
    let stats = rig.draw(&scene, &camera, &plain());
    assert_eq!((stats.stages_refused, stats.passes), (0, 1));
    rig.release(scene);
}

#[test]
fn camera_without_memory_for_its_target_does_not_affect_others() {
    let Some(mut rig) = new_rig([SIDE; 2]) else { return };
    let camera = unit_camera(SIDE);
    let beside = || Node::geode(vec![quad([0.75, 0.0, 0.0], [0.2; 2], [1.0, 0.0, 0.0, 1.0])]);
    let first = rig.scene(beside());
    rig.draw(&first, &camera, &plain());
    // The size differs from that of the window, whose depth buffer it could share otherwise.
    let texture = TextureObject::target("seen", [SIDE / 2; 2], TextureFormat::Rgba8Srgb);
    let of_texture = StateSet::default()
        .with_mode(Mode::Lighting, StateValue::OFF)
        .with(Attribute::Texture(0, TextureBinding::new(texture.clone())));
    let node = CameraNode::to_texture(texture, camera.eye_from_world, camera.clip_from_eye);
    let scene = rig.scene(Node::group(vec![
        beside(),
        Node::camera(node, vec![square([0.0, 1.0, 0.0, 1.0])]),
        square([1.0; 4]).with_state_set(Arc::new(of_texture)),
    ]));
    rig.ctx.pretend_frame_memory(Some(0));
    for _ in 0..3 {
        let stats = rig.draw(&scene, &camera, &plain());
        assert_eq!((stats.stages_refused, stats.passes), (1, 1));
    }
    let picture = rig.read_back();
    assert_eq!((pixel(&picture, 56, 32), pixel(&picture, 2, 2)), (RED, MAGENTA));
    assert_eq!(count(&picture, [0, 255, 0]), 0);
    assert_eq!(rig.renderer.take_errors().len(), 1);
    rig.ctx.pretend_frame_memory(None);
    let picture = rig.picture(&scene, &camera, &plain());
    assert_eq!(pixel(&picture, 32, 32), [0, 255, 0]);
    assert!(rig.renderer.take_errors().is_empty());
    rig.release(first);
    rig.release(scene);
}

/// Regression: the tables were created without regard to memory. Without them a clear sky is drawn, and lighting is
/// that of such a sky.
#[test]
fn without_memory_for_air_a_plain_sky_is_drawn() {
    let Some(mut rig) = new_rig([SIDE; 2]) else { return };
    let mut lit = quad([0.0; 3], [0.5; 2], [1.0; 4]);
    lit.material = Material::default();
    let scene = rig.scene(Node::geode(vec![lit]));
    let sky = Environment::default();
    let clear = Environment { sky: Sky::Background([0x87, 0xae, 0xd6]), ..sky };
    // The target exists, the tables of the air do not.
    let under_clear = rig.picture(&scene, &unit_camera(SIDE), &clear);
    rig.ctx.pretend_frame_memory(Some(0));
    for _ in 0..3 {
        let picture = rig.picture(&scene, &unit_camera(SIDE), &sky);
        assert!(picture == under_clear);
        assert_eq!(pixel(&picture, 2, 2), [0x87, 0xae, 0xd6]);
        assert!(pixel(&picture, 32, 32).iter().all(|channel| *channel > 60), "{:?}", pixel(&picture, 32, 32));
    }
    let errors = rig.renderer.take_errors();
    assert!(matches!(&errors[..], [error] if error.starts_with("out of graphics memory: air of ")), "{errors:?}");
    rig.ctx.pretend_frame_memory(None);
    let picture = rig.picture(&scene, &unit_camera(SIDE), &sky);
    assert_ne!(pixel(&picture, 2, 2), [0x87, 0xae, 0xd6]);
    assert_ne!(pixel(&picture, 2, 2), [0; 3], "the air is computed once there is room");
    rig.release(scene);
}

/// Regression: they were written to invalid buffers.
#[test]
fn uploads_wait_for_memory_and_report_it_once() {
    for compile_thread in [false, true] {
        let traits = ContextTraits {
            size_px: [SIDE; 2],
            adapter: AdapterChoice::Noop,
            compile_thread,
            ..ContextTraits::default()
        };
        let mut ctx = GraphicsContext::new_offscreen(&traits).unwrap();
        let mut drawable: Drawable = quad([0.0; 3], [0.5; 2], [1.0; 4]);
        drawable.material.texture = Some(Arc::new(with_mips(256, 256, vec![7; 256 * 256 * 4])));
        let compile = |ctx: &mut GraphicsContext, ticket| {
            ctx.compile(CompileOperation { ticket, drawables: vec![drawable.clone()] });
        };
        let run_until = |ctx: &mut GraphicsContext, is_done: &dyn Fn(&mut GraphicsContext) -> bool| {
            let start = Instant::now();
            while !is_done(ctx) && start.elapsed() < Duration::from_secs(20) {
                ctx.run_compiles(&CompileBudget::UNLIMITED);
            }
        };
        ctx.pretend_frame_memory(Some(0));
        compile(&mut ctx, 1);
        let mut errors = Vec::new();
        let start = Instant::now();
        while errors.is_empty() || start.elapsed() < Duration::from_millis(300) {
            ctx.run_compiles(&CompileBudget::UNLIMITED);
            errors.extend(ctx.take_device_errors());
            assert!(start.elapsed() < Duration::from_secs(20), "no error is reported");
        }
        let what = "out of graphics memory: staging buffer of ";
        assert!(matches!(&errors[..], [error] if error.starts_with(what)), "{compile_thread}: {errors:?}");
        assert_eq!((ctx.take_compiled().len(), ctx.pending_compiles()), (0, 1), "{compile_thread}");
        ctx.pretend_frame_memory(None);
        run_until(&mut ctx, &|ctx| ctx.pending_compiles() == 0);
        let compiled = ctx.take_compiled();
        assert!(matches!(&compiled[..], [one] if one.errors.is_empty()), "{compile_thread}");
        // A new failure is reported again.
        ctx.release(&compiled[0].slots);
        assert!(ctx.take_device_errors().is_empty(), "{compile_thread}");
    }
}
