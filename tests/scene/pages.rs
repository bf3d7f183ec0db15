//! Pages of a scene: handles, attaching and detaching, and their cost.

use glam::{DAffine3, DVec3};
use kit::cull_scenes::{Grid, content, page, quadtree, state_sets};
use terrane::math::Aabb;
use terrane::scene::{
    Billboard, BillboardMode, Drawable, Material, Mesh, Node, NodeId, NodeKind, Page, PageId, ProxyLoading, ProxyNode,
    Refine, Scene, SceneError, SlotState,
};
use terrane::state::StateSet;

fn tree(levels: u32) -> (Scene, PageId, Vec<NodeId>) {
    let mut scene = Scene::new();
    let root = scene.add_root(page(quadtree(levels, 1000.0, 100.0, Refine::Replace), 0));
    let slots = scene.slots_of_page(root).collect();
    (scene, root, slots)
}

#[test]
fn slots_return_their_content() {
    let (mut scene, root, slots) = tree(3);
    assert_eq!(slots.len(), 21);
    let info = scene.slot(slots[2]).unwrap();
    assert_eq!(&**info.uri, "000");
    assert_eq!((info.depth, info.page, info.is_proxy, info.last_used_frame), (2, root, false, 0));
    assert_eq!(info.state, SlotState::Empty);
    let id = scene.attach(slots[2], content(1.0, 0)).unwrap();
    assert_eq!(scene.slot(slots[2]).unwrap().state, SlotState::Resident(id));
    assert_eq!(scene.slot_of(id), Some(slots[2]));
    assert_eq!(scene.slot_of(root), None);
    assert_eq!(scene.page_count(), 2);
    assert!(scene.page(root).unwrap().is_tile_tree() && !scene.page(id).unwrap().is_tile_tree());
}

#[test]
fn handles_become_stale() {
    let (mut scene, root, slots) = tree(2);
    let first = scene.attach(slots[0], content(1.0, 0)).unwrap();
    let refused = scene.attach(slots[0], content(1.0, 7)).unwrap_err();
    assert_eq!(refused.0, SceneError::SlotTaken { node: slots[0] });
    assert_eq!(refused.1.drawable_count(), 1, "the page is returned");
    assert_eq!(scene.detach(first).unwrap().drawable_count(), 1);
    assert!(matches!(scene.detach(first), Err(SceneError::StalePage { .. })));
    let second = scene.attach(slots[0], content(1.0, 0)).unwrap();
    assert_eq!(second.slot, first.slot, "the slot is reused");
    assert_ne!(second, first);
    assert!(scene.page(first).is_none() && scene.slot_of(first).is_none());
    let stale = NodeId { page: first, index: 0 };
    assert!(matches!(scene.attach(stale, content(1.0, 0)).unwrap_err().0, SceneError::StaleNode { .. }));
    let inside = NodeId { page: second, index: 0 };
    assert!(matches!(scene.attach(inside, content(1.0, 0)).unwrap_err().0, SceneError::NotASlot { .. }));
    let beyond = NodeId { page: root, index: 999 };
    assert!(matches!(scene.attach(beyond, content(1.0, 0)).unwrap_err().0, SceneError::NotASlot { .. }));
    assert!(matches!(scene.detach(root), Err(SceneError::IsRoot { .. })));
    assert!(scene.remove_root(root).is_none(), "a page is attached to it");
    scene.detach(second).unwrap();
    assert!(scene.remove_root(root).is_some());
    assert_eq!(scene.page_count(), 0);
}

#[test]
fn detach_is_refused_while_pages_are_attached_below() {
    let mut scene = Scene::new();
    let proxy = Node::new(NodeKind::ProxyNode(Box::new(ProxyNode {
        uri: "x".into(),
        bounds: terrane::math::BoundingSphere::new(DVec3::ZERO, 1.0),
        content_transform: DAffine3::IDENTITY,
        loading: ProxyLoading::DeferToPager,
    })));
    let root = scene.add_root(page(Node::group(vec![proxy]), 0));
    let slot = scene.slots_of_page(root).next().unwrap();
    let external = scene.attach(slot, page(quadtree(2, 10.0, 1.0, Refine::Replace), 0)).unwrap();
    let inner: Vec<_> = scene.slots_of_page(external).collect();
    assert_eq!(scene.slot(inner[1]).unwrap().depth, 2);
    let tile = scene.attach(inner[1], content(1.0, 0)).unwrap();
    assert_eq!(scene.detach(external).unwrap_err(), SceneError::HasPages { page: external, count: 1 });
    assert!(!scene.is_expirable(external) && !scene.is_expirable(root) && scene.is_expirable(tile));
    scene.detach(tile).unwrap();
    assert!(scene.is_expirable(external));
    scene.detach(external).unwrap();
}

#[test]
fn expiry_starts_at_the_leaves() {
    let (mut scene, _, slots) = tree(3);
    // Page 0 is the root, 1 its first child, 2 the first grandchild.
    let pages: Vec<_> = [0, 1, 2].map(|i| scene.attach(slots[i], content(1.0, 0)).unwrap()).to_vec();
    let expirable = |scene: &Scene| pages.iter().map(|p| scene.is_expirable(*p)).collect::<Vec<_>>();
    assert_eq!(expirable(&scene), [false, false, true]);
    scene.detach(pages[1]).unwrap();
    assert_eq!(expirable(&scene), [false, false, true], "the grandchild still refines the root");
    scene.detach(pages[2]).unwrap();
    assert_eq!(expirable(&scene), [true, false, false]);
}

