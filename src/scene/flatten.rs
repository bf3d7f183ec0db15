//! Turning a tree of [`Node`] values into a [`Page`]. Decode workers; not frame time.

use std::collections::HashMap;
use std::sync::Arc;

use glam::{DAffine3, DVec3, Vec4};

use super::error::SceneError;
use super::geometry::{AlphaMode, Drawable};
use super::kinds::Billboard;
use super::lod_ranges::LodRecord;
use super::node::{Node, NodeKind};
use super::page::{
    BLEND, Boxes4, CALLBACK, DrawableRef, INACTIVE, LARGE, NONE, NodeRecord, PLAIN, Page, Special, StatePath, UNCULLED,
    VIEW, kind,
};
use super::tile_bounds::DeclaredBounds;
use super::tiles::{TileRoot, Tiles};
use super::transforms::Transforms;
use crate::math::{Aabb, BoundingSphere};
use crate::state::{Mode, StateSet, StateValue};

/// Deepest graph a page takes; deeper input is refused, so that no walk can exhaust a stack.
pub const MAX_DEPTH: usize = 512;

/// A node whose children are still being flattened.
struct Open {
    children: std::vec::IntoIter<Node>,
    node: u32,
    transform: u32,
    path: u32,
    tile: u32,
}

struct Flattener {
    page: Page,
    /// Of tiles, in the order they were met.
    declared: Vec<DeclaredBounds>,
    path_of: HashMap<(u32, u32), u32>,
    set_of: HashMap<usize, u32>,
}

impl Page {
    /// Flattens a tree of nodes. Refuses what is not a tile below a tile, and graphs deeper than [`MAX_DEPTH`].
    pub fn from_node(root: Node) -> Result<Page, SceneError> {
        let mut flattener = Flattener::new();
        let mut open = Vec::new();
        match flattener.flatten(root, &mut open) {
            Ok(()) => flattener.finish(),
            Err(error) => {
                // What was not reached may be too deep for a recursive drop.
                let mut rest: Vec<Node> = open.into_iter().flat_map(|o: Open| o.children).collect();
                while let Some(mut node) = rest.pop() {
                    rest.append(&mut node.children);
                }
                Err(error)
            }
        }
    }
}

impl Flattener {
    fn new() -> Self {
        Self {
            page: Page {
                nodes: Vec::new(),
                spheres: Vec::new(),
                stale: Vec::new(),
                fitted_spheres: 0,
                parents: Vec::new(),
                masks: Vec::new(),
                payloads: Vec::new(),
                switches: Vec::new(),
                lods: Vec::new(),
                specials: Vec::new(),
                names: Vec::new(),
                callbacks: Vec::new(),
                update_callbacks: Vec::new(),
                event_callbacks: Vec::new(),
                occluders: Vec::new(),
                clusters: Vec::new(),
                transforms: Transforms::new(),
                boxes: Vec::new(),
                local_boxes: Vec::new(),
                drawable_refs: Vec::new(),
                paths: vec![StatePath { parent: NONE, set: NONE }],
                state_sets: Vec::new(),
                tiles: Tiles::default(),
                tile_root_spheres: Vec::new(),
                origin: DVec3::ZERO,
                uses_page_frame: false,
                drawables: Vec::new(),
                payload_bytes: 0,
                kd_trees: Vec::new(),
                draw_slots: Vec::new(),
                shared: Vec::new(),
                shared_tree_bytes: 0,
                attached_pages: 0,
            },
            declared: Vec::new(),
            path_of: HashMap::new(),
            set_of: HashMap::new(),
        }
    }

    fn flatten(&mut self, root: Node, open: &mut Vec<Open>) -> Result<(), SceneError> {
        let first = self.add(root, None)?;
        open.push(first);
        while let Some(top) = open.last_mut() {
            match top.children.next() {
                Some(child) => {
                    let above = (top.node, top.transform, top.path, top.tile);
                    if open.len() >= MAX_DEPTH {
                        let grandchildren = child.children.into_iter();
                        open.push(Open { children: grandchildren, node: 0, transform: 0, path: 0, tile: NONE });
                        return Err(SceneError::TooDeep { limit: MAX_DEPTH });
                    }
                    let next = self.add(child, Some(above))?;
                    open.push(next);
                }
                None => {
                    let node = top.node as usize;
                    self.page.nodes[node].skip = (self.page.nodes.len() - node) as u32;
                    open.pop();
                }
            }
        }
        Ok(())
    }

