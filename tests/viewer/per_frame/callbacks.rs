//! Callbacks that change a state set, a uniform, a drawable and the cameras of a view: each frame shows what they have set.
//! Needs a GPU; a software adapter suffices.

use std::sync::{Arc, Mutex};

use glam::DVec3;
use kit::viewer::offscreen;
use terrane::gpu::AdapterChoice;
use terrane::scene::{CallbackStateSet, Drawable, Material, Mesh, Node, Page, Sky, UpdateCallback, UpdateInfo};
use terrane::state::{Attribute, DataVariance, Program, StateSet, UniformValue};
use terrane::viewer::{EventKind, Key, ThreadingModel, Viewer, ViewerConfig};

const WGSL: &str = "struct U { tint: vec3<f32> } @group(2) @binding(0) var<uniform> u: U;
    @vertex fn vs_main(vertex: MeshVertex, @builtin(instance_index) i: u32) -> @builtin(position) vec4<f32> {
        return frame.clip_from_eye * vec4<f32>(point_in_eye(leaves[i], vertex.position), 1.0);
    }
    @fragment fn fs_main() -> @location(0) vec4<f32> { return vec4<f32>(u.tint, 1.0); }";

/// A square of 2 m before the eye at `x`.
fn square(x: f64) -> Drawable {
    let mesh = Mesh::rectangle(DVec3::new(x - 1.0, 0.0, -1.0), DVec3::X * 2.0, DVec3::Z * 2.0);
    Drawable::new(mesh.into(), Material { unlit: true, ..Material::default() })
}

fn red_or_green(frame: u32) -> [f32; 3] {
    if frame.is_multiple_of(2) { [1.0, 0.0, 0.0] } else { [0.0, 1.0, 0.0] }
}

#[test]
fn each_frame_shows_what_its_callbacks_have_set() {
    for threading in ThreadingModel::ALL {
        let config = ViewerConfig { size_px: [96, 48], threading, adapter: kit::adapter(), ..ViewerConfig::default() };
        let Some(mut viewer) = offscreen(&config) else { return };
        let program = Attribute::Program(Program::new("tinted", WGSL));
        let tinted = StateSet::default().with(program).with_uniform("tint", UniformValue::Vec3([0.0; 3]));
        let (by_uniform, by_set) = (CallbackStateSet::new(tinted), CallbackStateSet::new(StateSet::default()));
        let mut left = Node::geode(vec![square(-3.0)]).with_state_set(by_uniform.current());
        left.update_callback = Some(by_uniform.on_uniform("tint", |tint, info: &UpdateInfo| {
            *tint = UniformValue::Vec3(red_or_green(info.frame));
        }));
        let mut middle = Node::geode(vec![square(0.0)]).with_state_set(by_set.current());
        middle.update_callback = Some(by_set.on_state_set(|set, info: &UpdateInfo| {
            let [r, g, b] = red_or_green(info.frame);
            set.color = Some([r, g, b, 1.0]);
        }));
        // The drawable is only where it was put in this frame.
        let mut right = Node::geode(vec![square(3.0)]);
        right.update_callback = Some(UpdateCallback::on_drawable(0, |scene, node, drawable, info| {
            let x = if info.frame.is_multiple_of(2) { 3.0 } else { 100.0 };
            let mesh = Mesh::rectangle(DVec3::new(x - 1.0, 0.0, -1.0), DVec3::X * 2.0, DVec3::Z * 2.0);
            scene.set_mesh(node, drawable, Arc::new(mesh), DataVariance::Static).unwrap();
        }));
        viewer.add_root(Page::from_node(Node::group(vec![left, middle, right])).unwrap()).unwrap();
        viewer.view_mut().environment.sky = Sky::Background([0, 0, 0]);
        viewer.view_mut().environment.fog.enabled = false;
        viewer.view_mut().camera.look_at(DVec3::new(0.0, -9.0, 0.0), DVec3::ZERO, DVec3::Z);
        // Everything is compiled before the pixels count.
        (0..4).for_each(|_| viewer.frame().unwrap());
        for _ in 0..6 {
            viewer.frame().unwrap();
            let frame = viewer.frame_stamp().frame;
            let picture = viewer.read_back().unwrap();
            let [r, g, b] = red_or_green(frame).map(|c| (255.0 * c) as u8);
            let at = |x: u32| picture.get_pixel(x, 24).0[..3].to_vec();
            assert_eq!(at(20), [r, g, b], "{threading}: the uniform in frame {frame}");
            assert_eq!(at(48), [r, g, b], "{threading}: the state set in frame {frame}");
            assert_eq!(at(76) != [0, 0, 0], frame.is_multiple_of(2), "{threading}: the drawable in frame {frame}");
        }
    }
}

fn empty_viewer() -> Viewer {
    let config =
        ViewerConfig { size_px: [32, 16], adapter: AdapterChoice::Noop, validation: false, ..ViewerConfig::default() };
    let mut viewer = Viewer::new_offscreen(&config).unwrap();
    viewer.add_root(Page::from_node(Node::group(vec![])).unwrap()).unwrap();
    viewer
}

#[test]
fn update_callback_of_the_cameras_runs_once_a_frame_after_the_scene() {
    let mut viewer = empty_viewer();
    let order: Arc<Mutex<Vec<String>>> = Arc::default();
    let (of_scene, of_view) = (order.clone(), order.clone());
    viewer.on_update(Box::new(move |_, stamp| of_scene.lock().unwrap().push(format!("scene {}", stamp.frame))));
    viewer.view_mut().set_update_callback(Some(Box::new(move |view, stamp| {
        of_view.lock().unwrap().push(format!("view {}", stamp.frame));
        view.camera.world_from_eye.translation.z = f64::from(stamp.frame);
        if stamp.frame == 3 {
            view.set_update_callback(Some(Box::new(|view, _| view.camera.world_from_eye.translation.z = -1.0)));
        }
    })));
    (0..3).for_each(|_| viewer.frame().unwrap());
    assert!(viewer.check_need_to_do_frame());
    assert_eq!(*order.lock().unwrap(), ["scene 1", "view 1", "scene 2", "view 2", "scene 3", "view 3"]);
    assert_eq!(viewer.view().camera.eye().z, 3.0);
    viewer.frame().unwrap();
    assert_eq!(viewer.view().camera.eye().z, -1.0, "the callback has set another one");
    viewer.view_mut().set_update_callback(None);
    assert!(!viewer.view().has_update_callback());
}

#[test]
fn event_callback_of_the_cameras_gets_every_event_after_the_handlers() {
    let mut viewer = empty_viewer();
    let seen: Arc<Mutex<Vec<(String, bool)>>> = Arc::default();
    let noted = seen.clone();
    viewer.view_mut().set_event_callback(Some(Box::new(move |view, event| {
        let kind = match event.kind {
            EventKind::KeyDown { .. } => "key",
            EventKind::Frame => "frame",
            _ => "other",
        };
        noted.lock().unwrap().push((kind.to_owned(), event.handled));
        view.camera.world_from_eye.translation.x += 1.0;
    })));
    let queue = viewer.view_mut().event_queue();
    queue.key_press(Key::Char('x'), Key::Char('x'), 0.0);
    viewer.frame().unwrap();
    let seen = std::mem::take(&mut *seen.lock().unwrap());
    let of = |kind: &str| seen.iter().filter(|(of, _)| of == kind).count();
    assert_eq!((of("key"), of("frame")), (1, 1), "{seen:?}");
    assert_eq!(viewer.view().camera.eye().x, seen.len() as f64);
}
