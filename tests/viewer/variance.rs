//! Update changes geometry, state and transforms in every frame while earlier frames are still drawn. Each image shows
//! its frame in every threading model. Needs a GPU; a software adapter suffices.

use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex};

use glam::{DAffine3, DVec3};
use image::RgbaImage;
use kit::viewer::offscreen;
use terrane::draw::{CameraCallbacks, RenderInfo};
use terrane::math::Aabb;
use terrane::scene::{
    CameraNode, ComputeNearFar, Drawable, Geometry, Material, Mesh, MeshVertex, Node, NodeId, Page, PageId,
    RenderOrder, SceneError, Sky, Topology,
};
use terrane::state::{Attribute, DataVariance, StateSet, SurfaceMaterial};
use terrane::viewer::{KEY_COLOR, ThreadingModel, Viewer, ViewerConfig};

/// The number of vertices along a side. Uploading and drawing take as long as update.
const SIDE: u32 = 48;

/// Returns the number of frames of a run.
fn frames() -> u32 {
    if kit::long_tests() { 80 } else { 30 }
}

/// Returns a sheet of 4 m that faces -y, with moving waves.
fn write_waves(mesh: &mut Mesh, frame: u32) {
    for (i, vertex) in mesh.vertices.iter_mut().enumerate() {
        let (x, z) = (i as u32 % SIDE, i as u32 / SIDE);
        let [u, v] = [x, z].map(|k| k as f32 / (SIDE - 1) as f32 - 0.5);
        let depth = 0.4 * (9.0 * u + 5.0 * v + 0.7 * frame as f32).sin();
        *vertex = MeshVertex {
            position: [4.0 * u * (1.0 + 0.2 * depth), depth, 4.0 * v],
            normal: [0, -127, 0, 0],
            color: [x as u8 * 5, (frame * 7 % 256) as u8, z as u8 * 5, 255],
            ..MeshVertex::default()
        };
    }
    mesh.bounds = Aabb { min: DVec3::new(-2.4, -0.4, -2.0), max: DVec3::new(2.4, 0.4, 2.0) };
}

fn sheet() -> Mesh {
    let corners = |x: u32, z: u32| [z * SIDE + x, z * SIDE + x + 1, (z + 1) * SIDE + x + 1, (z + 1) * SIDE + x];
    let quads = (0..(SIDE - 1) * (SIDE - 1)).map(|i| corners(i % (SIDE - 1), i / (SIDE - 1)));
    let mut mesh = Mesh {
        vertices: vec![MeshVertex::default(); (SIDE * SIDE) as usize],
        indices: quads.flat_map(|[a, b, c, d]| [a, b, c, a, c, d]).collect::<Vec<_>>().into(),
        topology: Topology::Triangles,
        ..Mesh::default()
    };
    write_waves(&mut mesh, 0);
    mesh
}

fn state(frame: u32) -> Arc<StateSet> {
    let shade = |k: u32| (frame * k % 16) as f32 / 15.0;
    let emission = [shade(3), shade(5), shade(7)];
    Arc::new(StateSet::default().with(Attribute::SurfaceMaterial(SurfaceMaterial { emission, ..Default::default() })))
}

fn viewer(threading: ThreadingModel) -> Option<Viewer> {
    let adapter = kit::adapter();
    let config = ViewerConfig { size_px: [160, 120], threading, adapter, validation: true, ..ViewerConfig::default() };
    offscreen(&config)
}

/// Returns a root with a waving sheet below a transform (node 1) and a state set, and one drawn by state only.
fn root(viewer: &mut Viewer, mesh: &Arc<Mesh>, set: &Arc<StateSet>) -> PageId {
    let drawable = |mesh: &Arc<Mesh>| Drawable::new(Geometry::Mesh(mesh.clone()), Material::default());
    let waving =
        Node::transform(DAffine3::IDENTITY, vec![Node::geode(vec![drawable(mesh)])]).with_state_set(set.clone());
    let still = Node::transform(
        DAffine3::from_translation(DVec3::new(0.0, 1.5, 0.0)),
        vec![Node::geode(vec![drawable(&Arc::new(sheet()))])],
    );
    let root = viewer.add_root(Page::from_node(Node::group(vec![waving, still])).unwrap()).unwrap();
    viewer.view_mut().environment.sky = Sky::Background(KEY_COLOR);
    viewer.view_mut().environment.fog.enabled = false;
    viewer.view_mut().camera.look_at(DVec3::new(0.0, -6.0, 1.0), DVec3::ZERO, DVec3::Z);
    root
}

