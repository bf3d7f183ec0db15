//! A page: what one load produces, flattened for culling. The type is composed of parts; see the module for the list.
//!
//! Decode workers (any thread) build pages. A [`Scene`](crate::scene::Scene) owns them while they are attached: update
//! changes them through `&mut`, culls read them through `&`.

use std::sync::Arc;

use glam::{DVec3, Vec4};

use super::drawable_arrays::{DrawableArrays, DrawableRef};
use super::node_arrays::{NodeArrays, NodeRecord, kind};
use super::node_extras::NodeExtras;
use super::node_spheres::NodeSpheres;
use super::page_payload::{DrawSlot, PagePayload, SharedUse};
use super::payload_tables::{OccluderRecord, PayloadTables, RareNode};
use super::state_paths::{StatePath, StatePaths};
use super::stored_bounds::Boxes4;
use super::transforms::Transforms;
use crate::math::Ellipsoid;
use crate::scene::features::{DrawableFeatures, TileMetadata};
use crate::scene::geometry::{BlockFormats, Drawable, Geometry, Mesh, NormalCone};
use crate::scene::intersect::KdTree;
use crate::scene::nodes::{CameraNode, CullCallback, EventCallback, UpdateCallback};
use crate::scene::settings::LodRecord;
use crate::scene::sparse_list::SparseList;
use crate::scene::tile_tree::Tiles;
use crate::state::{Attribute, StateSet};

/// The result of one load: nodes and drawables in flat depth-first arrays, tile trees in separate arrays.
///
/// A reader or an application builds it from a tree of nodes, on any thread. A scene then owns it, as a root or in the slot of a tile:
/// update alone changes it. Lengths are metres; bounds are stored as `f32` relative to the page's origin, and translations as
/// `f64`.
///
/// ```
/// use terrane::glam::DVec3;
/// use terrane::scene::{Drawable, Material, Mesh, Node, Page, Scene};
/// let floor = Mesh::rectangle(DVec3::ZERO, 10.0 * DVec3::X, 10.0 * DVec3::Y);
/// let geode = Node::geode(vec![Drawable::new(floor.into(), Material::default())]);
/// let mut scene = Scene::new();
/// let id = scene.add_root(Page::from_node(geode)?);
/// assert!(scene.page(id).is_some());
/// # Ok::<(), terrane::scene::SceneError>(())
/// ```
#[derive(Debug)]
pub struct Page {
    pub(super) nodes: NodeArrays,
    pub(super) spheres: NodeSpheres,
    pub(super) transforms: Transforms,
    pub(super) drawables: DrawableArrays,
    pub(super) states: StatePaths,
    pub(super) tables: PayloadTables,
    pub(super) extras: NodeExtras,
    pub(super) tiles: Tiles,
    pub(super) payload: PagePayload,
    /// The number of pages in this page's slots.
    pub(super) attached_pages: u32,
}

/// The arrays that culls read. Inlined, so that a scan keeps slices.
impl Page {
    /// Returns the records of all nodes in depth-first order, and one more that holds the totals.
    #[inline(always)]
    pub(crate) fn nodes(&self) -> &[NodeRecord] {
        self.nodes.records()
    }

    /// Returns the sphere of each node, relative to [`Self::origin`].
    #[inline(always)]
    pub(crate) fn spheres(&self) -> &[Vec4] {
        self.spheres.spheres()
    }

    /// Returns the point of the page's frame that all bounds are relative to.
    #[inline(always)]
    pub(crate) fn origin(&self) -> DVec3 {
        self.spheres.origin()
    }

    /// Returns the parent of each node, `NONE` for the root.
    #[inline(always)]
    pub(crate) fn parents(&self) -> &[u32] {
        self.nodes.parents()
    }

    /// Returns the mask of each node, or nothing if every camera sees every node.
    #[inline(always)]
    pub(crate) fn masks(&self) -> &[u32] {
        self.nodes.masks()
    }

    /// Returns the payload index of each node, or nothing if no node has one.
    #[inline(always)]
    pub(crate) fn payloads(&self) -> &[u32] {
        self.nodes.payloads()
    }

    /// Returns the visibility of the children of each Switch, by payload index.
    #[inline(always)]
    pub(crate) fn switches(&self) -> &[Box<[bool]>] {
        self.tables.switches()
    }

    /// Returns the ranges of each LOD, by payload index.
    #[inline(always)]
    pub(crate) fn lods(&self) -> &[LodRecord] {
        self.tables.lods()
    }

