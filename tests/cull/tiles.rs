//! Tile trees: no hole, no double cover, every wanted tile is asked for, coarse first.

use std::collections::{BTreeMap, BTreeSet, HashMap};

use glam::{DAffine3, DVec3};
use kit::cull_scenes::{content, look_at, page, quadtree, square_box};
use proptest::prelude::*;
use terrane::cull::{CullCamera, CullVisitor, RenderStage};
use terrane::math::{BoundingSphere, BoundingVolume, Frustum};
use terrane::scene::{
    Node, NodeId, NodeKind, PageId, PagedLod, PagingOptions, ProxyLoading, ProxyNode, RangeMode, Refine, Scene,
    SlotState,
};

/// A random tile; it covers a quarter of its parent.
#[derive(Clone, Debug)]
struct Tile {
    refine: Refine,
    /// Empty tiles have no content.
    kind: Kind,
    children: Vec<Tile>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    Content,
    Empty,
    /// The children are in another tileset.
    External,
    /// The children are in another tileset, behind a ProxyNode.
    Proxy,
}

fn tile(kinds: bool, add: bool) -> impl Strategy<Value = Tile> {
    let kind = if kinds {
        prop_oneof![6 => Just(Kind::Content), 2 => Just(Kind::Empty), 1 => Just(Kind::External), 1 => Just(Kind::Proxy)]
            .boxed()
    } else {
        Just(Kind::Content).boxed()
    };
    let refine =
        if add { prop_oneof![Just(Refine::Replace), Just(Refine::Add)].boxed() } else { Just(Refine::Replace).boxed() };
    let leaf = (refine.clone(), Just(Kind::Content)).prop_map(|(refine, kind)| Tile { refine, kind, children: vec![] });
    leaf.prop_recursive(5, 200, 4, move |inner| {
        (refine.clone(), kind.clone(), prop::collection::vec(inner, 1..5)).prop_map(|(refine, kind, children)| Tile {
            refine,
            kind,
            children,
        })
    })
}

/// A tile's name is its path from the root; the same in the scene (as URI) and in the model.
fn child_places(center: DVec3, half_m: f64) -> [DVec3; 4] {
    [(-0.5, -0.5), (0.5, -0.5), (-0.5, 0.5), (0.5, 0.5)].map(|(x, y)| center + half_m * DVec3::new(x, y, 0.0))
}

/// `is_replaced`: it replaces the content above.
fn build(tile: &Tile, center: DVec3, half_m: f64, name: &str, is_replaced: bool) -> Node {
    let bounds = BoundingVolume::Box(square_box(center, half_m));
    if tile.kind == Kind::Proxy {
        return Node::new(NodeKind::ProxyNode(Box::new(ProxyNode {
            uri: name.into(),
            bounds: bounds.bounding_sphere(),
            content_transform: DAffine3::IDENTITY,
            loading: ProxyLoading::DeferToPager,
        })));
    }
    let lod = PagedLod {
        bounds,
        range_mode: RangeMode::ScreenSpaceError { geometric_error_m: error_m(tile, half_m, is_replaced) },
        refine: tile.refine,
        content: (tile.kind != Kind::Empty).then(|| name.into()),
        content_transform: if tile.kind == Kind::External {
            DAffine3::IDENTITY
        } else {
            DAffine3::from_translation(center)
        },
        reader_data: None,
        request_volume: None,
        paging: PagingOptions::default(),
    };
    let mut node = Node::new(NodeKind::PagedLod(Box::new(lod)));
    if tile.kind != Kind::External {
        let below = is_replaced || replaces(tile);
        node.children = build_children(tile, center, half_m, name, below);
    }
    node
}

fn build_children(tile: &Tile, center: DVec3, half_m: f64, name: &str, is_replaced: bool) -> Vec<Node> {
    let places = child_places(center, half_m);
    tile.children
        .iter()
        .zip(places)
        .enumerate()
        .map(|(i, (child, place))| build(child, place, 0.5 * half_m, &format!("{name}/{i}"), is_replaced))
        .collect()
}