    fn add(&mut self, node: Node, above: Option<(u32, u32, u32, u32)>) -> Result<Open, SceneError> {
        let (parent, mut transform, above_path, mut tile) = above.unwrap_or((NONE, 0, 0, NONE));
        let Node { kind: node_kind, state_set, mask, culling_active, cull_callback, children, name, .. } = node;
        let children = children.into_iter();
        let index = u32::try_from(self.page.nodes.len()).ok().filter(|i| *i < NONE - 1).ok_or(SceneError::TooLarge)?;
        let first_drawable =
            u32::try_from(self.page.drawable_refs.len()).ok().filter(|i| *i < NONE / 2).ok_or(SceneError::TooLarge)?;
        let first_transform = self.page.transforms.len() as u32;
        let mut path = match state_set {
            Some(set) => self.path_below(above_path, set),
            None => above_path,
        };
        if tile != NONE && !matches!(node_kind, NodeKind::PagedLod(_) | NodeKind::ProxyNode(_)) {
            discard(children);
            return Err(SceneError::TileChild { kind: kind_name(&node_kind) });
        }
        if !name.is_empty() {
            self.page.names.push((name.into_boxed_str(), index));
        }
        let mut payload = NONE;
        let mut flags = if culling_active { 0 } else { INACTIVE | UNCULLED };
        if let Some(callback) = cull_callback {
            flags |= CALLBACK;
            self.page.callbacks.push((index, callback));
        }
        self.page.update_callbacks.extend(node.update_callback.map(|c| (index, c)));
        self.page.event_callbacks.extend(node.event_callback.map(|c| (index, c)));
        let code = match node_kind {
            NodeKind::Group => kind::GROUP,
            NodeKind::Transform(parent_from_child) => {
                let map = if parent_from_child.is_finite() { parent_from_child } else { DAffine3::IDENTITY };
                transform = self.page.transforms.push(transform, map);
                kind::TRANSFORM
            }
            NodeKind::Geode(drawables) => {
                for drawable in drawables {
                    self.add_drawable(drawable, transform, path);
                }
                kind::GEODE
            }
            NodeKind::Switch(shown) => {
                payload = self.page.switches.len() as u32;
                self.page.switches.push(shown.into_boxed_slice());
                kind::SWITCH
            }
            NodeKind::Lod { center, ranges_m } => {
                payload = self.page.lods.len() as u32;
                self.page.lods.push(LodRecord { center, radius_m: None, ranges: ranges_m.into_boxed_slice() });
                kind::LOD
            }
            NodeKind::LodByPixelSize { center, radius_m, ranges_px } => {
                payload = self.page.lods.len() as u32;
                let radius_m = Some(radius_m);
                self.page.lods.push(LodRecord { center, radius_m, ranges: ranges_px.into_boxed_slice() });
                kind::LOD
            }
            NodeKind::PagedLod(lod) => {
                payload = self.page.tiles.len() as u32;
                let (declared, sphere) = self.page.tiles.push_paged_lod(tile, index, path, *lod);
                self.declared.push(declared);
                self.note_tile_root(tile, TileRoot { tile: payload, transform, state_path: path }, sphere);
                tile = payload;
                kind::TILE
            }
            NodeKind::ProxyNode(proxy) => {
                payload = self.page.tiles.len() as u32;
                let (declared, sphere) = self.page.tiles.push_proxy(tile, index, path, *proxy);
                self.declared.push(declared);
                self.note_tile_root(tile, TileRoot { tile: payload, transform, state_path: path }, sphere);
                tile = payload;
                kind::TILE
            }
            NodeKind::Billboard(billboard) => {
                let Billboard { mode, drawables } = *billboard;
                let mut positions = Vec::with_capacity(drawables.len());
                let mut bounds = Vec::with_capacity(drawables.len());
                for (position, drawable) in drawables {
                    bounds.push(drawable.bounds());
                    self.add_drawable(drawable, transform, path);
                    positions.push(position);
                }
                payload = self.special(Special::Billboard { mode, positions, bounds });
                kind::SPECIAL
            }
            NodeKind::LightSource(light) => {
                payload = self.special(Special::LightSource(*light));
                // It shines wherever its own bound is.
                flags |= INACTIVE;
                kind::SPECIAL
            }
            NodeKind::ClipNode(clip) => {
                let mut set = StateSet::default();
                for (number, _) in &clip.planes {
                    // Those that there are not, draw tells of.
                    if Mode::ClipPlane(*number).check().is_ok() {
                        set.set_mode(Mode::ClipPlane(*number), StateValue::ON);
                    }
                }
                path = self.path_below(path, Arc::new(set));
                payload = self.special(Special::ClipNode(*clip));
                kind::SPECIAL
            }
            NodeKind::TexGenNode(texgen) => {
                payload = self.special(Special::TexGenNode(*texgen));
                flags |= INACTIVE;
                kind::SPECIAL
            }
            NodeKind::ClearNode(clear) => {
                payload = self.special(Special::ClearNode(clear));
                flags |= INACTIVE;
                kind::SPECIAL
            }
            NodeKind::Camera(camera) => {
                path = self.view_path(path);
                flags |= INACTIVE;
                payload = self.special(Special::Camera { camera, path });
                kind::SPECIAL
            }
            NodeKind::Projection(clip_from_eye) => {
                path = self.view_path(path);
                flags |= INACTIVE;
                payload = self.special(Special::Projection { clip_from_eye, path });
                kind::SPECIAL
            }
            NodeKind::AbsoluteTransform(eye_from_child) => {
                let map = if eye_from_child.is_finite() { eye_from_child } else { DAffine3::IDENTITY };
                transform = self.page.transforms.push(transform, map);
                flags |= INACTIVE;
                payload = self.special(Special::AbsoluteTransform);
                kind::SPECIAL
            }
            NodeKind::OccluderNode(occluder) => {
                self.page.occluders.push((index, transform, *occluder));
                payload = self.special(Special::Occluder);
                kind::SPECIAL
            }
            NodeKind::OcclusionQueryNode(query) => {
                payload = self.special(Special::OcclusionQuery(*query));
                kind::SPECIAL
            }
        };
        self.page.nodes.push(NodeRecord { skip: 1, first_drawable, first_transform, kind: code, flags });
        self.page.parents.push(parent);
        self.page.masks.push(mask);
        self.page.payloads.push(payload);
        Ok(Open { children, node: index, transform, path, tile })
    }