    /// Returns the payloads of nodes of kind [`kind::SPECIAL`], by payload index.
    #[inline(always)]
    pub(crate) fn rare_nodes(&self) -> &[RareNode] {
        self.tables.rare_nodes()
    }

    /// Returns the occluders, sorted by node.
    #[inline(always)]
    pub(crate) fn occluders(&self) -> &[OccluderRecord] {
        self.tables.occluders()
    }

    /// Returns the cull callback of a node, and the state path that ends with the node's own state set.
    #[inline]
    pub(crate) fn cull_callback(&self, node: u32) -> Option<&(CullCallback, u32)> {
        self.extras.cull_callbacks.get(node)
    }

    /// Returns the frame and state of each drawable.
    #[inline(always)]
    pub(crate) fn drawable_refs(&self) -> &[DrawableRef] {
        self.drawables.refs()
    }

    /// Returns the boxes of the drawables relative to [`Self::origin`], four to an element.
    #[inline(always)]
    pub(crate) fn boxes(&self) -> &[Boxes4] {
        self.drawables.boxes()
    }

    /// Returns the normal cones of the drawables that have one.
    #[inline(always)]
    pub(crate) fn normal_cones(&self) -> &SparseList<NormalCone> {
        self.drawables.normal_cones()
    }

    /// Returns the cull callbacks of the drawables that have one.
    #[inline(always)]
    pub(crate) fn drawable_callbacks(&self) -> &SparseList<CullCallback> {
        self.drawables.cull_callbacks()
    }

    /// Returns true if some drawable has no transform above it.
    #[inline(always)]
    pub(crate) fn uses_page_frame(&self) -> bool {
        self.drawables.uses_page_frame()
    }

    #[inline(always)]
    pub(crate) fn transforms(&self) -> &Transforms {
        &self.transforms
    }

    #[inline(always)]
    pub(crate) fn state_paths(&self) -> &[StatePath] {
        self.states.paths()
    }

    #[inline(always)]
    pub(crate) fn state_sets(&self) -> &[Arc<StateSet>] {
        self.states.state_sets()
    }

    #[inline(always)]
    pub(crate) fn tiles(&self) -> &Tiles {
        &self.tiles
    }

    /// Returns the draw slots of a context, in drawable order; empty if the page was not uploaded there.
    pub(crate) fn draw_slots_of(&self, context: u32) -> &[DrawSlot] {
        self.payload.draw_slots().iter().find(|(c, _)| *c == context).map_or(&[], |(_, slots)| slots)
    }

    /// Returns true if a cull must know the eye's position in the page's frame.
    pub(crate) fn needs_eye(&self) -> bool {
        let has_callbacks = !self.extras.cull_callbacks.is_empty() || !self.drawable_callbacks().is_empty();
        has_callbacks || !self.lods().is_empty() || !self.normal_cones().is_empty()
    }
}

/// Nodes and their payloads.
impl Page {
    /// Returns the number of nodes.
    pub fn node_count(&self) -> usize {
        self.nodes.node_count()
    }

    /// Returns true if the page holds tiles: an external tileset. A tile whose content is such a page is always refined.
    pub fn is_tile_tree(&self) -> bool {
        !self.tiles.is_empty()
    }

    /// Returns the tile of a node, if it is one.
    pub(crate) fn tile_of(&self, node: u32) -> Option<usize> {
        self.nodes.payload_of(node, kind::TILE)
    }

    /// Returns the values of a camera node; `None` for all other nodes.
    pub(crate) fn camera(&self, node: u32) -> Option<&CameraNode> {
        match self.rare_nodes().get(self.nodes.payload_of(node, kind::SPECIAL)?)? {
            RareNode::Camera { camera, .. } => Some(camera),
            _ => None,
        }
    }

