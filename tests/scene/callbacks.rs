//! Update and event callbacks of nodes: the calls, their order, and the number of visited nodes. No GPU.

use std::sync::{Arc, Mutex};

use glam::{DAffine3, DVec3};
use terrane::scene::{
    CallbackStateSet, Drawable, EventCallback, Material, Mesh, Node, NodeId, NodeKind, Page, PageId, PagedLod,
    PagingOptions, RangeMode, Refine, Scene, Traverse, UpdateCallback, UpdateInfo,
};

use terrane::state::{StateSet, UniformValue};

type Log = Arc<Mutex<Vec<String>>>;

fn logs(log: &Log, name: &'static str, then: Traverse) -> UpdateCallback {
    let log = log.clone();
    UpdateCallback::new(move |_, node, info| {
        log.lock().unwrap().push(format!("{name} {} {}", node.index, info.frame));
        then
    })
}

fn with_callback(mut node: Node, callback: UpdateCallback) -> Node {
    node.update_callback = Some(callback);
    node
}

fn taken(log: &Log) -> Vec<String> {
    std::mem::take(&mut log.lock().unwrap())
}

fn info(frame: u32) -> UpdateInfo {
    UpdateInfo { frame, ..UpdateInfo::default() }
}

fn tile(content: &str) -> Node {
    let sphere = terrane::math::BoundingSphere::new(DVec3::ZERO, 1.0);
    Node::new(NodeKind::PagedLod(Box::new(PagedLod {
        bounds: terrane::math::BoundingVolume::Sphere(sphere),
        range_mode: RangeMode::ScreenSpaceError { geometric_error_m: 0.0 },
        refine: Refine::Replace,
        content: Some(content.into()),
        content_transform: DAffine3::from_translation(DVec3::X),
        reader_data: None,
        request_volume: None,
        paging: PagingOptions::default(),
    })))
}

#[test]
fn traversal_visits_only_nodes_with_callbacks() {
    let log = Log::default();
    let leaves = |count| Node::group((0..count).map(|_| Node::group(Vec::new())).collect());
    let with = with_callback(leaves(300), logs(&log, "a", Traverse::Below))
        .with_child(with_callback(leaves(5), logs(&log, "b", Traverse::Below)));
    let mut scene = Scene::new();
    for _ in 0..3 {
        scene.add_root(Page::from_node(leaves(100_000)).unwrap());
    }
    let root = scene.add_root(Page::from_node(leaves(50_000).with_child(with)).unwrap());
    assert_eq!(scene.update_traversal(&info(7)), 2);
    assert_eq!(taken(&log), ["a 50001 7", "b 50302 7"]);
    assert_eq!(scene.event_traversal(&()), 0, "no event callback: nothing is visited");

    scene.set_update_callback(NodeId { page: root, index: 50_001 }, None).unwrap();
    scene.set_update_callback(NodeId { page: root, index: 3 }, Some(logs(&log, "c", Traverse::Below))).unwrap();
    assert_eq!(scene.update_traversal(&info(8)), 2);
    assert_eq!(taken(&log), ["c 3 8", "b 50302 8"]);
    scene.remove_root(root).unwrap();
    assert_eq!(scene.update_traversal(&info(9)), 0);
    assert!(scene.set_update_callback(NodeId { page: root, index: 3 }, None).is_err());
}

#[test]
fn removed_pages_do_not_skip_callbacks_of_others() {
    let log = Log::default();
    let mut scene = Scene::new();
    let add = |scene: &mut Scene, callback| {
        scene.add_root(Page::from_node(with_callback(Node::group(Vec::new()), callback)).unwrap())
    };
    let first = ["a", "b"].map(|name| add(&mut scene, logs(&log, name, Traverse::Below)));
    let closing = log.clone();
    let closes = UpdateCallback::new(move |scene: &mut Scene, _, _| {
        closing.lock().unwrap().push("closes".into());
        first.iter().for_each(|page| drop(scene.remove_root(*page)));
        Traverse::Below
    });
    add(&mut scene, closes);
    add(&mut scene, logs(&log, "d", Traverse::Below));
    scene.update_traversal(&info(1));
    assert_eq!(taken(&log), ["a 0 1", "b 0 1", "closes", "d 0 1"]);
    scene.update_traversal(&info(2));
    assert_eq!(taken(&log), ["closes", "d 0 2"]);
}

#[test]
fn page_is_updated_before_pages_attached_to_it() {
    let log = Log::default();
    let mut scene = Scene::new();
    let root = scene.add_root(Page::from_node(Node::group(vec![tile("x")])).unwrap());
    let slot = scene.slots_of_page(root).next().unwrap();
    let below = with_callback(Node::group(Vec::new()), logs(&log, "below", Traverse::Below));
    scene.attach(slot, Page::from_node(below).unwrap()).unwrap();
    let skips = logs(&log, "above", Traverse::Skip);
    scene.set_update_callback(NodeId { page: root, index: 0 }, Some(skips)).unwrap();
    scene.update_traversal(&info(1));
    assert_eq!(taken(&log), ["above 0 1"]);
}