/// Its content is an external tileset, or unknown.
fn replaces(tile: &Tile) -> bool {
    tile.kind != Kind::Empty && (tile.kind != Kind::Content || tile.refine == Refine::Replace)
}

fn error_m(tile: &Tile, half_m: f64, is_replaced: bool) -> f64 {
    match tile.kind {
        _ if tile.children.is_empty() => 0.0,
        Kind::Empty if is_replaced => f64::MAX / 1e6,
        _ => 0.05 * half_m,
    }
}

/// The scene of a model, with what is resident in it.
struct World {
    scene: Scene,
    root: PageId,
    tiles: BTreeMap<String, (Tile, DVec3, f64)>,
    slots: HashMap<u32, String>,
}

impl World {
    fn new(root_tile: &Tile) -> Self {
        let mut tiles = BTreeMap::new();
        collect(root_tile, DVec3::ZERO, 1024.0, "r", &mut tiles);
        let mut scene = Scene::new();
        let root = scene.add_root(page(build(root_tile, DVec3::ZERO, 1024.0, "r", false), 0));
        let slots = tiles.keys().enumerate().map(|(i, name)| (i as u32, name.clone())).collect();
        Self { scene, root, tiles, slots }
    }

    fn load(&mut self, slot: NodeId) {
        let name = self.scene.slot(slot).unwrap().uri.to_string();
        let (tile, center, half_m) = &self.tiles[&name];
        let page = if matches!(tile.kind, Kind::External | Kind::Proxy) {
            page(Node::group(build_children(tile, *center, *half_m, &name, true)), 0)
        } else {
            let number = self.tiles.keys().position(|k| *k == name).unwrap();
            content(*half_m, number as u32)
        };
        self.scene.attach(slot, page).unwrap();
    }

    fn cull(&self, camera: &CullCamera) -> RenderStage {
        let (mut visitor, mut stage) = (CullVisitor::new(), RenderStage::new());
        visitor.cull(&self.scene, camera, &mut stage);
        stage
    }

    fn drawn(&self, stage: &RenderStage) -> BTreeSet<String> {
        let leaves: Vec<_> = stage.bins.iter().flat_map(|b| &b.leaves).collect();
        let names: BTreeSet<_> = leaves.iter().map(|l| self.slots[&l.slot.0].clone()).collect();
        assert_eq!(names.len(), leaves.len(), "a tile drawn twice");
        names
    }

    /// Every slot in every page that is there.
    fn all_slots(&self) -> Vec<NodeId> {
        let mut found = Vec::new();
        let mut pages = vec![self.root];
        while let Some(id) = pages.pop() {
            for slot in self.scene.slots_of_page(id) {
                found.push(slot);
                if let SlotState::Resident(page) = self.scene.slot(slot).unwrap().state {
                    pages.push(page);
                }
            }
        }
        found
    }
}

fn collect(tile: &Tile, center: DVec3, half_m: f64, name: &str, tiles: &mut BTreeMap<String, (Tile, DVec3, f64)>) {
    tiles.insert(name.to_owned(), (tile.clone(), center, half_m));
    for (i, (child, place)) in tile.children.iter().zip(child_places(center, half_m)).enumerate() {
        collect(child, place, 0.5 * half_m, &format!("{name}/{i}"), tiles);
    }
}

fn camera(eye: [f64; 3], target: [f64; 2]) -> CullCamera {
    let mut camera = look_at(DVec3::from_array(eye), DVec3::new(target[0], target[1], 0.0), DVec3::new(0.1, 0.2, 1.0));
    camera.viewport_px = [512, 512];
    camera
}

fn eye() -> impl Strategy<Value = [f64; 3]> {
    ((-1500.0..1500.0f64), (-1500.0..1500.0f64), (2.0..1200.0f64)).prop_map(|(x, y, z)| [x, y, z])
}

