//! The pixels of each stereo mode, with two eyes that see different colors.

use std::sync::Arc;

use glam::dcamera::rh::proj::directx as proj;
use glam::{DAffine3, DVec3};
use image::RgbaImage;
use kit::frames::pixel;
use kit::rig::{Rig, plain, rig, unit_camera};
use kit::shapes::quad;
use terrane::cull::{CullCamera, Stereo, StereoMode};
use terrane::scene::{Attachment, CameraNode, CameraTarget, Node, Page, ReferenceFrame, RenderOrder};
use terrane::state::{TextureFormat, TextureObject};
use terrane::viewer::{Viewer, ViewerConfig};

const SIDE: u32 = 64;
const YELLOW: [u8; 3] = [255, 255, 0];
const CYAN: [u8; 3] = [0, 255, 255];

/// Everything that the left eye sees is yellow, everything that the right eye sees is cyan.
fn picture(rig: &mut Rig, stereo: &Stereo) -> RgbaImage {
    let wall = |mask, color| {
        let mut node = Node::geode(vec![quad([0.0, 0.0, 0.0], [4.0, 4.0], color)]);
        node.mask = mask;
        node
    };
    let scene = rig.scene(Node::group(vec![wall(1, [1.0, 1.0, 0.0, 1.0]), wall(2, [0.0, 1.0, 1.0, 1.0])]));
    let mut camera = unit_camera(SIDE);
    (camera.settings.cull_mask_left, camera.settings.cull_mask_right) = (1, 2);
    let size_px = stereo.eye_size_px([SIDE, SIDE]);
    let targets = ["left", "right"].map(|name| {
        let texture = TextureObject::target(name, size_px, TextureFormat::Rgba8Srgb);
        Arc::new(CameraTarget { colors: vec![Attachment::new(texture)], samples: 1, ..CameraTarget::default() })
    });
    rig.ctx.resize([SIDE, SIDE]).unwrap();
    rig.visitor.cull_stereo(&scene, &camera, stereo, &targets, &mut rig.stage);
    assert_eq!(rig.stage.counters.leaves, 2, "one stage per eye");
    rig.renderer.draw(&mut rig.ctx, &rig.stage, &plain()).unwrap();
    let errors = (rig.ctx.take_device_errors(), rig.renderer.take_errors());
    assert!(errors.0.is_empty() && errors.1.is_empty(), "{errors:?}");
    let picture = rig.read_back();
    rig.release(scene);
    picture
}

#[test]
fn each_mode_puts_the_eyes_at_their_pixels() {
    let Some(mut rig) = rig("each_mode_puts_the_eyes_at_their_pixels") else { return };
    let rig = &mut *rig;
    for mode in StereoMode::ALL {
        let picture = picture(rig, &Stereo::new(mode));
        for (x, y) in (0..SIDE).flat_map(|y| (0..SIDE).map(move |x| (x, y))) {
            let is_right = match mode {
                StereoMode::Anaglyphic => {
                    assert_eq!(pixel(&picture, x, y), [255; 3], "red of yellow, green and blue of cyan");
                    continue;
                }
                StereoMode::HorizontalSplit => x >= SIDE / 2,
                StereoMode::VerticalSplit => y >= SIDE / 2,
                StereoMode::LeftEye => false,
                StereoMode::RightEye => true,
                StereoMode::HorizontalInterlace => y % 2 == 1,
                StereoMode::VerticalInterlace => x % 2 == 1,
                StereoMode::Checkerboard => (x + y) % 2 == 1,
            };
            assert_eq!(pixel(&picture, x, y), if is_right { CYAN } else { YELLOW }, "{mode:?} at {x}, {y}");
        }
    }
}

/// The part of each eye is cleared of the image of the other one.
#[test]
fn masks_follow_the_eyes_when_they_are_swapped() {
    let Some(mut rig) = rig("masks_follow_the_eyes_when_they_are_swapped") else { return };
    let stereo = Stereo { swaps_eyes: true, ..Stereo::new(StereoMode::HorizontalSplit) };
    let picture = picture(&mut rig, &stereo);
    assert_eq!([pixel(&picture, 2, 2), pixel(&picture, SIDE - 2, 2)], [CYAN, YELLOW]);
}

#[test]
fn overlays_are_in_both_eyes() {
    let Some(mut rig) = rig("overlays_are_in_both_eyes") else { return };
    let rig = &mut *rig;
    let hud = CameraNode {
        frame: ReferenceFrame::Absolute,
        view: DAffine3::IDENTITY,
        projection: Some(proj::orthographic(-1.0, 1.0, -1.0, 1.0, 10.0, 0.1)),
        clear_color: None,
        ..CameraNode::new(RenderOrder::PostRender(0))
    };
    let left_half = || {
        Node::camera(hud.clone(), vec![Node::geode(vec![quad([-0.5, 0.0, -1.0], [0.5, 1.0], [0.0, 1.0, 0.0, 1.0])])])
    };
    for samples in [1, 4] {
        let scene = rig.scene(left_half());
        let targets = ["left", "right"].map(|name| {
            let texture = TextureObject::target(name, [SIDE / 2, SIDE], TextureFormat::Rgba8Srgb);
            Arc::new(CameraTarget { colors: vec![Attachment::new(texture)], samples, ..CameraTarget::default() })
        });
        rig.ctx.resize([SIDE, SIDE]).unwrap();
        let stereo = Stereo::new(StereoMode::HorizontalSplit);
        rig.visitor.cull_stereo(&scene, &unit_camera(SIDE), &stereo, &targets, &mut rig.stage);
        rig.renderer.draw(&mut rig.ctx, &rig.stage, &plain()).unwrap();
        let errors = (rig.ctx.take_device_errors(), rig.renderer.take_errors());
        assert!(errors.0.is_empty() && errors.1.is_empty(), "{errors:?}");
        let picture = rig.read_back();
        rig.release(scene);
        for (x, y) in (0..SIDE).flat_map(|y| (0..SIDE).map(move |x| (x, y))) {
            let is_left = x % (SIDE / 2) < SIDE / 4;
            assert_eq!(pixel(&picture, x, y) == [0, 255, 0], is_left, "{samples} samples at {x}, {y}");
        }
    }
}