/// The result of a run: an image per frame, and the number of times that update found its mesh shared.
type Run = (Vec<(u32, RgbaImage)>, u32);

fn run(threading: ThreadingModel, variance: DataVariance) -> Option<Run> {
    let mut viewer = viewer(threading)?;
    let mesh = Arc::new(sheet());
    let set = state(0);
    let root = root(&mut viewer, &mesh, &set);
    // Frames are drawn until both sheets are uploaded.
    while viewer.stats().last_drawn().is_none_or(|s| s.leaves < 2) {
        viewer.frame().unwrap();
    }
    viewer.finish().unwrap();
    let first = viewer.frame_stamp().frame + 1;
    let shared = Arc::new(AtomicU32::new(0));
    let count = shared.clone();
    let (mut mesh, mut old) = (mesh, set);
    viewer.on_update(Box::new(move |scene, stamp| {
        let frame = stamp.frame - first;
        if Arc::strong_count(&mesh) > 1 {
            count.fetch_add(1, Ordering::Relaxed);
        }
        write_waves(Arc::make_mut(&mut mesh), frame);
        scene.set_mesh(NodeId { page: root, index: 2 }, 0, mesh.clone(), variance).unwrap();
        let turned = DAffine3::from_rotation_y(0.05 * f64::from(frame));
        scene.set_transform(NodeId { page: root, index: 1 }, turned).unwrap();
        let new = state(frame);
        assert!(scene.replace_state_set(root, &old, new.clone()));
        old = new;
    }));
    for _ in 0..frames() {
        viewer.want_picture();
        viewer.frame().unwrap();
    }
    viewer.finish().unwrap();
    let pictures = viewer.take_pictures().into_iter().map(|(frame, picture)| (frame - first, picture)).collect();
    Some((pictures, shared.load(Ordering::Relaxed)))
}

#[test]
fn changing_scenes_are_the_same_frame_for_frame() {
    let Some((expected, _)) = run(ThreadingModel::SingleThreaded, DataVariance::Static) else { return };
    assert_eq!(expected.len() as u32, frames());
    let different = expected.windows(2).filter(|w| w[0].1 != w[1].1).count() as u32;
    assert_eq!(different, frames() - 1, "each frame must be different");
    for variance in [DataVariance::Static, DataVariance::Dynamic] {
        for threading in ThreadingModel::ALL {
            let (pictures, shared) = run(threading, variance).unwrap();
            assert_eq!(pictures.len(), expected.len());
            for ((frame, picture), (expected_frame, expected)) in pictures.iter().zip(&expected) {
                assert_eq!(frame, expected_frame);
                assert!(picture == expected, "{threading}, {variance:?}: frame {frame} differs");
            }
            if variance == DataVariance::Dynamic {
                // The first update may find the compiled mesh, or a separate one.
                assert!(shared <= 1, "{threading}: {shared} updates found their mesh still read");
            }
        }
    }
}

#[test]
fn dynamic_callbacks_have_read_the_data_before_the_next_update() {
    for threading in ThreadingModel::ALL {
        let Some(mut viewer) = viewer(threading) else { return };
        // Update writes the number of the frame, and draw reads it.
        let shared = Arc::new(AtomicU32::new(0));
        let seen: Arc<Mutex<Vec<(u32, u32)>>> = Arc::default();
        let (of_draw, read) = (shared.clone(), seen.clone());
        let callbacks = CameraCallbacks {
            final_draw: Some(Box::new(move |info, _| {
                std::thread::sleep(std::time::Duration::from_millis(2));
                read.lock().unwrap().push((info.stage.camera.frame, of_draw.load(Ordering::SeqCst)));
            })),
            data_variance: DataVariance::Dynamic,
            ..CameraCallbacks::default()
        };
        let camera = CameraNode { callbacks: Some(callbacks.hook()), ..CameraNode::new(RenderOrder::PostRender(0)) };
        let mesh = Drawable::new(Geometry::Mesh(Arc::new(sheet())), Material::default());
        let node = Node::camera(camera, vec![Node::geode(vec![mesh])]);
        viewer.add_root(Page::from_node(node).unwrap()).unwrap();
        viewer.on_update(Box::new(move |_, stamp| shared.store(stamp.frame, Ordering::SeqCst)));
        for _ in 0..30 {
            viewer.frame().unwrap();
        }
        viewer.finish().unwrap();
        let seen = std::mem::take(&mut *seen.lock().unwrap());
        assert_eq!(seen.len(), 30, "{threading}");
        assert!(seen.iter().all(|(frame, value)| frame == value), "{threading}: {seen:?}");
    }
}