/// Strategy for the number of skipped levels: none, some, all.
fn skip() -> impl Strategy<Value = f64> {
    prop::sample::select(vec![1.0, 1.0, 2.5, 16.0, 1e30])
}

/// Tiles on the way from the root to a tile, the tile included.
fn ancestors(name: &str) -> impl Iterator<Item = &str> {
    name.match_indices('/').map(|(i, _)| &name[..i]).chain([name])
}

/// Checks that every path from the root to a leaf whose middle is in the frustum is covered exactly once.
fn assert_covered(world: &World, stage: &RenderStage, camera: &CullCamera) {
    let drawn = world.drawn(stage);
    let frustum = Frustum::from_clip(&camera.clip_from_eye);
    for (name, (tile, center, _)) in &world.tiles {
        let in_eye = camera.eye_from_world.transform_point3(*center);
        if !tile.children.is_empty() || !frustum.planes.iter().all(|p| p.truncate().dot(in_eye) + p.w > 1e-3) {
            continue;
        }
        let covers = ancestors(name).filter(|a| drawn.contains(*a)).count();
        assert_eq!(covers, 1, "{name}: {drawn:?}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, ..ProptestConfig::default() })]

    /// Loading in the order asked for, with failures and expiry in between: from the root on never a hole.
    #[test]
    fn replace_never_shows_a_hole(
        tree in tile(true, false),
        places in prop::collection::vec((eye(), prop::array::uniform2(-800.0..800.0f64)), 1..6),
        choices in prop::collection::vec((0u32..1000, 0u32..10), 40),
        skip_sse_factor in skip(),
    ) {
        // The root has content, or there is nothing to fall back to.
        let tree = Tile { kind: Kind::Content, ..tree };
        let mut world = World::new(&tree);
        world.load(NodeId { page: world.root, index: 0 });
        let mut step = 0;
        for (eye, target) in places {
            let mut camera = camera(eye, target);
            camera.settings.skip_sse_factor = skip_sse_factor;
            for _ in 0..12 {
                camera.frame += 1;
                let stage = world.cull(&camera);
                assert_covered(&world, &stage, &camera);
                let (pick, what) = choices[step % choices.len()];
                step += 1;
                for (i, request) in stage.requests.iter().enumerate() {
                    if what >= 5 || (i as u32 * 7 + pick).is_multiple_of(3) {
                        if what == 3 && pick.is_multiple_of(5) {
                            world.scene.set_failed(request.slot, true);
                        } else {
                            world.load(request.slot);
                        }
                    }
                }
                if what < 3 {
                    // Expire something, used or not: fallbacks must hold.
                    let slots = world.all_slots();
                    let slot = slots[pick as usize % slots.len()];
                    if let SlotState::Resident(page) = world.scene.slot(slot).unwrap().state
                        && world.scene.is_expirable(page)
                        && slot != (NodeId { page: world.root, index: 0 })
                    {
                        world.scene.detach(page).unwrap();
                    }
                }
            }
        }
    }

    /// Any set of resident tiles whatever (the root with them): exactly one cover.
    #[test]
    fn any_resident_set_covers_once(
        tree in tile(true, false),
        eye in eye(),
        target in prop::array::uniform2(-800.0..800.0f64),
        resident in prop::collection::vec(any::<bool>(), 200),
    ) {
        let tree = Tile { kind: Kind::Content, ..tree };
        let mut world = World::new(&tree);
        world.load(NodeId { page: world.root, index: 0 });
        for _ in 0..4 {
            for (i, slot) in world.all_slots().into_iter().enumerate() {
                if resident[i % resident.len()] && world.scene.slot(slot).unwrap().state == SlotState::Empty {
                    world.load(slot);
                }
            }
        }
        let camera = camera(eye, target);
        assert_covered(&world, &world.cull(&camera), &camera);
    }

    /// Loading the requested tiles leads to the wanted view without further requests.
    #[test]
    fn requests_lead_to_the_wanted_picture(
        tree in tile(true, true),
        eye in eye(),
        target in prop::array::uniform2(-800.0..800.0f64),
        lod_scale in 0.5..2.0f64,
        skip_sse_factor in skip(),
    ) {
        let mut world = World::new(&tree);
        let mut camera = camera(eye, target);
        (camera.settings.lod_scale, camera.settings.skip_sse_factor) = (lod_scale, skip_sse_factor);
        let mut rounds = 0;
        let stage = loop {
            camera.frame += 1;
            let stage = world.cull(&camera);
            prop_assert_eq!(stage.counters.wanted_missing as usize, stage.requests.len());
            let asked: BTreeSet<_> = stage.requests.iter().map(|r| r.slot).collect();
            prop_assert_eq!(asked.len(), stage.requests.len(), "asked twice");
            if stage.requests.is_empty() {
                break stage;
            }
            // Coarse before fine along every path.
            let priority: HashMap<String, f32> = stage
                .requests
                .iter()
                .map(|r| (world.scene.slot(r.slot).unwrap().uri.to_string(), r.priority))
                .collect();
            for (name, own) in &priority {
                prop_assert!(own.is_finite() && *own >= 0.0);
                for above in ancestors(name).filter(|a| a != name) {
                    if let Some(coarser) = priority.get(above) {
                        prop_assert!(coarser > own, "{} {} before {} {}", name, own, above, coarser);
                    }
                }
            }
            stage.requests.iter().for_each(|r| world.load(r.slot));
            rounds += 1;
            prop_assert!(rounds < 20);
        };
        // External tilesets are the only reason for a second round.
        let drawn = world.drawn(&stage);
        let mut wanted = Wanted { world: &world, camera: &camera, tiles: BTreeSet::new(), unsure: false };
        wanted.visit("r");
        prop_assume!(!wanted.unsure);
        prop_assert_eq!(&drawn, &wanted.tiles);
        prop_assert_eq!(stage.counters.tiles_drawn as usize, drawn.len());
        // Every tile that the view depends on was stamped, culled siblings too.
        for slot in world.all_slots() {
            let info = world.scene.slot(slot).unwrap();
            if drawn.contains(&**info.uri) {
                prop_assert_eq!(info.last_used_frame, camera.frame);
            }
        }
    }
}

/// The wanted selection by the rule's words, in f64.
struct Wanted<'a> {
    world: &'a World,
    camera: &'a CullCamera,
    tiles: BTreeSet<String>,
    unsure: bool,
}

impl Wanted<'_> {
    fn visit(&mut self, name: &str) {
        let (tile, center, half_m) = &self.world.tiles[name];
        let bounds = square_box(*center, *half_m);
        match self.in_frustum(&bounds) {
            Some(true) => {}
            Some(false) => return,
            None => self.unsure = true,
        }
        let eye = self.camera.eye_from_world.inverse().translation;
        let distance_m = bounds.distance_to(eye).max(1e-7);
        let is_replaced = ancestors(name).any(|above| above != name && replaces(&self.world.tiles[above].0));
        let error_px = error_m(tile, *half_m, is_replaced) * f64::from(self.camera.viewport_px[1])
            / (2.0 * 30f64.to_radians().tan())
            / distance_m
            / self.camera.settings.lod_scale;
        let limit_px = self.camera.settings.max_sse_px;
        let always = !matches!(tile.kind, Kind::Content | Kind::Empty);
        self.unsure |= !always && error_px > 0.0 && (error_px / limit_px - 1.0).abs() < 1e-3;
        let refine = !tile.children.is_empty() && (always || error_px > limit_px);
        if tile.kind == Kind::Content && (!refine || tile.refine == Refine::Add) {
            self.tiles.insert(name.to_owned());
        }
        if refine {
            for i in 0..tile.children.len() {
                self.visit(&format!("{name}/{i}"));
            }
        }
    }

    /// `None` when too close to say.
    fn in_frustum(&self, b: &terrane::math::OrientedBox) -> Option<bool> {
        let in_eye = b.transformed(&self.camera.eye_from_world);
        let mut closest = f64::INFINITY;
        for plane in Frustum::from_clip(&self.camera.clip_from_eye).planes {
            let n = plane.truncate();
            let m = in_eye.half_axes;
            let reach = n.dot(m.x_axis).abs() + n.dot(m.y_axis).abs() + n.dot(m.z_axis).abs();
            closest = closest.min(n.dot(in_eye.center) + plane.w + reach);
        }
        if closest.abs() < 0.01 { None } else { Some(closest > 0.0) }
    }
}

