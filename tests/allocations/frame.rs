//! A steady frame of a viewer with a pager: events, update with the pager, cull and draw. Terrane's own code allocates two
//! boxes per context, in which the frame goes to the draw side and its result back. The queue of replies allocates a block
//! for every 31 of them. The noop adapter draws.

use std::sync::Arc;

use glam::{DAffine3, DVec3};

use kit::shapes::ball;
use kit::tile_sets::small_set;
use kit::viewer::Settle;
use terrane::gpu::AdapterChoice;
use terrane::scene::{Node, Page};
use terrane::viewer::{ThreadingModel, Viewer, ViewerConfig, world_from_eye};

use crate::attribution::allocations;

/// Frames of a round around the set.
const ROUND: u32 = 50;

#[test]
fn steady_frame_allocates_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let set = small_set(folder.path());
    let config = ViewerConfig {
        size_px: [160, 120],
        adapter: AdapterChoice::Noop,
        validation: false,
        threading: ThreadingModel::SingleThreaded,
        max_sse_px: 3.0,
        ..ViewerConfig::default()
    };
    let mut viewer = Viewer::new_offscreen(&config).unwrap();
    viewer.load(&set).unwrap();
    let turning = Node::transform(DAffine3::IDENTITY, vec![ball(DVec3::new(0.0, 0.0, 4_000.0), 500.0, [1.0; 4])]);
    viewer.add_root(Page::from_node(turning).unwrap()).unwrap();
    let bounds = *viewer.bounds().unwrap();
    let fly = |viewer: &mut Viewer, frames: std::ops::Range<u32>| {
        for frame in frames {
            let angle = std::f64::consts::TAU * f64::from(frame) / f64::from(ROUND);
            let (sin, cos) = angle.sin_cos();
            let half = bounds.half_size_m;
            let z = bounds.middle_m.z + half.z + 0.1 * half.y;
            let eye = DVec3::new(bounds.middle_m.x + 0.4 * half.x * cos, bounds.middle_m.y + 0.4 * half.y * sin, z);
            let pose = world_from_eye(eye, DVec3::new(-sin, cos, -0.6), DVec3::Z);
            viewer.view_mut().camera.world_from_eye = bounds.frame.world_from_local * pose;
            viewer.frame().unwrap();
        }
    };
    for _ in 0..4 {
        fly(&mut viewer, 0..ROUND);
        viewer.settle(1);
    }
    let (before, resident) = (*viewer.pager().unwrap().stats(), viewer.pager().unwrap().stats().resident);
    let (own, wgpu) = allocations(|| fly(&mut viewer, 7..10));
    assert!(wgpu > 0, "the call stacks have no names: are there symbols?");
    // Three frames send fewer than 31 replies, so at most one block is allocated.
    let (blocks, own): (Vec<_>, Vec<_>) =
        own.iter().partition(|calls| calls.contains("DrawSide::swap") && calls.contains("flavors::list::Channel"));
    assert!(blocks.len() <= 1, "{} allocations:\n{blocks:#?}", blocks.len());
    let (boxes, others): (Vec<_>, Vec<_>) = own
        .into_iter()
        .partition(|calls| ["DeviceHandle::frame", "DrawSide::render"].iter().any(|name| calls.contains(name)));
    assert!(others.is_empty(), "{} allocations:\n{others:#?}", others.len());
    assert!(boxes.len() <= 3 * 2, "{} allocations:\n{boxes:#?}", boxes.len());
    let stats = viewer.pager().unwrap().stats();
    assert!(resident > 10 && stats.resident == resident && stats.requested == before.requested, "{stats:?}");
    let drawn = viewer.stats().last().unwrap();
    assert!(drawn.tiles_drawn > 0, "{drawn:?}");
    // An update that loads does allocate, so the count is not blind.
    let added = Arc::new(std::sync::Mutex::new(Vec::<u64>::new()));
    let (own, _) = allocations(|| added.lock().unwrap().push(1));
    assert_eq!(own.len(), 1);
}
