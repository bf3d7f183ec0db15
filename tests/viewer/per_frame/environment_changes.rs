//! Changes of the environment take effect once their pipelines exist, whole, and no frame creates a pipeline.

use std::sync::Arc;

use glam::DVec3;
use image::RgbaImage;
use kit::rig::plain;
use kit::shadows::{ground, small_maps};
use kit::viewer::{Settle, offscreen};

use terrane::scene::{
    AlphaMode, DistanceFog, Drawable, Environment, Geometry, Material, Mesh, Node, Page, Sky, ToneMapping, Water,
};
use terrane::state::{Attribute, Program, StateSet, SurfaceMaterial};
use terrane::viewer::{EnvironmentChanges, ThreadingModel, Viewer, ViewerConfig};

/// Returns drawables of several kinds on the ground: plain, masked and blended ones, one with a material, and one with a
/// program.
fn kinds() -> Page {
    let sphere = |alpha, x: f64, y: f64| {
        let mesh = Mesh::sphere(DVec3::new(x, y, 1.0), 0.8, 24);
        let material = Material { alpha, base_color: [0.9, 0.6, 0.3, 0.6], ..Material::default() };
        Node::geode(vec![Drawable::new(Geometry::Mesh(Arc::new(mesh)), material)])
    };
    let wgsl = "
        struct V { @builtin(position) position: vec4<f32> }
        @vertex fn vs_main(vertex: MeshVertex, @builtin(instance_index) i: u32) -> V {
            return V(frame.clip_from_eye * vec4<f32>(point_in_eye(leaves[i], vertex.position), 1.0));
        }
        @fragment fn fs_main(in: V) -> @location(0) vec4<f32> { return vec4<f32>(0.1, 0.8, 0.2, 1.0); }";
    let of = |attribute| Arc::new(StateSet::default().with(attribute));
    let nodes = vec![
        Node::geode(vec![ground(20.0)]),
        sphere(AlphaMode::Opaque, -2.0, 0.0),
        sphere(AlphaMode::Mask(0.5), 0.0, 0.0),
        sphere(AlphaMode::Blend, 2.0, 0.0),
        sphere(AlphaMode::Opaque, -1.0, 2.0).with_state_set(of(Attribute::SurfaceMaterial(SurfaceMaterial::default()))),
        sphere(AlphaMode::Opaque, 1.0, 2.0).with_state_set(of(Attribute::Program(Program::new("green", wgsl)))),
    ];
    Page::from_node(Node::group(nodes)).unwrap()
}

fn viewer(environment: &Environment, threading: ThreadingModel, changes: EnvironmentChanges) -> Option<Viewer> {
    let config = ViewerConfig {
        size_px: [64, 48],
        threading,
        adapter: kit::adapter(),
        validation: false,
        environment_changes: changes,
        ..ViewerConfig::default()
    };
    let mut viewer = offscreen(&config)?;
    viewer.add_root(kinds()).unwrap();
    viewer.view_mut().camera.look_at(DVec3::new(0.0, -7.0, 5.0), DVec3::ZERO, DVec3::Z);
    viewer.view_mut().environment = *environment;
    viewer.settle(3);
    Some(viewer)
}

fn picture(viewer: &mut Viewer) -> RgbaImage {
    viewer.want_picture();
    viewer.frame().unwrap();
    viewer.finish().unwrap();
    viewer.take_pictures().pop().unwrap().1
}

/// Returns the pipelines that frames after one have created themselves, and those that another thread has created.
fn created(viewer: &Viewer, after: u32) -> [u32; 2] {
    let frames = || viewer.stats().iter().filter(|s| s.frame > after);
    [frames().map(|s| s.pipelines_created).sum(), frames().map(|s| s.pipelines_created_by_thread).sum()]
}

fn noon() -> Environment {
    Environment { sun_direction: DVec3::new(0.5, 0.2, 1.0).normalize(), ..plain() }
}

/// Draws until a change has taken effect. Returns the number of frames that were drawn as before.
fn shown_after(viewer: &mut Viewer, before: &RgbaImage, after: &RgbaImage) -> usize {
    for frame in 0..20_000 {
        let shown = picture(viewer);
        if shown == *after {
            assert!(viewer.is_settled());
            return frame;
        }
        assert!(shown == *before && !viewer.is_settled(), "frame {frame} shows a part of the change");
        assert!(viewer.check_need_to_do_frame());
    }
    panic!("the change takes no effect");
}

