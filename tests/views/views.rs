//! Views of a configuration file: their windows, parts, scenes and cameras, offscreen. Images need a GPU; a software
//! adapter suffices.

use std::path::Path;

use glam::DVec3;
use image::RgbaImage;
use kit::shapes::ball;
use kit::skip::or_skip;
use kit::tile_sets::small_set;
use kit::viewer::Settle;
use terrane::gpu::{AdapterChoice, GraphicsContext};
use terrane::scene::{Inherit, Node, Page};
use terrane::viewer::{
    ArrangedViews, Arrangement, CompositeViewer, Slave, ViewFrom, ViewerConfig, ViewerError, ViewsSetup,
};

fn setup(folder: &Path, text: &str) -> ViewsSetup {
    let file = folder.join("views.json");
    std::fs::write(&file, text).unwrap();
    match Arrangement::read(&file).unwrap() {
        Arrangement::Views(setup) => setup,
        other => panic!("{other:?}"),
    }
}

fn arranged(setup: &ViewsSetup) -> Option<ArrangedViews> {
    let mut config = ViewerConfig { size_px: [200, 100], adapter: kit::adapter(), ..ViewerConfig::default() };
    config.pager.blocking = true;
    let roots = setup.read_roots(&config.pager).unwrap();
    or_skip(ArrangedViews::new_offscreen(setup, &config, roots, None))
}

fn part(picture: &RgbaImage, [x, y, width, height]: [u32; 4]) -> RgbaImage {
    image::imageops::crop_imm(picture, x, y, width, height).to_image()
}

/// Returns the share of pixels with approximately a colour.
fn share(picture: &RgbaImage, color: [u8; 3]) -> f64 {
    let is_near = |p: &&image::Rgba<u8>| p.0.iter().zip(color).all(|(a, b)| a.abs_diff(b) < 8);
    picture.pixels().filter(is_near).count() as f64 / f64::from(picture.width() * picture.height())
}

fn colours(picture: &RgbaImage) -> usize {
    picture.pixels().map(|p| p.0).collect::<std::collections::HashSet<_>>().len()
}

#[test]
fn views_have_their_parts_scenes_and_slaves() {
    let folder = tempfile::tempdir().unwrap();
    small_set(folder.path());
    let setup = setup(
        folder.path(),
        r#"{"windows": [{"size_px": [300, 100]}, {"size_px": [120, 80], "shares_device": true}],
            "scenes": {"hills": "set"},
            "views": [
              {"scene": "hills", "pitch_deg": -80, "background": [250, 0, 0],
               "cameras": [{"viewport_px": [0, 0, 100, 100]}, {"window": 1}]},
              {"pitch_deg": -80, "range_m": 7, "background": [0, 0, 250],
               "cameras": [{"viewport_px": [100, 0, 100, 100]}]},
              {"background": [0, 250, 0], "cameras": [{"viewport_px": [200, 0, 100, 100]}]}]}"#,
    );
    let Some(ArrangedViews { mut viewer, contexts, views, own_scene }) = arranged(&setup) else { return };
    assert_eq!((contexts.len(), views.len()), (2, 3));
    let own = own_scene.unwrap();
    assert!(viewer.scene_of(views[1]).unwrap() == own && viewer.scene_of(views[2]).unwrap() == own);
    assert!(viewer.scene_of(views[0]).unwrap() != own);
    // Both views show the application's scene, each from a separate eye.
    let white = ball(DVec3::ZERO, 1.0, [1.0; 4]);
    viewer.add_root(own, Page::from_node(Node::group(vec![white])).unwrap()).unwrap();
    // The view is that of the file, although nothing was loaded when it was read.
    let bounds = *viewer.bounds(own).unwrap().unwrap();
    let as_said = ViewFrom { pitch: (-80f64).to_radians(), range_m: Some(7.0), ..ViewFrom::default() };
    for (view, from) in views[1..].iter().zip([as_said, ViewFrom::default()]) {
        let pose = viewer.view_mut(*view).unwrap().camera.world_from_eye;
        assert_eq!(pose, bounds.first_camera(&from));
    }
    for (view, distance) in views[1..].iter().zip([3.0, 12.0]) {
        viewer.view_mut(*view).unwrap().camera.look_at(DVec3::new(0.0, -distance, 0.0), DVec3::ZERO, DVec3::Z);
    }
    viewer.settle(3);
    let [first, second] = [0, 1].map(|place| viewer.read_back(contexts[place]).unwrap());
    if let Some(folder) = std::env::var_os("KEEP_IMAGES") {
        first.save(Path::new(&folder).join("views-first.png")).unwrap();
        second.save(Path::new(&folder).join("views-second.png")).unwrap();
    }
    assert_eq!((first.dimensions(), second.dimensions()), ((300, 100), (120, 80)));
    let [hills, near, far] = [0, 100, 200].map(|x| part(&first, [x, 0, 100, 100]));
    assert!(colours(&hills) > 200 && share(&hills, [0, 0, 250]) == 0.0, "terrain on the left");
    assert!(colours(&second) > 200, "terrain in the other window");
    let (large, small) = (share(&near, [255; 3]), share(&far, [255; 3]));
    assert!(large > 4.0 * small && small > 0.005, "{large} and {small} of white");
    assert!(share(&near, [0, 0, 250]) > 0.2 && share(&far, [0, 250, 0]) > 0.5);
    // One view is removed, and the others stay.
    viewer.remove_view(views[1]).unwrap();
    viewer.frame().unwrap();
    let first = viewer.read_back(contexts[0]).unwrap();
    assert!(share(&part(&first, [100, 0, 100, 100]), [255; 3]) == 0.0);
    assert!(part(&first, [200, 0, 100, 100]) == far);
}