#[test]
fn skipping_a_node_skips_the_pages_below() {
    let log = Log::default();
    let skipping = with_callback(Node::group(vec![tile("x")]), logs(&log, "above", Traverse::Skip));
    let other = with_callback(Node::group(Vec::new()), logs(&log, "beside", Traverse::Below));
    let mut scene = Scene::new();
    let root = scene.add_root(Page::from_node(Node::group(vec![skipping, other])).unwrap());
    let content = with_callback(Node::group(vec![tile("y")]), logs(&log, "content", Traverse::Below));
    let content = scene.attach(NodeId { page: root, index: 2 }, Page::from_node(content).unwrap()).unwrap();
    let deeper = with_callback(Node::group(Vec::new()), logs(&log, "deeper", Traverse::Below));
    let deeper = scene.attach(NodeId { page: content, index: 1 }, Page::from_node(deeper).unwrap()).unwrap();
    scene.update_traversal(&info(1));
    assert_eq!(taken(&log), ["above 1 1", "beside 3 1"]);

    scene.set_update_callback(NodeId { page: root, index: 1 }, None).unwrap();
    scene.update_traversal(&info(2));
    assert_eq!(taken(&log), ["beside 3 2", "content 0 2", "deeper 0 2"]);
    let place = scene.world_from_node(NodeId { page: deeper, index: 0 }).unwrap();
    assert_eq!(place.translation, DVec3::new(2.0, 0.0, 0.0));
    scene.detach(deeper).unwrap();
    scene.update_traversal(&info(3));
    assert_eq!(taken(&log), ["beside 3 3", "content 0 3"]);
}

#[test]
fn callback_may_change_its_scene() {
    let mut scene = Scene::new();
    let mut turning = Node::transform(DAffine3::IDENTITY, vec![Node::group(Vec::new())]);
    turning.update_callback = Some(UpdateCallback::new(|scene, node, info| {
        scene.set_transform(node, DAffine3::from_translation(DVec3::X * f64::from(info.frame))).unwrap();
        Traverse::Below
    }));
    // The callback removes its page before another one is called.
    let mut leaving = Node::group(Vec::new());
    leaving.update_callback = Some(UpdateCallback::new(|scene: &mut Scene, node, _| {
        scene.remove_root(node.page).unwrap();
        Traverse::Below
    }));
    let pages: Vec<PageId> = [leaving, turning].map(|node| scene.add_root(Page::from_node(node).unwrap())).into();
    scene.update_traversal(&info(5));
    assert!(scene.page(pages[0]).is_none());
    let inner = NodeId { page: pages[1], index: 1 };
    assert_eq!(scene.world_from_node(inner).unwrap().translation, DVec3::new(5.0, 0.0, 0.0));
}

/// Regression: a page with a remaining callback of the other kind stayed in both lists.
#[test]
fn page_leaves_the_list_of_a_kind_with_its_last_callback() {
    let update = || Some(UpdateCallback::new(|_, _, _| Traverse::Below));
    let event = || Some(EventCallback::new(|_, _, _| Traverse::Below));
    let both = Node { update_callback: update(), event_callback: event(), ..Node::group(Vec::new()) };
    let mut scene = Scene::new();
    let node = NodeId { page: scene.add_root(Page::from_node(both).unwrap()), index: 0 };
    assert!(scene.has_update_callbacks() && scene.has_event_callbacks());
    scene.set_update_callback(node, None).unwrap();
    assert!(!scene.has_update_callbacks() && scene.has_event_callbacks());
    scene.set_update_callback(node, update()).unwrap();
    scene.set_event_callback(node, None).unwrap();
    assert!(scene.has_update_callbacks() && !scene.has_event_callbacks());
    scene.set_update_callback(node, None).unwrap();
    assert!(!scene.has_update_callbacks() && !scene.has_event_callbacks());
}

#[test]
fn events_of_any_type_reach_event_callbacks() {
    let log = Log::default();
    let kept = log.clone();
    let mut node = Node::group(Vec::new());
    node.event_callback = Some(EventCallback::new(move |_, _, event| {
        kept.lock().unwrap().push(format!("{:?}", event.downcast_ref::<u32>()));
        Traverse::Below
    }));
    let mut scene = Scene::new();
    scene.add_root(Page::from_node(node).unwrap());
    assert_eq!(scene.event_traversal(&5u32) + scene.event_traversal(&"text"), 2);
    assert_eq!(taken(&log), ["Some(5)", "None"]);
}

#[test]
fn tiles_are_listed_with_their_position_and_state() {
    let mut scene = Scene::new();
    let root = Node::transform(DAffine3::from_scale(DVec3::splat(2.0)), vec![tile("x")]);
    let root = scene.add_root(Page::from_node(root).unwrap());
    scene.attach(NodeId { page: root, index: 1 }, Page::from_node(tile("y")).unwrap()).unwrap();
    let tiles: Vec<_> = scene.tiles().map(|t| (t.depth, t.bounds.center, t.bounds.half_axes.x_axis.x)).collect();
    assert_eq!(tiles.len(), 2);
    assert_eq!((tiles[0].0, tiles[0].1), (0, DVec3::ZERO));
    assert_eq!((tiles[1].0, tiles[1].1), (1, DVec3::new(2.0, 0.0, 0.0)));
    assert!((tiles[0].2 - 2.0).abs() < 1e-5 && (tiles[1].2 - 2.0).abs() < 1e-5);
}

