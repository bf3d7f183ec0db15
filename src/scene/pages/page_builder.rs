//! Builds a page from nodes that arrive in depth-first order. Decode workers (any thread).

use std::collections::HashMap;
use std::sync::Arc;

use glam::{DAffine3, DVec3};

use super::drawable_arrays::{DrawableArrays, DrawableRef};
use super::node_arrays::{NodeArrays, NodeRecord};
use super::node_extras::NodeExtras;
use super::node_spheres::NodeSpheres;
use super::page::Page;
use super::page_payload::PagePayload;
use super::payload_tables::{OccluderRecord, PayloadTables, RareNode};
use super::state_paths::{BLEND, LIGHTS, StatePaths, VIEW};
use super::transforms::Transforms;
use crate::math::Aabb;
use crate::scene::error::SceneError;
use crate::scene::features::TileMetadata;
use crate::scene::geometry::{AlphaMode, Drawable};
use crate::scene::id::NONE;
use crate::scene::nodes::{ConvexPlanarOccluder, CullCallback, EventCallback, PagedLod, ProxyNode, UpdateCallback};
use crate::scene::settings::LodRecord;
use crate::scene::tile_tree::{TileTreeBuilder, Tiles};
use crate::state::StateSet;

/// A node before its drawables and payload are added: the numbers that follow from its position in depth-first order.
#[derive(Clone, Copy, Debug)]
pub(crate) struct NodeStart {
    /// The index that the node will have.
    pub node: u32,
    first_drawable: u32,
    first_transform: u32,
}

/// The parts of a page that is being built.
#[derive(Debug)]
pub(crate) struct PageBuilder {
    nodes: NodeArrays,
    transforms: Transforms,
    drawables: DrawableArrays,
    states: StatePaths,
    tables: PayloadTables,
    extras: NodeExtras,
    tiles: TileTreeBuilder,
    payload: PagePayload,
    /// Paths by parent and state set.
    known_paths: HashMap<(u32, u32), u32>,
    /// State sets by address: they are shared by identity.
    known_sets: HashMap<usize, u32>,
}

impl PageBuilder {
    pub fn new() -> Self {
        Self {
            nodes: NodeArrays::default(),
            transforms: Transforms::new(),
            drawables: DrawableArrays::default(),
            states: StatePaths::new(),
            tables: PayloadTables::default(),
            extras: NodeExtras::default(),
            tiles: TileTreeBuilder::default(),
            payload: PagePayload::default(),
            known_paths: HashMap::new(),
            known_sets: HashMap::new(),
        }
    }

    /// Begins the next node. Fails if the page has more nodes or drawables than its 32-bit indices allow.
    pub fn start_node(&self) -> Result<NodeStart, SceneError> {
        let index = |len: usize, limit: u32| u32::try_from(len).ok().filter(|i| *i < limit).ok_or(SceneError::TooLarge);
        Ok(NodeStart {
            node: index(self.nodes.records().len(), NONE - 1)?,
            first_drawable: index(self.drawables.len(), NONE / 2)?,
            first_transform: self.transforms.len() as u32,
        })
    }

    /// Adds a node whose drawables, transform and payload were added since [`Self::start_node`].
    pub fn push_node(&mut self, start: NodeStart, kind: u8, flags: u8, parent: u32, mask: u32, payload: u32) {
        let NodeStart { first_drawable, first_transform, .. } = start;
        let record = NodeRecord { skip: 1, first_drawable, first_transform, kind, flags };
        self.nodes.push(record, parent, mask, payload);
    }

    /// Ends the subtree of a node: everything that was pushed after the node is below it.
    pub fn close_subtree(&mut self, node: u32) {
        self.nodes.close_subtree(node);
    }

    /// Adds a transform below another and returns its index. A map that is not finite becomes the identity.
    pub fn push_transform(&mut self, parent: u32, parent_from_child: DAffine3) -> u32 {
        let map = if parent_from_child.is_finite() { parent_from_child } else { DAffine3::IDENTITY };
        self.transforms.push(parent, map)
    }

    /// Adds a drawable to the node that was started.
    pub fn push_drawable(&mut self, mut drawable: Drawable, transform: u32, path: u32) {
        let path = match drawable.state_set.take() {
            Some(set) => self.path_below(path, set),
            None => path,
        };
        let callback = drawable.cull_callback.take();
        let blends = matches!(drawable.material.alpha, AlphaMode::Blend);
        let state_path = if blends { self.path_to(path, BLEND) } else { path };
        self.drawables.push(DrawableRef { state_path, transform }, drawable.bounds(), drawable.cluster, callback);
        self.payload.push(drawable);
    }

    pub fn push_switch(&mut self, shown: Vec<bool>) -> u32 {
        self.tables.push_switch(shown)
    }

