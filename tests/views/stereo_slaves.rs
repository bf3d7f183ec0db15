//! Slave cameras in stereo: each has both eyes in its image, or one of them in a separate window. Needs a GPU; a
//! software adapter suffices.

use std::sync::Arc;

use glam::{DAffine3, DMat4, DVec3};
use image::RgbaImage;
use kit::skip::or_skip;
use kit::viewer::Settle;
use terrane::cull::{Stereo, StereoMode};

use terrane::gpu::{ContextTraits, GraphicsContext};
use terrane::scene::{Drawable, Geometry, Material, Mesh, Node, Page, Sky};
use terrane::viewer::{ContextId, Eyes, Slave, ThreadingModel, ViewArea, Viewer, ViewerConfig};

const SIZE: [u32; 2] = [96, 64];

fn traits(size_px: [u32; 2]) -> ContextTraits {
    ContextTraits { size_px, adapter: kit::adapter(), validation: true, ..ContextTraits::default() }
}

/// Opens a viewer with balls near and far in front of the eye. `None`, and the test skipped, without an adapter.
fn viewer(size_px: [u32; 2], stereo: Option<Stereo>, threading: ThreadingModel) -> Option<Viewer> {
    let context = or_skip(GraphicsContext::new_offscreen(&traits(size_px)))?;
    let config = ViewerConfig { size_px, threading, stereo, max_contexts: 3, ..ViewerConfig::default() };
    let mut viewer = Viewer::new(context, &config).unwrap();
    let ball = |[x, z]: [f64; 2], radius: f64, color| {
        let material = Material { base_color: color, unlit: true, ..Material::default() };
        let drawable = Drawable::new(Geometry::Mesh(Arc::new(Mesh::sphere(DVec3::ZERO, radius, 16))), material);
        Node::transform(DAffine3::from_translation(DVec3::new(x, 0.0, z)), vec![Node::geode(vec![drawable])])
    };
    let balls = vec![
        ball([0.05, -0.3], 0.03, [1.0, 0.2, 0.1, 1.0]),
        ball([-0.2, -1.0], 0.15, [0.1, 1.0, 0.2, 1.0]),
        ball([0.6, -2.0], 0.4, [0.2, 0.3, 1.0, 1.0]),
    ];
    viewer.add_root(Page::from_node(Node::group(balls)).unwrap()).unwrap();
    viewer.view_mut().camera.world_from_eye = DAffine3::IDENTITY;
    viewer.view_mut().environment.sky = Sky::Background([90, 80, 70]);
    viewer.view_mut().environment.fog.enabled = false;
    Some(viewer)
}

fn pictures(viewer: &mut Viewer, contexts: &[ContextId]) -> Vec<RgbaImage> {
    viewer.settle(4);
    contexts.iter().map(|context| viewer.composite_mut().read_back(*context).unwrap()).collect()
}

fn alone(stereo: Option<Stereo>) -> Option<RgbaImage> {
    let mut viewer = viewer(SIZE, stereo, ThreadingModel::SingleThreaded)?;
    let context = viewer.context();
    pictures(&mut viewer, &[context]).pop()
}

fn part(picture: &RgbaImage, x: u32) -> RgbaImage {
    image::imageops::crop_imm(picture, x, 0, SIZE[0], SIZE[1]).to_image()
}

fn differing(a: &RgbaImage, b: &RgbaImage) -> usize {
    a.pixels().zip(b.pixels()).filter(|(a, b)| a != b).count()
}

/// Returns the threading models for one of several cases: each model has a case, and a long test has all in each.
fn models_for(case: usize) -> Vec<ThreadingModel> {
    let all = ThreadingModel::ALL;
    if kit::long_tests() { all.to_vec() } else { vec![all[case % all.len()]] }
}

#[test]
fn slave_has_both_eyes_in_its_image() {
    for (number, mode) in StereoMode::ALL.into_iter().enumerate() {
        let separation_px = if mode == StereoMode::HorizontalSplit { 6 } else { 0 };
        let stereo = Stereo { separation_px, ..Stereo::new(mode) };
        let Some(expected) = alone(Some(stereo)) else { return };
        for threading in models_for(number) {
            // In a part of the master's part of its context, in a context of the same device, and in one with a
            // separate device.
            let mut viewer = viewer([200, SIZE[1]], Some(stereo), threading).unwrap();
            viewer.view_mut().set_viewport([0, 0, SIZE[0], SIZE[1]]);
            let first = viewer.context();
            let shared = viewer.composite_mut().open_offscreen_on(first, &traits(SIZE)).unwrap();
            let own = viewer.open_context(GraphicsContext::new_offscreen(&traits(SIZE)).unwrap()).unwrap();
            viewer
                .add_slave(Slave { viewport: ViewArea::Pixels([100, 0, SIZE[0], SIZE[1]]), ..Slave::new(first) })
                .unwrap();
            viewer.add_slave(Slave::new(shared)).unwrap();
            viewer.add_slave(Slave::new(own)).unwrap();
            let found = pictures(&mut viewer, &[first, shared, own]);
            for (name, picture) in [
                ("part", part(&found[0], 0)),
                ("beside", part(&found[0], 100)),
                ("shared", found[1].clone()),
                ("own", found[2].clone()),
            ] {
                assert!(
                    picture == expected,
                    "{mode:?}, {threading}, {name}: {} differ",
                    differing(&picture, &expected)
                );
            }
            assert!(found[0].get_pixel(98, 30).0 == [0, 0, 0, 255], "nothing is drawn between the parts");
        }
    }
}