    /// Returns a node and those above it, each with the node below it on the path.
    pub(crate) fn path_to_root(&self, node: u32) -> impl Iterator<Item = (u32, Option<u32>)> + '_ {
        self.nodes.path_to_root(node)
    }

    /// Returns the transform in whose frame a node lies.
    pub(crate) fn enclosing_transform(&self, node: u32) -> u32 {
        let (nodes, parents) = (self.nodes(), self.parents());
        let mut at = parents[node as usize];
        while let Some(record) = nodes.get(at as usize) {
            let is_absolute = record.kind == kind::SPECIAL
                && matches!(
                    self.rare_nodes().get(self.payloads()[at as usize] as usize),
                    Some(RareNode::AbsoluteTransform)
                );
            if record.kind == kind::TRANSFORM || is_absolute {
                return record.first_transform;
            }
            at = parents[at as usize];
        }
        0
    }

    /// Returns the visibility of a Switch's children, to be changed.
    pub(crate) fn switch_mut(&mut self, node: u32) -> Option<&mut [bool]> {
        self.tables.switch_mut(self.nodes.payload_of(node, kind::SWITCH)?)
    }

    /// Returns the visibility of a Switch's children; `None` for other nodes.
    pub(crate) fn switch(&self, node: u32) -> Option<&[bool]> {
        Some(&self.switches()[self.nodes.payload_of(node, kind::SWITCH)?])
    }

    /// Returns false if a node is a Switch that hides one of its children.
    pub(crate) fn switch_shows(&self, node: u32, child: u32) -> bool {
        let shows = |switch: &[bool]| switch.get(self.child_index(node, child)).copied().unwrap_or(false);
        self.switch(node).is_none_or(shows)
    }

    /// Returns the position of a child among the children of a node.
    pub(crate) fn child_index(&self, node: u32, child: u32) -> usize {
        self.nodes.children(node as usize).take_while(|at| *at < child as usize).count()
    }

    /// Returns true if OccluderNodes are below a node.
    pub(crate) fn has_occluders_below(&self, node: u32) -> bool {
        self.tables.has_occluders_in(node, node + self.nodes()[node as usize].skip)
    }

    /// Returns the nodes that have names, in depth-first order.
    pub(crate) fn names(&self) -> &[(Box<str>, u32)] {
        self.extras.names()
    }

    /// Returns the attributions of what the page shows: of its content, and of the overlays over it.
    pub fn credits(&self) -> &[Arc<str>] {
        self.extras.credits()
    }

    /// Sets the attributions.
    pub(crate) fn set_credits(&mut self, credits: Vec<Arc<str>>) {
        self.extras.set_credits(credits);
    }

    /// Returns the ellipsoid that the page's tiles lie on, if they lie on one: that of its tile set, else WGS84.
    pub fn ellipsoid(&self) -> Ellipsoid {
        self.extras.ellipsoid()
    }

    /// Sets the ellipsoid, for pages that an application builds for another body than the earth.
    pub fn set_ellipsoid(&mut self, ellipsoid: Ellipsoid) {
        self.extras.set_ellipsoid(ellipsoid);
    }

    /// Returns the metadata of a node, if it has any.
    pub(in crate::scene) fn metadata(&self, node: u32) -> Option<&TileMetadata> {
        self.extras.metadata(node)
    }

    /// Returns the update callbacks, sorted by node.
    pub(crate) fn update_callbacks(&self) -> &SparseList<UpdateCallback> {
        &self.extras.update_callbacks
    }

    pub(crate) fn update_callbacks_mut(&mut self) -> &mut SparseList<UpdateCallback> {
        &mut self.extras.update_callbacks
    }

    /// Returns the event callbacks, sorted by node.
    pub(crate) fn event_callbacks(&self) -> &SparseList<EventCallback> {
        &self.extras.event_callbacks
    }

    pub(crate) fn event_callbacks_mut(&mut self) -> &mut SparseList<EventCallback> {
        &mut self.extras.event_callbacks
    }

    /// Returns true if the page uses a state set.
    pub(crate) fn has_state_set(&self, set: &Arc<StateSet>) -> bool {
        self.state_sets().iter().any(|of| Arc::ptr_eq(of, set))
    }

    /// Returns the state sets, to be replaced by others.
    pub(crate) fn state_sets_mut(&mut self) -> &mut [Arc<StateSet>] {
        self.states.state_sets_mut()
    }
}

/// Slots of tiles and the pages in them.
impl Page {
    pub(crate) fn tiles_mut(&mut self) -> &mut Tiles {
        &mut self.tiles
    }

    /// Returns the number of pages in this page's slots.
    pub(crate) fn attached_pages(&self) -> u32 {
        self.attached_pages
    }

    /// Counts a page that was attached to one of the slots.
    pub(crate) fn count_attached(&mut self) {
        self.attached_pages += 1;
    }

    /// Counts a page that was detached from one of the slots.
    pub(crate) fn count_detached(&mut self) {
        self.attached_pages -= 1;
    }
}

/// Drawables and their payloads.
impl Page {
    /// Returns the number of drawables, whether their payloads were taken or not.
    pub fn drawable_count(&self) -> usize {
        self.drawables.len()
    }

    /// Takes the payloads in drawable order, to be uploaded; their bounds stay in the page.
    pub fn take_drawables(&mut self) -> Vec<Drawable> {
        self.payload.take()
    }

