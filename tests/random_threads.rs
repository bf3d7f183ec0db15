//! Scenes by chance, changed from frame to frame: every threading model draws the same pictures. Needs a GPU (a software one
//! will do). `RANDOM_SCENES=FIRST..END` draws those seeds.
#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

mod gpu_support;
mod random_support;
mod viewer_support;

use glam::DVec3;
use gpu_support::plain;
use image::RgbaImage;
use random_support::{Maker, change, eye, named, seeds};
use terrane::gpu::AdapterChoice;
use terrane::scene::Page;
use terrane::viewer::{ThreadingModel, ViewerConfig};
use viewer_support::{Settle, offscreen};

const SIZE_PX: [u32; 2] = [96, 64];
const FRAMES: u32 = 8;

/// Every frame of a seed; `None` without an adapter.
fn flown(seed: u64, threading: ThreadingModel, compile_contexts: bool) -> Option<Vec<RgbaImage>> {
    let config = ViewerConfig {
        size_px: SIZE_PX,
        threading,
        compile_contexts,
        adapter: AdapterChoice::Software,
        validation: false,
        ..ViewerConfig::default()
    };
    let mut viewer = offscreen(&config)?;
    let context = viewer.contexts().next().unwrap();
    let mut maker = Maker::new(seed, false);
    let mut node = maker.scene();
    named(&mut node, &mut 0);
    viewer.add_root(Page::from_node(node.clone()).unwrap()).unwrap();
    viewer.environment = plain();
    viewer.camera.look_at(eye(&mut maker.random), DVec3::ZERO, DVec3::Z);
    viewer.camera.settings.lod_fade_s = 0.0;
    viewer.settle(2);
    let mut pictures = Vec::new();
    for _ in 0..FRAMES {
        for _ in 0..maker.random.below(5) {
            change(viewer.scene_mut(), &mut node, &mut maker, true);
        }
        // Meshes come when they are there: in as many frames as the machine makes of them.
        viewer.settle(2);
        viewer.want_picture_of(context);
        viewer.frame().unwrap();
        if maker.random.percent(30) {
            viewer.finish().unwrap();
        }
        pictures.extend(viewer.take_pictures_of(context));
    }
    viewer.finish().unwrap();
    pictures.extend(viewer.take_pictures_of(context));
    Some(pictures.into_iter().map(|(_, picture)| picture).collect())
}

#[test]
fn all_threading_models_draw_the_same() {
    for seed in seeds(5000..5002) {
        let Some(wanted) = flown(seed, ThreadingModel::SingleThreaded, false) else { return };
        assert_eq!(wanted.len(), FRAMES as usize);
        for (model, compiles) in ThreadingModel::ALL.into_iter().flat_map(|m| [(m, false), (m, true)]).skip(1) {
            let pictures = flown(seed, model, compiles).unwrap();
            assert_eq!(pictures.len(), wanted.len(), "seed {seed}, {model:?}");
            for (frame, (a, b)) in pictures.iter().zip(&wanted).enumerate() {
                let others = a.pixels().zip(b.pixels()).filter(|(a, b)| a != b).count();
                if others > 0 {
                    let folder = std::path::PathBuf::from(env!("CARGO_TARGET_TMPDIR"));
                    a.save(folder.join("threads_a.png")).unwrap();
                    b.save(folder.join("threads_b.png")).unwrap();
                    panic!(
                        "seed {seed}, {model:?}, compile thread {compiles}: {others} pixels of picture {frame} differ"
                    );
                }
            }
        }
    }
}