/// Regression: the frame after a change created its pipelines.
#[test]
fn no_frame_creates_the_pipelines_of_a_change() {
    let environment = Environment {
        sky: Sky::Atmosphere,
        water: Some(Water::at(-0.5)),
        shadows: small_maps(),
        tone_mapping: ToneMapping::InOwnPass,
        ..noon()
    };
    let threading = ThreadingModel::CullThreadPerCameraDrawThreadPerContext;
    let Some(mut expects) = viewer(&environment, threading, EnvironmentChanges::AtOnce) else { return };
    let expected = picture(&mut expects);
    let mut viewer = viewer(&noon(), threading, EnvironmentChanges::WhenReady).unwrap();
    let before = picture(&mut viewer);
    assert!(expected != before);
    let changed = viewer.frame_stamp().frame;
    viewer.view_mut().environment = environment;
    let waited = shown_after(&mut viewer, &before, &expected);
    let [in_frames, by_thread] = created(&viewer, changed);
    assert!(waited > 0 && in_frames == 0 && by_thread > 1, "{waited} frames, {in_frames} and {by_thread} pipelines");
}

#[test]
fn offscreen_views_change_at_once_unless_asked_otherwise() {
    let shadows = Environment { shadows: small_maps(), ..noon() };
    let of = EnvironmentChanges::default();
    let Some(mut expects) = viewer(&shadows, ThreadingModel::SingleThreaded, of) else { return };
    let mut viewer = viewer(&noon(), ThreadingModel::SingleThreaded, of).unwrap();
    let changed = viewer.frame_stamp().frame;
    viewer.view_mut().environment = shadows;
    assert!(picture(&mut viewer) == picture(&mut expects));
    assert!(created(&viewer, changed)[0] > 1);
    // An image of the present view shows what is set, and does not wait.
    viewer.composite_mut().set_environment_changes(EnvironmentChanges::WhenReady);
    let haze = Environment { fog: DistanceFog { enabled: true, density_per_m: 0.02 }, ..noon() };
    (viewer.view_mut().environment, expects.view_mut().environment) = (haze, haze);
    assert!(viewer.picture().unwrap() == picture(&mut expects));
}

#[test]
fn second_change_replaces_one_that_waits() {
    let [shadows, haze] = [
        Environment { shadows: small_maps(), ..noon() },
        Environment { fog: DistanceFog { enabled: true, density_per_m: 0.02 }, ..noon() },
    ];
    let single = ThreadingModel::SingleThreaded;
    let Some(mut expects) = viewer(&haze, single, EnvironmentChanges::AtOnce) else { return };
    let expected = picture(&mut expects);
    let mut viewer = viewer(&noon(), single, EnvironmentChanges::WhenReady).unwrap();
    let before = picture(&mut viewer);
    let changed = viewer.frame_stamp().frame;
    viewer.view_mut().environment = shadows;
    assert!(picture(&mut viewer) == before);
    viewer.view_mut().environment = haze;
    assert!(shown_after(&mut viewer, &before, &expected) > 0);
    // A change that is taken back leaves the view as it was.
    viewer.view_mut().environment = Environment { sky: Sky::Atmosphere, ..noon() };
    assert!(picture(&mut viewer) == expected && !viewer.is_settled());
    viewer.view_mut().environment = haze;
    assert!(picture(&mut viewer) == expected && viewer.is_settled());
    assert_eq!(created(&viewer, changed)[0], 0);
}

#[test]
fn change_survives_the_loss_of_its_device() {
    let shadows = Environment { shadows: small_maps(), ..noon() };
    let threading = ThreadingModel::CullThreadPerCameraDrawThreadPerContext;
    let Some(mut expects) = viewer(&shadows, threading, EnvironmentChanges::AtOnce) else { return };
    let mut viewer = viewer(&noon(), threading, EnvironmentChanges::WhenReady).unwrap();
    viewer.view_mut().environment = shadows;
    viewer.frame().unwrap();
    let context = viewer.context();
    viewer.composite_mut().lose_device(context).unwrap();
    // The frames in flight, the one that reports the loss, and those that upload.
    viewer.settle(6);
    assert!(picture(&mut viewer) == picture(&mut expects));
}
