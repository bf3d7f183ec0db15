//! Fades of levels of detail in a viewer: the same in all threading models, by the application's time, and frames
//! continue until they have ended.

use std::sync::Arc;

use glam::DVec3;
use image::RgbaImage;
use kit::viewer::offscreen;

use terrane::scene::{Drawable, Geometry, Material, Mesh, Node, NodeKind, Page, Sky};
use terrane::viewer::{Slave, ThreadingModel, ViewArea, Viewer, ViewerConfig};

const SIZE: [u32; 2] = [96, 64];

fn viewer(threading: ThreadingModel) -> Option<Viewer> {
    let config = ViewerConfig {
        size_px: SIZE,
        threading,
        adapter: kit::adapter(),
        validation: false,
        ..ViewerConfig::default()
    };
    offscreen(&config)
}

/// Returns a red ball far away and a green one near.
fn open(viewer: &mut Viewer) {
    let ball = |color, segments| {
        let material = Material { base_color: color, unlit: true, ..Material::default() };
        let mesh = Geometry::Mesh(Arc::new(Mesh::sphere(DVec3::ZERO, 2.0, segments)));
        Node::geode(vec![Drawable::new(mesh, material)])
    };
    let mut lod = Node::new(NodeKind::Lod { center: DVec3::ZERO, ranges_m: vec![[0.0, 6.0], [6.0, 1e9]] });
    lod.children = vec![ball([0.0, 1.0, 0.0, 1.0], 16), ball([1.0, 0.0, 0.0, 1.0], 9)];
    viewer.add_root(Page::from_node(Node::group(vec![lod])).unwrap()).unwrap();
    viewer.view_mut().camera.look_at(DVec3::new(0.0, 0.0, 10.0), DVec3::ZERO, DVec3::Y);
    viewer.view_mut().environment.sky = Sky::Background([0, 0, 255]);
    viewer.view_mut().environment.fog.enabled = false;
    viewer.view_mut().environment.exposure = None;
}

fn greens(picture: &RgbaImage) -> usize {
    picture.pixels().filter(|p| p.0[1] > 200).count()
}

#[test]
fn all_models_draw_the_same_fade() {
    let mut first: Option<Vec<RgbaImage>> = None;
    for model in ThreadingModel::ALL {
        let Some(mut viewer) = viewer(model) else { return };
        open(&mut viewer);
        // A slave in a part of the image has a separate level of detail and fade.
        let context = viewer.contexts().next().unwrap();
        let slave = Slave { viewport: ViewArea::Pixels([64, 0, 32, 32]), ..Slave::new(context) };
        let slave = viewer.add_slave(slave).unwrap();
        viewer.view_mut().slave_mut(slave).unwrap().inherit = terrane::scene::Inherit::NONE;
        viewer.view_mut().slave_mut(slave).unwrap().settings.lod_scale = 0.5;
        // Frames are drawn until the balls are uploaded, by any thread.
        for _ in 0..4 {
            viewer.frame_at(4.99).unwrap();
            viewer.finish().unwrap();
        }
        for frame in 0..12 {
            let time_s = 5.0 + 0.04 * f64::from(frame);
            viewer.view_mut().camera.settings.lod_scale = if frame < 3 { 1.0 } else { 0.5 };
            viewer.view_mut().slave_mut(slave).unwrap().settings.lod_scale = if frame < 5 { 0.5 } else { 1.0 };
            if frame > 0 {
                viewer.want_picture();
            }
            viewer.frame_at(time_s).unwrap();
            // An additional image may be in flight.
            assert!(viewer.check_need_to_do_frame() || viewer.is_settled());
            let is_fading = (3..11).contains(&frame);
            assert_eq!(viewer.is_settled(), !is_fading, "{model} {frame}");
        }
        viewer.finish().unwrap();
        assert!(!viewer.check_need_to_do_frame());
        let pictures: Vec<RgbaImage> = viewer.take_pictures().into_iter().map(|(_, picture)| picture).collect();
        assert_eq!(pictures.len(), 11);
        let counts: Vec<usize> = pictures.iter().map(greens).collect();
        assert!(counts[4] > counts[1] + 100 && counts[10] > counts[5], "{model}: {counts:?}");
        match &first {
            None => first = Some(pictures),
            Some(first) => assert!(*first == pictures, "{model}"),
        }
    }
}

#[test]
fn fade_ends_while_time_stands_still_and_images_show_its_end() {
    let Some(mut viewer) = viewer(ThreadingModel::SingleThreaded) else { return };
    open(&mut viewer);
    for frame in 0..6 {
        viewer.frame_at(0.01 * f64::from(frame)).unwrap();
    }
    let old = viewer.picture().unwrap();
    viewer.view_mut().camera.settings.lod_scale = 0.5;
    viewer.frame_at(0.1).unwrap();
    assert!(!viewer.is_settled() && viewer.check_need_to_do_frame());
    let fading = viewer.read_back().unwrap();
    assert!(greens(&fading) > 50 && greens(&old) == 0, "{}", greens(&fading));
    let new = viewer.picture().unwrap();
    assert!(greens(&new) > greens(&fading));
    viewer.frame_at(0.1).unwrap();
    assert!(viewer.is_settled() && !viewer.check_need_to_do_frame());
    assert!(viewer.read_back().unwrap() == new);
    // With fades off there is none.
    viewer.view_mut().camera.settings.lod_fade_s = 0.0;
    viewer.view_mut().camera.settings.lod_scale = 1.0;
    viewer.frame_at(0.11).unwrap();
    assert!(viewer.is_settled());
    assert!(viewer.read_back().unwrap() == old);
}