/// Nothing is loaded for tiles that would show nothing that large.
#[test]
fn empty_tiles_heed_their_error() {
    let leaf = Tile { refine: Refine::Replace, kind: Kind::Content, children: vec![] };
    let tree = Tile { refine: Refine::Replace, kind: Kind::Empty, children: vec![leaf] };
    let world = World::new(&tree);
    // An error of 51.2 m takes 16 pixels of 512, which show 60 degrees, at 1,419 m.
    let asked = |height_m: f64| world.cull(&camera([0.0, 0.0, height_m], [0.0, 0.1])).requests.len();
    assert_eq!([1_000.0, 1_400.0, 1_440.0, 1e6].map(asked), [1, 1, 0, 0]);
}

/// A chain of ancestors was loaded for each tile that is shown.
#[test]
fn levels_between_are_skipped() {
    let leaf = Tile { refine: Refine::Replace, kind: Kind::Content, children: vec![] };
    let tree = (0..5).fold(leaf, |below, _| Tile { children: vec![below.clone(); 4], ..below });
    let mut camera = camera([10.0, 10.0, 3.0], [12.0, 10.0]);
    let load = |camera: &CullCamera, fails: &str| {
        let mut world = World::new(&tree);
        let mut loaded = Vec::new();
        loop {
            let stage = world.cull(camera);
            if stage.requests.is_empty() {
                return (world.drawn(&stage), loaded);
            }
            assert_covered_where_the_root_is(&world, &stage, camera);
            for request in &stage.requests {
                let uri = world.scene.slot(request.slot).unwrap().uri.to_string();
                if uri == fails {
                    world.scene.set_failed(request.slot, true);
                    continue;
                }
                loaded.push(uri);
                world.load(request.slot);
            }
        }
    };
    let depths =
        |loaded: &[String]| -> BTreeSet<usize> { loaded.iter().map(|name| name.matches('/').count()).collect() };
    let (all, every) = load(&camera, "");
    camera.settings.skip_sse_factor = 16.0;
    let (drawn, some) = load(&camera, "");
    assert_eq!(drawn, all, "the picture is the same");
    let above = |name: &str| all.iter().any(|drawn| drawn != name && ancestors(drawn).any(|above| above == name));
    let replaced = |loaded: &[String]| loaded.iter().filter(|name| above(name)).count();
    assert!(all.iter().any(|name| name.matches('/').count() == 5), "down to the finest");
    assert!(depths(&every).len() == 6 && replaced(&every) > 5, "{every:?}");
    // Below the root, four levels are one step.
    assert!(replaced(&some) <= replaced(&every) / 2 && some.len() < every.len(), "{some:?}");
    assert!(some.contains(&"r".to_owned()), "there is something from the start on");

    // The tile above a failure is loaded instead, and the rest stays as fine.
    let fails = all.iter().find(|name| name.matches('/').count() == 5).unwrap();
    let above = fails.rsplit_once('/').unwrap().0;
    assert!(!some.contains(&above.to_owned()), "it was skipped");
    let (drawn, loaded) = load(&camera, fails);
    assert!(drawn.contains(above) && loaded.contains(&above.to_owned()), "{drawn:?}");
    let others = |set: &BTreeSet<String>| -> BTreeSet<String> {
        set.iter().filter(|name| !name.starts_with(above)).cloned().collect()
    };
    assert_eq!(others(&drawn), others(&all));
}

