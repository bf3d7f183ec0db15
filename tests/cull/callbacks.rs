//! Cull callbacks of nodes and drawables, and state sets of drawables.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

use crate::single_page::{camera, cube, cull, cull_scene, scene, slots};
use glam::{DAffine3, DVec3};
use kit::cull_scenes::drawable;
use terrane::cull::{CullCamera, RenderStage};
use terrane::math::Aabb;
use terrane::scene::{AlphaMode, Billboard, CullAction, CullCallback, CullPass, Drawable, LocalLights, Node, NodeKind};
use terrane::state::{BinDetails, Light, SortMode, StateSet};

fn named(name: &str) -> Arc<StateSet> {
    Arc::new(StateSet { name: name.into(), ..StateSet::default() })
}

/// Returns a state set with a color factor, so that a chain of them is their product.
fn factor(factor: f32) -> Arc<StateSet> {
    Arc::new(StateSet { color: Some([factor, 1.0, 1.0, 1.0]), ..StateSet::default() })
}

fn at(x: f64) -> Drawable {
    let center = DVec3::new(x, 0.0, 0.0);
    drawable(Aabb { min: center - 0.5, max: center + 0.5 })
}

/// Returns the slot and the red factor of each leaf, in traversal order.
fn reds(stage: &RenderStage) -> Vec<(u32, f32)> {
    let leaves = stage.bins.iter().flat_map(|bin| &bin.leaves);
    let mut reds: Vec<_> = leaves.map(|leaf| (leaf.slot.0, stage.state_sets[leaf.state as usize].color[0])).collect();
    reds.sort_by(|a, b| a.partial_cmp(b).unwrap());
    reds
}

fn answering(action: CullAction) -> Option<CullCallback> {
    Some(CullCallback(Arc::new(move |_| action.clone())))
}

fn passes(passes: &[&[f32]]) -> CullAction {
    let pass = |factors: &&[f32]| -> CullPass { factors.iter().map(|f| factor(*f)).collect() };
    CullAction::Passes(passes.iter().map(pass).collect())
}

#[test]
fn drawables_of_a_node_have_state_sets_of_their_own() {
    let mut last = at(2.0).with_state_set(named("last"));
    last.material.alpha = AlphaMode::Blend;
    let geode = Node::geode(vec![at(-2.0).with_state_set(named("first")), at(0.0), last]);
    let stage = cull(geode.with_state_set(named("node")), &camera());
    let of = |slot: u32| {
        let bins = stage.bins.iter();
        let mut found =
            bins.flat_map(|bin| bin.leaves.iter().filter(|leaf| leaf.slot.0 == slot).map(move |l| (bin, l)));
        let (bin, leaf) = found.next().unwrap();
        (stage.state_sets[leaf.state as usize].name.clone(), bin.number())
    };
    assert_eq!([0, 1, 2].map(of), [("first".into(), 0), ("node".into(), 0), ("last".into(), 10)]);
    // A bin of the drawable itself is below that of its node.
    let bin =
        |number| Arc::new(StateSet { bin: Some(BinDetails::new(number, SortMode::ByState)), ..Default::default() });
    let geode = Node::geode(vec![at(0.0).with_state_set(bin(3))]).with_state_set(bin(2));
    let stage = cull(geode, &camera());
    assert_eq!(stage.bins[0].path.iter().map(|bin| bin.number).collect::<Vec<_>>(), [2, 3]);
}

