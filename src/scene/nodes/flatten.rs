//! Turning a tree of [`Node`] values into a [`Page`]. Decode workers (any thread); not frame-time code.

use std::sync::Arc;

use super::billboard::Billboard;
use super::node::{Node, NodeKind};
use super::node_payloads::ClipNode;
use crate::math::BoundingSphere;
use crate::scene::error::SceneError;
use crate::scene::id::NONE;
use crate::scene::pages::{CALLBACK, INACTIVE, Page, PageBuilder, RareNode, UNCULLED, kind};
use crate::scene::settings::LodRecord;
use crate::state::{Mode, StateSet, StateValue};

/// The maximum depth of a graph. Deeper input is refused, so that no walk can exhaust a stack.
pub const MAX_DEPTH: usize = 512;

/// The values that nodes inherit from the node above.
#[derive(Clone, Copy)]
struct Inherited {
    node: u32,
    transform: u32,
    /// The state path.
    path: u32,
    /// The tile above; `NONE` if there is none.
    tile: u32,
}

impl Inherited {
    /// The values for the root of a page.
    const ROOT: Self = Self { node: NONE, transform: 0, path: 0, tile: NONE };
}

/// A node whose children are still being flattened, with what they inherit.
struct Open {
    children: std::vec::IntoIter<Node>,
    inherited: Inherited,
}

impl Page {
    /// Flattens a tree of nodes. Fails if another node than a tile is below a tile, or the graph is deeper than
    /// [`MAX_DEPTH`] or too large.
    pub fn from_node(root: Node) -> Result<Page, SceneError> {
        let mut builder = PageBuilder::new();
        let mut open = Vec::new();
        match flatten(&mut builder, root, &mut open) {
            Ok(()) => Ok(builder.finish()),
            Err(error) => {
                // The nodes that were not reached may be too deep for a recursive drop.
                open.into_iter().for_each(|open| discard(open.children));
                Err(error)
            }
        }
    }
}

impl Node {
    /// Returns a sphere around everything below the node, in the frame that the node is in. It is empty if nothing has a
    /// bound, or if no page can be made of the graph. Visits the whole graph.
    pub fn bounding_sphere(&self) -> BoundingSphere {
        Page::from_node(self.clone()).map_or(BoundingSphere::EMPTY, |page| page.bounding_sphere())
    }
}

fn flatten(builder: &mut PageBuilder, root: Node, open: &mut Vec<Open>) -> Result<(), SceneError> {
    let first = add(builder, root, Inherited::ROOT)?;
    open.push(first);
    while let Some(top) = open.last_mut() {
        match top.children.next() {
            Some(child) => {
                let inherited = top.inherited;
                if open.len() >= MAX_DEPTH {
                    open.push(Open { children: child.children.into_iter(), inherited });
                    return Err(SceneError::TooDeep { limit: MAX_DEPTH });
                }
                let next = add(builder, child, inherited)?;
                open.push(next);
            }
            None => {
                builder.close_subtree(top.inherited.node);
                open.pop();
            }
        }
    }
    Ok(())
}

