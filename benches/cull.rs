//! Measures cull: the peer's grid (goal: at most 5.5 ns per visited node and drawable up to 1e5 cells) and tile trees
//! (goal: at most 6 ns per visited tile). One thread, no GPU.
#![allow(missing_docs, reason = "criterion's macros make undocumented items")]

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use glam::DVec3;
use kit::cull_scenes::{Grid, content, look_at, page, quadtree, state_sets};
use terrane::cull::{CullVisitor, RenderStage};
use terrane::scene::{Refine, Scene};
use terrane::state::{BinDetails, SortMode, StateSet};

fn grid(criterion: &mut Criterion) {
    for sort in [SortMode::ByState, SortMode::ByStateThenFrontToBack, SortMode::BackToFront] {
        let mut group = criterion.benchmark_group(format!("grid/{sort:?}"));
        for cells in [1_000, 10_000, 100_000] {
            let grid = Grid::new(cells);
            let set = StateSet { bin: Some(BinDetails::new(0, sort)), ..StateSet::default() };
            let mut scene = Scene::new();
            scene.add_root(page(grid.build(&state_sets(64, &set)), 0));
            for view in ["tenth", "all", "tilted"] {
                let camera = grid.camera(view);
                let (mut visitor, mut stage) = (CullVisitor::visiting_all(), RenderStage::new());
                visitor.cull(&scene, &camera, &mut stage);
                let visits = stage.counters.nodes_visited + stage.counters.drawables_tested;
                group.throughput(Throughput::Elements(u64::from(visits)));
                group.bench_function(BenchmarkId::new(format!("{view}, every node"), cells), |b| {
                    b.iter(|| visitor.cull(&scene, &camera, &mut stage));
                });
                let mut visitor = CullVisitor::new();
                group.bench_function(BenchmarkId::new(view, cells), |b| {
                    b.iter(|| visitor.cull(&scene, &camera, &mut stage));
                });
            }
        }
    }
}

fn tiles(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("tiles");
    for levels in [4u32, 6, 8] {
        for resident in [true, false] {
            let mut scene = Scene::new();
            let root = scene.add_root(page(quadtree(levels, 20_000.0, 2_000.0, Refine::Replace), 0));
            for (i, slot) in scene.slots_of_page(root).collect::<Vec<_>>().into_iter().enumerate() {
                // Without content, only the traversal and its requests are measured.
                if resident && scene.attach(slot, content(50.0, i as u32)).is_err() {
                    return;
                }
            }
            let mut camera = look_at(DVec3::new(0.0, -22_000.0, 6_000.0), DVec3::ZERO, DVec3::Z);
            camera.settings.max_sse_px = 1.0;
            let (mut visitor, mut stage) = (CullVisitor::new(), RenderStage::new());
            visitor.cull(&scene, &camera, &mut stage);
            group.throughput(Throughput::Elements(u64::from(stage.counters.tiles_visited)));
            let name = if resident { "drawn" } else { "wanted" };
            group.bench_function(BenchmarkId::new(name, stage.counters.tiles_visited), |b| {
                b.iter(|| visitor.cull(&scene, &camera, &mut stage));
            });
        }
    }
}

criterion_group!(benches, grid, tiles);
criterion_main!(benches);