#[test]
fn callbacks_of_drawables_are_asked_for_each() {
    let asked = Arc::new(AtomicU32::new(0));
    let count = asked.clone();
    let mut skipped = at(3.0);
    skipped.cull_callback = Some(CullCallback(Arc::new(move |info| {
        count.fetch_add(1, Ordering::Relaxed);
        let eye = DVec3::new(0.0, -10.0, 0.0);
        assert!((info.distance_m - eye.distance(DVec3::new(3.0, 0.0, 0.0))).abs() < 1e-5, "{info:?}");
        if info.frame == 7 { CullAction::Skip } else { CullAction::Traverse }
    })));
    // Beside many others, so that the whole group is inside of the frustum.
    let mut nodes: Vec<Node> = (0..8).map(|_| cube(DVec3::ZERO)).collect();
    nodes.push(Node::geode(vec![at(0.0), skipped]));
    let root = scene(Node::group(nodes));
    let all: Vec<u32> = (0..10).collect();
    assert_eq!(slots(&cull_scene(&root, &camera())), all);
    let before = asked.load(Ordering::Relaxed);
    assert_eq!(slots(&cull_scene(&root, &CullCamera { frame: 7, ..camera() })), all[..9]);
    assert!(before > 0 && asked.load(Ordering::Relaxed) == 2 * before);
    // A skipped drawable does not move near and far.
    let mut far = drawable(Aabb { min: DVec3::new(-1.0, 500.0, -1.0), max: DVec3::new(1.0, 502.0, 1.0) });
    far.cull_callback = answering(CullAction::Skip);
    assert!(cull(Node::geode(vec![at(0.0), far]), &camera()).far_m < 20.0);
}

#[test]
fn nodes_that_are_never_culled_and_billboards_ask_their_drawables() {
    let answered = |action: CullAction| {
        let mut drawable = at(0.0);
        drawable.cull_callback = answering(action);
        drawable
    };
    let skipped = || answered(CullAction::Skip);
    let twice = || answered(passes(&[&[2.0], &[3.0]]));
    let geode = Node { culling_active: false, ..Node::geode(vec![skipped(), twice()]) };
    assert_eq!(reds(&cull(geode, &camera())), [(1, 2.0), (1, 3.0)]);
    let drawables = vec![(DVec3::ZERO, skipped()), (DVec3::ZERO, twice())];
    let billboard = Billboard { drawables, ..Billboard::default() };
    let node = Node::new(NodeKind::Billboard(Box::new(billboard)));
    assert_eq!(reds(&cull(node, &camera())), [(1, 2.0), (1, 3.0)]);
}

#[test]
fn callback_pushes_state_sets_and_traverses_once_for_each_pass() {
    let below = Node::group(vec![
        cube(DVec3::ZERO).with_state_set(factor(0.5)),
        Node::transform(DAffine3::IDENTITY, vec![cube(DVec3::ZERO)]),
    ]);
    let mut twice = Node::group(vec![below]).with_state_set(factor(7.0));
    twice.cull_callback = answering(passes(&[&[2.0], &[3.0, 5.0]]));
    let root = Node::group(vec![cube(DVec3::ZERO), twice, cube(DVec3::ZERO)]).with_state_set(factor(11.0));
    let expected = [(0, 11.0), (1, 77.0), (1, 577.5), (2, 154.0), (2, 1155.0), (3, 11.0)];
    assert_eq!(reds(&cull(root, &camera())), expected);
    // Without a pass nothing is drawn, and a pass without state sets changes nothing.
    let node = |action| Node { cull_callback: answering(action), ..cube(DVec3::ZERO) };
    let stage = cull(Node::group(vec![node(passes(&[])), node(passes(&[&[]]))]), &camera());
    assert_eq!(reds(&stage), [(1, 1.0)]);
}

#[test]
fn passes_nest_and_leave_lights_and_siblings_as_they_were() {
    let mut inner = Node::group(vec![cube(DVec3::ZERO)]);
    inner.cull_callback = answering(passes(&[&[3.0], &[5.0]]));
    let mut outer = Node::group(vec![inner, cube(DVec3::ZERO)]);
    outer.cull_callback = answering(passes(&[&[2.0], &[7.0]]));
    let lamp = LocalLights { lights: vec![Light::default()] };
    let lit = Node { children: vec![outer, cube(DVec3::ZERO)], ..Node::new(NodeKind::LocalLights(lamp)) };
    let stage = cull(lit, &camera());
    let expected = [(0, 6.0), (0, 10.0), (0, 21.0), (0, 35.0), (1, 2.0), (1, 7.0), (2, 1.0)];
    assert_eq!(reds(&stage), expected);
    assert!(stage.lights_of_state.iter().all(|group| *group == 1), "the lamp shines on all: {stage:?}");
}
