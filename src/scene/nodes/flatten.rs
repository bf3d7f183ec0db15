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
    let mut below = Inherited { node: index, ..above };
    if let Some(set) = state_set {
        below.path = builder.path_below(above.path, set);
    }
    if above.tile != NONE && !is_tile(&node_kind) {
        discard(children);
        return Err(SceneError::TileChild { kind: kind_name(&node_kind) });
    }
    builder.push_name(index, name);
    let mut flags = if culling_active { 0 } else { INACTIVE | UNCULLED };
    if has_effect_outside(&node_kind) {
        flags |= INACTIVE;
    }
    if let Some(callback) = cull_callback {
        flags |= CALLBACK;
        builder.push_cull_callback(index, callback, below.path);
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
    let (code, payload) = add_kind(builder, node_kind, &mut below);
    builder.push_node(start, code, flags, above.node, mask, payload);
    Ok(Open { children, inherited: below })
}

/// Adds the payload of a node's kind, and changes what the children inherit. Returns the code of the kind and the payload
/// of the node.
fn add_kind(builder: &mut PageBuilder, node_kind: NodeKind, below: &mut Inherited) -> (u8, u32) {
    let Inherited { node, transform, path, tile } = *below;
    let rare = match node_kind {
        NodeKind::Group => return (kind::GROUP, NONE),
        NodeKind::Transform(parent_from_child) => {
            below.transform = builder.push_transform(transform, parent_from_child);
            return (kind::TRANSFORM, NONE);
        }
        NodeKind::Geode(drawables) => {
            for drawable in drawables {
                builder.push_drawable(drawable, transform, path);
            }
            return (kind::GEODE, NONE);
        }
        NodeKind::Switch(shown) => return (kind::SWITCH, builder.push_switch(shown)),
        NodeKind::Lod { center, ranges_m } => {
            let ranges = ranges_m.into_boxed_slice();
            return (kind::LOD, builder.push_lod(LodRecord { center, radius_m: None, ranges }));
        }
        NodeKind::LodByPixelSize { center, radius_m, ranges_px } => {
            let ranges = ranges_px.into_boxed_slice();
            return (kind::LOD, builder.push_lod(LodRecord { center, radius_m: Some(radius_m), ranges }));
        }
        NodeKind::PagedLod(lod) | NodeKind::MultiContentTile(lod) => {
            below.tile = builder.push_paged_lod(tile, node, transform, path, *lod);
            return (kind::TILE, below.tile);
        }
        NodeKind::ProxyNode(proxy) => {
            below.tile = builder.push_proxy(tile, node, transform, path, *proxy);
            return (kind::TILE, below.tile);
        }
        NodeKind::Billboard(billboard) => add_billboard(builder, *billboard, transform, path),
        NodeKind::LightSource(light) => RareNode::LightSource(*light),
        NodeKind::LocalLights(lights) => {
            below.path = builder.lights_path(path);
            RareNode::LocalLights { lights: Arc::new(lights), path: below.path }
        }
        NodeKind::ClipNode(clip) => {
            below.path = builder.path_below(path, Arc::new(modes_of(&clip)));
            RareNode::ClipNode(*clip)
        }
        NodeKind::TexGenNode(texgen) => RareNode::TexGenNode(*texgen),
        NodeKind::ClearNode(clear) => RareNode::ClearNode(clear),
        NodeKind::Camera(camera) => {
            below.path = builder.view_path(path);
            RareNode::Camera { camera, path: below.path }
        }
        NodeKind::Projection(clip_from_eye) => {
            below.path = builder.view_path(path);
            RareNode::Projection { clip_from_eye, path: below.path }
        }
        NodeKind::AbsoluteTransform(eye_from_child) => {
            below.transform = builder.push_transform(transform, eye_from_child);
            RareNode::AbsoluteTransform
        }
        NodeKind::OccluderNode(occluder) => {
            builder.push_occluder(node, transform, *occluder);
            RareNode::Occluder
        }
        NodeKind::OcclusionQueryNode(query) => RareNode::OcclusionQuery(*query),
    };
    (kind::SPECIAL, builder.push_rare(rare))
}

/// Returns true for nodes that have an effect outside their own bound, so that they are visited wherever it lies.
fn has_effect_outside(kind: &NodeKind) -> bool {
    matches!(
        kind,
        NodeKind::LightSource(_)
            | NodeKind::TexGenNode(_)
            | NodeKind::ClearNode(_)
            | NodeKind::Camera(_)
            | NodeKind::Projection(_)
            | NodeKind::AbsoluteTransform(_)
    )
}

/// Adds the drawables of a billboard under a transform and a path of state sets, and returns its record.
fn add_billboard(builder: &mut PageBuilder, billboard: Billboard, transform: u32, path: u32) -> RareNode {
    let Billboard { mode, auto_scale, drawables } = billboard;
    let mut positions = Vec::with_capacity(drawables.len());
    let mut bounds = Vec::with_capacity(drawables.len());
    for (position, drawable) in drawables {
        bounds.push(drawable.bounds());
        builder.push_drawable(drawable, transform, path);
        positions.push(position);
    }
    RareNode::Billboard { mode, auto_scale, positions, bounds }
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
