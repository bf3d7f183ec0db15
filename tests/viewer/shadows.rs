//! Shadows with several images or several levels of a scene: fades, eyes, slaves, tiles.

use std::path::Path;
use std::sync::Arc;

use glam::{DAffine3, DVec3};
use image::RgbaImage;
use kit::frames::{MAGENTA, count};
use kit::rig::{camera, rig};
use kit::shadows::{check, cuboid, ground, meets, ray, small_maps, sunny, tower};
use kit::skip::skipped;
use terrane::cull::{CullCamera, Stereo, StereoMode};

use terrane::math::Aabb;
use terrane::pager::PagerConfig;
use terrane::scene::{Attachment, CameraTarget, Environment, Node, NodeKind, Page};
use terrane::state::{TextureFormat, TextureObject};
use terrane::viewer::{Slave, ThreadingModel, ViewArea, Viewer, ViewerConfig};

const SIZE: [u32; 2] = [256, 192];

/// Saves an image if `KEEP_IMAGES` names a folder.
fn keep(name: &str, picture: &RgbaImage) {
    if let Some(folder) = std::env::var_os("KEEP_IMAGES") {
        picture.save(Path::new(&folder).join(format!("{name}.png"))).unwrap();
    }
}

fn darker(with: &RgbaImage, without: &RgbaImage) -> usize {
    with.pixels().zip(without.pixels()).filter(|(a, b)| a.0[0].saturating_add(4) < b.0[0]).count()
}

fn brighter(with: &RgbaImage, without: &RgbaImage) -> usize {
    with.pixels().zip(without.pixels()).filter(|(a, b)| a.0[0] > b.0[0].saturating_add(4)).count()
}

#[test]
fn fading_content_casts_shadows() {
    let Some(mut rig) = rig("fading_content_casts_shadows") else { return };
    let rig = &mut *rig;
    let low = Aabb { max: tower().max.with_z(8.0), ..tower() };
    let of = |bounds: &Aabb, color: [f32; 4]| {
        let mut drawable = cuboid(bounds.min, bounds.max);
        drawable.material.base_color = color;
        Node::geode(vec![drawable])
    };
    let mut lod = Node::new(NodeKind::Lod { center: DVec3::ZERO, ranges_m: vec![[0.0, 60.0], [60.0, 1e9]] });
    lod.children = vec![of(&tower(), [1.0, 0.2, 0.2, 1.0]), of(&low, [0.2, 0.2, 1.0, 1.0])];
    let scene = rig.scene(Node::group(vec![Node::geode(vec![ground(200.0)]), lod]));
    let environment = sunny(DVec3::new(1.0, 0.5, 1.0));
    let at = |time_s: f64, lod_scale: f64| {
        let eye = DVec3::new(-40.0, -50.0, 45.0);
        let mut camera = CullCamera { simulation_time_s: time_s, ..camera(SIZE, eye, DVec3::ZERO, DVec3::Z) };
        (camera.settings.lod_scale, camera.settings.lod_fade_s) = (lod_scale, 1.0);
        camera
    };
    // From the low level, which is drawn from 60 m on, to the high one and back.
    for (from, to, coming) in [(1.0, 0.5, tower()), (0.5, 1.0, low)] {
        let start_s = if from == 1.0 { 0.0 } else { 100.0 };
        let old = rig.picture(&scene, &at(start_s, from), &environment);
        let mut shares = Vec::new();
        let mut on_ground = 0;
        let pictures: Vec<_> = (1..=11)
            .map(|i| {
                let picture = rig.picture(&scene, &at(start_s + 0.1 * f64::from(i), to), &environment);
                assert_eq!(count(&picture, MAGENTA), count(&old, MAGENTA), "nothing behind is visible");
                picture
            })
            .collect();
        keep(&format!("fade-{from}"), &pictures[4]);
        let new = &pictures[10];
        // Pixels of ground are checked: the new level casts its whole shadow at once.
        for picture in &pictures {
            let mut of_old = 0;
            for (x, y, pixel) in picture.enumerate_pixels() {
                let (eye, along) = ray(&at(0.0, 1.0), x, y);
                let wide = Aabb { min: tower().min - 0.5, max: tower().max + 0.5 };
                if meets(eye, along, &wide).is_none() {
                    assert_eq!(pixel, new.get_pixel(x, y), "({x}, {y})");
                    on_ground += 1;
                } else {
                    of_old += usize::from(pixel == old.get_pixel(x, y) && pixel != new.get_pixel(x, y));
                }
            }
            shares.push(of_old);
        }
        assert!(on_ground > 300_000 && darker(new, &old) + darker(&old, new) > 300, "{on_ground}");
        let (dark, lit) =
            check(new, &rig.stage.shadows, &at(0.0, 1.0), [&[coming], &[tower()]], DVec3::new(1.0, 0.5, 1.0));
        assert!(dark > 20 && lit > 5_000, "{dark} {lit}");
        assert!(shares.windows(2).all(|w| w[1] <= w[0]) && shares[0] > shares[4] && shares[4] > 50, "{shares:?}");
        assert_eq!(shares[10], 0);
    }
    rig.release(scene);
    assert!(rig.renderer.take_errors().is_empty());
}

