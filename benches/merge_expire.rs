//! Measures attaching and detaching a page, over three decades of page size and of scene size: the time must not grow.
//! The physical limit is a handful of cache misses (about 100 ns each when the scene is large).
#![allow(missing_docs, reason = "criterion's macros make undocumented items")]

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};
use kit::cull_scenes::{Grid, content, page, quadtree, state_sets};
use terrane::scene::{Refine, Scene};
use terrane::state::StateSet;

fn merge_expire(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("merge_expire");
    // The sets have 21, 341, 5461 and 21845 tiles, all but one resident.
    for levels in [3, 5, 7, 8] {
        let mut scene = Scene::new();
        let root = scene.add_root(page(quadtree(levels, 20_000.0, 2_000.0, Refine::Replace), 0));
        let slots: Vec<_> = scene.slots_of_page(root).collect();
        let Some((last, others)) = slots.split_last() else { return };
        for slot in others {
            if scene.attach(*slot, content(1.0, 0)).is_err() {
                return;
            }
        }
        for cells in [100, 1_000, 10_000, 100_000] {
            let mut held = Some(page(Grid::new(cells).build(&state_sets(1, &StateSet::default())), 0));
            group.bench_function(BenchmarkId::new(format!("scene of {} tiles", slots.len()), cells), |b| {
                b.iter(|| {
                    let attached = held.take().map(|page| scene.attach(*last, page));
                    if let Some(Ok(id)) = attached {
                        held = scene.detach(id).ok();
                    }
                });
            });
        }
    }
}

criterion_group!(benches, merge_expire);
criterion_main!(benches);