/// Checks the same as [`assert_covered`], once any tile is resident.
fn assert_covered_where_the_root_is(world: &World, stage: &RenderStage, camera: &CullCamera) {
    if !world.drawn(stage).is_empty() {
        assert_covered(world, stage, camera);
    }
}

/// They were skipped, and what is above them waited for ever.
#[test]
fn a_tile_above_tiles_that_hold_nothing_is_not_skipped() {
    let empty = |children| Tile { refine: Refine::Replace, kind: Kind::Empty, children };
    let middle = Tile { refine: Refine::Replace, kind: Kind::Content, children: vec![empty(vec![]); 4] };
    let tree = Tile { refine: Refine::Replace, kind: Kind::Content, children: vec![middle; 4] };
    let mut world = World::new(&tree);
    let mut camera = camera([10.0, 10.0, 3.0], [12.0, 10.0]);
    camera.settings.skip_sse_factor = 1e30;
    for _ in 0..3 {
        world.cull(&camera).requests.iter().for_each(|request| world.load(request.slot));
    }
    let stage = world.cull(&camera);
    assert!(stage.requests.is_empty());
    // The tile's refinement holds nothing.
    assert!(world.drawn(&stage).is_empty());
    assert_eq!(
        world.all_slots().iter().filter(|s| world.scene.slot(**s).unwrap().state != SlotState::Empty).count(),
        5
    );
}

