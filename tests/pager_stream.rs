//! The pager over real files: what can be loaded is, what fails is one error and leaves its parent. No GPU.

#![allow(clippy::unwrap_used, reason = "a failed unwrap is a failed test")]

use std::path::Path;
use std::time::{Duration, Instant};

use terrane::cull::{CullCamera, CullVisitor, RenderStage};
use terrane::gpu::{CompileBudget, CompileOperation, Compiled};
use terrane::io::write::{GlbMesh, write_glb};
use terrane::io::{Limits, ReadOptions, root_uri};
use terrane::pager::{CompileContext, DatabasePager, PagerConfig};
use terrane::scene::{DrawSlot, Scene};

/// Compiles at once, and counts the slots that are out.
#[derive(Default)]
struct Context {
    done: Vec<Compiled>,
    slots_out: usize,
}

impl CompileContext for Context {
    fn id(&self) -> u32 {
        0
    }

    fn compile(&mut self, operation: CompileOperation) {
        let slots = vec![DrawSlot(0); operation.drawables.len()];
        self.slots_out += slots.len();
        self.done.push(Compiled { ticket: operation.ticket, slots, bytes: 1000, errors: Vec::new() });
    }

    fn run_compiles(&mut self, _: &CompileBudget) {}

    fn take_compiled(&mut self) -> Vec<Compiled> {
        std::mem::take(&mut self.done)
    }

    fn release(&mut self, slots: Vec<DrawSlot>) {
        self.slots_out -= slots.len();
    }
}

/// A root and four children around the origin, one glb each.
fn write_set(folder: &Path) {
    let glb = write_glb(&GlbMesh {
        positions: vec![[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
        indices: vec![0, 1, 2],
        base_color: [1.0; 4],
        ..GlbMesh::default()
    });
    let tile = |name: &str, error: f64, children: &str| {
        std::fs::write(folder.join(format!("{name}.glb")), &glb).unwrap();
        format!(
            r#"{{"boundingVolume":{{"sphere":[0,0,0,2]}},"geometricError":{error},"content":{{"uri":"{name}.glb"}},"children":[{children}]}}"#
        )
    };
    let children: Vec<String> = (0..4).map(|i| tile(&format!("child{i}"), 0.0, "")).collect();
    let root = tile("root", 5.0, &children.join(","));
    let json = format!(r#"{{"asset":{{"version":"1.1"}},"geometricError":9,"root":{root}}}"#);
    std::fs::write(folder.join("tileset.json"), json).unwrap();
}

struct Run {
    scene: Scene,
    pager: DatabasePager,
    context: Context,
    stage: RenderStage,
    visitor: CullVisitor,
    frame: u32,
}

impl Run {
    fn new(folder: &Path, config: PagerConfig) -> Self {
        let uri = root_uri(folder.to_str().unwrap()).unwrap();
        let mut pager = DatabasePager::new(config, ReadOptions::for_root(&uri, Limits::default())).unwrap();
        let mut scene = Scene::new();
        scene.add_root(pager.read_root(&uri).unwrap());
        let (context, stage, visitor) = (Context::default(), RenderStage::new(), CullVisitor::new());
        Self { scene, pager, context, stage, visitor, frame: 0 }
    }

    /// A frame with the camera at a distance from the origin.
    fn frame(&mut self, distance_m: f64) {
        self.frame += 1;
        let eye_from_world = glam::DAffine3::from_translation(glam::DVec3::new(0.0, 0.0, -distance_m));
        let camera = CullCamera { eye_from_world, frame: self.frame, ..CullCamera::default() };
        self.visitor.cull(&self.scene, &camera, &mut self.stage);
        let contexts: &mut [&mut dyn CompileContext] = &mut [&mut self.context];
        self.pager.update_scene_graph(&mut self.scene, self.frame, &self.stage.requests, contexts);
    }

    fn settle(&mut self, distance_m: f64) {
        let end = Instant::now() + Duration::from_secs(30);
        self.frame(distance_m);
        while !(self.pager.is_idle() && self.stage.requests.is_empty()) {
            assert!(Instant::now() < end, "does not settle: {:?}", self.pager.stats());
            self.frame(distance_m);
            std::thread::yield_now();
        }
    }
}

#[test]
fn everything_wanted_arrives_and_is_drawn() {
    let folder = tempfile::tempdir().unwrap();
    write_set(folder.path());
    let mut run = Run::new(folder.path(), PagerConfig::default());
    run.settle(10.0);
    assert_eq!(run.pager.stats().merged, 5);
    assert_eq!(run.stage.counters.tiles_drawn, 4, "the four children instead of the root");
    assert!(run.pager.errors().is_empty());
}

#[test]
fn a_broken_child_leaves_its_parent_and_is_one_error() {
    let folder = tempfile::tempdir().unwrap();
    write_set(folder.path());
    std::fs::remove_file(folder.path().join("child2.glb")).unwrap();
    std::fs::write(folder.path().join("child3.glb"), b"glTF\x02\0\0\0").unwrap();
    let mut run = Run::new(folder.path(), PagerConfig::default());
    run.settle(10.0);
    let read = run.pager.stats().failed;
    for _ in 0..50 {
        run.frame(10.0);
    }
    assert_eq!(run.pager.stats().failed, read, "failures are not tried again each frame");
    assert_eq!(run.stage.counters.tiles_drawn, 1, "the parent stays");
    let errors = run.pager.errors();
    assert_eq!(errors.iter().map(|e| e.count).sum::<u64>(), 2, "{errors:?}");
    assert!(errors.iter().any(|e| e.uri.ends_with("child2.glb") && &*e.reason == "not found"), "{errors:?}");
    assert!(errors.iter().any(|e| e.uri.ends_with("child3.glb") && e.reason.contains("truncated")), "{errors:?}");
}

#[test]
fn what_is_not_wanted_expires_within_the_tile_budget() {
    let folder = tempfile::tempdir().unwrap();
    write_set(folder.path());
    let config = PagerConfig { max_tiles: 5, expiry_frames: 3, ..PagerConfig::default() };
    let mut run = Run::new(folder.path(), config);
    run.settle(10.0);
    assert_eq!(run.pager.stats().resident, 5);
    for _ in 0..20 {
        // Far away the root alone is wanted.
        run.frame(100_000.0);
    }
    assert!(run.pager.stats().expired >= 1 && run.stage.counters.tiles_drawn == 1, "{:?}", run.pager.stats());
    assert_eq!(run.context.slots_out as u64, run.pager.stats().resident, "slots go back with their pages");
}

#[test]
fn blocking_loads_the_same_each_time_and_pagers_stop() {
    let folder = tempfile::tempdir().unwrap();
    write_set(folder.path());
    for _ in 0..10 {
        let mut run = Run::new(folder.path(), PagerConfig { blocking: true, ..PagerConfig::default() });
        let merged: Vec<u64> = (0..4)
            .map(|_| {
                run.frame(10.0);
                run.pager.stats().merged
            })
            .collect();
        assert_eq!(merged, [5, 5, 5, 5], "all wanted levels are asked for at once");
    }
}