/// The cost of merging and expiring, counted in written records, is independent of all sizes.
#[test]
fn merge_and_expire_do_not_grow_with_page_or_scene() {
    let mut costs = Vec::new();
    for cells in [100u32, 1_000, 10_000, 100_000] {
        for levels in [2u32, 4, 6] {
            let (mut scene, _, slots) = tree(levels);
            // Coarse pages are attached first, as by the pager; the last subtree is measured.
            let last = slots.len() - 1;
            let parent = slots.len() - 5;
            for slot in &slots[..last] {
                scene.attach(*slot, content(1.0, 0)).unwrap();
            }
            assert!(parent > 0 || levels == 2);
            let big = page(Grid::new(cells).build(&state_sets(1, &StateSet::default())), 0);
            let before = scene.touched_records();
            let id = scene.attach(slots[last], big).unwrap();
            let merged = scene.touched_records();
            scene.detach(id).unwrap();
            costs.push((merged - before, scene.touched_records() - merged));
        }
    }
    assert!(costs.iter().all(|c| *c == costs[0]), "{costs:?}");
    assert!(costs[0].0 <= 4);
}

#[test]
fn readiness_follows_attach_and_detach_in_any_order() {
    // The expected count is that of a scene in which the same pages were attached in another order.
    let mut seed = 12_345u64;
    let mut random = move |below: usize| {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (seed >> 33) as usize % below
    };
    let (mut scene, _, slots) = tree(4);
    let mut resident: Vec<Option<PageId>> = vec![None; slots.len()];
    for _ in 0..3_000 {
        let i = random(slots.len());
        match resident[i] {
            Some(id) => {
                scene.detach(id).unwrap();
                resident[i] = None;
            }
            None => resident[i] = Some(scene.attach(slots[i], content(1.0, i as u32)).unwrap()),
        }
        let j = random(slots.len());
        if let Some(id) = resident[j] {
            let name = scene.slot(slots[j]).unwrap().uri.to_string();
            let refined = slots.iter().zip(&resident).any(|(slot, page)| {
                let uri = scene.slot(*slot).unwrap().uri;
                page.is_some() && uri.len() > name.len() && uri.starts_with(&name)
            });
            assert_eq!(scene.is_expirable(id), !refined, "{name}");
        }
    }
}

#[test]
fn page_can_be_shared_between_threads() {
    fn shared<T: Send + Sync>() {}
    shared::<Scene>();
    shared::<terrane::scene::Page>();
    fn sent<T: Send>() {}
    sent::<terrane::cull::RenderStage>();
    sent::<terrane::cull::CullVisitor>();
}

#[test]
fn transforms_can_only_be_set_on_transforms() {
    let mut scene = Scene::new();
    let root = scene.add_root(page(Node::group(vec![Node::transform(DAffine3::IDENTITY, vec![])]), 0));
    let at = |index| NodeId { page: root, index };
    assert!(matches!(scene.set_transform(at(0), DAffine3::IDENTITY), Err(SceneError::NotATransform { .. })));
    assert!(matches!(scene.set_transform(at(9), DAffine3::IDENTITY), Err(SceneError::StaleNode { .. })));
    let nan = DAffine3::from_translation(DVec3::NAN);
    assert_eq!(scene.set_transform(at(1), nan), Err(SceneError::NotFinite));
    assert_eq!(scene.set_transform(at(1), DAffine3::from_translation(DVec3::X)), Ok(()));
}

/// Regression: the boxes were those of the first transform. Billboards that extended along the image's up axis were
/// culled while visible.
#[test]
fn bounds_of_billboards_follow_later_transforms() {
    let scene_of = |map: DAffine3| {
        let mesh = Mesh::cuboid(&Aabb { min: DVec3::new(-5.0, 0.0, 0.0), max: DVec3::new(5.0, 0.1, 10.0) });
        let drawables = vec![(DVec3::X, Drawable::new(mesh.into(), Material::default()))];
        let mode = BillboardMode::PointRotEye;
        let billboard = Node::new(NodeKind::Billboard(Box::new(Billboard { mode, drawables, ..Billboard::default() })));
        let outer = Node::transform(DAffine3::IDENTITY, vec![Node::transform(map, vec![billboard])]);
        let mut scene = Scene::new();
        let root = scene.add_root(Page::from_node(outer).unwrap());
        (scene, root)
    };
    let long = DAffine3::from_scale(DVec3::new(1.0, 1.0, 10.0));
    let (first, root) = scene_of(long);
    let expected = first.node_sphere(NodeId { page: root, index: 0 }).unwrap();
    assert!(expected.radius_m > 100.0);
    for index in [0, 1] {
        let (mut scene, root) = scene_of(DAffine3::IDENTITY);
        let at = |index| NodeId { page: root, index };
        assert!(scene.node_sphere(at(0)).unwrap().radius_m < 30.0);
        scene.set_transform(at(index), long).unwrap();
        let found = scene.node_sphere(at(0)).unwrap();
        assert!((found.radius_m / expected.radius_m - 1.0).abs() < 1e-4, "{found:?} and {expected:?}");
        // Other drawables keep their box.
        scene.set_transform(at(index), DAffine3::IDENTITY).unwrap();
        assert!(scene.node_sphere(at(0)).unwrap().radius_m < 30.0);
    }
}