    fn note_tile_root(&mut self, parent: u32, root: TileRoot, sphere: BoundingSphere) {
        if parent == NONE {
            self.page.tiles.roots.push(root);
            self.page.tile_root_spheres.push(sphere);
        }
    }

    fn special(&mut self, special: Special) -> u32 {
        self.page.specials.push(special);
        self.page.specials.len() as u32 - 1
    }

    /// A path of its own for what has another view.
    fn view_path(&mut self, parent: u32) -> u32 {
        self.page.paths.push(StatePath { parent, set: VIEW });
        self.page.paths.len() as u32 - 1
    }

    fn add_drawable(&mut self, drawable: Drawable, transform: u32, path: u32) {
        let blends = matches!(drawable.material.alpha, AlphaMode::Blend);
        let state_path = if blends { self.path_to(path, BLEND) } else { path };
        self.page.uses_page_frame |= transform == 0;
        self.page.local_boxes.push(drawable.bounds());
        if let Some(cone) = drawable.cluster {
            self.page.clusters.push((self.page.drawable_refs.len() as u32, cone));
        }
        self.page.drawable_refs.push(DrawableRef { state_path, transform });
        self.page.payload_bytes += drawable.size_bytes();
        self.page.drawables.push(drawable);
    }

    fn path_below(&mut self, parent: u32, set: Arc<StateSet>) -> u32 {
        let sets = &mut self.page.state_sets;
        let index = *self.set_of.entry(Arc::as_ptr(&set) as usize).or_insert_with(|| {
            sets.push(set);
            sets.len() as u32 - 1
        });
        self.path_to(parent, index)
    }

    fn path_to(&mut self, parent: u32, set: u32) -> u32 {
        let paths = &mut self.page.paths;
        *self.path_of.entry((parent, set)).or_insert_with(|| {
            paths.push(StatePath { parent, set });
            paths.len() as u32 - 1
        })
    }

