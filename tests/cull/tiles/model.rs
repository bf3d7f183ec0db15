//! A model of a tile tree, the scene that is built from it, and checks of coverage.

use std::collections::{BTreeMap, BTreeSet, HashMap};

use glam::{DAffine3, DVec3, Vec4};
use kit::cull_scenes::{content, look_at, page, square_box};
use proptest::prelude::*;
use terrane::cull::{CullCamera, CullVisitor, CutVolume, DrawnPart, RenderStage};
use terrane::math::{BoundingVolume, Frustum};
use terrane::scene::{
    Node, NodeId, NodeKind, PageId, PagedLod, PagingOptions, ProxyLoading, ProxyNode, RangeMode, Refine, Scene,
    SlotState,
};

/// A tile of the model. It covers a quarter of its parent.
#[derive(Clone, Debug)]
pub struct Tile {
    pub refine: Refine,
    pub kind: Kind,
    pub children: Vec<Tile>,
}

/// The kinds of content of a tile.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kind {
    /// A drawable.
    Content,
    /// No content.
    Empty,
    /// The children are in another tileset.
    External,
    /// The children are in another tileset, behind a ProxyNode.
    Proxy,
}

/// Generates random trees; with `kinds` of all kinds of content, with `add` of both refinements.
pub fn tile(kinds: bool, add: bool) -> impl Strategy<Value = Tile> {
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

/// Returns the centers of the four children of a tile.
pub fn child_centers(center: DVec3, half_m: f64) -> [DVec3; 4] {
    [(-0.5, -0.5), (0.5, -0.5), (-0.5, 0.5), (0.5, 0.5)].map(|(x, y)| center + half_m * DVec3::new(x, y, 0.0))
}

/// Builds the node of a tile. `name` is its path from the root, also used as URI. `is_replaced` is true if it replaces
/// content of its ancestors.
pub fn build(tile: &Tile, center: DVec3, half_m: f64, name: &str, is_replaced: bool) -> Node {
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

pub fn build_children(tile: &Tile, center: DVec3, half_m: f64, name: &str, is_replaced: bool) -> Vec<Node> {
    let centers = child_centers(center, half_m);
    tile.children
        .iter()
        .zip(centers)
        .enumerate()
        .map(|(i, (child, center))| build(child, center, 0.5 * half_m, &format!("{name}/{i}"), is_replaced))
        .collect()
}

/// Returns true if the content of a tile replaces that of its ancestors.
pub fn replaces(tile: &Tile) -> bool {
    tile.kind != Kind::Empty && (tile.kind != Kind::Content || tile.refine == Refine::Replace)
}

/// Returns the geometric error of a tile in metres.
pub fn error_m(tile: &Tile, half_m: f64, is_replaced: bool) -> f64 {
    match tile.kind {
        _ if tile.children.is_empty() => 0.0,
        Kind::Empty if is_replaced => f64::MAX / 1e6,
        _ => 0.05 * half_m,
    }
}

/// The scene of a model.
pub struct World {
    pub scene: Scene,
    pub root: PageId,
    pub tiles: BTreeMap<String, (Tile, DVec3, f64)>,
    pub slots: HashMap<u32, String>,
}

impl World {
    pub fn new(root_tile: &Tile) -> Self {
        let mut tiles = BTreeMap::new();
        collect(root_tile, DVec3::ZERO, 1024.0, "r", &mut tiles);
        let mut scene = Scene::new();
        let root = scene.add_root(page(build(root_tile, DVec3::ZERO, 1024.0, "r", false), 0));
        let slots = tiles.keys().enumerate().map(|(i, name)| (i as u32, name.clone())).collect();
        Self { scene, root, tiles, slots }
    }

    pub fn load(&mut self, slot: NodeId) {
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

    pub fn cull(&self, camera: &CullCamera) -> RenderStage {
        let (mut visitor, mut stage) = (CullVisitor::new(), RenderStage::new());
        visitor.cull(&self.scene, camera, &mut stage);
        stage
    }

    /// Returns the tiles that are drawn whole.
    pub fn drawn(&self, stage: &RenderStage) -> BTreeSet<String> {
        let whole: Vec<_> = self.parts(stage).filter(|(_, volume)| volume.is_none()).collect();
        let names: BTreeSet<_> = whole.iter().map(|(name, _)| (*name).to_owned()).collect();
        assert_eq!(names.len(), whole.len(), "a tile drawn twice");
        names
    }

    /// Returns the tiles that are drawn in place of unavailable ones, with the volumes that they are cut to.
    pub fn stand_ins<'a>(&'a self, stage: &'a RenderStage) -> Vec<(&'a str, CutVolume)> {
        self.parts(stage).filter_map(|(name, volume)| Some((name, volume?))).collect()
    }

    fn parts<'a>(&'a self, stage: &'a RenderStage) -> impl Iterator<Item = (&'a str, Option<CutVolume>)> {
        stage.bins.iter().flat_map(|bin| &bin.leaves).filter_map(|leaf| {
            let part = stage.part_of_state[leaf.state as usize];
            let volume = match part.checked_sub(1).map(|index| stage.parts[index as usize]) {
                Some(DrawnPart::Within(volume)) => Some(volume),
                Some(DrawnPart::Backdrop(_)) => return None,
                _ => None,
            };
            Some((self.slots[&leaf.slot.0].as_str(), volume))
        })
    }

    /// Returns all slots of all resident pages.
    pub fn all_slots(&self) -> Vec<NodeId> {
        slots_below(&self.scene, self.root)
    }
}

/// Returns the slots of a page, and those of all resident pages below it.
pub fn slots_below(scene: &Scene, root: PageId) -> Vec<NodeId> {
    let mut found = Vec::new();
    let mut pages = vec![root];
    while let Some(id) = pages.pop() {
        for slot in scene.slots_of_page(id) {
            found.push(slot);
            if let SlotState::Resident(page) = scene.slot(slot).unwrap().state {
                pages.push(page);
            }
        }
    }
    found
}

pub fn collect(tile: &Tile, center: DVec3, half_m: f64, name: &str, tiles: &mut BTreeMap<String, (Tile, DVec3, f64)>) {
    tiles.insert(name.to_owned(), (tile.clone(), center, half_m));
    for (i, (child, center)) in tile.children.iter().zip(child_centers(center, half_m)).enumerate() {
        collect(child, center, 0.5 * half_m, &format!("{name}/{i}"), tiles);
    }
}

/// Returns a camera that looks at a point of the ground, with 512 x 512 pixels.
pub fn camera(eye: [f64; 3], target: [f64; 2]) -> CullCamera {
    let mut camera = look_at(DVec3::from_array(eye), DVec3::new(target[0], target[1], 0.0), DVec3::new(0.1, 0.2, 1.0));
    camera.viewport_px = [512, 512];
    camera
}

/// Generates positions of the eye.
pub fn eye() -> impl Strategy<Value = [f64; 3]> {
    ((-1500.0..1500.0f64), (-1500.0..1500.0f64), (2.0..1200.0f64)).prop_map(|(x, y, z)| [x, y, z])
}

/// Generates factors for skipping levels: none, some, or all are skipped.
pub fn skip() -> impl Strategy<Value = f64> {
    prop::sample::select(vec![1.0, 1.0, 2.5, 16.0, 1e30])
}

/// Returns the tiles on the path from the root to a tile, with the tile itself.
pub fn ancestors(name: &str) -> impl Iterator<Item = &str> {
    name.match_indices('/').map(|(i, _)| &name[..i]).chain([name])
}

/// Returns true if a point of the eye space is inside a box.
pub fn is_inside(volume: &CutVolume, point: DVec3) -> bool {
    volume.rows.iter().all(|row| (Vec4::from_array(*row).dot(point.as_vec3().extend(1.0))).abs() <= 1.0)
}

/// Checks that every path from the root to a leaf whose middle is in the frustum is covered exactly once, or by parts that
/// stand in for unavailable tiles.
pub fn assert_covered(world: &World, stage: &RenderStage, camera: &CullCamera) {
    let (drawn, stand_ins) = (world.drawn(stage), world.stand_ins(stage));
    let frustum = Frustum::from_clip(&camera.clip_from_eye);
    for (name, (tile, center, _)) in &world.tiles {
        let in_eye = camera.eye_from_world.transform_point3(*center);
        if !tile.children.is_empty() || !frustum.planes.iter().all(|p| p.truncate().dot(in_eye) + p.w > 1e-3) {
            continue;
        }
        let covers = ancestors(name).filter(|a| drawn.contains(*a)).count();
        let is_cut = || {
            stand_ins.iter().any(|(above, volume)| ancestors(name).any(|a| a == *above) && is_inside(volume, in_eye))
        };
        assert!(covers == 1 || (covers == 0 && is_cut()), "{name}: {covers} of {drawn:?}, {stand_ins:?}");
    }
}