#[test]
fn a_failed_tile_keeps_its_parent() {
    let mut scene = Scene::new();
    let root = scene.add_root(page(quadtree(2, 100.0, 50.0, Refine::Replace), 0));
    let slots: Vec<_> = scene.slots_of_page(root).collect();
    let camera = look_at(DVec3::new(0.0, 0.0, 50.0), DVec3::ZERO, DVec3::Y);
    let (mut visitor, mut stage) = (CullVisitor::new(), RenderStage::new());
    for (i, slot) in slots.iter().enumerate().take(4) {
        scene.attach(*slot, content(50.0, i as u32)).unwrap();
    }
    let mut drawn = |scene: &Scene| {
        visitor.cull(scene, &camera, &mut stage);
        (stage.bins.iter().flat_map(|b| &b.leaves).map(|l| l.slot.0).collect::<Vec<_>>(), stage.requests.len())
    };
    assert_eq!(drawn(&scene), (vec![0], 1));
    scene.set_failed(slots[4], true);
    assert_eq!(scene.slot(slots[4]).unwrap().state, SlotState::Failed);
    assert_eq!(drawn(&scene), (vec![0], 0));
    scene.set_failed(slots[4], false);
    assert_eq!(drawn(&scene), (vec![0], 1));
    scene.attach(slots[4], content(50.0, 4)).unwrap();
    assert_eq!(drawn(&scene), (vec![1, 2, 3, 4], 0));
}

/// An external tileset whose own tiles all lie outside the frustum is loaded nevertheless: its parent waits for it.
#[test]
fn culled_tiles_of_an_external_tileset_are_asked_for() {
    let leaf = |refine| Tile { refine, kind: Kind::Content, children: vec![] };
    let external = Tile { refine: Refine::Replace, kind: Kind::External, children: vec![leaf(Refine::Replace)] };
    let tree = Tile { refine: Refine::Replace, kind: Kind::Content, children: vec![external] };
    let mut world = World::new(&tree);
    // Over the external tile's far corner: the tile (from -1024 to 0) is seen, its child (to -512) is not.
    let mut camera = camera([-60.0, -60.0, 60.0], [-60.0, -60.5]);
    for round in 0.. {
        let stage = world.cull(&camera);
        assert!(round < 5);
        if stage.requests.is_empty() {
            assert_eq!(round, 2, "root and external tileset, then what is in it");
            assert!(world.drawn(&stage).is_empty(), "the root gave way");
            break;
        }
        stage.requests.iter().for_each(|r| world.load(r.slot));
        camera.frame += 1;
    }
    for slot in world.all_slots() {
        assert_eq!(world.scene.slot(slot).unwrap().last_used_frame, camera.frame);
    }
}