    pub fn push_lod(&mut self, lod: LodRecord) -> u32 {
        self.tables.push_lod(lod)
    }

    pub fn push_rare(&mut self, rare: RareNode) -> u32 {
        self.tables.push_rare(rare)
    }

    /// Adds the polygon of an OccluderNode.
    pub fn push_occluder(&mut self, node: u32, transform: u32, occluder: ConvexPlanarOccluder) {
        self.tables.push_occluder(OccluderRecord { node, transform, occluder });
    }

    /// Adds a tile below another (`NONE` for the top tile of a tree) and returns its index.
    pub fn push_paged_lod(&mut self, parent: u32, node: u32, transform: u32, path: u32, tile: PagedLod) -> u32 {
        self.tiles.push_paged_lod(parent, node, transform, path, tile)
    }

    /// Adds a proxy as [`Self::push_paged_lod`] adds a tile.
    pub fn push_proxy(&mut self, parent: u32, node: u32, transform: u32, path: u32, proxy: ProxyNode) -> u32 {
        self.tiles.push_proxy(parent, node, transform, path, proxy)
    }

    pub fn push_name(&mut self, node: u32, name: String) {
        if !name.is_empty() {
            self.extras.push_name(node, name);
        }
    }

    /// Adds the cull callback of a node, whose state path ends with the node's own state set.
    pub fn push_cull_callback(&mut self, node: u32, callback: CullCallback, path: u32) {
        self.extras.cull_callbacks.push(node, (callback, path));
    }

    pub fn push_update_callback(&mut self, node: u32, callback: UpdateCallback) {
        self.extras.update_callbacks.push(node, callback);
    }

    pub fn push_event_callback(&mut self, node: u32, callback: EventCallback) {
        self.extras.event_callbacks.push(node, callback);
    }

    pub fn push_metadata(&mut self, node: u32, metadata: Arc<TileMetadata>) {
        self.extras.push_metadata(node, metadata);
    }

    /// Returns the path of a state set below another path.
    pub fn path_below(&mut self, parent: u32, set: Arc<StateSet>) -> u32 {
        let states = &mut self.states;
        let index = *self.known_sets.entry(Arc::as_ptr(&set) as usize).or_insert_with(|| states.push_set(set));
        self.path_to(parent, index)
    }

    /// Returns a new path for nodes that have another view than those above.
    pub fn view_path(&mut self, parent: u32) -> u32 {
        self.states.push_path(parent, VIEW)
    }

    /// Returns a new path for what is below a node with local lights.
    pub fn lights_path(&mut self, parent: u32) -> u32 {
        self.states.push_path(parent, LIGHTS)
    }

    fn path_to(&mut self, parent: u32, set: u32) -> u32 {
        let states = &mut self.states;
        *self.known_paths.entry((parent, set)).or_insert_with(|| states.push_path(parent, set))
    }

    /// Finishes the page: flags, order of the tiles, and all bounds.
    pub fn finish(mut self) -> Page {
        let drawables = &self.drawables;
        let needs_tests = |range| drawables.needs_tests(range);
        self.nodes.finish(drawables.len() as u32, self.transforms.len() as u32, needs_tests);
        let (tiles, new_index) = self.tiles.finish();
        self.nodes.renumber_tiles(&new_index);
        self.transforms.shrink();
        let count = self.nodes.node_count();
        let mut page = Page {
            nodes: self.nodes,
            spheres: NodeSpheres::default(),
            transforms: self.transforms,
            drawables: self.drawables,
            states: self.states,
            tables: self.tables,
            extras: self.extras,
            tiles,
            payload: self.payload,
            attached_pages: 0,
        };
        page.fit_billboards(0, count);
        page.spheres = NodeSpheres::new(count, middle(&page.drawables, &page.tiles, &page.transforms));
        page.fit_boxes(0, page.drawables.len());
        page.fit_spheres(0, count);
        page
    }
}

/// Returns the middle of everything that has a bound: coordinates relative to it are as small as possible.
fn middle(drawables: &DrawableArrays, tiles: &Tiles, transforms: &Transforms) -> DVec3 {
    let mut around = Aabb::EMPTY;
    for drawable in 0..drawables.len() {
        if let Some(b) = drawables.box_in_page(drawable, transforms) {
            around = around.union(&b);
        }
    }
    for (root, sphere) in tiles.roots_with_spheres() {
        let s = sphere.transformed(&transforms.page_from_node(root.transform));
        if s.center.is_finite() && s.radius_m >= 0.0 && s.radius_m.is_finite() {
            let r = DVec3::splat(s.radius_m);
            around = around.union(&Aabb { min: s.center - r, max: s.center + r });
        }
    }
    let center = around.center();
    if around.is_empty() || !center.is_finite() { DVec3::ZERO } else { center }
}