#[test]
fn each_eye_has_separate_shadows() {
    let Some(mut rig) = rig("each_eye_has_separate_shadows") else { return };
    let rig = &mut *rig;
    let to_sun = DVec3::new(1.0, 0.5, 1.0);
    let scene = rig.scene(Node::geode(vec![ground(200.0), cuboid(tower().min, tower().max)]));
    let whole = camera(SIZE, DVec3::new(-40.0, -50.0, 45.0), DVec3::new(0.0, 0.0, 2.0), DVec3::Z);
    let mut pictures = Vec::new();
    for (eye, mode) in [(0, StereoMode::LeftEye), (1, StereoMode::RightEye)] {
        let stereo = Stereo { eye_separation_m: 4.0, screen_distance_m: 40.0, ..Stereo::new(mode) };
        let size_px = stereo.eye_size_px(SIZE);
        assert_eq!(size_px, SIZE);
        let targets = ["left", "right"].map(|name| {
            let texture = TextureObject::target(name, size_px, TextureFormat::Rgba8Srgb);
            Arc::new(CameraTarget { colors: vec![Attachment::new(texture)], samples: 1, ..CameraTarget::default() })
        });
        let environment = sunny(to_sun);
        rig.ctx.resize(SIZE).unwrap();
        rig.visitor.environment = Some(environment);
        rig.visitor.cull_stereo(&scene, &whole, &stereo, &targets, &mut rig.stage);
        let stats = rig.renderer.draw(&mut rig.ctx, &rig.stage, &environment).unwrap();
        assert!(rig.ctx.take_device_errors().is_empty() && rig.renderer.take_errors().is_empty());
        // Two images with four cascades each are combined.
        assert_eq!(stats.passes, 11);
        let picture = rig.read_back();
        keep(&format!("eye-{eye}"), &picture);
        let seen = stereo.eyes(&whole)[eye];
        let shadows = &rig.stage.pre_render[eye].shadows;
        let (dark, lit) = check(&picture, shadows, &seen, [&[tower()], &[]], to_sun);
        assert!(dark > 100 && lit > 5_000, "{eye}: {dark} {lit}");
        pictures.push(picture);
    }
    assert!(darker(&pictures[0], &pictures[1]) > 500, "the eyes differ");
    rig.visitor.environment = None;
    rig.release(scene);
}

fn viewer(size_px: [u32; 2], threading: ThreadingModel) -> Viewer {
    let config = ViewerConfig {
        size_px,
        threading,
        adapter: kit::adapter(),
        validation: false,
        pager: PagerConfig { blocking: true, ..PagerConfig::default() },
        ..ViewerConfig::default()
    };
    Viewer::new_offscreen(&config).unwrap()
}

