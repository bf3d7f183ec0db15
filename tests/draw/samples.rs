//! Small meshes between pixel centres are culled, and no pixel changes by that.

use std::sync::Arc;

use glam::{DAffine3, DMat4, DQuat, DVec3};
use kit::rig::{Rig, camera, plain, rig, rig_with, traits};
use proptest::strategy::{Strategy, ValueTree};
use proptest::test_runner::TestRunner;
use terrane::cull::CullCamera;
use terrane::gpu::ContextTraits;
use terrane::scene::{AlphaMode, CullingMode, Drawable, Geometry, Material, Mesh, MeshVertex, Node, Scene, Topology};
use terrane::state::{Attribute, BinDetails, PolygonMode, SortMode, StateSet, Viewport};

/// Returns a thousand meshes of one to four triangles, half a millimetre to half a metre large, within ten metres.
fn dust(topology: Topology) -> Node {
    let mut runner = TestRunner::deterministic();
    let mut number = |low: f64, high: f64| (low..high).new_tree(&mut runner).unwrap().current();
    let mut nodes = Vec::new();
    for i in 0..1000u32 {
        let size = 10f64.powf(number(-3.3, -0.3));
        let count = 1 + i % 4;
        let mut point = |_| [0; 3].map(|_| (size * number(-1.0, 1.0)) as f32);
        let positions: Vec<[f32; 3]> = (0..3 * count).map(&mut point).collect();
        let color = [0; 3].map(|_| number(0.2, 1.0) as f32);
        let vertices = positions.iter().map(|p| MeshVertex { position: *p, ..MeshVertex::default() }).collect();
        let mut mesh = Mesh::cuboid(&terrane::math::Aabb { min: DVec3::splat(-size), max: DVec3::splat(size) });
        mesh.vertices = vertices;
        mesh.indices = (0..3 * count).collect();
        mesh.topology = topology;
        let alpha = if i % 3 == 0 { AlphaMode::Blend } else { AlphaMode::Opaque };
        let base_color = [color[0], color[1], color[2], if i % 3 == 0 { 0.6 } else { 1.0 }];
        let material = Material { base_color, unlit: true, double_sided: true, alpha, ..Material::default() };
        let drawable = Drawable::new(Geometry::Mesh(Arc::new(mesh)), material);
        let turn = DQuat::from_euler(glam::EulerRot::XYZ, number(0.0, 6.3), number(0.0, 6.3), number(0.0, 6.3));
        let stretch = DVec3::new(number(0.3, 2.0), number(0.3, 2.0) * if i % 2 == 0 { -1.0 } else { 1.0 }, 1.0);
        let place = DVec3::new(number(-10.0, 10.0), number(-10.0, 10.0), number(-10.0, 10.0));
        let map = DAffine3::from_scale_rotation_translation(stretch, turn, place);
        nodes.push(Node::transform(map, vec![Node::geode(vec![drawable])]));
    }
    Node::group(nodes)
}

/// Returns the number of culled leaves. Fails if the image differs from that of all leaves.
fn left_out(rig: &mut Rig, scene: &Scene, camera: &CullCamera) -> u32 {
    let mut every = *camera;
    every.settings.culling = CullingMode(camera.settings.culling.0 & !CullingMode::SAMPLES.0);
    let drawn = rig.draw(scene, &every, &plain());
    assert_eq!(drawn.unsampled_leaves, 0);
    let whole = rig.read_back();
    let fewer = rig.draw(scene, camera, &plain());
    assert_eq!(fewer.leaves + fewer.unsampled_leaves, drawn.leaves);
    assert!(rig.read_back() == whole, "{} of {} left out are missed", fewer.unsampled_leaves, drawn.leaves);
    fewer.unsampled_leaves
}

#[test]
fn only_leaves_that_cover_no_sample_are_culled() {
    let Some(mut rig) = rig("only_leaves_that_cover_no_sample_are_culled") else { return };
    for bin in [None, Some(BinDetails::new(0, SortMode::BackToFront))] {
        let scene =
            rig.scene(dust(Topology::Triangles).with_state_set(Arc::new(StateSet { bin, ..StateSet::default() })));
        for eye in [DVec3::new(30.0, 5.0, 40.0), DVec3::new(-90.0, 200.0, 10.0), DVec3::new(1.0, 2.0, 3.0)] {
            for size_px in [[256, 256], [61, 40]] {
                let camera = camera(size_px, eye, DVec3::ZERO, DVec3::Z);
                let few = left_out(&mut rig, &scene, &camera);
                // The eye is among the meshes, of which the nearest are many pixels wide.
                assert!(few > if eye.length() > 20.0 { 200 } else { 20 }, "{few} from {eye}");
            }
        }
        let mut parallel = camera([128, 128], DVec3::new(0.0, 30.0, 20.0), DVec3::ZERO, DVec3::Z);
        parallel.clip_from_eye = glam::dcamera::rh::proj::directx::orthographic(-12.0, 12.0, -12.0, 12.0, 100.0, 0.1);
        assert!(left_out(&mut rig, &scene, &parallel) > 200);
        // The projection is off its axis, like that of one eye in stereo or of a tile of a wall of screens.
        let mut shifted = camera([128, 128], DVec3::new(0.0, 30.0, 20.0), DVec3::ZERO, DVec3::Z);
        shifted.clip_from_eye = DMat4::from_translation(DVec3::new(0.7, -0.4, 0.0)) * shifted.clip_from_eye;
        assert!(left_out(&mut rig, &scene, &shifted) > 100);
        rig.release(scene);
    }
}

#[test]
fn samples_are_those_of_the_state_sets_viewport() {
    let Some(mut rig) = rig("samples_are_those_of_the_state_sets_viewport") else { return };
    let camera = camera([200, 200], DVec3::new(30.0, 5.0, 40.0), DVec3::ZERO, DVec3::Z);
    let mut counts = Vec::new();
    for [x, y, width, height] in [[0.0, 0.0, 200.0, 200.0], [33.5, 20.25, 41.0, 77.5], [150.0, 190.0, 50.0, 10.0]] {
        let part = StateSet::default().with(Attribute::Viewport(Viewport { x, y, width, height }));
        let scene = rig.scene(dust(Topology::Triangles).with_state_set(Arc::new(part)));
        counts.push(left_out(&mut rig, &scene, &camera));
        rig.release(scene);
    }
    assert!(counts[0] < counts[1] && counts[1] < counts[2], "{counts:?}");
}

#[test]
fn lines_points_and_wireframes_are_never_culled() {
    let Some(mut rig) = rig("lines_points_and_wireframes_are_never_culled") else { return };
    let camera = camera([64, 64], DVec3::new(30.0, 5.0, 40.0), DVec3::ZERO, DVec3::Z);
    let outlines = StateSet::default().with(Attribute::PolygonMode(PolygonMode::Line));
    for root in
        [dust(Topology::Lines), dust(Topology::Points), dust(Topology::Triangles).with_state_set(Arc::new(outlines))]
    {
        let scene = rig.scene(root);
        assert_eq!(left_out(&mut rig, &scene, &camera), 0);
        rig.release(scene);
    }
}

#[test]
fn nothing_is_culled_with_several_samples_per_pixel() {
    let Some(mut rig) = rig_with(&ContextTraits { samples: 4, ..traits([64, 64]) }) else { return };
    let scene = rig.scene(dust(Topology::Triangles));
    let camera = camera([64, 64], DVec3::new(30.0, 5.0, 40.0), DVec3::ZERO, DVec3::Z);
    assert_eq!(left_out(&mut rig, &scene, &camera), 0);
}