/// Adds a node without its children.
fn add(builder: &mut PageBuilder, node: Node, above: Inherited) -> Result<Open, SceneError> {
    let Node { kind: node_kind, state_set, mask, culling_active, cull_callback, children, name, .. } = node;
    let children = children.into_iter();
    let start = builder.start_node()?;
    let index = start.node;
    let Inherited { node: parent, mut transform, mut path, mut tile } = above;
    if let Some(set) = state_set {
        path = builder.path_below(path, set);
    }
    if tile != NONE && !is_tile(&node_kind) {
        discard(children);
        return Err(SceneError::TileChild { kind: kind_name(&node_kind) });
    }
    builder.push_name(index, name);
    let mut flags = if culling_active { 0 } else { INACTIVE | UNCULLED };
    if let Some(callback) = cull_callback {
        flags |= CALLBACK;
        builder.push_cull_callback(index, callback, path);
    }
    if let Some(callback) = node.update_callback {
        builder.push_update_callback(index, callback);
    }
    if let Some(callback) = node.event_callback {
        builder.push_event_callback(index, callback);
    }
    if let Some(metadata) = node.metadata {
        builder.push_metadata(index, metadata);
    }
    let mut payload = NONE;
    let code = match node_kind {
        NodeKind::Group => kind::GROUP,
        NodeKind::Transform(parent_from_child) => {
            transform = builder.push_transform(transform, parent_from_child);
            kind::TRANSFORM
        }
        NodeKind::Geode(drawables) => {
            for drawable in drawables {
                builder.push_drawable(drawable, transform, path);
            }
            kind::GEODE
        }
        NodeKind::Switch(shown) => {
            payload = builder.push_switch(shown);
            kind::SWITCH
        }
        NodeKind::Lod { center, ranges_m } => {
            payload = builder.push_lod(LodRecord { center, radius_m: None, ranges: ranges_m.into_boxed_slice() });
            kind::LOD
        }
        NodeKind::LodByPixelSize { center, radius_m, ranges_px } => {
            let ranges = ranges_px.into_boxed_slice();
            payload = builder.push_lod(LodRecord { center, radius_m: Some(radius_m), ranges });
            kind::LOD
        }
        NodeKind::PagedLod(lod) | NodeKind::MultiContentTile(lod) => {
            payload = builder.push_paged_lod(tile, index, transform, path, *lod);
            tile = payload;
            kind::TILE
        }
        NodeKind::ProxyNode(proxy) => {
            payload = builder.push_proxy(tile, index, transform, path, *proxy);
            tile = payload;
            kind::TILE
        }
        NodeKind::Billboard(billboard) => {
            payload = add_billboard(builder, *billboard, transform, path);
            kind::SPECIAL
        }
        NodeKind::LightSource(light) => {
            payload = builder.push_rare(RareNode::LightSource(*light));
            // A light has an effect outside its own bound.
            flags |= INACTIVE;
            kind::SPECIAL
        }
        NodeKind::LocalLights(lights) => {
            path = builder.lights_path(path);
            payload = builder.push_rare(RareNode::LocalLights { lights: Arc::new(lights), path });
            kind::SPECIAL
        }
        NodeKind::ClipNode(clip) => {
            path = builder.path_below(path, Arc::new(modes_of(&clip)));
            payload = builder.push_rare(RareNode::ClipNode(*clip));
            kind::SPECIAL
        }
        NodeKind::TexGenNode(texgen) => {
            payload = builder.push_rare(RareNode::TexGenNode(*texgen));
            flags |= INACTIVE;
            kind::SPECIAL
        }
        NodeKind::ClearNode(clear) => {
            payload = builder.push_rare(RareNode::ClearNode(clear));
            flags |= INACTIVE;
            kind::SPECIAL
        }
        NodeKind::Camera(camera) => {
            path = builder.view_path(path);
            flags |= INACTIVE;
            payload = builder.push_rare(RareNode::Camera { camera, path });
            kind::SPECIAL
        }
        NodeKind::Projection(clip_from_eye) => {
            path = builder.view_path(path);
            flags |= INACTIVE;
            payload = builder.push_rare(RareNode::Projection { clip_from_eye, path });
            kind::SPECIAL
        }
        NodeKind::AbsoluteTransform(eye_from_child) => {
            transform = builder.push_transform(transform, eye_from_child);
            flags |= INACTIVE;
            payload = builder.push_rare(RareNode::AbsoluteTransform);
            kind::SPECIAL
        }
        NodeKind::OccluderNode(occluder) => {
            builder.push_occluder(index, transform, *occluder);
            payload = builder.push_rare(RareNode::Occluder);
            kind::SPECIAL
        }
        NodeKind::OcclusionQueryNode(query) => {
            payload = builder.push_rare(RareNode::OcclusionQuery(*query));
            kind::SPECIAL
        }
    };
    builder.push_node(start, code, flags, parent, mask, payload);
    Ok(Open { children, inherited: Inherited { node: index, transform, path, tile } })
}

/// Adds the drawables of a billboard under a transform and a path of state sets; returns the payload of its node.
fn add_billboard(builder: &mut PageBuilder, billboard: Billboard, transform: u32, path: u32) -> u32 {
    let Billboard { mode, auto_scale, drawables } = billboard;
    let mut positions = Vec::with_capacity(drawables.len());
    let mut bounds = Vec::with_capacity(drawables.len());
    for (position, drawable) in drawables {
        bounds.push(drawable.bounds());
        builder.push_drawable(drawable, transform, path);
        positions.push(position);
    }
    builder.push_rare(RareNode::Billboard { mode, auto_scale, positions, bounds })
}

/// Returns a state set that switches the planes of a clip node on. Draw reports plane numbers that are out of range.
fn modes_of(clip: &ClipNode) -> StateSet {
    let mut set = StateSet::default();
    for (number, _) in clip.planes.iter().filter(|(number, _)| Mode::ClipPlane(*number).check().is_ok()) {
        set.set_mode(Mode::ClipPlane(*number), StateValue::ON);
    }
    set
}

fn is_tile(kind: &NodeKind) -> bool {
    matches!(kind, NodeKind::PagedLod(_) | NodeKind::MultiContentTile(_) | NodeKind::ProxyNode(_))
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
        NodeKind::PagedLod(_) | NodeKind::MultiContentTile(_) => "PagedLod",
        NodeKind::ProxyNode(_) => "ProxyNode",
        NodeKind::Geode(_) => "Geode",
        NodeKind::Billboard(_) => "Billboard",
        NodeKind::LightSource(_) => "LightSource",
        NodeKind::LocalLights(_) => "LocalLights",
        NodeKind::ClipNode(_) => "ClipNode",
        NodeKind::TexGenNode(_) => "TexGenNode",
        NodeKind::ClearNode(_) => "ClearNode",
        NodeKind::Camera(_) => "Camera",
        NodeKind::OccluderNode(_) => "OccluderNode",
        NodeKind::OcclusionQueryNode(_) => "OcclusionQueryNode",
    }
}