/// Adds the tower and the ground, and returns the image after some frames.
fn open(viewer: &mut Viewer) {
    let root = Node::geode(vec![ground(200.0), cuboid(tower().min, tower().max)]);
    viewer.add_root(Page::from_node(root).unwrap()).unwrap();
    viewer.view_mut().camera.look_at(DVec3::new(-40.0, -50.0, 45.0), DVec3::ZERO, DVec3::Z);
    viewer.view_mut().environment = Environment { shadows: small_maps(), ..sunny(DVec3::new(1.0, 0.5, 1.0)) };
}

fn settled(viewer: &mut Viewer) -> RgbaImage {
    for _ in 0..6 {
        viewer.frame_at(1.0).unwrap();
        viewer.finish().unwrap();
    }
    viewer.read_back().unwrap()
}

#[test]
fn slaves_have_separate_shadows() {
    if rig("slaves_have_separate_shadows").is_none() {
        return;
    }
    let turned = DAffine3::from_rotation_y(0.2) * DAffine3::from_translation(DVec3::new(3.0, 0.0, 0.0));
    let [width, height] = SIZE;
    // The view of the slave is drawn alone.
    let mut alone = viewer(SIZE, ThreadingModel::SingleThreaded);
    open(&mut alone);
    let master = settled(&mut alone);
    alone.view_mut().camera.world_from_eye *= turned.inverse();
    let beside = settled(&mut alone);
    assert!(master != beside);
    alone.view_mut().environment.shadows = None;
    assert!(darker(&beside, &settled(&mut alone)) > 500);
    for model in ThreadingModel::ALL {
        let mut both = viewer([2 * width, height], model);
        open(&mut both);
        both.view_mut().set_viewport([0, 0, width, height]);
        let context = both.contexts().next().unwrap();
        let viewport = ViewArea::Pixels([width, 0, width, height]);
        both.add_slave(Slave { viewport, view_offset: turned, ..Slave::new(context) }).unwrap();
        let picture = settled(&mut both);
        keep(&format!("slaves-{model}"), &picture);
        for (x, wanted) in [(0, &master), (width, &beside)] {
            let part = image::imageops::crop_imm(&picture, x, 0, width, height).to_image();
            let differ = part.pixels().zip(wanted.pixels()).filter(|(a, b)| a.0[0].abs_diff(b.0[0]) > 2).count();
            // Each has separate maps. At the edge of two triangles, another part of a target may round differently.
            assert!(differ <= 4, "{model} at {x}: {differ}");
        }
        let report = both.report().unwrap();
        assert!(report.draw.shadow_leaves > 0);
    }
}

#[test]
fn gltf_tiles_cast_shadows() {
    let samples = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/samples/3d-tiles");
    if !samples.is_dir() {
        return skipped(format!("no sample tile sets at {}", samples.display()));
    }
    if rig("gltf_tiles_cast_shadows").is_none() {
        return;
    }
    let mut seen = 0;
    for set in ["TilesetWithDiscreteLOD/tileset.json", "ReplaceTileset/tileset.json", "MultipleContents/tileset.json"] {
        let file = samples.join(set);
        if !file.is_file() {
            eprintln!("gltf_tiles_cast_shadows: no {}", file.display());
            continue;
        }
        let mut viewer = viewer([320, 240], ThreadingModel::default());
        viewer.load(file.to_str().unwrap()).unwrap();
        let up = viewer.view().environment.up_in_world;
        let side = up.any_orthonormal_vector();
        viewer.view_mut().environment.sun_direction = (0.5 * up + side).normalize();
        let without = settled(&mut viewer);
        viewer.view_mut().environment.shadows = small_maps();
        let with = settled(&mut viewer);
        let name = set.split('/').next().unwrap();
        keep(&format!("{name}-without"), &without);
        keep(&format!("{name}-with"), &with);
        assert!(viewer.stats().last().unwrap().shadow_leaves > 0, "{set}");
        assert_eq!(brighter(&with, &without), 0, "{set}");
        eprintln!("{set}: {} pixels darker", darker(&with, &without));
        seen += usize::from(darker(&with, &without) > 50);
    }
    assert!(seen > 0);
}