    fn finish(self) -> Result<Page, SceneError> {
        let mut page = self.page;
        let count = page.nodes.len();
        page.nodes.push(NodeRecord {
            skip: 1,
            first_drawable: page.drawable_refs.len() as u32,
            first_transform: page.transforms.len() as u32,
            kind: kind::GROUP,
            flags: 0,
        });
        let mut plain = vec![true; count];
        for node in (0..count).rev() {
            let record = &page.nodes[node];
            let own = record.first_drawable..page.nodes[node + 1].first_drawable;
            let clustered = page.clusters.partition_point(|(d, _)| *d < own.start);
            let has_cluster = page.clusters.get(clustered).is_some_and(|(d, _)| *d < own.end);
            plain[node] &= matches!(record.kind, kind::GROUP | kind::TRANSFORM | kind::GEODE)
                && page.masks[node] == u32::MAX
                && record.flags == 0
                && !has_cluster;
            let is_large = record.kind == kind::TILE || record.flags & (INACTIVE | LARGE) != 0;
            let of_parent = record.flags & INACTIVE | if is_large { LARGE } else { 0 };
            page.nodes[node].flags |= of_parent;
            if page.parents[node] != NONE {
                page.nodes[page.parents[node] as usize].flags |= of_parent;
            }
            if plain[node] {
                page.nodes[node].flags |= PLAIN;
            } else if page.parents[node] != NONE {
                plain[page.parents[node] as usize] = false;
            }
        }
        if page.masks.iter().all(|m| *m == u32::MAX) {
            page.masks = Vec::new();
        }
        if page.payloads.iter().all(|p| *p == NONE) {
            page.payloads = Vec::new();
        }
        let places = page.tiles.lay_siblings_together(&self.declared);
        for (node, payload) in page.nodes.iter().zip(&mut page.payloads) {
            if node.kind == kind::TILE {
                *payload = places[*payload as usize];
            }
        }
        page.tiles.count_readiness();
        page.transforms.shrink();
        page.fit_billboards(0, count);
        page.origin = middle(&page);
        let four = Boxes4 { center: [Vec4::ZERO; 3], half: [Vec4::ZERO; 3] };
        page.boxes = vec![four; page.drawable_refs.len().div_ceil(4)];
        page.fit_boxes(0, page.drawable_refs.len());
        page.spheres = vec![Vec4::ZERO; count];
        page.fit_spheres(0, count);
        Ok(page)
    }
}

/// The middle of everything that has a bound: coordinates relative to it are as small as can be.
fn middle(page: &Page) -> DVec3 {
    let mut around = Aabb::EMPTY;
    for drawable in 0..page.drawable_refs.len() {
        if let Some(b) = page.box_in_page(drawable) {
            around = around.union(&b);
        }
    }
    for (root, sphere) in page.tiles.roots.iter().zip(&page.tile_root_spheres) {
        let s = sphere.transformed(&page.transforms.page_from_node(root.transform));
        if s.center.is_finite() && s.radius_m >= 0.0 && s.radius_m.is_finite() {
            let r = DVec3::splat(s.radius_m);
            around = around.union(&Aabb { min: s.center - r, max: s.center + r });
        }
    }
    let center = around.center();
    if around.is_empty() || !center.is_finite() { DVec3::ZERO } else { center }
}

/// Drops nodes without recursion.
fn discard(children: std::vec::IntoIter<Node>) {
    let mut rest: Vec<Node> = children.collect();
    while let Some(mut node) = rest.pop() {
        rest.append(&mut node.children);
    }
}

fn kind_name(kind: &NodeKind) -> &'static str {
    match kind {
        NodeKind::Group => "Group",
        NodeKind::Transform(_) => "Transform",
        NodeKind::AbsoluteTransform(_) => "AbsoluteTransform",
        NodeKind::Projection(_) => "Projection",
        NodeKind::Switch(_) => "Switch",
        NodeKind::Lod { .. } => "Lod",
        NodeKind::LodByPixelSize { .. } => "LodByPixelSize",
        NodeKind::PagedLod(_) => "PagedLod",
        NodeKind::ProxyNode(_) => "ProxyNode",
        NodeKind::Geode(_) => "Geode",
        NodeKind::Billboard(_) => "Billboard",
        NodeKind::LightSource(_) => "LightSource",
        NodeKind::ClipNode(_) => "ClipNode",
        NodeKind::TexGenNode(_) => "TexGenNode",
        NodeKind::ClearNode(_) => "ClearNode",
        NodeKind::Camera(_) => "Camera",
        NodeKind::OccluderNode(_) => "OccluderNode",
        NodeKind::OcclusionQueryNode(_) => "OcclusionQueryNode",
    }
}