/// A tile set whose errors grow downwards is still loaded from the top.
#[test]
fn coarse_tiles_come_first_even_with_wrong_errors() {
    let error = |geometric_error_m| RangeMode::ScreenSpaceError { geometric_error_m };
    let leaf = tile_at(DVec3::ZERO, 1.0, error(0.0), "2");
    let root = tile_at(DVec3::ZERO, 3.0, error(10.0), "0")
        .with_child(tile_at(DVec3::ZERO, 2.0, error(1000.0), "1").with_child(leaf));
    let mut scene = Scene::new();
    let id = scene.add_root(page(root, 0));
    let (mut visitor, mut stage) = (CullVisitor::new(), RenderStage::new());
    visitor.cull(&scene, &look_at(DVec3::new(0.0, -10.0, 0.0), DVec3::ZERO, DVec3::Z), &mut stage);
    let order: Vec<f32> =
        scene.slots_of_page(id).map(|slot| stage.requests.iter().find(|r| r.slot == slot).unwrap().priority).collect();
    assert!(order[0] > order[1] && order[1] > order[2], "{order:?}");
}

/// Among equally distant and coarse tiles, those near the view's center are requested first.
#[test]
fn tiles_near_the_view_center_come_first() {
    let error = RangeMode::ScreenSpaceError { geometric_error_m: 10.0 };
    let aside: Vec<f64> = vec![0.0, 20.0, -35.0, 50.0];
    let place = |degrees: f64| 100.0 * DVec3::new(degrees.to_radians().sin(), degrees.to_radians().cos(), 0.0);
    let mut scene = Scene::new();
    let tiles: Vec<Node> =
        aside.iter().enumerate().map(|(i, d)| tile_at(place(*d), 1.0, error, &i.to_string())).collect();
    let id = scene.add_root(page(Node::group(tiles), 0));
    let (mut visitor, mut stage) = (CullVisitor::new(), RenderStage::new());
    let mut camera = look_at(DVec3::ZERO, DVec3::Y, DVec3::Z);
    camera.clip_from_eye =
        glam::dcamera::rh::proj::directx::perspective_infinite_reverse(120f64.to_radians(), 1.0, 0.1);
    visitor.cull(&scene, &camera, &mut stage);
    let priorities: Vec<f32> =
        scene.slots_of_page(id).map(|slot| stage.requests.iter().find(|r| r.slot == slot).unwrap().priority).collect();
    assert!(priorities.windows(2).all(|p| p[0] > p[1]), "{priorities:?}");
    assert!(priorities[3] > 0.25 * priorities[0] && priorities[3] < 0.5 * priorities[0], "{priorities:?}");
}

/// A tile whose middle lay behind the eye came as late as one that is not seen.
#[test]
fn tiles_around_the_eye_have_the_priority_of_those_in_front() {
    let error = RangeMode::ScreenSpaceError { geometric_error_m: 10.0 };
    let priority = |center: DVec3, scale: f64| {
        let mut scene = Scene::new();
        let tile = tile_at(center / scale, 300.0 / scale, error, "0");
        let id = scene.add_root(page(Node::transform(DAffine3::from_scale(DVec3::splat(scale)), vec![tile]), 0));
        let (mut visitor, mut stage) = (CullVisitor::new(), RenderStage::new());
        visitor.cull(&scene, &look_at(DVec3::ZERO, DVec3::Y, DVec3::Z), &mut stage);
        let slot = scene.slots_of_page(id).next().unwrap();
        stage.requests.iter().find(|r| r.slot == slot).unwrap().priority
    };
    for scale in [1.0, 0.01, 100.0] {
        let [behind, before] = [-200.0, 200.0].map(|y| priority(DVec3::new(0.0, y, -100.0), scale));
        assert!(behind > 0.9 * before, "{scale}: {behind} {before}");
    }
}

