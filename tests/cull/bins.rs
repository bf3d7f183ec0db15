//! The bins of leaves, and the order of bins.

use std::collections::BTreeMap;
use std::sync::Arc;

use glam::DVec3;
use kit::cull_scenes::{drawable, look_at, page};
use proptest::prelude::*;
use terrane::cull::{CullVisitor, RenderStage};
use terrane::math::Aabb;
use terrane::scene::{Node, Scene};
use terrane::state::{BinDetails, BinPrototype, SortKey, SortMode, StateSet, StateValue};

fn cube(center: DVec3) -> Node {
    Node::geode(vec![drawable(Aabb { min: center - 0.5, max: center + 0.5 })])
}

/// Returns a camera 10 m in front of the origin that looks along +y.
fn cull(root: Node) -> RenderStage {
    let mut scene = Scene::new();
    scene.add_root(page(root, 0));
    let mut stage = RenderStage::new();
    let mut visitor = CullVisitor::new();
    for _ in 0..3 {
        visitor.cull(&scene, &look_at(DVec3::new(0.0, -10.0, 0.0), DVec3::ZERO, DVec3::Z), &mut stage);
    }
    stage
}

#[test]
fn bins_nest_and_can_be_overridden() {
    let with = |number, nest_bins, bin_value, child: Node| {
        let bin = Some(BinDetails::new(number, SortMode::ByState));
        Node::group(vec![child]).with_state_set(Arc::new(StateSet { bin, nest_bins, bin_value, ..StateSet::default() }))
    };
    let (on, over, protect) = (StateValue::ON, StateValue::OVERRIDE, StateValue::PROTECTED);
    let it = || cube(DVec3::ZERO);
    let root = Node::group(vec![
        it(),
        with(3, true, on, with(-1, true, on, it())),
        with(3, true, on, it()),
        with(3, true, on, with(-1, false, on, it())),
        with(2, true, on | over, with(9, true, on, it())),
        with(2, true, on | over, with(9, true, on | protect, it())),
    ]);
    let stage = cull(root);
    let bins: Vec<_> = stage
        .bins
        .iter()
        .map(|b| {
            (b.path.iter().map(|p| p.number).collect::<Vec<_>>(), b.leaves.iter().map(|l| l.slot.0).collect::<Vec<_>>())
        })
        .collect();
    let expected: Vec<(Vec<i32>, Vec<u32>)> = vec![
        (vec![-1], vec![3]),
        (vec![], vec![0]),
        (vec![2], vec![4]),
        (vec![2, 9], vec![5]),
        (vec![3, -1], vec![1]),
        (vec![3], vec![2]),
    ];
    assert_eq!(bins, expected);
}

/// Names in the order of drawing for equal numbers.
const NAMES: [&str; 4] = ["RenderBin", "DepthSortedBin", "cull_bins: by key", "cull_bins: plain"];

fn named(number: i32, name: &str, callback_of: &mut StateSet) -> BinDetails {
    callback_of.set_render_bin_details(number, name).unwrap();
    callback_of.bin.unwrap()
}

/// A bin number and an index into [`NAMES`].
type Bin = (i32, usize);

proptest! {
    /// Regression: all went into the first bin of their number, with its order.
    #[test]
    fn each_number_and_name_is_a_separate_bin(leaves in prop::collection::vec(
        prop::collection::vec((-2..3i32, 0..NAMES.len()), 0..3), 1..40,
    )) {
        // A closure with a value.
        let last = u64::MAX - leaves.len() as u64;
        let backwards = SortKey::new(move |leaf| last - u64::from(leaf.order));
        BinPrototype::register(NAMES[2], BinPrototype { sort: SortMode::ByKey(backwards), draw: None });
        BinPrototype::register(NAMES[3], BinPrototype::default());
        let mut expected: BTreeMap<Vec<Bin>, Vec<u32>> = BTreeMap::new();
        let mut nodes = Vec::new();
        for (slot, path) in (0u32..).zip(&leaves) {
            // Each drawable is farther away than the previous one.
            let inside = cube(DVec3::new(0.0, f64::from(slot), 0.0));
            nodes.push(path.iter().rev().fold(inside, |child, (number, name)| {
                let mut set = StateSet::default();
                named(*number, NAMES[*name], &mut set);
                Node::group(vec![child]).with_state_set(Arc::new(set))
            }));
            expected.entry(path.clone()).or_default().push(slot);
        }
        for (path, slots) in &mut expected {
            // One bin is sorted by distance, farthest first, another by a key that reverses the order.
            if path.last().is_some_and(|(_, name)| (1..3).contains(name)) {
                slots.reverse();
            }
        }
        let stage = cull(Node::group(nodes));
        let mut all = StateSet::default();
        let mut found: Vec<(Vec<Bin>, Vec<u32>)> = Vec::new();
        for bin in &stage.bins {
            let place = |at: &BinDetails| {
                let name = NAMES.iter().position(|name| named(at.number, name, &mut all) == *at).unwrap();
                (at.number, name)
            };
            found.push((bin.path.iter().map(place).collect(), bin.leaves.iter().map(|leaf| leaf.slot.0).collect()));
        }
        // Nested bins with negative numbers come before the leaves of their bin, the others after them.
        let drawn = |path: &Vec<Bin>| {
            let mut key: Vec<_> = path.iter().map(|(number, name)| (*number, 1, *name)).collect();
            key.push((0, 0, 0));
            key
        };
        let mut in_order: Vec<_> = expected.into_iter().collect();
        in_order.sort_by_key(|(path, _)| drawn(path));
        prop_assert_eq!(found, in_order);
    }
}
