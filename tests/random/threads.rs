//! Random scenes that change from frame to frame, in several views: every threading model draws the same images. Needs
//! a GPU; a software adapter suffices. `RANDOM_SCENES=FIRST..END` draws those seeds.

use crate::graphs::{Maker, Random, change, eye, named, seeds};
use glam::DVec3;
use image::RgbaImage;
use kit::rig::plain;
use kit::skip::or_skip;
use kit::viewer::Settle;
use terrane::gpu::{ContextTraits, GraphicsContext};
use terrane::scene::{Environment, Node, Page, Scene, SunShadows, Water};
use terrane::viewer::{CompositeViewer, ThreadingModel, View, ViewerConfig};

/// Returns the number of frames of a seed.
fn frames() -> u32 {
    if kit::long_tests() { 6 } else { 3 }
}

/// A graph, and the scene that must look like it.
struct Graph {
    maker: Maker,
    node: Node,
}

impl Graph {
    fn new(seed: u64) -> Self {
        let mut maker = Maker::new(seed, false);
        // A software driver takes most of the time to compile the pipelines of a large scene.
        let mut node = if kit::long_tests() { maker.scene() } else { maker.small_scene() };
        named(&mut node, &mut 0);
        Self { maker, node }
    }

    fn change(&mut self, scene: &mut Scene) {
        for _ in 0..self.maker.random.below(5) {
            change(scene, &mut self.node, &mut self.maker, true);
        }
    }
}

/// Returns an environment. Some have a sky, shadows or a sea, some only a background.
fn environment(random: &mut Random) -> Environment {
    if random.percent(60) {
        return plain();
    }
    Environment {
        sun_direction: eye(random).normalize(),
        shadows: random.percent(60).then(|| SunShadows { resolution_px: 256, ..SunShadows::default() }),
        water: random.percent(40).then(|| Water::at(-6.0)),
        ..Environment::default()
    }
}

fn moved(view: &mut View, random: &mut Random) {
    view.camera.look_at(eye(random), DVec3::ZERO, DVec3::Z);
    view.environment = environment(random);
}

/// Returns all images of a seed: two scenes in three views, two of them in one of two contexts. `None` without an
/// adapter.
fn flown(seed: u64, threading: ThreadingModel, compile_contexts: bool) -> Option<Vec<RgbaImage>> {
    let config = ViewerConfig {
        max_contexts: 2,
        threading,
        compile_contexts,
        adapter: kit::adapter(),
        validation: false,
        ..ViewerConfig::default()
    };
    let random = &mut Random::new(seed);
    let traits =
        |size_px| ContextTraits { size_px, adapter: kit::adapter(), validation: false, ..ContextTraits::default() };
    let mut viewer = CompositeViewer::new(&config).unwrap();
    let first = viewer.open_context(or_skip(GraphicsContext::new_offscreen(&traits([128, 64])))?).unwrap();
    let second = match random.percent(50) {
        true => viewer.open_offscreen_on(first, &traits([64, 48])).unwrap(),
        false => viewer.open_context(GraphicsContext::new_offscreen(&traits([64, 48])).unwrap()).unwrap(),
    };
    let mut graphs = [Graph::new(seed), Graph::new(!seed)];
    let scenes = [0; 2].map(|_| viewer.add_scene().unwrap());
    for (graph, scene) in graphs.iter().zip(scenes) {
        viewer.add_root(scene, Page::from_node(graph.node.clone()).unwrap()).unwrap();
    }
    let views = [
        viewer.add_view(scenes[0], first, Some([0, 0, 64, 64])).unwrap(),
        viewer.add_view(scenes[1], first, Some([64, 0, 64, 64])).unwrap(),
        viewer.add_view(scenes[random.below(2) as usize], second, None).unwrap(),
    ];
    for view in views {
        let view = viewer.view_mut(view).unwrap();
        view.camera.settings.lod_fade_s = 0.0;
        moved(view, random);
    }
    let mut pictures = Vec::new();
    for _ in 0..frames() {
        for (graph, scene) in graphs.iter_mut().zip(scenes) {
            graph.change(viewer.scene_mut(scene).unwrap());
        }
        moved(viewer.view_mut(random.one_of(&views)).unwrap(), random);
        if random.percent(20) {
            viewer.resize_context(second, [40 + random.below(60) as u32, 48]).unwrap();
        }
        // Meshes are drawn once they are uploaded, whose number of frames depends on the machine.
        viewer.settle(2);
        for context in [first, second] {
            viewer.want_picture(context);
        }
        viewer.frame().unwrap();
        // Otherwise the next frames would be culled while this one is drawn.
        if random.percent(30) {
            viewer.finish().unwrap();
        }
        pictures.extend([first, second].map(|context| (context, viewer.take_pictures(context))));
    }
    viewer.finish().unwrap();
    pictures.extend([first, second].map(|context| (context, viewer.take_pictures(context))));
    let of = |context| pictures.iter().filter(move |(of, _)| *of == context).flat_map(|(_, pictures)| pictures);
    Some(of(first).chain(of(second)).map(|(_, picture)| picture.clone()).collect())
}

#[test]
fn all_threading_models_draw_the_same() {
    for seed in seeds(0, 2) {
        let Some(wanted) = flown(seed, ThreadingModel::SingleThreaded, false) else { return };
        assert_eq!(wanted.len(), 2 * frames() as usize);
        // A seed runs half of the models, one of them with a compile thread. Four seeds run all with and without one.
        for (place, model) in (0..).zip(ThreadingModel::ALL).filter(|(place, _)| place % 2 == seed % 2) {
            let compiles = (place / 2 + seed / 2) % 2 == 0;
            let pictures = flown(seed, model, compiles).unwrap();
            assert_eq!(pictures.len(), wanted.len(), "seed {seed}, {model:?}");
            for (place, (a, b)) in pictures.iter().zip(&wanted).enumerate() {
                let others = a.pixels().zip(b.pixels()).filter(|(a, b)| a != b).count();
                if others > 0 {
                    let folder = std::path::PathBuf::from(env!("CARGO_TARGET_TMPDIR"));
                    a.save(folder.join("threads_a.png")).unwrap();
                    b.save(folder.join("threads_b.png")).unwrap();
                    panic!(
                        "seed {seed}, {model:?}, compile thread {compiles}: {others} pixels of picture {place} differ"
                    );
                }
            }
        }
    }
}