    /// Returns the features of a drawable; `None` if it has none, or if its content was read without
    /// [`ReadOptions::keep_features`](crate::formats::ReadOptions::keep_features).
    pub fn features(&self, drawable: u32) -> Option<&DrawableFeatures> {
        self.payload.features(drawable).map(|features| &**features)
    }

    /// Puts back payloads that were taken, all of them or none.
    pub(crate) fn put_drawables(&mut self, drawables: Vec<Drawable>) {
        self.payload.put(drawables);
    }

    /// Returns the payloads in drawable order; empty once they were taken.
    pub(crate) fn drawables(&self) -> &[Drawable] {
        self.payload.drawables()
    }

    /// Builds a k-d tree over the primitives of each drawable, which stays when the payloads are taken: about 20 bytes a
    /// triangle, 3 a triangle of a height tile. Without one, intersections meet a drawable only while its payload is in
    /// the page.
    pub fn build_kd_trees(&mut self) {
        if self.has_all_drawables() {
            self.payload.build_kd_trees();
        }
    }

    /// Stores the vertex formats of the drawables, for their upload.
    pub(crate) fn find_vertex_formats(&mut self) {
        self.payload.find_vertex_formats();
    }

    /// Returns true if no payload was taken.
    pub(crate) fn has_all_drawables(&self) -> bool {
        self.drawables().len() == self.drawable_count()
    }

    /// Returns the k-d tree of a drawable, if one was built.
    pub fn kd_tree(&self, drawable: u32) -> Option<&Arc<KdTree>> {
        self.payload.kd_tree(drawable)
    }

    /// Changes drawables, and their k-d trees if there are any, to shared ones.
    pub(crate) fn share_drawables(&mut self, share: impl FnMut(&mut Drawable, Option<&mut Option<Arc<KdTree>>>)) {
        self.payload.share(share);
    }

    /// Takes references to the shared contents of the drawables, so that they stay shared when the payloads are taken.
    pub(crate) fn hold_shared(&mut self) {
        self.payload.hold_shared();
    }

    /// Counts the textures of the page's state sets among its shared contents. Once, when the page is complete.
    pub(crate) fn hold_textures(&mut self) {
        let attributes = self.states.state_sets().iter().flat_map(|set| &set.attributes);
        let textures = attributes.filter_map(|(attribute, _)| match attribute {
            Attribute::Texture(_, binding) => Some(&binding.texture),
            _ => None,
        });
        self.payload.hold_textures(textures);
    }

    /// Returns the contents shared with other pages, each once.
    pub(crate) fn shared_contents(&self) -> &[SharedUse] {
        self.payload.shared()
    }

    /// Replaces the mesh that intersections meet.
    pub(crate) fn replace_mesh(&mut self, drawable: u32, mesh: &Arc<Mesh>) {
        let geometry = Geometry::Mesh(mesh.clone());
        self.payload.rebuild_kd_tree(drawable, || KdTree::build(&geometry).map(Arc::new));
        if let Some(kept) = self.payload.drawable_mut(drawable) {
            kept.geometry = geometry;
        }
    }

    /// Sets the draw slots of the page's drawables in a context, in drawable order.
    pub fn set_draw_slots(&mut self, context: u32, slots: Vec<DrawSlot>) {
        self.payload.set_draw_slots(context, slots);
    }

    /// Takes the draw slots of every context, to be released.
    pub fn take_draw_slots(&mut self) -> Vec<(u32, Vec<DrawSlot>)> {
        self.payload.take_draw_slots()
    }

    /// Drops the draw slots of a context that no longer exists.
    pub(crate) fn forget_context(&mut self, context: u32) {
        self.payload.forget_context(context);
    }

    /// Returns the families of compressed formats that the textures of the page's drawables need.
    pub(crate) fn block_formats(&self) -> BlockFormats {
        self.payload.block_formats()
    }

    /// Returns the bytes of CPU memory that the page holds, including payloads that were not taken.
    pub fn size_bytes(&self) -> u64 {
        let arrays = self.nodes.size_bytes()
            + self.nodes().len() * size_of::<Vec4>()
            + self.drawables.size_bytes()
            + self.states.size_bytes()
            + self.tables.size_bytes()
            + self.extras.size_bytes();
        (size_of::<Self>() + arrays) as u64
            + self.transforms.size_bytes()
            + self.tiles.size_bytes()
            + self.payload.size_bytes()
    }

    /// Returns [`Self::size_bytes`] without what other pages share.
    pub(crate) fn own_bytes(&self) -> u64 {
        self.size_bytes().saturating_sub(self.payload.shared_tree_bytes())
    }
}
