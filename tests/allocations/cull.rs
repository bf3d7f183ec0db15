//! A steady cull allocates nothing. The allocator of this test binary counts.

use std::sync::Arc;

use glam::DVec3;
use kit::cull_scenes::{Grid, content, drawable, look_at, page, quadtree, state_sets};
use terrane::cull::{CullCamera, CullVisitor, RenderStage};
use terrane::math::Aabb;
use terrane::scene::{
    CameraEnvironment, CameraNode, CameraShadows, ConvexPlanarOccluder, Environment, LocalLights, Node, NodeKind, Page,
    Refine, RenderOrder, Scene, SunShadows,
};
use terrane::state::{BinDetails, Light, SortMode, StateSet};

/// Flies a circle three times and counts the allocations of the last round. In the second one, tiles fade that were seen
/// at the end of the first.
fn allocations_of_last_round(scene: &Scene, camera_at: impl Fn(u32) -> CullCamera) -> (u64, u32) {
    let (mut visitor, mut stage) = (CullVisitor::new(), RenderStage::new());
    let to_sun = DVec3::new(0.6, 0.0, 0.8);
    let shadows = Some(SunShadows::default());
    visitor.environment =
        Some(Environment { sun_direction: to_sun, up_in_world: to_sun, shadows, ..Environment::default() });
    let mut casters = 0;
    let mut before = 0;
    let (mut leaves, mut fading) = (0, 0);
    for round in 0..3 {
        before = crate::count();
        for frame in 0..100 {
            let number = 1 + round * 100 + frame;
            // Levels of detail fade while the eye moves.
            let simulation_time_s = 0.016 * f64::from(number);
            let camera = CullCamera { frame: number, simulation_time_s, ..camera_at(frame) };
            visitor.cull(scene, &camera, &mut stage);
            leaves += stage.counters.leaves;
            casters += stage.counters.shadow_leaves;
            fading += stage.counters.fading;
        }
    }
    let allocations = crate::count() - before;
    assert!(leaves > 1_000 && casters > 1_000);
    (allocations, fading)
}

/// Returns content with an occluder across it.
fn walled(slot: u32) -> Page {
    let corners = [(-30.0, 0.0), (30.0, 0.0), (30.0, 20.0), (-30.0, 20.0)].map(|(x, z)| DVec3::new(x, x, z));
    let occluder = ConvexPlanarOccluder { corners: corners.to_vec(), holes: vec![corners[..3].to_vec()] };
    let bounds = Aabb { min: DVec3::splat(-50.0), max: DVec3::splat(50.0) };
    let occluder = Node::new(NodeKind::OccluderNode(Box::new(occluder)));
    page(Node::group(vec![Node::geode(vec![drawable(bounds)]), occluder]), slot)
}

/// Returns content with lights.
fn lit(slot: u32) -> Page {
    let lights = vec![Light::default(); 3];
    let bounds = Aabb { min: DVec3::splat(-50.0), max: DVec3::splat(50.0) };
    let set = Arc::new(StateSet::default());
    let children = vec![Node::geode(vec![drawable(bounds)]).with_state_set(set)];
    page(Node { children, ..Node::new(NodeKind::LocalLights(LocalLights { lights })) }, slot)
}

#[test]
fn steady_cull_allocates_nothing() {
    for sort in [
        SortMode::ByState,
        SortMode::ByStateThenFrontToBack,
        SortMode::FrontToBack,
        SortMode::BackToFront,
        SortMode::TraversalOrder,
    ] {
        let grid = Grid::new(10_000);
        let sets: Vec<_> = (0..64)
            .map(|i| Arc::new(StateSet { bin: Some(BinDetails::new(i % 3, sort)), ..StateSet::default() }))
            .collect();
        let mut scene = Scene::new();
        scene.add_root(page(grid.build(&sets), 0));
        let (round, _) = allocations_of_last_round(&scene, |frame| {
            let angle = f64::from(frame) * 0.0628;
            let center = DVec3::new(50.0, 50.0, 0.0);
            look_at(center + DVec3::new(60.0 * angle.cos(), 60.0 * angle.sin(), 40.0), center, DVec3::Z)
        });
        assert_eq!(round, 0, "{sort:?}");
    }
    assert!(!state_sets(1, &StateSet::default()).is_empty());

    // Half of the tiles are loaded, so that there are requests, fallbacks and pages of content.
    let mut scene = Scene::new();
    let root = scene.add_root(page(quadtree(6, 2000.0, 200.0, Refine::Replace), 0));
    for (i, slot) in scene.slots_of_page(root).collect::<Vec<_>>().into_iter().enumerate() {
        if i % 7 != 3 || i < 3 {
            let content = match i % 5 {
                0 => walled(i as u32),
                1 => lit(i as u32),
                _ => content(50.0, i as u32),
            };
            assert!(scene.attach(slot, content).is_ok());
        }
    }
    let (round, fading) = allocations_of_last_round(&scene, |frame| {
        let angle = f64::from(frame) * 0.0628;
        let eye = DVec3::new(1500.0 * angle.cos(), 1500.0 * angle.sin(), 100.0 + f64::from(frame));
        look_at(eye, DVec3::new(0.0, 0.0, 1.0), DVec3::Z)
    });
    assert_eq!(round, 0);
    assert!(fading > 200, "{fading}");

    // The scene has cameras, one of them nested, each with separate shadows and a separate environment.
    let own = CameraEnvironment::Own(Arc::new(Environment::default()));
    let cameras = [RenderOrder::PreRender(0), RenderOrder::Nested, RenderOrder::PostRender(0)].map(|order| {
        let shadows = CameraShadows::Own(SunShadows::default());
        let camera = CameraNode { environment: own.clone(), shadows, ..CameraNode::new(order) };
        Node::camera(camera, vec![Grid::new(1_000).build(&sets_of(3))])
    });
    let mut scene = Scene::new();
    scene.add_root(page(Node::group(cameras.to_vec()), 0));
    let (round, _) = allocations_of_last_round(&scene, |frame| {
        let angle = f64::from(frame) * 0.0628;
        let center = DVec3::new(16.0, 16.0, 0.0);
        look_at(center + DVec3::new(30.0 * angle.cos(), 30.0 * angle.sin(), 20.0), center, DVec3::Z)
    });
    assert_eq!(round, 0);
}

fn sets_of(count: i32) -> Vec<Arc<StateSet>> {
    let set = |number| StateSet { bin: Some(BinDetails::new(number, SortMode::ByState)), ..StateSet::default() };
    (0..count).map(|number| Arc::new(set(number))).collect()
}