#[test]
fn scene_shows_one_tile_set() {
    let folder = tempfile::tempdir().unwrap();
    let set = small_set(folder.path());
    let config = ViewerConfig { adapter: AdapterChoice::Noop, validation: false, ..ViewerConfig::default() };
    let mut viewer = CompositeViewer::new(&config).unwrap();
    let (first, second) = (viewer.add_scene().unwrap(), viewer.add_scene().unwrap());
    let root = viewer.load(first, &set).unwrap();
    let again = viewer.load(first, &set).unwrap_err();
    assert!(matches!(&again, ViewerError::HasTileset { uri } if uri.contains("tileset.json")), "{again}");
    viewer.load(second, &set).unwrap();
    assert!(viewer.remove_root(first, root).unwrap().is_some());
    viewer.load(first, &set).unwrap();
}

/// Regression: a view that draws nothing was hidden by the sum over all views.
#[test]
fn tiles_are_counted_for_each_view() {
    let folder = tempfile::tempdir().unwrap();
    let set = small_set(folder.path());
    let mut config = ViewerConfig { adapter: AdapterChoice::Noop, validation: false, ..ViewerConfig::default() };
    config.pager.blocking = true;
    let mut viewer = CompositeViewer::new(&config).unwrap();
    let context = viewer.open_context(GraphicsContext::new_offscreen(&config.traits()).unwrap()).unwrap();
    let scene = viewer.add_scene().unwrap();
    viewer.load(scene, &set).unwrap();
    let [seeing, blind] = [(); 2].map(|()| viewer.add_view(scene, context, None).unwrap());
    viewer.view_mut(blind).unwrap().camera.settings.cull_mask = 0;
    let slave = Slave { inherit: Inherit::NONE, ..Slave::new(context) };
    viewer.add_slave(blind, slave).unwrap();
    viewer.settle(3);
    let [seen, unseen] = [seeing, blind].map(|id| viewer.view_mut(id).unwrap().tiles_drawn());
    let together = viewer.stats().last().unwrap().tiles_drawn;
    assert!(seen > 0 && unseen == 0 && together > seen, "{seen} and {unseen} of {together}, the slave's too");
    viewer.close_context(context).unwrap();
    assert_eq!(viewer.view_mut(seeing).unwrap().tiles_drawn(), 0);
}

/// Regression: a view that showed nothing but ancestors in place of failed tiles counted as a view that shows nothing.
#[test]
fn stand_ins_count_as_drawn_tiles() {
    let folder = tempfile::tempdir().unwrap();
    let set = small_set(folder.path());
    // One tile of each four is left.
    for (column, row) in (0..16).map(|place| (place % 4, place / 4)).filter(|(column, row)| column % 2 + row % 2 > 0) {
        let tile = Path::new(&set).join(format!("2/{column}/{row}.exr"));
        assert!(tile.exists());
        std::fs::write(tile, "no heights").unwrap();
    }
    let mut config = ViewerConfig { adapter: AdapterChoice::Noop, validation: false, ..ViewerConfig::default() };
    config.pager.blocking = true;
    let mut viewer = CompositeViewer::new(&config).unwrap();
    let context = viewer.open_context(GraphicsContext::new_offscreen(&config.traits()).unwrap()).unwrap();
    let scene = viewer.add_scene().unwrap();
    viewer.load(scene, &set).unwrap();
    let bounds = *viewer.bounds(scene).unwrap().unwrap();
    let view = viewer.add_view(scene, context, None).unwrap();
    let up = bounds.frame.direction(0.0, 0.0);
    let mut only_stand_ins = 0;
    for place in 0..16 {
        let [east, north] = [place % 4, place / 4].map(|number| (f64::from(number) - 1.5) / 2.0);
        let ground = bounds.middle_m + DVec3::new(east, north, 0.0) * bounds.half_size_m;
        let world = |up_m: f64| bounds.frame.world_from_local.transform_point3(ground + DVec3::Z * up_m);
        let eye = world(2.0 * bounds.half_size_m.z);
        viewer.view_mut(view).unwrap().camera.look_at(eye, world(0.0), up);
        viewer.settle(10);
        assert!(viewer.view_mut(view).unwrap().tiles_drawn() > 0, "nothing is shown at {east} {north}");
        only_stand_ins += u32::from(viewer.stats().last().unwrap().tiles_drawn == 0);
    }
    assert!(only_stand_ins > 0, "each view shows a tile of its own");
}