#[test]
fn nested_callbacks_follow_unless_the_first_skips() {
    let log = Log::default();
    let of = |name, then| logs(&log, name, then);
    let chained = of("a", Traverse::Below).then(of("b", Traverse::Below)).then(of("c", Traverse::Below));
    let skipping = of("d", Traverse::Skip).then(of("e", Traverse::Below));
    let below = with_callback(Node::group(Vec::new()), of("below", Traverse::Below));
    let first = with_callback(Node::group(vec![below.clone()]), chained);
    let second = with_callback(Node::group(vec![below]), skipping);
    let mut scene = Scene::new();
    scene.add_root(Page::from_node(Node::group(vec![first, second])).unwrap());
    scene.update_traversal(&info(1));
    assert_eq!(taken(&log), ["a 1 1", "b 1 1", "c 1 1", "below 2 1", "d 3 1"]);
}

#[test]
fn callback_of_a_drawable_gets_its_geode_and_index() {
    let log = Log::default();
    let seen = log.clone();
    let square =
        |size: f64| Drawable::new(Mesh::rectangle(DVec3::ZERO, DVec3::X * size, DVec3::Y).into(), Material::default());
    let mut geode = Node::geode(vec![square(1.0), square(2.0)]);
    geode.update_callback = Some(UpdateCallback::on_drawable(1, move |scene, node, drawable, info| {
        seen.lock().unwrap().push(format!("{} {drawable} {}", node.index, info.frame));
        let grown = Mesh::rectangle(DVec3::ZERO, DVec3::X * 10.0, DVec3::Y);
        scene.set_mesh(node, drawable, Arc::new(grown), terrane::state::DataVariance::Static).unwrap();
    }));
    let told = log.clone();
    geode.event_callback = Some(EventCallback::on_drawable(0, move |_, node, drawable, event| {
        let event = event.downcast_ref::<u32>().unwrap();
        told.lock().unwrap().push(format!("event {} {drawable} {event}", node.index));
    }));
    let mut scene = Scene::new();
    scene.add_root(Page::from_node(Node::group(vec![geode])).unwrap());
    let radius = |scene: &Scene| scene.bounding_sphere().radius_m;
    let before = radius(&scene);
    assert_eq!((scene.update_traversal(&info(4)), scene.event_traversal(&7u32)), (1, 1));
    assert_eq!(taken(&log), ["1 1 4", "event 1 0 7"]);
    scene.compute_bounds();
    assert!(radius(&scene) > before + 3.0, "the mesh was replaced");
}

#[test]
fn callbacks_change_a_state_set_and_its_uniforms_where_a_page_uses_it() {
    let state = CallbackStateSet::new(StateSet::default().with_uniform("wind", UniformValue::Float(0.0)));
    let mut node = Node::group(Vec::new()).with_state_set(state.current());
    let wind = state.on_uniform("wind", |wind, info: &UpdateInfo| *wind = UniformValue::Float(info.frame as f32));
    let missing = state.on_uniform("rain", |_, _: &UpdateInfo| panic!("there is no such uniform"));
    let color = state.on_state_set(|set, info: &UpdateInfo| set.color = Some([0.5 * info.frame as f32; 4]));
    node.update_callback = Some(wind.then(missing).then(color));
    let named =
        state.on_state_set(|set, event: &dyn std::any::Any| set.name = event.downcast_ref::<String>().unwrap().clone());
    node.event_callback = Some(named);
    let mut scene = Scene::new();
    let root = scene.add_root(Page::from_node(node).unwrap());
    let other = scene.add_root(Page::from_node(Node::group(Vec::new())).unwrap());
    for frame in 1..4 {
        let before = state.current();
        scene.update_traversal(&info(frame));
        let after = state.current();
        assert_eq!(
            (after.uniforms[0].0.value.clone(), after.color),
            (UniformValue::Float(frame as f32), Some([0.5 * frame as f32; 4]))
        );
        // A set that draw may still read was not changed itself, and is no longer that of the page.
        assert_eq!(before.color, (frame > 1).then(|| [0.5 * (frame - 1) as f32; 4]));
        assert!(!scene.replace_state_set(root, &before, after.clone()));
    }
    scene.event_traversal(&"shaken".to_owned());
    assert_eq!(state.current().name, "shaken");
    let before = state.current();
    assert!(state.change(&mut scene, root, |_| {}) && Arc::ptr_eq(&before, &state.current()), "nothing has changed");
    assert!(!state.change(&mut scene, other, |set| set.name.clear()), "the page does not use it");
    assert!(scene.replace_state_set(root, &state.current(), Arc::new(StateSet::default())));
    assert!(!state.change(&mut scene, root, |set| set.name.clear()), "the application has replaced it");
    assert_eq!(state.current().name, "shaken");
}