#[test]
fn split_images_have_a_gap_if_configured() {
    let Some(mut rig) = rig("split_images_have_a_gap_if_configured") else { return };
    let rig = &mut *rig;
    for mode in [StereoMode::HorizontalSplit, StereoMode::VerticalSplit] {
        let picture = picture(rig, &Stereo { separation_px: 10, ..Stereo::new(mode) });
        for (x, y) in (0..SIDE).flat_map(|y| (0..SIDE).map(move |x| (x, y))) {
            let along = if mode == StereoMode::HorizontalSplit { x } else { y };
            let expected = match along {
                _ if along < (SIDE - 10) / 2 => YELLOW,
                _ if along < (SIDE + 10) / 2 => [0; 3],
                _ => CYAN,
            };
            assert_eq!(pixel(&picture, x, y), expected, "{mode:?} at {x}, {y}");
        }
    }
}

#[test]
fn near_objects_have_a_disparity() {
    let Some(mut rig) = rig("near_objects_have_a_disparity") else { return };
    let rig = &mut *rig;
    // At 10 m with the fusion distance at 20 m, the left eye sees the object farther to the right.
    let stereo = Stereo { eye_separation_m: 0.05, fusion_distance_m: 20.0, ..Stereo::new(StereoMode::LeftEye) };
    let middle = |rig: &mut Rig, mode| {
        let scene = rig.scene(Node::geode(vec![quad([0.0; 3], [0.25, 0.25], [1.0, 0.0, 0.0, 1.0])]));
        let targets = ["left", "right"].map(|name| {
            let texture = TextureObject::target(name, [SIDE; 2], TextureFormat::Rgba8Srgb);
            Arc::new(CameraTarget { colors: vec![Attachment::new(texture)], samples: 1, ..CameraTarget::default() })
        });
        rig.ctx.resize([SIDE, SIDE]).unwrap();
        let camera: CullCamera = unit_camera(SIDE);
        rig.visitor.cull_stereo(&scene, &camera, &Stereo { mode, ..stereo }, &targets, &mut rig.stage);
        rig.renderer.draw(&mut rig.ctx, &rig.stage, &plain()).unwrap();
        let picture = rig.read_back();
        rig.release(scene);
        let red: Vec<u32> =
            picture.enumerate_pixels().filter(|(.., p)| p.0[..3] == [255, 0, 0]).map(|(x, ..)| x).collect();
        f64::from(red.iter().sum::<u32>()) / red.len() as f64 + 0.5
    };
    let (left, right) = (middle(rig, StereoMode::LeftEye), middle(rig, StereoMode::RightEye));
    // Each eye is 1 m off (2.5 cm times 20 m / 0.5 m). Half of that is removed by the shear at 10 m, which leaves 16
    // pixels.
    assert!((left - 48.0).abs() < 1.0 && (right - 16.0).abs() < 1.0, "{left} {right}");
}

#[test]
fn viewer_draws_for_two_eyes() {
    let Some(rig) = rig("viewer_draws_for_two_eyes") else { return };
    drop(rig);
    let config = ViewerConfig { size_px: [96, 64], validation: false, ..ViewerConfig::default() };
    let mut viewer = Viewer::new_offscreen(&config).unwrap();
    viewer
        .add_root(Page::from_node(Node::geode(vec![quad([0.0; 3], [0.5; 2], [1.0, 0.0, 0.0, 1.0])])).unwrap())
        .unwrap();
    viewer.view_mut().camera.look_at(DVec3::new(0.0, 0.0, 3.0), DVec3::ZERO, DVec3::Y);
    let red = |viewer: &mut Viewer, from: u32, to: u32| {
        for _ in 0..10 {
            viewer.frame().unwrap();
        }
        let picture = viewer.read_back().unwrap();
        picture.enumerate_pixels().filter(|(x, _, p)| (from..to).contains(x) && p.0[0] > 200 && p.0[1] < 90).count()
    };
    let whole = red(&mut viewer, 0, 96);
    viewer.view_mut().set_stereo(Some(Stereo::new(StereoMode::HorizontalSplit)));
    let halves = [red(&mut viewer, 0, 48), red(&mut viewer, 48, 96)];
    assert!(whole > 200 && halves.iter().all(|h| h.abs_diff(whole / 2) < whole / 8), "{whole} {halves:?}");
    viewer.resize([64, 64]).unwrap();
    assert!(red(&mut viewer, 0, 32) > 50);
    viewer.view_mut().set_stereo(None);
    assert!(red(&mut viewer, 0, 64) > 200);
}