/// The moment, the frame, and the distance of the near plane in metres.
type Said = (&'static str, u32, f64);

/// Regression: only cameras in the graph had callbacks.
#[test]
fn view_has_callbacks_that_report_near_and_far() {
    for threading in ThreadingModel::ALL {
        let Some(mut viewer) = viewer(threading) else { return };
        let said: Arc<Mutex<Vec<Said>>> = Arc::default();
        let log = |moment: &'static str| {
            let said = said.clone();
            move |info: &RenderInfo<'_>| {
                let camera = &info.stage.camera;
                // Points at -near have depth 1.
                let near_m = camera.clip_from_eye.w_axis.z / (1.0 + camera.clip_from_eye.z_axis.z);
                said.lock().unwrap().push((moment, camera.frame, near_m));
            }
        };
        let (initial, pre, post, last) = (log("initial"), log("pre"), log("post"), log("final"));
        viewer.view_mut().set_draw_callbacks(Some(CameraCallbacks {
            initial: Some(Box::new(move |info, _| initial(info))),
            pre_draw: Some(Box::new(move |info, _| pre(info))),
            post_draw: Some(Box::new(move |info, _| post(info))),
            final_draw: Some(Box::new(move |info, _| last(info))),
            ..CameraCallbacks::default()
        }));
        viewer.view_mut().camera.settings.compute_near_far = ComputeNearFar::BoundingVolumes;
        viewer.view_mut().set_clamp_projection(Some(|near_m, far_m| {
            assert!(near_m > 0.125, "{near_m}");
            (0.125, far_m)
        }));
        let mesh = Drawable::new(Geometry::Mesh(Arc::new(sheet())), Material::default());
        viewer.add_root(Page::from_node(Node::geode(vec![mesh])).unwrap()).unwrap();
        (0..3).for_each(|_| viewer.frame().unwrap());
        viewer.view_mut().set_draw_callbacks(None);
        viewer.frame().unwrap();
        viewer.finish().unwrap();
        let said = std::mem::take(&mut *said.lock().unwrap());
        let moments: Vec<_> = said.iter().map(|(moment, frame, _)| (*moment, *frame)).collect();
        let first = moments[0].1;
        let of_frame = |frame| ["initial", "pre", "post", "final"].map(|moment| (moment, frame));
        let expected: Vec<_> = (first..first + 3).flat_map(of_frame).collect();
        assert_eq!(moments, expected, "{threading}");
        // A small margin is left.
        assert!(said.iter().all(|(_, _, near_m)| (0.12..=0.125).contains(near_m)), "{threading}: {said:?}");
    }
}

#[test]
fn drawables_without_a_mesh_are_refused() {
    let Some(mut viewer) = viewer(ThreadingModel::SingleThreaded) else { return };
    let mesh = Arc::new(sheet());
    let root = root(&mut viewer, &mesh, &state(0));
    let mut set = |index, drawable| {
        let node = NodeId { page: root, index };
        viewer.scene_mut().set_mesh(node, drawable, mesh.clone(), DataVariance::Static)
    };
    assert_eq!(set(2, 0), Ok(()));
    assert!(matches!(set(2, 1), Err(SceneError::NotAMesh { drawable: 1, .. })));
    assert!(matches!(set(1, 0), Err(SceneError::NotAMesh { .. })));
    assert!(matches!(set(99, 0), Err(SceneError::StaleNode { .. })));
}