#[test]
fn parts_follow_their_window_by_their_policy() {
    let folder = tempfile::tempdir().unwrap();
    // Side by side: parts that follow the window with each policy, and one that stays in a corner.
    let setup = setup(
        folder.path(),
        r#"{"windows": [{"size_px": [300, 100]}],
            "views": [
              {"background": [250, 0, 0], "cameras": [{"viewport": [0, 0, 0.3333, 1], "resize": "FIXED"}]},
              {"background": [0, 250, 0], "cameras": [{"viewport": [0.3333, 0, 0.3333, 1], "resize": "HORIZONTAL"}]},
              {"background": [0, 0, 250], "cameras": [{"viewport": [0.6667, 0, 0.3333, 1], "resize": "VERTICAL"}]},
              {"background": [250, 250, 0], "cameras": [{"viewport_px": [5, 7, 10, 20]}]}]}"#,
    );
    let Some(ArrangedViews { mut viewer, contexts, views, own_scene }) = arranged(&setup) else { return };
    let white = ball(DVec3::ZERO, 1.0, [1.0; 4]);
    viewer.add_root(own_scene.unwrap(), Page::from_node(Node::group(vec![white])).unwrap()).unwrap();
    let backgrounds = [[250, 0, 0], [0, 250, 0], [0, 0, 250], [250, 250, 0]];
    for (view, distance) in views.iter().zip([5.0, 5.0, 5.0, -100.0]) {
        let view = viewer.view_mut(*view).unwrap();
        view.camera.look_at(DVec3::new(0.0, -distance, 0.0), DVec3::new(0.0, -distance + 1.0, 0.0), DVec3::Z);
    }
    // Returns the width and height of the ball in pixels, in parts of an image that show only the ball.
    let mut balls = |size_px: [u32; 2]| {
        viewer.resize_context(contexts[0], size_px).unwrap();
        viewer.settle(3);
        let picture = viewer.read_back(contexts[0]).unwrap();
        if let Some(folder) = std::env::var_os("KEEP_IMAGES") {
            picture.save(Path::new(&folder).join(format!("views-{}x{}.png", size_px[0], size_px[1]))).unwrap();
        }
        assert_eq!(picture.dimensions(), (size_px[0], size_px[1]));
        assert_eq!(share(&part(&picture, [5, 7, 10, 20]), backgrounds[3]), 1.0, "the corner does not change");
        let third = size_px[0] / 3;
        [0, 1, 2].map(|place| {
            let of = part(&picture, [place as u32 * third, 0, third, size_px[1]]);
            let around = [[0, 0], [third - 1, 0], [0, size_px[1] - 1], [third - 1, size_px[1] - 1]];
            assert!(around.iter().all(|[x, y]| share(&part(&of, [*x, *y, 1, 1]), backgrounds[place]) == 1.0));
            let is_white = |x: u32, y: u32| of.get_pixel(x, y).0 == [255; 4];
            let across = (0..third).filter(|x| is_white(*x, size_px[1] / 2)).count();
            let upwards = (0..size_px[1]).filter(|y| is_white(third / 2, *y)).count();
            [across as f64, upwards as f64]
        })
    };
    let same = |a: f64, b: f64| (a - b).abs() < 3.0;
    let [before, others @ ..] = balls([300, 100]);
    assert!(before[0] > 20.0 && others == [before; 2], "{before:?} {others:?}");
    // Twice as wide: stretched, more at the sides, or less at the top and bottom.
    let [fixed, horizontal, vertical] = balls([600, 100]);
    assert!(same(fixed[0], 2.0 * before[0]) && same(fixed[1], before[1]), "{fixed:?} of {before:?}");
    assert!(same(horizontal[0], before[0]) && same(horizontal[1], before[1]), "{horizontal:?} of {before:?}");
    assert!(same(vertical[0], 2.0 * before[0]) && same(vertical[1], 2.0 * before[1]), "{vertical:?} of {before:?}");
    // Twice as high.
    let [fixed, horizontal, vertical] = balls([300, 200]);
    assert!(same(fixed[0], before[0]) && same(fixed[1], 2.0 * before[1]), "{fixed:?} of {before:?}");
    assert!(same(horizontal[0], 2.0 * before[0]) && same(horizontal[1], 2.0 * before[1]), "{horizontal:?}");
    assert!(same(vertical[0], before[0]) && same(vertical[1], before[1]), "{vertical:?} of {before:?}");
    // The original size again.
    assert_eq!(balls([300, 100]), [before; 3]);
}

#[test]
fn source_that_cannot_be_read_is_one_error_with_its_position() {
    let folder = tempfile::tempdir().unwrap();
    let setup = setup(folder.path(), r#"{"scenes": {"a": "no/set"}, "views": [{"scene": "a"}]}"#);
    let error = setup.read_roots(&ViewerConfig::default().pager).err().unwrap().to_string();
    assert!(error.contains("no/set"), "{error}");
    assert!(!setup.needs_root());
}