/// At planetary coordinates the distance to a tile is still good to a millimetre.
#[test]
fn ranges_are_exact_far_from_the_origin() {
    let center = DVec3::new(4_517_590.0, 1_000_000.25, 4_487_348.0);
    let range_m = 100.0;
    let child = |i: u32| tile_at(center, 1.0, RangeMode::Distance { center, range_m: 0.0 }, &format!("c{i}"));
    let root = tile_at(center, 1.0, RangeMode::Distance { center, range_m }, "r").with_child(child(0));
    let mut scene = Scene::new();
    let id = scene.add_root(page(root, 0));
    for (i, slot) in scene.slots_of_page(id).collect::<Vec<_>>().into_iter().enumerate() {
        scene.attach(slot, content(1.0, i as u32)).unwrap();
    }
    let drawn_at = |distance_m: f64| {
        let up = center.normalize();
        let camera = look_at(center + up * distance_m, center, DVec3::Z);
        let (mut visitor, mut stage) = (CullVisitor::new(), RenderStage::new());
        visitor.cull(&scene, &camera, &mut stage);
        stage.bins[0].leaves[0].slot.0
    };
    assert_eq!(drawn_at(range_m - 0.002), 1);
    assert_eq!(drawn_at(range_m + 0.002), 0);
}

fn tile_at(center: DVec3, radius_m: f64, range_mode: RangeMode, name: &str) -> Node {
    Node::new(NodeKind::PagedLod(Box::new(PagedLod {
        bounds: BoundingVolume::Sphere(BoundingSphere::new(center, radius_m)),
        range_mode,
        refine: Refine::Replace,
        content: Some(name.into()),
        content_transform: DAffine3::from_translation(center),
        reader_data: None,
        request_volume: None,
        paging: PagingOptions::default(),
    })))
}

/// Broken numbers in a tile set must neither panic nor hide the rest.
#[test]
fn broken_tiles_do_no_harm() {
    let nan = BoundingSphere::new(DVec3::NAN, f64::NAN);
    let mut odd = tile_at(DVec3::ZERO, 1.0, RangeMode::ScreenSpaceError { geometric_error_m: f64::NAN }, "odd");
    if let NodeKind::PagedLod(lod) = &mut odd.kind {
        lod.bounds = BoundingVolume::Sphere(nan);
        lod.content_transform = DAffine3::from_scale(DVec3::INFINITY);
    }
    let huge = tile_at(DVec3::ZERO, 1e30, RangeMode::ScreenSpaceError { geometric_error_m: 1e300 }, "huge");
    let negative = tile_at(DVec3::ZERO, -5.0, RangeMode::ScreenSpaceError { geometric_error_m: -1.0 }, "negative");
    let good = tile_at(DVec3::ZERO, 1.0, RangeMode::ScreenSpaceError { geometric_error_m: 1.0 }, "good");
    let root = Node::group(vec![huge.with_child(odd), negative, good]);
    let mut scene = Scene::new();
    let id = scene.add_root(page(root, 0));
    let camera = look_at(DVec3::new(0.0, -10.0, 0.0), DVec3::ZERO, DVec3::Z);
    let (mut visitor, mut stage) = (CullVisitor::new(), RenderStage::new());
    visitor.cull(&scene, &camera, &mut stage);
    assert_eq!(stage.requests.len(), 4);
    assert!(stage.requests.iter().all(|r| r.priority.is_finite() && r.error_px.is_finite()));
    for (i, slot) in scene.slots_of_page(id).collect::<Vec<_>>().into_iter().enumerate() {
        scene.attach(slot, content(1.0, i as u32)).unwrap();
    }
    visitor.cull(&scene, &camera, &mut stage);
    assert_eq!(stage.counters.leaves, 3);
    assert!(stage.near_m > 7.0 && stage.far_m < 13.0);
}
