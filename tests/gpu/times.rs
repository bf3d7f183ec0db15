//! The adapter's time of each pass is reported under its name. Needs a GPU; a software adapter suffices. There is one
//! test, because a process has one recording.

use std::time::{Duration, Instant};

use glam::{DAffine3, DVec3};
use kit::process::runs_alone;
use kit::rig::{camera, new_rig};
use kit::shadows::{cuboid, ground, sunny};
use kit::skip::skipped;
use serde_json::Value;
use terrane::scene::{CameraNode, Node, ReferenceFrame, RenderOrder};
use terrane::state::{TextureFormat, TextureObject};
use terrane::trace::Recording;

/// The number of frames after which the times have certainly been read back.
const PATIENCE: Duration = Duration::from_secs(60);

#[test]
fn each_pass_has_a_time_with_its_name() {
    if runs_alone(module_path!(), "each_pass_has_a_time_with_its_name") {
        return;
    }
    // Software adapters are asked for times only while recording.
    let recording = Recording::start().unwrap();
    let Some(mut rig) = new_rig([96, 64]) else { return };
    let view = camera([96, 64], DVec3::new(0.0, -30.0, 20.0), DVec3::ZERO, DVec3::Z);
    let texture = TextureObject::target("mirror", [32; 2], TextureFormat::Rgba8Srgb);
    let mirror = CameraNode::to_texture(texture, view.eye_from_world, view.clip_from_eye);
    let over = CameraNode {
        frame: ReferenceFrame::Absolute,
        view: DAffine3::IDENTITY,
        clear_color: None,
        ..CameraNode::new(RenderOrder::PostRender(0))
    };
    let tower = || Node::geode(vec![cuboid(DVec3::new(-1.0, -1.0, 0.0), DVec3::new(1.0, 1.0, 4.0))]);
    let scene = rig.scene(Node::group(vec![
        Node::camera(mirror, vec![tower()]),
        Node::geode(vec![ground(20.0)]),
        tower(),
        Node::camera(over, vec![tower()]),
    ]));
    let environment = sunny(DVec3::new(1.0, -1.0, 2.0));
    let start = Instant::now();
    let (stats, times) = loop {
        let stats = rig.draw(&scene, &view, &environment);
        let times = rig.renderer.pass_ms().to_vec();
        let has_timestamps = rig.ctx.device().features().contains(wgpu::Features::TIMESTAMP_QUERY);
        if !has_timestamps {
            assert!(times.is_empty() && stats.gpu_ms.is_none());
            return skipped("the adapter has no timestamps");
        }
        if !times.is_empty() && stats.gpu_ms.is_some() {
            break (stats, times);
        }
        assert!(start.elapsed() < PATIENCE, "no times were reported");
    };
    rig.release(scene);
    assert_eq!(times.len(), stats.passes as usize, "{times:?}");
    assert!(times.iter().all(|ms| ms.is_finite() && *ms >= 0.0), "{times:?}");
    assert!(times.iter().sum::<f64>() > 0.0, "{times:?}");

    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("trace.json");
    recording.write(&file).unwrap();
    let json: Value = serde_json::from_slice(&std::fs::read(&file).unwrap()).unwrap();
    let events = json["traceEvents"].as_array().unwrap();
    let line = events.iter().find(|e| e["args"]["name"].as_str().is_some_and(|name| name.starts_with("gpu ")));
    let line = line.expect("a track for the adapter")["tid"].clone();
    let spans = events.iter().filter(|e| e["ph"] == "X" && e["tid"] == line && e["name"] != "frame");
    // The times are those of the last frame that was read back.
    let spans: Vec<(&str, f64)> =
        spans.map(|e| (e["name"].as_str().unwrap(), e["dur"].as_f64().unwrap() / 1e3)).collect();
    let last = &spans[spans.len() - times.len()..];
    let names: Vec<&str> = last.iter().map(|(name, _)| *name).collect();
    let cascades = names.iter().filter(|name| **name == "shadows").count();
    assert!(cascades >= 1, "{names:?}");
    let mut expected = vec!["camera"];
    expected.extend(std::iter::repeat_n("shadows", cascades));
    expected.extend(["picture", "nested picture"]);
    assert_eq!(names, expected);
    for ((name, on_line), ms) in last.iter().zip(&times) {
        assert!((on_line - ms).abs() < 1e-5, "{name}: {on_line} ms in the trace, {ms} ms reported");
    }
}
