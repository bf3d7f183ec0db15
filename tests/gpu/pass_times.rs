//! The adapter's time of a draw is the sum of all its passes. Needs a GPU; a software adapter suffices. There is one
//! test, because a process has one recording, and software adapters are only asked for times while recording.

use std::sync::Arc;

use glam::DVec3;
use kit::process::runs_alone;
use kit::rig::{camera, rig};
use kit::shapes::quad;
use kit::skip::skipped;
use terrane::cull::CullCamera;

use terrane::scene::{Attachment, CameraNode, CameraTarget, Environment, Node, Sky};
use terrane::state::{TextureFormat, TextureObject};
use terrane::trace::Recording;

/// Passes beyond the 32nd, the atmosphere's tables, and passes that load their color are included. Regression: they
/// were not.
#[test]
fn all_passes_of_a_draw_are_measured() {
    if runs_alone(module_path!(), "all_passes_of_a_draw_are_measured") {
        return;
    }
    let Some(mut rig) = rig("all_passes_of_a_draw_are_measured") else { return };
    let rig = &mut *rig;
    if !rig.ctx.device().features().contains(wgpu::Features::TIMESTAMP_QUERY) {
        return skipped("the adapter has no timestamps");
    }
    let _recording = Recording::start().unwrap();
    let own = camera([16, 16], DVec3::new(0.0, 0.0, 10.0), DVec3::ZERO, DVec3::Y);
    let onto = |samples, clear_color| {
        let texture = TextureObject::target("small", [16; 2], TextureFormat::Rgba8Srgb);
        let target =
            CameraTarget { colors: vec![Attachment::new(texture.clone())], samples, ..CameraTarget::default() };
        let node = CameraNode::to_texture(texture, own.eye_from_world, own.clip_from_eye);
        let node = CameraNode { target: Some(Arc::new(target)), clear_color, ..node };
        Node::camera(node, vec![Node::geode(vec![quad([0.0; 3], [0.5; 2], [1.0; 4])])])
    };
    let mut draw = |cameras: usize| {
        let mut nodes: Vec<Node> = (0..cameras).map(|_| onto(1, Some([0.0; 4]))).collect();
        nodes.push(onto(4, None));
        let scene = rig.scene(Node::group(nodes));
        let sky = Environment { sky: Sky::Atmosphere, ..Environment::default() };
        let mut measured = Vec::new();
        for frame in 0..20 {
            // Another height of the eye needs new tables of the air each time.
            let eye = DVec3::new(0.0, 0.0, 10.0 + 500.0 * f64::from(frame));
            let above = CullCamera { frame, ..camera([16, 16], eye, DVec3::ZERO, DVec3::Y) };
            let stats = rig.draw(&scene, &above, &sky);
            assert_eq!(stats.passes as usize, cameras + 2);
            let passes = rig.renderer.pass_ms();
            assert_eq!(stats.gpu_ms.is_some(), !passes.is_empty());
            measured.push(passes.len());
        }
        rig.release(scene);
        measured
    };
    // Passes are the image, the camera with samples, their resolves, and the tables of the air.
    let few = draw(3);
    assert_eq!(few.last(), Some(&7), "{few:?}");
    let many = draw(100);
    assert_eq!(many.last(), Some(&104), "{many:?}");
    // The count is never partial: 7 passes in earlier frames, none in the first frame with more, then all of them.
    assert!(many.iter().all(|passes| [7, 0, 104].contains(passes)), "{many:?}");
}