#[test]
fn interlaced_rows_and_columns_are_those_of_the_screen() {
    let of = |mode| alone(Some(Stereo::new(mode)));
    let (Some(left), Some(right)) = (of(StereoMode::LeftEye), of(StereoMode::RightEye)) else { return };
    assert!(differing(&left, &right) > 300);
    for mode in [StereoMode::VerticalInterlace, StereoMode::Checkerboard] {
        let mut viewer = viewer([200, SIZE[1]], Some(Stereo::new(mode)), ThreadingModel::DrawThreadPerContext).unwrap();
        viewer.view_mut().set_viewport([0, 0, SIZE[0], SIZE[1]]);
        let first = viewer.context();
        viewer
            .add_slave(Slave { viewport: ViewArea::Pixels([101, 0, SIZE[0], SIZE[1]]), ..Slave::new(first) })
            .unwrap();
        let found = part(&pictures(&mut viewer, &[first])[0], 101);
        for (x, y, pixel) in found.enumerate_pixels() {
            let row = if mode == StereoMode::Checkerboard { y } else { 0 };
            let eye = if (x + 101 + row) % 2 == 1 { &right } else { &left };
            assert_eq!(pixel, eye.get_pixel(x, y), "{mode:?}: {x}, {y}");
        }
    }
}

#[test]
fn eye_may_have_a_separate_window() {
    let of = |mode| alone(Some(Stereo::new(mode)));
    let (Some(left), Some(right), Some(middle)) = (of(StereoMode::LeftEye), of(StereoMode::RightEye), alone(None))
    else {
        return;
    };
    for threading in ThreadingModel::ALL {
        // The stereo mode of other windows has no effect.
        let stereo = Stereo { keeps_aspect: true, ..Stereo::new(StereoMode::HorizontalSplit) };
        let mut viewer = viewer(SIZE, Some(stereo), threading).unwrap();
        viewer.view_mut().set_eyes(Eyes::Left);
        let first = viewer.context();
        let second = viewer.composite_mut().open_offscreen_on(first, &traits(SIZE)).unwrap();
        let third = viewer.open_context(GraphicsContext::new_offscreen(&traits(SIZE)).unwrap()).unwrap();
        let slave = viewer.add_slave(Slave { eyes: Eyes::Right, ..Slave::new(second) }).unwrap();
        viewer.add_slave(Slave { eyes: Eyes::Middle, ..Slave::new(third) }).unwrap();
        let found = pictures(&mut viewer, &[first, second, third]);
        assert!(found[0] == left && found[1] == right && found[2] == middle, "{threading}");
        // It changes between frames, also with swapped eyes.
        viewer.view_mut().slave_mut(slave).unwrap().eyes = Eyes::Left;
        assert!(pictures(&mut viewer, &[second])[0] == left, "{threading}");
        viewer.view_mut().set_stereo(Some(Stereo { swaps_eyes: true, ..stereo }));
        assert!(pictures(&mut viewer, &[first, second]) == [right.clone(), right.clone()], "{threading}");
        viewer.view_mut().set_stereo(None);
        assert!(pictures(&mut viewer, &[first, second]) == [middle.clone(), middle.clone()], "{threading}");
    }
}

#[test]
fn offsets_of_a_slave_apply_before_its_eyes() {
    // The slave shows the right half of the master's image, so its eyes show the halves of the master's eyes.
    let half = DMat4::from_scale(DVec3::new(2.0, 1.0, 1.0)) * DMat4::from_translation(DVec3::new(-0.5, 0.0, 0.0));
    let wide = [2 * SIZE[0], SIZE[1]];
    for (mode, eyes) in [(StereoMode::LeftEye, Eyes::Left), (StereoMode::RightEye, Eyes::Right)] {
        let Some(mut master) = viewer(wide, Some(Stereo::new(mode)), ThreadingModel::SingleThreaded) else { return };
        let context = master.context();
        let slave = master.composite_mut().open_offscreen_on(context, &traits(SIZE)).unwrap();
        let id = master.add_slave(Slave { projection_offset: half, ..Slave::new(slave) }).unwrap();
        let found = pictures(&mut master, &[context, slave]);
        let expected = part(&found[0], SIZE[0]);
        assert!(differing(&found[1], &expected) < 40, "{mode:?}: {} differ", differing(&found[1], &expected));
        master.view_mut().slave_mut(id).unwrap().eyes = eyes;
        let single = pictures(&mut master, &[slave]);
        assert!(single[0] == found[1], "{mode:?}: a single eye differs");
    }
}

/// Regression: both were culled and drawn, and one was discarded.
#[test]
fn eye_that_is_not_shown_is_not_drawn() {
    let leaves = |stereo: Option<Stereo>, threading| {
        let mut viewer = viewer(SIZE, stereo, threading)?;
        let context = viewer.context();
        let second = viewer.composite_mut().open_offscreen_on(context, &traits(SIZE)).unwrap();
        let both = |viewer: &mut Viewer| {
            viewer.settle(4);
            viewer.finish().unwrap();
            let last = viewer.stats().last_drawn().unwrap();
            (last.leaves, last.triangles)
        };
        let alone = both(&mut viewer);
        viewer.add_slave(Slave::new(second)).unwrap();
        Some([alone, both(&mut viewer)])
    };
    for threading in ThreadingModel::ALL {
        let Some(one) = leaves(None, threading) else { return };
        assert_eq!((one[0].0, one[1].0), (3, 6), "three balls, in one window and in two");
        let two = one.map(|(leaves, triangles)| (2 * leaves, 2 * triangles));
        for mode in StereoMode::ALL {
            let is_one = [StereoMode::LeftEye, StereoMode::RightEye].contains(&mode);
            let expected = if is_one { one } else { two };
            assert_eq!(leaves(Some(Stereo::new(mode)), threading).unwrap(), expected, "{mode:?}, {threading}");
        }
    }
}
